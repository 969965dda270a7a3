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
    """Raised if a worker does not see the file of a model, or sees another one.

    args : its `Place` (path, size and time)
    """

    def __str__(self) -> str:
        return f"a worker does not see {self.args[0].path} or sees another file: save it where all workers see it"


class DroppedError(Exception):
    """Raised inside a job or task on a worker to end it: its result is no longer needed."""


@dataclass(frozen=True)
class JobSpec:
    """Specification of a job on a scene, sent to a worker.

    scene : unique name of the scene, key of the worker's cache
    work : module-level function that takes the scene's snapshot, `args`, shared values, a number of threads and a
        `Progress`
    value_count : number of shared values: objects that many jobs need, sent to each worker once, apart from the jobs
    """

    scene: str
    work: Callable[..., Any]
    args: tuple[Any, ...]
    value_count: int = 0


@dataclass(frozen=True)
class ScatteredModel:
    """Name of a model that was sent to workers by Dask's `scatter`; it does not concern scattered points.

    key : Dask's key of the model; scheduler : id of the workers' scheduler
    """

    key: str
    scheduler: str


@dataclass
class WorkerCache:
    """Scenes and models that a worker has made or loaded, for its next jobs.

    lock : held by the running job, as jobs run one at a time
    scenes : snapshots by the name of the scene; files : models by their file
    sent : models that a client has sent by Dask's `scatter`, as long as they are used
    """

    lock: threading.Lock = field(default_factory=threading.Lock)
    scenes: OrderedDict[str, Any] = field(default_factory=OrderedDict)
    files: OrderedDict[Place, Model] = field(default_factory=OrderedDict)
    sent: WeakValueDictionary[ScatteredModel, Model] = field(default_factory=WeakValueDictionary)

    def scene(self, name: str, recipe: bytes, baked: Any, models: Sequence[Model | Place | ScatteredModel]) -> Any:
        """Return the snapshot of a scene, from the cache or made from its parts.

        name : unique; recipe : the scene without models, from `write_recipe`; baked : light or None
        models : each as itself, as a file to load, or as the name of a model that workers have
        """
        return _get_or_make(self.scenes, name, SCENES, lambda: self._snapshot(recipe, baked, models))

    def _snapshot(self, recipe: bytes, baked: Any, models: Sequence[Model | Place | ScatteredModel]) -> Any:
        scene = read_recipe(recipe, [self._model(model) for model in models])
        scene.baked = baked
        return scene.snapshot()

    def _model(self, model: Model | Place | ScatteredModel) -> Model:
        """Return a model: loaded from its file (`Place`), fetched from workers (`ScatteredModel`), or given (`Model`).

        A `ScatteredModel` names a model that a client has sent to workers by Dask's `scatter`. Loaded and fetched
        models are taken from the cache if they are in it.
        """
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
    """Do a job on a Dask worker and return its result; None if it was cancelled.

    recipe : the scene without models, from `write_recipe`; baked : its light or None
    sent : models (or what was sent for them), then values that jobs share

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
    """Call `work` on a scene and return its result, one call at a time in this worker, or in this process without one.

    scene_of : returns the snapshot of the scene, given the cache
    work : called with the snapshot, `args`, a number of threads and a progress callback (None for both without a
        worker)
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
    """Return the Dask worker that runs the current thread, or None outside of workers."""
    distributed: Any = sys.modules.get("distributed")
    try:
        return None if distributed is None else distributed.get_worker()
    except ValueError:
        return None


def _fetch(sent: ScatteredModel) -> Model:
    """Fetch a model that a client has sent to workers (Dask's `scatter`); raise an error if they are lost."""
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
    """Load the model in a file; raise UnseenFileError if the file is missing here or has changed."""
    if not place.is_there:
        raise UnseenFileError(place)
    model = Model.load(place.path)
    if not place.leveled:
        model.levels = ()
    return model


def _get_or_make(cache: OrderedDict[K, T], key: K, most: int, make: Callable[[], T]) -> T:
    """Return the object with a key from a cache, or make it and add it to the cache.

    most : largest number of objects in the cache, beyond which the least recently used one is dropped
    make : called to make the object
    """
    if key not in cache:
        made = make()
        while len(cache) >= most:
            cache.popitem(last=False)
        cache[key] = made
    cache.move_to_end(key)
    return cache[key]


def _aligned(model: Model) -> Model:
    """Align the arrays of a model, which was received in a message, as kernels require; return the model."""
    for one in (model, *model.levels, *model.parts):
        if one.source is None:
            one.align_tree()
    return model
