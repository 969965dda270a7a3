"""What runs on a worker: it makes the scene once, then does jobs for it, one at a time, each on all of its threads."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, TypeVar
from weakref import WeakKeyDictionary

import numpy as np

from ..kernels.tree import Tree
from ..model import Model
from ..model_file import Place
from ..scene.world import Snapshot
from .recipe import read_recipe

SCENES, FILES = 2, 8  # scenes that a worker keeps, and files of models; the least recently used ones go

K = TypeVar("K")
T = TypeVar("T")


class UnseenFileError(Exception):
    """The worker does not see the file of a model. args : its place"""


class DroppedError(Exception):
    """Nobody wants the result any more."""


@dataclass(frozen=True)
class Ticket:
    """What is wanted.

    scene : the name of the scene
    work : a function of a module, which takes the scene's snapshot, `args`, a number of threads and a `Progress`
    """

    scene: str
    work: Callable[..., Any]
    args: tuple[Any, ...]


@dataclass
class _Bench:
    """What a worker keeps. A lock is held by the job that is at work."""

    lock: threading.Lock = field(default_factory=threading.Lock)
    scenes: OrderedDict[str, Snapshot] = field(default_factory=OrderedDict)
    files: OrderedDict[Place, Model] = field(default_factory=OrderedDict)


_BENCHES: WeakKeyDictionary[Any, _Bench] = WeakKeyDictionary()  # by worker: several may share a process


def version_here() -> str:
    """The version of pointray in this process."""
    import pointray

    return pointray.__version__


def do_job(ticket: Ticket, recipe: bytes, baked: Any, *models: Model | Place) -> Any:
    """Do a job on a worker of Dask; returns what its work returns.

    Raises
    ------
    UnseenFileError
        If a model is to be read from a file that is not here.
    """
    import distributed

    worker = distributed.get_worker()
    key, bench = worker.get_current_task(), _BENCHES.setdefault(worker, _Bench())

    def check(share: float = 0.0) -> None:
        task = worker.state.tasks.get(key)
        if task is None or task.state == "cancelled":
            raise DroppedError

    with bench.lock:
        try:
            check()
            scene = _kept(bench.scenes, ticket.scene, SCENES, lambda: _scene(bench, recipe, baked, models))
            return ticket.work(scene, *ticket.args, worker.state.nthreads, check)
        except DroppedError:
            return None


def _scene(bench: _Bench, recipe: bytes, baked: Any, models: tuple[Model | Place, ...]) -> Snapshot:
    """The scene of a recipe."""
    scene = read_recipe(recipe, [_model(bench, model) for model in models])
    scene.baked = baked
    return scene.snapshot()


def _model(bench: _Bench, model: Model | Place) -> Model:
    """A model that Dask has brought, or that is in a file."""
    if isinstance(model, Model):
        for one in (model, *model.levels, *model.parts):
            _align(one)
        return model
    return _kept(bench.files, model, FILES, lambda: _load(model))


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


def _align(model: Model) -> None:
    """Copy the arrays that kernels read of a model if they lie at odd addresses, as parts of a message."""
    if not all(array.flags.aligned for array in model.tree):
        model.tree = Tree(*(np.require(array, requirements=["A", "C", "W"]) for array in model.tree))
