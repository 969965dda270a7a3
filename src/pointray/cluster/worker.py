"""What runs on a worker: it makes the scene once, then does jobs for it, one at a time, each on all of its threads.

Chunks of arrays are made in the same way where there is no worker, by threads of this process or by other processes.
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

SCENES, FILES = 2, 8  # scenes that a worker keeps, and files of models; the least recently used ones go

K = TypeVar("K")
T = TypeVar("T")


class UnseenFileError(Exception):
    """The worker does not see the file of a model. args : its place"""

    def __str__(self) -> str:
        return f"a worker does not see {self.args[0].path}, or sees another file: save it where all see it"


class DroppedError(Exception):
    """Nobody wants the result any more."""


@dataclass(frozen=True)
class JobSpec:
    """What is wanted.

    scene : the name of the scene
    work : a function of a module, which takes the scene's snapshot, `args`, things that were sent before, a number of
    threads and a `Progress`
    things : how many there are of these
    """

    scene: str
    work: Callable[..., Any]
    args: tuple[Any, ...]
    things: int = 0


@dataclass(frozen=True)
class Sent:
    """A model that workers have. key : by which Dask knows it; scheduler : whose workers these are"""

    key: str
    scheduler: str


@dataclass
class WorkerCache:
    """What a worker keeps. A lock is held by the job that is at work.

    scenes : their snapshots; files, sent : models
    """

    lock: threading.Lock = field(default_factory=threading.Lock)
    scenes: OrderedDict[str, Any] = field(default_factory=OrderedDict)
    files: OrderedDict[Place, Model] = field(default_factory=OrderedDict)
    sent: WeakValueDictionary[Sent, Model] = field(default_factory=WeakValueDictionary)

    def scene(self, name: str, recipe: bytes, baked: Any, models: Sequence[Model | Place | Sent]) -> Any:
        """The snapshot of a scene, which is kept."""
        return _kept(self.scenes, name, SCENES, lambda: self._snapshot(recipe, baked, models))

    def _snapshot(self, recipe: bytes, baked: Any, models: Sequence[Model | Place | Sent]) -> Any:
        scene = read_recipe(recipe, [self._model(model) for model in models])
        scene.baked = baked
        return scene.snapshot()

    def _model(self, model: Model | Place | Sent) -> Model:
        """A model that Dask has brought, that it can fetch, or that is in a file."""
        if isinstance(model, Place):
            return _kept(self.files, model, FILES, lambda: _load(model))
        if isinstance(model, Sent):
            found = self.sent.get(model)
            if found is None:
                found = self.sent[model] = _aligned(_fetch(model))
            return found
        return _aligned(model)


_CACHES: WeakKeyDictionary[Any, WorkerCache] = WeakKeyDictionary()  # by worker: several may share a process
_HERE = WorkerCache()  # where there is no worker


def version_here() -> str:
    """The version of pointray in this process."""
    return __version__


def do_job(spec: JobSpec, recipe: bytes, baked: Any, *sent: Any) -> Any:
    """Do a job on a worker of Dask; returns what its work returns. sent : models, then other things

    Raises
    ------
    UnseenFileError
        If a model is to be read from a file that is not here.
    """
    models, things = sent[: len(sent) - spec.things], sent[len(sent) - spec.things :]
    return at_work(lambda cache: cache.scene(spec.scene, recipe, baked, models), spec.work, (*spec.args, *things))


def at_work(scene_of: Callable[[WorkerCache], Any], work: Callable[..., Any], args: tuple[Any, ...]) -> Any:
    """Do work of which there is one at a time: on a worker, as one of its tasks, or in any other thread.

    scene_of : makes the scene, given what is kept here; work : see `JobSpec`
    """
    worker = worker_here()
    if worker is None:
        with _HERE.lock:
            return work(scene_of(_HERE), *args, None, None)
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
    """The worker of Dask that this thread works for; None: it does not."""
    distributed: Any = sys.modules.get("distributed")
    try:
        return None if distributed is None else distributed.get_worker()
    except ValueError:
        return None


def _fetch(sent: Sent) -> Model:
    """A model from the workers that have it."""
    distributed: Any = sys.modules["distributed"]
    client = distributed.get_client()
    if client.scheduler_info()["id"] != sent.scheduler:
        raise ValueError("a model was sent to the workers of another client: ask the scene again, with this one")
    future = distributed.Future(sent.key, client, state="memory")  # as a client knows one that another client made
    if not client.who_has([future])[sent.key]:
        raise RuntimeError("the workers that had a model are lost: ask the scene again")
    model = future.result()
    assert isinstance(model, Model)
    return model


def _load(place: Place) -> Model:
    """The model in a file."""
    if not place.is_there:
        raise UnseenFileError(place)
    model = Model.load(place.path)
    if not place.leveled:
        model.levels = ()
    return model


def _kept(things: OrderedDict[K, T], key: K, most: int, make: Callable[[], T]) -> T:
    """A thing that is kept, or made and kept now."""
    if key not in things:
        made = make()
        while len(things) >= most:
            things.popitem(last=False)
        things[key] = made
    things.move_to_end(key)
    return things[key]


def _aligned(model: Model) -> Model:
    """A model whose arrays kernels can read."""
    for one in (model, *model.levels, *model.parts):
        if one.source is None:
            one.align_tree()
    return model
