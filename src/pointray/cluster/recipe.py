"""Serialization of a scene without its models and baked light, which workers already have; and of other objects.

A snapshot cannot be serialized, as it holds addresses of arrays. A worker takes its own snapshot of the scene.
"""

from __future__ import annotations

import io
import pickle
from collections.abc import Sequence
from typing import Any, Protocol

from ..model.model import Model


class SceneLike(Protocol):
    """Interface of a `Scene`, as far as it is needed to send it to workers. baked : its baked light or None"""

    baked: Any

    @property
    def models(self) -> list[Model]:
        """The distinct models of all instances."""

    def copy(self) -> SceneLike:
        """Return an independent scene of the same models."""

    def snapshot(self) -> Any:
        """Return the snapshot of the current scene, which is passed to jobs."""


class _Writer(pickle.Pickler):
    """Pickler of scenes that writes a number, an index of the given models, in place of each model."""

    def __init__(self, file: io.BytesIO, models: Sequence[Model]) -> None:
        super().__init__(file, protocol=5)
        self._numbers = {id(model): number for number, model in enumerate(models)}

    def persistent_id(self, value: Any) -> int | None:
        """Return the index of a model, which is pickled in its place, or None for any other object."""
        return self._numbers.get(id(value)) if isinstance(value, Model) else None


class _Reader(pickle.Unpickler):
    """Unpickler of scenes that replaces the number written for each model by the model with this index."""

    def __init__(self, file: io.BytesIO, models: Sequence[Model]) -> None:
        super().__init__(file)
        self._models = models

    def persistent_load(self, number: Any) -> Model:
        """Return the model with an index, which was pickled in its place."""
        return self._models[number]


def write_recipe(scene: SceneLike, models: Sequence[Model]) -> bytes:
    """Serialize a scene without its models, which workers get separately.

    models : those of the scene, in the order of `scene.models`
    """
    file = io.BytesIO()
    _Writer(file, models).dump(scene)
    return file.getvalue()


def read_recipe(recipe: bytes, models: Sequence[Model]) -> SceneLike:
    """Return the scene from bytes of `write_recipe`, with its models in the same order.

    The bytes come from this package's client through Dask, which uses pickle.
    """
    scene: SceneLike = _Reader(io.BytesIO(recipe), models).load()
    return scene


def pack(value: Any) -> bytes:
    """Pickle an object for a message between client and workers."""
    return pickle.dumps(value, protocol=5)


def unpack(packed: bytes) -> Any:
    """Unpickle an object. The bytes come from this package's client or workers through Dask, which uses pickle."""
    return pickle.loads(packed)
