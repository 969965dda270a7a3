"""A scene without its models and baked light, as bytes for a worker, which has these already; and a scene again.

Other things as bytes too, such as functions with arguments: their arrays can be read and written by kernels again.

A snapshot cannot be sent: it holds addresses of arrays. A scene can, and makes its snapshot anew.
"""

from __future__ import annotations

import io
import pickle
from collections.abc import Sequence
from typing import Any, Protocol

from ..model.model import Model


class Stage(Protocol):
    """What is asked of a scene here, see `scene.scene.Scene`."""

    baked: Any

    @property
    def models(self) -> list[Model]:
        """All models, each once."""

    def copy(self) -> Stage:
        """An independent scene of the same models."""

    def snapshot(self) -> Any:
        """What jobs take: the scene as it is now."""


class _Writer(pickle.Pickler):
    """Writes the number of each model in place of the model."""

    def __init__(self, file: io.BytesIO, models: Sequence[Model]) -> None:
        super().__init__(file, protocol=5)
        self._numbers = {id(model): number for number, model in enumerate(models)}

    def persistent_id(self, thing: Any) -> int | None:
        """The number of a model; None: it is something else, which is written."""
        return self._numbers.get(id(thing)) if isinstance(thing, Model) else None


class _Reader(pickle.Unpickler):
    """Puts models in the places of their numbers."""

    def __init__(self, file: io.BytesIO, models: Sequence[Model]) -> None:
        super().__init__(file)
        self._models = models

    def persistent_load(self, number: Any) -> Model:
        """The model with a number."""
        return self._models[number]


def write_recipe(scene: Stage, models: Sequence[Model]) -> bytes:
    """Everything of a scene but its models and its baked light. models : `scene.models`"""
    file = io.BytesIO()
    _Writer(file, models).dump(scene)
    return file.getvalue()


def read_recipe(recipe: bytes, models: Sequence[Model]) -> Stage:
    """The scene, with these models. The bytes come from our own client by Dask, which itself uses pickle."""
    scene: Stage = _Reader(io.BytesIO(recipe), models).load()
    return scene


def pack(thing: Any) -> bytes:
    """A thing that can be pickled, as bytes."""
    return pickle.dumps(thing, protocol=5)


def unpack(packed: bytes) -> Any:
    """The thing again. The bytes come from our own client or its workers by Dask, which itself uses pickle."""
    return pickle.loads(packed)
