"""A scene in the graph of a Dask array: the scene itself within a process, else its recipe.

The graph is pickled when it is computed in other processes. Models are then replaced by the paths of their files or by
objects that the client's workers already have; without such a client they are included.
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
from .recipe import SceneLike, write_recipe
from .scattered_objects import ScatteredObject, ScatteredObjects, check_spreadable, scattered_objects_of
from .worker import ScatteredModel, UnseenFileError, WorkerCache, run_exclusively, version_here

_NAMES: WeakKeyDictionary[Model, str] = WeakKeyDictionary()  # unique names of models


class SerializedScene:
    """A copy of a scene that can be pickled into the graph of a Dask array, and used in any process.

    Attributes
    ----------
    key : str
        Unique name of the scene in this state.
    """

    def __init__(self, scene: SceneLike) -> None:
        self._scene = scene.copy()
        self._scene.baked = None
        self._models = self._scene.models
        self._recipe = write_recipe(self._scene, self._models)
        names = [_NAMES.setdefault(model, uuid.uuid4().hex) for model in self._models]
        digest = hashlib.sha256(self._recipe + "".join(names).encode())
        self.key = f"pointray-scene-{digest.hexdigest()[:32]}"
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
        """Return the result of a function on the scene, called in this process, one call at a time.

        work : called with a snapshot of the scene, `args`, a number of threads and a progress callback (None for both
            outside of Dask's workers)
        """
        return run_exclusively(lambda cache: self._scene.snapshot(), work, args)

    def _portable(self) -> list[Model | Place | ScatteredModel]:
        """Return what to pickle for each model: the model, its file's place, or the name of the copy that workers have.

        It must not wait for messages, as Dask holds a lock while pickling.
        """
        client, places = current_client(), [model.place for model in self._models]
        if client is None or client is not self._client:
            return [place or model for place, model in zip(places, self._models, strict=True)]
        return [self._as_sent(*pair) for pair in zip(self._sent, self._models, strict=True)]

    def _as_sent(self, sent: ScatteredObject | Place, model: Model) -> Model | Place | ScatteredModel:
        """Return what to pickle for a model: its file's place, the name of the copy that workers have, or the model.

        sent : the file that workers see, or the object that was sent to them; if it is lost, the model is returned
        """
        if isinstance(sent, Place):
            return model.place or model
        if sent.future is None or sent.future.status != "finished":
            return model
        return ScatteredModel(sent.future.key, self._scheduler)


class _Packed:
    """A `SerializedScene` after unpickling in another process, which makes the scene when it is used."""

    def __init__(self, key: str, version: str, recipe: bytes, models: Sequence[Model | Place | ScatteredModel]) -> None:
        self._args = key, version, recipe, models

    def __reduce__(self) -> tuple[Any, ...]:
        return _Packed, self._args

    def use(self, work: Callable[..., Any], args: tuple[Any, ...]) -> Any:
        """Return the result of a function on the scene, called in this process, one call at a time.

        work : called with a snapshot of the scene, `args`, a number of threads and a progress callback (None for both
            outside of Dask's workers)
        """
        key, version, recipe, models = self._args
        if version != version_here():
            raise ValueError(f"this worker has pointray {version_here()}, the scene was sent by pointray {version}")

        def scene_of(cache: WorkerCache) -> Any:
            return cache.scene(key, recipe, None, models)

        return run_exclusively(scene_of, work, args)


def current_client() -> Any:
    """Return Dask's default client, or None if there is none, or it is closed or asynchronous."""
    distributed: Any = sys.modules.get("distributed")
    with suppress(ValueError, AttributeError):
        client = distributed.Client.current()
        if client.status == "running" and not client.asynchronous:
            return client
    return None


def homes_for(models: Sequence[Model]) -> list[str]:
    """Return the addresses of the workers of the default client, among which the parts of models on disk are divided.

    models : those of the scene

    Raises
    ------
    ValueError
        If there is no client, it has no workers, or one of them does not see the folder of a model.
    """
    client = current_client()
    if client is None:
        raise ValueError("spread: no Dask client found: create one, whose workers hold the models")
    workers = sorted(check_client(client).nthreads())  # sorted, so that workers keep their parts from call to call
    places = [check_spreadable(model) for model in models if model.parts]
    objects = scattered_objects_of(client)
    _find_unseen(client, objects, set(places) - objects.asked)
    for place in places:
        if place in objects.unseen:
            raise ValueError(f"spread: {UnseenFileError(place)}")
    return workers


def _send(client: Any, models: Sequence[Model]) -> list[ScatteredObject | Place]:
    """Return for each model its file's place or the object on the workers; send models whose file a worker lacks."""
    objects = scattered_objects_of(client)
    _find_unseen(client, objects, {model.place for model in models} - {None} - objects.asked)
    sent = [objects.of_model(model) for model in models]
    for one in sent:
        with suppress(OSError):  # no worker is there yet
            if isinstance(one, ScatteredObject):
                one.send(client)
    return sent


def _find_unseen(client: Any, objects: ScatteredObjects, places: set[Any]) -> None:
    """Ask all workers which files they see, and record the answers in `objects.unseen` and `objects.asked`.

    places : files of models
    """
    wanted = list(places)
    for answers in client.run(_check_places, wanted).values() if places else ():
        objects.unseen |= {place for place, there in zip(wanted, answers, strict=True) if not there}
        objects.asked |= places


def _check_places(places: list[Place]) -> list[bool]:
    return [place.is_there for place in places]
