"""Models in parts, as folders: an index in JSON, the points of all parts, and for each part a file with its tree.

    city.pointray/index.json             what is in the folder
    city.pointray/points.pointray        positions, normals, colours, attributes and radii, part after part
    city.pointray/part-0000.pointray     the tree over the splats of a part and those of others that reach into it

A part is an aligned stretch of the kd order. Rows are those of all points. Nothing is trusted, see `model_file`.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .array_file import Kind, Pieces, read_arrays, take_array, write_arrays
from .data import Points
from .kernels.tree import BOUNDS, LONGEST, Tree, no_tree
from .model_file import LAYOUT, Level, check_level, points_of, survey_of, take_tree
from .points.replacing import replacing

INDEX, POINTS = "index.json", "points.pointray"
UNFINISHED = "unfinished"  # the folder in it that holds what is found until all is done
FORMAT, VERSION = "pointray parts", 1
MOST = 2**31  # rows are int32 in trees
OUTDATED = "written by another version of pointray: prepare it anew"
POINTS_KIND = Kind("pointray points", VERSION, [], "the points of a model in parts", OUTDATED)
PART_KIND = Kind("pointray part", VERSION, LAYOUT, "a part of a model", OUTDATED)

Say = Callable[[float], None]


class PartFile(NamedTuple):
    """What the index says of a part.

    name : of the file; points : how many are its own; bounds : (2, 3) of these, world
    nbytes, sha256 : of the file
    """

    name: str
    points: int
    bounds: list[list[float]]
    nbytes: int
    sha256: str


class Index(NamedTuple):
    """What the index says.

    id : that all files of the folder name
    settings : of the model, in a form that JSON can hold
    survey : facts of the coordinates
    bounds : (2, 3), of all points, world
    supports : (6,), of all supports, about the origin: where a ray enters them its lattice of samples begins
    longest : longest step of the samples in any part
    nbytes, sha256 : of the points' file
    """

    id: str
    settings: dict[str, Any]
    survey: dict[str, Any]
    bounds: list[list[float]]
    supports: list[float]
    longest: float
    nbytes: int
    sha256: str
    parts: list[PartFile]


class Folder(NamedTuple):
    """A model in parts: the whole, whose tree is empty, and its parts, with the points of the whole."""

    whole: Level
    parts: list[Level]


def digest_of(path: Path) -> tuple[int, str]:
    """The bytes of a file, and their SHA-256."""
    with path.open("rb") as file:
        return os.fstat(file.fileno()).st_size, hashlib.file_digest(file, "sha256").hexdigest()


def write_points(folder: Path, id: str, points: Points, radii: NDArray[np.float32], say: Say) -> tuple[int, str]:
    """Write the points' file; returns its `digest_of`."""
    named: dict[str, Any] = {name: getattr(points, name) for name in ("positions", "normals", "colors")}
    return write_columns(folder, id, points.origin, named, points.attributes, radii, say)


def write_columns(
    folder: Path,
    id: str,
    origin: NDArray[np.float64],
    named: Mapping[str, Pieces | None],
    attributes: Mapping[str, Pieces],
    radii: Pieces,
    say: Say,
) -> tuple[int, str]:
    """`write_points`, of columns: "positions", "normals" and "colors", the last two perhaps None, and attributes."""
    known = {f"points.{name}": column for name, column in named.items() if column is not None}
    known |= {"points.origin": origin, **{f"attribute.{name}": values for name, values in attributes.items()}}
    write_arrays(folder / POINTS, POINTS_KIND, {"folder": id}, {**known, "radii": radii}, say)
    return digest_of(folder / POINTS)


def write_part(folder: Path, id: str, number: int, points: int, bounds: NDArray[np.float64], tree: Tree) -> PartFile:
    """Write the file of a part; returns what the index says of it."""
    path = folder / f"part-{number:04d}.pointray"
    named = {f"tree.{name}": array for name, array in zip(Tree._fields, tree, strict=True)}
    write_arrays(path, PART_KIND, {"folder": id, "part": number}, named, lambda share: None)
    return PartFile(path.name, points, bounds.tolist(), *digest_of(path))


def write_index(folder: Path, index: Index) -> None:
    """Write the index, last: without it there is no model."""
    parts = [part._asdict() for part in index.parts]
    text = json.dumps({"format": FORMAT, "version": VERSION, **index._asdict(), "parts": parts}, indent=1)
    with replacing(folder / INDEX) as file:
        file.write(text.encode())


def read_folder(path: str | os.PathLike[str]) -> Folder:
    """The model in a folder, mapped.

    Raises
    ------
    OSError
        If a file cannot be opened; the error names it.
    ValueError
        If there is no index, or it or another file is damaged, of another version or of another folder; the message
        names the file.
    """
    folder = Path(path)
    index = _read_index(folder)
    points, radii = _read_points(folder, index)
    supports, bounds = np.array(index.supports, np.float32), np.array(index.bounds)
    whole = Level(index.settings, points, radii, bounds, no_tree(supports))
    parts = []
    for number, part in enumerate(index.parts):
        tree = _read_part(folder, index, number)
        parts.append(Level(index.settings, points, radii, np.array(part.bounds), tree))
    return Folder(whole, parts)


def check_folder(path: str | os.PathLike[str]) -> None:
    """ValueError if a folder has no index of a model in parts, or a damaged one."""
    _read_index(Path(path))


def _read_index(folder: Path) -> Index:
    path = folder / INDEX
    if not path.is_file() and (folder / UNFINISHED).is_dir():
        raise ValueError(f"{folder}: is unfinished: run the same `pointray prepare` again, it goes on")
    if not path.is_file():
        raise ValueError(f"{folder}: no model in parts: it has no {INDEX}")
    try:
        found = json.loads(path.read_bytes())
        if not isinstance(found, dict) or found.pop("format", None) != FORMAT:
            raise ValueError("not the index of a model in parts")
        if found.pop("version", None) != VERSION:
            raise ValueError(OUTDATED)
        parts = [PartFile(**part) for part in found.pop("parts")]
        index = Index(**found, parts=parts)
        _check_index(index)
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise ValueError(f"{path}: {error}") from error
    return index


def _check_index(index: Index) -> None:
    """ValueError if a value of the index has another type or is out of range."""
    names = [part.name for part in index.parts]
    whole = [index.nbytes, *(number for part in index.parts for number in (part.points, part.nbytes))]
    boxes = [index.bounds, *(part.bounds for part in index.parts)]
    if not names or not all(isinstance(name, str) and Path(name).name == name for name in names):
        raise ValueError("it names no parts, or not by files of the folder")
    if not isinstance(index.settings, dict) or not isinstance(index.survey, dict) or not isinstance(index.id, str):
        raise ValueError("its settings, survey or id are none")
    if not all(isinstance(number, int) and number >= 0 for number in whole):
        raise ValueError("a number of points or bytes is none")
    if not all(np.shape(box) == (2, 3) and np.isfinite(np.array(box, np.float64)).all() for box in boxes):
        raise ValueError("bounds are none")
    supports = np.array(index.supports, np.float64)
    if supports.shape != (6,) or not np.isfinite(supports).all() or not 0 <= float(index.longest) < math.inf:
        raise ValueError("bounds of supports or the longest step are no numbers")


def _read_points(folder: Path, index: Index) -> tuple[Points, NDArray[np.float32]]:
    path = folder / POINTS
    try:
        _check_size(path, index.nbytes)
        about, found = read_arrays(path, POINTS_KIND)
        if about.get("folder") != index.id:
            raise ValueError("it is of another folder")
        points = points_of(found, survey_of({"survey": index.survey}))
        radii = take_array(found, "radii", np.float32, (len(points),))
        if sum(part.points for part in index.parts) != len(points):
            raise ValueError(f"it holds {len(points):,} points, the parts others")
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
    return points, radii


def _read_part(folder: Path, index: Index, number: int) -> Tree:
    path = folder / index.parts[number].name
    try:
        _check_size(path, index.parts[number].nbytes)
        about, found = read_arrays(path, PART_KIND)
        if about.get("folder") != index.id or about.get("part") != number:
            raise ValueError("it is another part, or of another folder")
        tree = take_tree(found)
        tree.head[BOUNDS : BOUNDS + 6], tree.head[LONGEST] = index.supports, index.longest
        check_level(tree, sum(part.points for part in index.parts))
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
    return tree


def _check_size(path: Path, nbytes: int) -> None:
    """ValueError if a file has another size than the index says."""
    size = path.stat().st_size
    if size != nbytes:
        raise ValueError(f"it has {size:,} bytes, not {nbytes:,}: it is cut off, or of another folder")
