"""A scene as the graph of an array of Dask carries it: itself within a process, else its recipe.

Whoever computes the graph pickles it. Then models go as the paths of their files, or as what the workers of the client
at hand have got already; where there is no such client, they go along.
"""

from __future__ import annotations

import hashlib
import sys
import uuid
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any
from weakref import WeakKeyDictionary

from ..model.model import Model
from ..model.model_file import Place
from .client import check_client
from .recipe import Stage, write_recipe
from .scattered_objects import ScatteredObject, ScatteredObjects, check_spreadable, scattered_objects_of
from .worker import Sent, UnseenFileError, WorkerCache, at_work, version_here

_NAMES: WeakKeyDictionary[Model, str] = WeakKeyDictionary()  # of models, which nothing else in any process has


class SerializedScene:
    """A scene as it is now; later changes of the scene change nothing here. It can be pickled.

    Attributes
    ----------
    key : str
        Its name, which other scenes do not have.
    """

    def __init__(self, scene: Stage) -> None:
        self._scene = scene.copy()
        self._scene.baked = None
        self._models = self._scene.models
        self._recipe = write_recipe(self._scene, self._models)
        names = [_NAMES.setdefault(model, uuid.uuid4().hex) for model in self._models]
        told = hashlib.sha256(self._recipe + "".join(names).encode())
        self.key = f"pointray-scene-{told.hexdigest()[:32]}"
        self._client, self._scheduler = current_client(), ""
        self._sent: list[ScatteredObject | Place] = []
        if self._client is not None:
            self._scheduler = self._client.scheduler_info()["id"]
            self._sent = _send(self._client, self._models)

    def __reduce__(self) -> tuple[Any, ...]:
        return _Packed, (self.key, version_here(), self._recipe, self._portable())

    def __dask_tokenize__(self) -> str:
        return self.key

    def use(self, work: Callable[..., Any], args: tuple[Any, ...]) -> Any:
        """Do work for the scene, see `worker.JobSpec`."""
        return at_work(lambda cache: self._scene.snapshot(), work, args)

    def _portable(self) -> list[Model | Place | Sent]:
        """The models as they are sent. No message can be waited for here: Dask, which pickles, holds a lock."""
        client, places = current_client(), [model.place for model in self._models]
        if client is None or client is not self._client:
            return [place or model for place, model in zip(places, self._models, strict=True)]
        return [self._as_sent(*pair) for pair in zip(self._sent, self._models, strict=True)]

    def _as_sent(self, sent: ScatteredObject | Place, model: Model) -> Model | Place | Sent:
        """A model as the workers of the client get it."""
        if isinstance(sent, Place):
            return model.place or model
        if sent.future is None or sent.future.status != "finished":
            return model
        return Sent(sent.future.key, self._scheduler)


class _Packed:
    """The same in another process."""

    def __init__(self, key: str, version: str, recipe: bytes, models: Sequence[Model | Place | Sent]) -> None:
        self._args = key, version, recipe, models

    def __reduce__(self) -> tuple[Any, ...]:
        return _Packed, self._args

    def use(self, work: Callable[..., Any], args: tuple[Any, ...]) -> Any:
        """See `SerializedScene.use`."""
        key, version, recipe, models = self._args
        if version != version_here():
            raise ValueError(f"this worker has pointray {version_here()}, the scene is of pointray {version}")

        def scene_of(cache: WorkerCache) -> Any:
            return cache.scene(key, recipe, None, models)

        return at_work(scene_of, work, args)


def current_client() -> Any:
    """The client of Dask that computes what nobody else is told to; None: there is none that can be waited for."""
    distributed: Any = sys.modules.get("distributed")
    with suppress(ValueError, AttributeError):
        client = distributed.Client.current()
        if client.status == "running" and not client.asynchronous:
            return client
    return None


def homes_for(models: Sequence[Model]) -> list[str]:
    """The workers of the client at hand over which models in parts can be spread.

    Raises
    ------
    ValueError
        If there is no client, it has no workers, or not all of these see the folders.
    """
    client = current_client()
    if client is None:
        raise ValueError("spread: there is no client of Dask, whose workers would hold the models")
    workers = sorted(check_client(client).nthreads())  # the same ones hold the same parts in the next call
    places = [check_spreadable(model) for model in models if model.parts]
    objects = scattered_objects_of(client)
    _ask(client, objects, set(places) - objects.asked)
    for place in places:
        if place in objects.unseen:
            raise ValueError(f"spread: {UnseenFileError(place)}")
    return workers


def _send(client: Any, models: Sequence[Model]) -> list[ScatteredObject | Place]:
    """Send models to workers that do not see their files."""
    objects = scattered_objects_of(client)
    _ask(client, objects, {model.place for model in models} - {None} - objects.asked)
    sent = [objects.of_model(model) for model in models]
    for one in sent:
        with suppress(OSError):  # no worker is there yet
            if isinstance(one, ScatteredObject):
                one.send(client)
    return sent


def _ask(client: Any, objects: ScatteredObjects, places: set[Any]) -> None:
    """Ask all workers which files they see."""
    wanted = list(places)
    for answers in client.run(_are_there, wanted).values() if places else ():
        objects.unseen |= {place for place, there in zip(wanted, answers, strict=True) if not there}
        objects.asked |= places


def _are_there(places: list[Place]) -> list[bool]:
    return [place.is_there for place in places]
