"""What stands where in a scene file: instances of models, one or many, and planes; and those that cut all open."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.lib.format import open_memmap
from numpy.typing import NDArray

from ..points.files import check_regular
from ..scene.clips import MOST, check_clip
from ..scene.instances import Plane, check_transform
from ..scene.scene import Scene
from ..scene.transforms import transform
from .lines import Key
from .source import Source
from .words import TEXT, check_table, optional, unknown, words_of

PLACE = words_of(transform)  # translate, rotate, axis, scale
ADD = {**words_of(Scene.add), "material": optional(TEXT), **PLACE}


class Place(NamedTuple):
    """What `Scene.add` is told.

    Attributes
    ----------
    shape : str or Plane
        The name of a model, or a plane.
    matrix : (4, 4) float64
    many : Path or None
        A file of such matrices, instead.
    material : str or None
        Its name.
    """

    key: Key
    shape: str | Plane
    matrix: NDArray[np.float64]
    many: Path | None
    material: str | None


def check_instance(source: Source, key: Key, models: Any, materials: Any) -> Place:
    """What a table of `instances` says."""
    values = check_table(source, key, {"model": TEXT, **ADD, "transforms": optional(TEXT)})
    model = values.pop("model")
    if model not in models:
        raise source.error((*key, "model"), unknown("model", model, models))
    many = values.pop("transforms", None)
    if many is None:
        return _place(source, key, model, values, materials)
    others = [name for name in values if name != "material"]
    if others:
        raise source.error((*key, others[0]), "transforms say it already")
    path = source.path(many)
    with source.telling((*key, "transforms")):
        _open_transforms(path)
    return _place(source, key, model, values, materials)._replace(many=path)


def check_plane(source: Source, key: Key, materials: Any) -> Place:
    """What a table of `planes` says."""
    words = words_of(Plane)
    values = check_table(source, key, {**words, **ADD})
    with source.telling(key, values):
        plane = Plane(**{name: values.pop(name) for name in words if name in values})
    return _place(source, key, plane, values, materials)


def check_cut(source: Source, key: Key) -> NDArray[np.float64]:
    """What a table of `clips` says, (2, 3)."""
    if key[-1] == MOST:
        raise source.error(key, f"there are at most {MOST} planes")
    values = check_table(source, key, words_of(check_clip))
    with source.telling(key, values):
        return check_clip(**values)


def _place(source: Source, key: Key, shape: str | Plane, values: dict[str, Any], materials: Any) -> Place:
    material = values.pop("material", None)
    if material is not None and material not in materials:
        raise source.error((*key, "material"), unknown("material", material, materials))
    parts = [name for name in values if name in PLACE]
    if parts and "transform" in values:
        raise source.error((*key, parts[0]), "transform says it already")
    with source.telling(key, values):
        matrix = check_transform(values["transform"] if "transform" in values else transform(**values))
    return Place(key, shape, matrix, None, material)


def matrices(source: Source, place: Place) -> list[NDArray[np.float64]]:
    """All places of an instance; a file of them is read."""
    if place.many is None:
        return [place.matrix]
    with source.telling((*place.key, "transforms")):
        rows = np.array(_open_transforms(place.many), np.float64)
    out = []
    for k, row in enumerate(rows):
        with source.telling((*place.key, "transforms", f"row {k}")):
            out.append(check_transform(row))
    return out


def _open_transforms(path: Path) -> NDArray[Any]:
    """A .npy of (n, 4, 4) numbers, mapped; Python objects are refused."""
    try:
        array = open_memmap(check_regular(path), mode="r")
    except ValueError as error:
        raise ValueError(f"{path}: this is no .npy file of numbers: {error}") from None
    if array.ndim != 3 or array.shape[1:] != (4, 4) or array.dtype.kind not in "iuf":
        raise ValueError(f"{path}: transforms are (n, 4, 4) numbers, not {array.shape} of {array.dtype}")
    return array
