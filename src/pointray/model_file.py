"""Models as files: arrays one after the other, each as NumPy's .npy, behind one that names them. Read by mapping.

A model's levels of detail follow it, as models of their own.

A file is not trusted: names, types, lengths and every number that a ray follows are checked before the first ray, so
that a damaged one is an error.
"""

from __future__ import annotations

import json
import math
import mmap
import os
from collections.abc import Callable, Sequence
from typing import IO, Any, NamedTuple

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from .data import FARTHEST, Points
from .kernels.tree import BLOCK, GROUP, HEAD, LEAF, LONGEST, NODE, PATCH, STEP, Tree
from .points.files import check_regular, replacing
from .tree.indices import check_indices

SAVED = ".pointray"  # the usual end of such a file's name
FORMAT, VERSION = "pointray model", 2
LAYOUT = [BLOCK, LEAF, NODE, GROUP, HEAD, PATCH]  # of the records: a tree with another layout cannot be read
ALIGN = 64  # bytes: arrays begin at multiples of it, and as much follows the last one, for loads past its end
CHUNK = 1 << 24  # items that are written between two progress reports

Say = Callable[[float], None]


class Part(NamedTuple):
    """A model, or one of its levels of detail, as a file keeps it.

    Attributes
    ----------
    settings : dict
        In a form that JSON can hold.
    points : Points
    radii : (n,) float32
    bounds : (2, 3) float64
    tree : Tree
    """

    settings: dict[str, Any]
    points: Points
    radii: NDArray[np.float32]
    bounds: NDArray[np.float64]
    tree: Tree


def write_model(path: str | os.PathLike[str], parts: Sequence[Part], say: Say) -> None:
    """Write a file that `read_model` reads; the file gets its name when all is written.

    Parameters
    ----------
    parts : sequence of Part
        The model, then its levels of detail.
    say : callable
        Told the share done.
    """
    named = {f"{_prefix(k)}{name}": array for k, part in enumerate(parts) for name, array in _arrays_of(part).items()}
    settings = [part.settings for part in parts]
    about = {"format": FORMAT, "version": VERSION, "layout": LAYOUT, "arrays": list(named)}
    meta = {**about, "settings": settings[0], "levels": settings[1:]}
    head = np.frombuffer(json.dumps(meta).encode(), np.uint8)
    total, done = sum(array.size for array in named.values()) or 1, 0
    with replacing(path) as file:
        for array in (head, *named.values()):
            npy.write_array_header_1_0(file, npy.header_data_from_array_1_0(array))
            flat = np.ascontiguousarray(array).reshape(-1)
            for start in range(0, flat.size, CHUNK):
                file.write(flat[start : start + CHUNK].data)
                if array is not head:
                    done += len(flat[start : start + CHUNK])
                    say(done / total)
            file.write(bytes(-file.tell() % ALIGN))
        file.write(bytes(ALIGN))


def _prefix(k: int) -> str:
    """The prefix of the names of a part's arrays: empty for the model itself."""
    return f"level{k}." if k else ""


def _arrays_of(part: Part) -> dict[str, NDArray[Any]]:
    """A part's arrays, by their names in a file."""
    points = part.points
    named = {f"points.{name}": getattr(points, name) for name in ("positions", "origin", "normals", "colors")}
    named |= {f"attribute.{name}": values for name, values in points.attributes.items()}
    named |= {"radii": part.radii, "bounds": part.bounds}
    named |= {f"tree.{name}": array for name, array in zip(Tree._fields, part.tree, strict=True)}
    return {name: array for name, array in named.items() if array is not None}


def read_model(path: str | os.PathLike[str]) -> list[Part]:
    """The parts of a file, the model and its levels of detail: mapped, so that they are ready at once.

    Raises
    ------
    OSError
        If the file cannot be opened.
    ValueError
        If it is no model, has another version, or is damaged.
    """
    file = check_regular(path)
    try:
        with file.open("rb") as stream:
            about, found = _read_arrays(stream)
        parts = [_take_part(settings, found, _prefix(k)) for k, settings in enumerate(_settings_in(about))]
        for part in parts[1:]:
            if _columns_of(part.points) != _columns_of(parts[0].points):
                raise ValueError("the model is damaged: a level of detail has other attributes or colors")
    except ValueError as error:
        raise ValueError(f"{file}: {error}") from error
    return parts


def _settings_in(about: dict[str, Any]) -> list[dict[str, Any]]:
    """The settings of the model and of its levels of detail; an older file has no levels."""
    settings = [about.get("settings"), *_listed(about.get("levels", []))]
    if not all(isinstance(one, dict) for one in settings):
        raise ValueError("the model is damaged: its settings are none")
    return settings


def _listed(value: Any) -> list[Any]:
    return value if isinstance(value, list) else [value]


def _columns_of(points: Points) -> dict[str, Any]:
    """The columns that all levels of a model share."""
    return {"": points.colors is None, **{name: values.shape[1:] for name, values in points.attributes.items()}}


def _read_arrays(stream: IO[bytes]) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """The description and the arrays it names."""
    size = os.fstat(stream.fileno()).st_size
    if stream.read(6) != b"\x93NUMPY":
        raise ValueError("not a saved model")
    # Pages are copied when written to: the file does not change.
    memory = mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_COPY)
    stream.seek(0)
    head = _next_array(stream, memory, size, "the description")
    try:
        about = json.loads(head.tobytes())
        names = [str(name) for name in about["arrays"]]
        known = about["format"], about["version"], about["layout"]
    except (ValueError, KeyError, TypeError) as error:
        raise ValueError("not a saved model, or its description is damaged") from error
    if known[0] != FORMAT:
        raise ValueError("not a saved model")
    if known[1:] != (VERSION, LAYOUT):
        raise ValueError("saved by another version of pointray: save it anew")
    arrays = {name: _next_array(stream, memory, size, name) for name in names}
    if stream.tell() + ALIGN > size:
        raise ValueError("the file is cut off")
    return about, arrays


def _next_array(stream: IO[bytes], memory: mmap.mmap, size: int, name: str) -> NDArray[Any]:
    """The array that begins at the stream's position; leaves the stream at the array's end."""
    try:
        if npy.read_magic(stream) != (1, 0):
            raise ValueError("of another version")
        shape, fortran, dtype = npy.read_array_header_1_0(stream)
    except Exception as error:  # NumPy's parser lets a header's text raise nearly anything
        raise ValueError(f"the header of {name} is damaged") from error
    if fortran or dtype.hasobject or dtype.newbyteorder("=") != dtype or min(shape, default=0) < 0 or len(shape) > 2:
        raise ValueError(f"{name} has an array of another kind")
    start, count = stream.tell(), math.prod(shape)
    if start + count * dtype.itemsize > size:
        raise ValueError(f"the file is cut off in {name}")
    stream.seek(start + count * dtype.itemsize)
    stream.seek(-stream.tell() % ALIGN, os.SEEK_CUR)
    if count == 0:
        return np.empty(shape, dtype)
    return np.frombuffer(memory, dtype, count, start).reshape(shape)


def _take_part(settings: dict[str, Any], found: dict[str, NDArray[Any]], prefix: str) -> Part:
    """The part whose arrays' names begin with a prefix, checked."""
    mine = {name.removeprefix(prefix): array for name, array in found.items() if name.startswith(prefix)}
    points = _take_points(mine)
    radii, bounds = _take(mine, "radii", np.float32, (len(points),)), _take(mine, "bounds", np.float64, (2, 3))
    within = np.abs(bounds - points.origin) <= 2.0 * FARTHEST  # also false for NaN
    if not (within.all() and (bounds[0] <= bounds[1]).all()):
        raise ValueError("the model is damaged: its bounds are none")
    part = Part(settings, points, radii, bounds, _take_tree(mine))
    problems = check_indices(part.tree, len(points))
    if problems:
        raise ValueError(f"the model is damaged: {problems[0]}")
    return part


def _take(found: dict[str, NDArray[Any]], name: str, dtype: type, shape: tuple[int, ...]) -> NDArray[Any]:
    """An array of the file, out of `found`; -1 in `shape` stands for any length. ValueError if it differs."""
    if name not in found:
        raise ValueError(f"{name} is missing")
    array = found.pop(name)
    right = array.ndim == len(shape) and all(a in (b, -1) for a, b in zip(shape, array.shape, strict=True))
    if array.dtype != dtype or not right:
        raise ValueError(f"{name} is {array.dtype} {array.shape}")
    return array


def _take_points(found: dict[str, NDArray[Any]]) -> Points:
    positions = _take(found, "points.positions", np.float32, (-1, 3))
    origin = _take(found, "points.origin", np.float64, (3,))
    names = [name for name in found if name.startswith("attribute.")]
    attributes = {name.removeprefix("attribute."): found.pop(name) for name in names}
    normals, colors = found.pop("points.normals", None), found.pop("points.colors", None)
    return Points.about(origin, positions, normals, colors, attributes)


def _take_tree(found: dict[str, NDArray[Any]]) -> Tree:
    whole = {"children", "spans", "refs", "order", "colors"}
    small = {"borders", "facing"}
    types = {name: np.int32 if name in whole else np.int8 if name in small else np.float32 for name in Tree._fields}
    tree = Tree(*(_take(found, f"tree.{name}", types[name], (-1,)) for name in Tree._fields))
    if len(tree.head) == HEAD and tree.head[LONGEST] == 0.0:  # the file was saved before this number was kept
        tree.head[LONGEST] = tree.leaves[STEP::LEAF].max(initial=0.0)
    return tree
