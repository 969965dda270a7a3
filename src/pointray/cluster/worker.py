"""Code that runs on a worker: it builds a scene once, then does jobs on it, one at a time, with all of its threads.

Chunks of arrays are computed in the same way in threads and processes that are not workers.
"""

from __future__ import annotations

import sys
import threading
from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar
from weakref import WeakKeyDictionary, WeakValueDictionary

from ..base.version import __version__
from ..model.model import Model
from ..model.model_file import Place
from .recipe import read_recipe

SCENES, FILES = 2, 8  # scenes and files of models that a worker caches; the least recently used are dropped

K = TypeVar("K")
T = TypeVar("T")


class UnseenFileError(Exception):
    """Raised if the worker does not see the file of a model. args : its place"""

    def __str__(self) -> str:
        return f"a worker does not see {self.args[0].path} or sees another file: save it where all workers see it"


class DroppedError(Exception):
    """Raised if the result of a task is no longer needed."""


@dataclass(frozen=True)
class JobSpec:
    """Specification of a job.

    scene : name of the scene
    work : function of a module that takes the scene's snapshot, `args`, shared values, a number of threads and a
        `Progress`
    value_count : number of shared values
    """

    scene: str
    work: Callable[..., Any]
    args: tuple[Any, ...]
    value_count: int = 0


@dataclass(frozen=True)
class ScatteredModel:
    """A model that workers have. key : Dask's key; scheduler : id of their scheduler"""

    key: str
    scheduler: str


@dataclass
class WorkerCache:
    """Cache of a worker.

    lock : held by the running job; scenes : snapshots; files, sent : models
    """

    lock: threading.Lock = field(default_factory=threading.Lock)
    scenes: OrderedDict[str, Any] = field(default_factory=OrderedDict)
    files: OrderedDict[Place, Model] = field(default_factory=OrderedDict)
    sent: WeakValueDictionary[ScatteredModel, Model] = field(default_factory=WeakValueDictionary)

    def scene(self, name: str, recipe: bytes, baked: Any, models: Sequence[Model | Place | ScatteredModel]) -> Any:
        """Return the snapshot of a scene, which is cached."""
        return _get_or_make(self.scenes, name, SCENES, lambda: self._snapshot(recipe, baked, models))

    def _snapshot(self, recipe: bytes, baked: Any, models: Sequence[Model | Place | ScatteredModel]) -> Any:
        scene = read_recipe(recipe, [self._model(model) for model in models])
        scene.baked = baked
        return scene.snapshot()

    def _model(self, model: Model | Place | ScatteredModel) -> Model:
        """Return a model: passed along, fetched from a worker, or loaded from a file."""
        if isinstance(model, Place):
            return _get_or_make(self.files, model, FILES, lambda: _load(model))
        if isinstance(model, ScatteredModel):
            found = self.sent.get(model)
            if found is None:
                found = self.sent[model] = _aligned(_fetch(model))
            return found
        return _aligned(model)


_CACHES: WeakKeyDictionary[Any, WorkerCache] = WeakKeyDictionary()  # by worker: several may share a process
_LOCAL_CACHE = WorkerCache()  # for threads that are not Dask workers


def version_here() -> str:
    """Return the version of pointray in this process."""
    return __version__


def do_job(spec: JobSpec, recipe: bytes, baked: Any, *sent: Any) -> Any:
    """Do a job on a Dask worker and return its result. sent : models, then shared values

    Raises
    ------
    UnseenFileError
        If the file of a model is missing here.
    """
    models, values = sent[: len(sent) - spec.value_count], sent[len(sent) - spec.value_count :]
    return run_exclusively(
        lambda cache: cache.scene(spec.scene, recipe, baked, models), spec.work, (*spec.args, *values)
    )


def run_exclusively(scene_of: Callable[[WorkerCache], Any], work: Callable[..., Any], args: tuple[Any, ...]) -> Any:
    """Do work with exclusive use of the cache, in a task of a worker or in any other thread.

    scene_of : returns the scene from the cache; work : see `JobSpec`
    """
    worker = worker_here()
    if worker is None:
        with _LOCAL_CACHE.lock:
            return work(scene_of(_LOCAL_CACHE), *args, None, None)
    key, cache = worker.get_current_task(), _CACHES.setdefault(worker, WorkerCache())

    def check(share: float = 0.0) -> None:
        task = worker.state.tasks.get(key)
        if task is None or task.state == "cancelled":
            raise DroppedError

    with cache.lock:
        try:
            check()
            return work(scene_of(cache), *args, worker.state.nthreads, check)
        except DroppedError:
            return None


def worker_here() -> Any:
    """Return the Dask worker of this thread, or None."""
    distributed: Any = sys.modules.get("distributed")
    try:
        return None if distributed is None else distributed.get_worker()
    except ValueError:
        return None


def _fetch(sent: ScatteredModel) -> Model:
    """Fetch a model from the workers that have it."""
    distributed: Any = sys.modules["distributed"]
    client = distributed.get_client()
    if client.scheduler_info()["id"] != sent.scheduler:
        raise ValueError("a model was sent to the workers of another client: query the scene again with this one")
    future = distributed.Future(sent.key, client, state="memory")  # of a key that another client has made
    if not client.who_has([future])[sent.key]:
        raise RuntimeError("the workers that had a model are lost: query the scene again")
    model = future.result()
    assert isinstance(model, Model)
    return model


def _load(place: Place) -> Model:
    """Load the model in a file."""
    if not place.is_there:
        raise UnseenFileError(place)
    model = Model.load(place.path)
    if not place.leveled:
        model.levels = ()
    return model


def _get_or_make(cache: OrderedDict[K, T], key: K, most: int, make: Callable[[], T]) -> T:
    """Return an object from a cache, or make it and drop the least recently used one."""
    if key not in cache:
        made = make()
        while len(cache) >= most:
            cache.popitem(last=False)
        cache[key] = made
    cache.move_to_end(key)
    return cache[key]


def _aligned(model: Model) -> Model:
    """Align the arrays of a model for kernels, and return it."""
    for one in (model, *model.levels, *model.parts):
        if one.source is None:
            one.align_tree()
    return model
