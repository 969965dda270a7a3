"""Models as files: one after the other the arrays, each as NumPy's .npy, behind one that names them. Read by mapping.

A file is not trusted: names, types, lengths and every number that a ray follows are checked before the first ray, so
that a damaged one is an error.
"""

from __future__ import annotations

import json
import math
import mmap
import os
from collections.abc import Callable
from typing import IO, Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from .data import Points
from .points.files import check_regular, replacing
from .records import BLOCK, GROUP, HEAD, LEAF, NODE, Tree
from .tree.indices import check_indices

SAVED = ".pointray"  # how the name of such a file usually ends
FORMAT, VERSION = "pointray model", 2
LAYOUT = [BLOCK, LEAF, NODE, GROUP, HEAD]  # of the records: another layout is another tree
ALIGN = 64  # bytes: where an array begins, and what follows the last, for loads past its end
CHUNK = 1 << 24  # items written between two words on the progress

Say = Callable[[float], None]


def write_model(
    path: str | os.PathLike[str], about: dict[str, Any], points: Points, arrays: dict[str, NDArray[Any]], say: Say
) -> None:
    """Write a file that `read_model` reads; it takes its name when all is written.

    Parameters
    ----------
    about : dict
        What is kept besides arrays, as JSON can hold it.
    arrays : dict
        The tree's, and more.
    say : callable
        Told the share done.
    """
    named = {**_arrays_of(points), **arrays}
    names = list(named)
    meta = {"format": FORMAT, "version": VERSION, "layout": LAYOUT, "arrays": names, **about}
    head = np.frombuffer(json.dumps(meta).encode(), np.uint8)
    total, done = sum(array.size for array in named.values()) or 1, 0
    with replacing(path) as beside, beside.open("wb") as file:
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


def _arrays_of(points: Points) -> dict[str, NDArray[Any]]:
    """The points' arrays, under the names they have in a file."""
    named = {f"points.{name}": getattr(points, name) for name in ("positions", "origin", "normals", "colors")}
    named |= {f"attribute.{name}": values for name, values in points.attributes.items()}
    return {name: array for name, array in named.items() if array is not None}


def read_model(path: str | os.PathLike[str]) -> tuple[dict[str, Any], Points, dict[str, NDArray[Any]], Tree]:
    """What was written, the points, further arrays, and the tree: mapped, so that it is there at once.

    Raises
    ------
    OSError
        If the file cannot be opened.
    ValueError
        If it is no model, of another version, or damaged.
    """
    file = check_regular(path)
    try:
        with file.open("rb") as stream:
            about, found = _read_arrays(stream)
        points = _take_points(found)
        tree = _take_tree(found)
    except ValueError as error:
        raise ValueError(f"{file}: {error}") from error
    problems = check_indices(tree, len(points))
    if problems:
        raise ValueError(f"{file}: the model is damaged: {problems[0]}")
    return about, points, found, tree


def _read_arrays(stream: IO[bytes]) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """The description and the arrays it names."""
    size = os.fstat(stream.fileno()).st_size
    if stream.read(6) != b"\x93NUMPY":
        raise ValueError("not a saved model")
    # Copied where written to: the file stays as it is.
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
    """The array that begins where the stream is; leaves the stream behind it."""
    try:
        if npy.read_magic(stream) != (1, 0):  # type: ignore[no-untyped-call]
            raise ValueError("of another version")
        shape, fortran, dtype = npy.read_array_header_1_0(stream)  # type: ignore[no-untyped-call]
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


def take_array(found: dict[str, NDArray[Any]], name: str, dtype: type, shape: tuple[int, ...]) -> NDArray[Any]:
    """An array of the file, out of `found`; -1 in `shape` stands for any length. ValueError if it is not so."""
    if name not in found:
        raise ValueError(f"{name} is missing")
    array = found.pop(name)
    right = array.ndim == len(shape) and all(a in (b, -1) for a, b in zip(shape, array.shape, strict=True))
    if array.dtype != dtype or not right:
        raise ValueError(f"{name} is {array.dtype} {array.shape}")
    return array


def _take_points(found: dict[str, NDArray[Any]]) -> Points:
    positions = take_array(found, "points.positions", np.float32, (-1, 3))
    origin = take_array(found, "points.origin", np.float64, (3,))
    names = [name for name in found if name.startswith("attribute.")]
    attributes = {name.removeprefix("attribute."): found.pop(name) for name in names}
    normals, colors = found.pop("points.normals", None), found.pop("points.colors", None)
    return Points.about(origin, positions, normals, colors, attributes)


def _take_tree(found: dict[str, NDArray[Any]]) -> Tree:
    whole = {"children", "spans", "refs", "order", "colors"}
    small = {"borders", "facing"}
    types = {name: np.int32 if name in whole else np.int8 if name in small else np.float32 for name in Tree._fields}
    return Tree(*(take_array(found, f"tree.{name}", types[name], (-1,)) for name in Tree._fields))
