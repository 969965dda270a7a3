"""The instances, planes and clip planes of a scene file."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.lib.format import open_memmap
from numpy.typing import NDArray

from ..base.arrays import Doubles
from ..base.atomic_write import check_regular
from ..scene.clips import MOST, check_clip
from ..scene.instances import Plane, check_transform
from ..scene.scene import Scene
from ..scene.transforms import transform
from .lines import Key
from .source import Source
from .words import TEXT, check_table, optional, unknown, words_of

TRANSFORM = words_of(transform)  # translate, rotate, axis, scale
ADD = {**words_of(Scene.add), "material": optional(TEXT), **TRANSFORM}


class Placement(NamedTuple):
    """One or more instances of a model, or a plane, as a scene file describes them; later arguments of `Scene.add`.

    Attributes
    ----------
    key : Key
        Where it is in the file, for messages, such as ("instances", 0).
    shape : str or Plane
        Name of a model in the file, or a plane.
    matrix : (4, 4) float64
        Model to world.
    matrices : Path or None
        .npy file of many such matrices, (n, 4, 4), one per instance; replaces `matrix`.
    material : str or None
        Name of a material in the file; None: diffuse.
    """

    key: Key
    shape: str | Plane
    matrix: Doubles
    matrices: Path | None
    material: str | None


def check_instance(source: Source, key: Key, models: Any, materials: Any) -> Placement:
    """Check a table of `instances` in a scene file and return its contents: model, transforms and material.

    A file of matrices is checked, but its rows are not read.

    key : path of the table in the file, such as ("instances", 0)
    models, materials : those of the file, by name
    """
    values = check_table(source, key, {"model": TEXT, **ADD, "transforms": optional(TEXT)})
    model = values.pop("model")
    if model not in models:
        raise source.error((*key, "model"), unknown("model", model, models))
    file_name = values.pop("transforms", None)
    if file_name is None:
        return _placement(source, key, model, values, materials)
    others = [name for name in values if name != "material"]
    if others:
        raise source.error((*key, others[0]), "cannot be combined with transforms")
    path = source.path(file_name)
    with source.errors_at((*key, "transforms")):
        _open_matrices(path)
    return _placement(source, key, model, values, materials)._replace(matrices=path)


def check_plane(source: Source, key: Key, materials: Any) -> Placement:
    """Check a table of `planes` in a scene file and return its contents: plane, transform and material.

    key : path of the table in the file, such as ("planes", 0); materials : those of the file, by name
    """
    words = words_of(Plane)
    values = check_table(source, key, {**words, **ADD})
    with source.errors_at(key, values):
        plane = Plane(**{name: values.pop(name) for name in words if name in values})
    return _placement(source, key, plane, values, materials)


def check_clip_plane(source: Source, key: Key) -> Doubles:
    """Check a table of `clips`, planes that cut the scene, and return its point and normal, (2, 3) float64.

    key : path of the table in the scene file, such as ("clips", 0)
    """
    if key[-1] == MOST:
        raise source.error(key, f"at most {MOST} clip planes are supported")
    values = check_table(source, key, words_of(check_clip))
    with source.errors_at(key, values):
        return check_clip(**values)


def _placement(source: Source, key: Key, shape: str | Plane, values: dict[str, Any], materials: Any) -> Placement:
    material = values.pop("material", None)
    if material is not None and material not in materials:
        raise source.error((*key, "material"), unknown("material", material, materials))
    parts = [name for name in values if name in TRANSFORM]
    if parts and "transform" in values:
        raise source.error((*key, parts[0]), "cannot be combined with transform")
    with source.errors_at(key, values):
        matrix = check_transform(values["transform"] if "transform" in values else transform(**values))
    return Placement(key, shape, matrix, None, material)


def count_matrices(placement: Placement) -> int:
    """Return the number of instances that a table of a scene file makes: 1, or one per matrix of the file it names."""
    return 1 if placement.matrices is None else len(_open_matrices(placement.matrices))


def load_matrices(source: Source, placement: Placement) -> list[Doubles]:
    """Return the model-to-world matrices, (4, 4) float64, of all instances that a table makes; read their file, if any.

    Errors name the line in the scene file and the row of the matrix.
    """
    if placement.matrices is None:
        return [placement.matrix]
    with source.errors_at((*placement.key, "transforms")):
        rows = np.array(_open_matrices(placement.matrices), np.float64)
    matrices = []
    for k, row in enumerate(rows):
        with source.errors_at((*placement.key, "transforms", f"row {k}")):
            matrices.append(check_transform(row))
    return matrices


def _open_matrices(path: Path) -> NDArray[Any]:
    """Map a .npy file of (n, 4, 4) numbers into memory; raise ValueError for other shapes, and for Python objects."""
    try:
        array = open_memmap(check_regular(path), mode="r")
    except ValueError as error:
        raise ValueError(f"{path}: not a valid .npy file of numbers: {error}") from None
    if array.ndim != 3 or array.shape[1:] != (4, 4) or array.dtype.kind not in "iuf":
        raise ValueError(f"{path}: expected transforms of shape (n, 4, 4), got {array.shape} of {array.dtype}")
    return array
