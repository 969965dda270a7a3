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
    """Interface of a scene, see `scene.scene.Scene`."""

    baked: Any

    @property
    def models(self) -> list[Model]:
        """The distinct models."""

    def copy(self) -> SceneLike:
        """Return an independent scene of the same models."""

    def snapshot(self) -> Any:
        """Return the current scene, as jobs take it."""


class _Writer(pickle.Pickler):
    """Pickler that writes numbers in place of models."""

    def __init__(self, file: io.BytesIO, models: Sequence[Model]) -> None:
        super().__init__(file, protocol=5)
        self._numbers = {id(model): number for number, model in enumerate(models)}

    def persistent_id(self, value: Any) -> int | None:
        """Return the number of a model, or None for any other object."""
        return self._numbers.get(id(value)) if isinstance(value, Model) else None


class _Reader(pickle.Unpickler):
    """Unpickler that replaces numbers by models."""

    def __init__(self, file: io.BytesIO, models: Sequence[Model]) -> None:
        super().__init__(file)
        self._models = models

    def persistent_load(self, number: Any) -> Model:
        """Return the model with a number."""
        return self._models[number]


def write_recipe(scene: SceneLike, models: Sequence[Model]) -> bytes:
    """Serialize a scene without its models. models : `scene.models`"""
    file = io.BytesIO()
    _Writer(file, models).dump(scene)
    return file.getvalue()


def read_recipe(recipe: bytes, models: Sequence[Model]) -> SceneLike:
    """Return the scene with these models. The bytes come from this package's client through Dask, which uses pickle."""
    scene: SceneLike = _Reader(io.BytesIO(recipe), models).load()
    return scene


def pack(value: Any) -> bytes:
    """Pickle an object."""
    return pickle.dumps(value, protocol=5)


def unpack(packed: bytes) -> Any:
    """Unpickle an object. The bytes come from this package's client or workers through Dask, which uses pickle."""
    return pickle.loads(packed)
