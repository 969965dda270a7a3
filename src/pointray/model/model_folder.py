"""Models in parts, as folders: an index in JSON, the points of all parts, and for each part a file with its tree.

    city.pointray/index.json             what is in the folder
    city.pointray/points.pointray        positions, normals, colours, attributes and radii, part after part
    city.pointray/part-0000.pointray     the tree over the splats of a part and those of others that reach into it
    city.pointray/part-0000-1.pointray   a level of detail of the part, a saved model: 1 is the finest

A part is an aligned stretch of the kd order of the surface's points, or of the scattered points, which follow those of
the surface. Rows are those of all points, in a level's file those of its own. Nothing is trusted, see `model_file`.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.atomic_write import replacing
from ..cloud.points import Points
from ..engine.kernels.tree import BOUNDS, HEAD, LONGEST, SCATTER, Tree, no_tree
from ..surface.tree.stored import find_surface_bounds, longest_leaf, radii_of
from .array_file import Kind, Pieces, read_arrays, take_array, write_arrays
from .model_file import (
    LAYOUT,
    SAVED,
    Level,
    check_columns,
    check_level,
    points_of,
    read_model,
    survey_of,
    take_tree,
    write_model,
)

INDEX, POINTS = "index.json", "points.pointray"
UNFINISHED = "unfinished"  # the folder in it that holds what is found until all is done
# Version 3 has scattered points; a folder without any is written as version 2, which earlier releases read.
FORMAT, VERSION, SURFACE_ONLY = "pointray parts", 3, 2
MOST = 2**31  # rows are int32 in trees
OUTDATED = "written by another version of pointray: prepare it anew"
POINTS_KIND = Kind("pointray points", SURFACE_ONLY, [], "the points of a model in parts", OUTDATED)
PART_KIND = Kind("pointray part", VERSION, LAYOUT, "a part of a model", OUTDATED, (SURFACE_ONLY,))

Say = Callable[[float], None]


class LevelFile(NamedTuple):
    """What the index says of a level of detail of a part.

    name : of the file; points : how many it has
    spacing : median of their radii
    longest : the number of blocks in the longest leaf
    nbytes, sha256 : of the file
    """

    name: str
    points: int
    spacing: float
    longest: int
    nbytes: int
    sha256: str


class PartFile(NamedTuple):
    """What the index says of a part.

    name : of the file; points : how many are its own; bounds : (2, 3) of these, world
    reach : (2, 3) about the origin, bounds of all that rays can hit; None: nothing
    spacing : median of the radii of all splats in the file
    longest : the number of blocks in the longest leaf
    nbytes, sha256 : of the file
    levels : its levels of detail, from fine to coarse
    """

    name: str
    points: int
    bounds: list[list[float]]
    reach: list[list[float]] | None
    spacing: float
    longest: int
    nbytes: int
    sha256: str
    levels: list[LevelFile]

    @classmethod
    def of(cls, facts: dict[str, Any]) -> PartFile:
        """What `facts` told."""
        return cls(**{**facts, "levels": [LevelFile(**level) for level in facts["levels"]]})

    @property
    def facts(self) -> dict[str, Any]:
        """All of it, in a form that JSON can hold."""
        return {**self._asdict(), "levels": [level._asdict() for level in self.levels]}


class Index(NamedTuple):
    """What the index says.

    id : that all files of the folder name
    settings : of the model, in a form that JSON can hold
    survey : facts of the coordinates
    bounds : (2, 3), of all points, world
    supports : (6,), of all supports, about the origin: where a ray enters them its lattice of samples begins
    longest : longest step of the samples in any part
    nbytes, sha256 : of the points' file
    scattered : how many points are scattered: the last ones
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
    scattered: int = 0

    @property
    def files(self) -> list[PartFile | LevelFile]:
        """All parts, and all their levels of detail."""
        return [*self.parts, *(level for part in self.parts for level in part.levels)]


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
    """Write the file of a part; returns what the index says of it, the spacing as if all were surface."""
    path = folder / f"part-{number:04d}.pointray"
    named = {f"tree.{name}": array for name, array in zip(Tree._fields, tree, strict=True)}
    kind = PART_KIND if tree.head[SCATTER] else PART_KIND._replace(version=SURFACE_ONLY)
    write_arrays(path, kind, {"folder": id, "part": number}, named, lambda share: None)
    reach = find_surface_bounds(tree)
    box = None if reach is None else reach.tolist()
    spacing = float(np.median(radii_of(tree))) if box else 0.0
    return PartFile(path.name, points, bounds.tolist(), box, spacing, longest_leaf(tree), *digest_of(path), [])


def write_level(folder: Path, id: str, part: int, number: int, level: Level) -> LevelFile:
    """Write the file of a part's level of detail; returns what the index says of it. number : 1 is the finest"""
    path = folder / f"part-{part:04d}-{number}.pointray"
    write_model(path, [level], lambda share: None, {"folder": id, "part": part, "level": number})
    spacing = float(np.median(level.radii))
    return LevelFile(path.name, len(level.points), spacing, longest_leaf(level.tree), *digest_of(path))


def write_index(folder: Path, index: Index) -> None:
    """Write the index, last: without it there is no model."""
    facts = {**index._asdict(), "parts": [part.facts for part in index.parts]}
    if not index.scattered:
        del facts["scattered"]
    version = VERSION if index.scattered else SURFACE_ONLY
    text = json.dumps({"format": FORMAT, "version": version, **facts}, indent=1)
    with replacing(folder / INDEX) as file:
        file.write(text.encode())


def read_folder(path: str | os.PathLike[str]) -> tuple[Index, Level]:
    """The index of a model in parts, and the whole, whose points are mapped and whose tree is empty.

    Sizes are compared; parts and levels of detail are not opened.

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
    for file in index.files:
        with _named(folder / file.name):
            _check_size(folder / file.name, file.nbytes)
    supports = np.array(index.supports, np.float32)
    return index, Level(index.settings, points, radii, np.array(index.bounds), no_tree(supports))


def check_folder(path: str | os.PathLike[str]) -> None:
    """ValueError if a folder has no index of a model in parts, or a damaged one."""
    _read_index(Path(path))


def verify_folder(path: str | os.PathLike[str]) -> None:
    """ValueError if a file of a folder is not the one that its index describes, to the last byte."""
    folder = Path(path)
    index = _read_index(folder)
    told = {file.name: (file.nbytes, file.sha256) for file in index.files} | {POINTS: (index.nbytes, index.sha256)}
    for name, facts in told.items():
        with _named(folder / name):
            if digest_of(folder / name) != facts:
                raise ValueError("it is not the file that the index describes: its SHA-256 is another")


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
        if found.pop("version", None) not in (SURFACE_ONLY, VERSION):
            raise ValueError(OUTDATED)
        parts = [PartFile.of(part) for part in found.pop("parts")]
        index = Index(**found, parts=parts)
        _check_index(index)
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise ValueError(f"{path}: {error}") from error
    return index


def _check_index(index: Index) -> None:
    """ValueError if a value of the index has another type or is out of range."""
    files = index.files
    names = {file.name for file in files if isinstance(file.name, str) and file.name.endswith(SAVED)}
    if not files or len(names) != len(files) or any(Path(name).name != name for name in names):
        raise ValueError("it names no parts, or not by files of the folder")
    if not isinstance(index.settings, dict) or not isinstance(index.survey, dict) or not isinstance(index.id, str):
        raise ValueError("its settings, survey or id are none")
    whole = [
        index.nbytes,
        index.scattered,
        *(number for file in files for number in (file.points, file.longest, file.nbytes)),
    ]
    if not all(isinstance(number, int) and 0 <= number < 2**63 for number in whole):
        raise ValueError("a number of points, blocks or bytes is none")
    if index.scattered > sum(part.points for part in index.parts):
        raise ValueError("more points are scattered than there are")
    boxes = [index.bounds, *(part.bounds for part in index.parts)]
    boxes += [part.reach for part in index.parts if part.reach is not None]
    if not all(_is_box(np.array(box, np.float64)) for box in boxes):
        raise ValueError("bounds are none")
    supports = np.array(index.supports, np.float64)
    if supports.shape != (6,) or not np.isfinite(supports).all() or not 0 <= float(index.longest) < math.inf:
        raise ValueError("bounds of supports or the longest step are no numbers")
    for part in index.parts:
        spacings = [float(level.spacing) for level in part.levels]
        if not 0 <= float(part.spacing) < math.inf or not all(0 < spacing < math.inf for spacing in spacings):
            raise ValueError("a spacing is none")
        if spacings != sorted(spacings):
            raise ValueError("levels of detail are not from fine to coarse")


def _is_box(box: NDArray[np.float64]) -> bool:
    return box.shape == (2, 3) and bool(np.isfinite(box).all() and (box[0] <= box[1]).all())


def _read_points(folder: Path, index: Index) -> tuple[Points, NDArray[np.float32]]:
    path = folder / POINTS
    with _named(path):
        _check_size(path, index.nbytes)
        about, found = read_arrays(path, POINTS_KIND)
        if about.get("folder") != index.id:
            raise ValueError("it is of another folder")
        points = points_of(found, survey_of({"survey": index.survey}))
        radii = take_array(found, "radii", np.float32, (len(points),))
        if sum(part.points for part in index.parts) != len(points):
            raise ValueError(f"it holds {len(points):,} points, the parts others")
    return points, radii


def read_part(folder: Path, index: Index, key: tuple[int, int], whole: Level, is_sound: bool = False) -> Level:
    """A part with the points of the whole, mapped and checked, see `read_folder`.

    key : the part's number, and 0; is_sound : whether the file has been checked before, and is the same
    """
    part = index.parts[key[0]]
    path = folder / part.name
    with _named(path):
        _check_size(path, part.nbytes)
        about, found = read_arrays(path, PART_KIND)
        if about.get("folder") != index.id or about.get("part") != key[0]:
            raise ValueError("it is another part, or of another folder")
        tree = take_tree(found)
        if len(tree.head) == HEAD:
            tree.head[BOUNDS : BOUNDS + 6], tree.head[LONGEST] = index.supports, index.longest
        if not is_sound:
            check_level(tree, len(whole.points))
        _check_told(tree, part)
    return Level(index.settings, whole.points, whole.radii, np.array(part.bounds), tree)


def read_level(folder: Path, index: Index, key: tuple[int, int], whole: Level, is_sound: bool = False) -> Level:
    """A level of detail of a part, likewise. key : the part's number, and the level's: 1 is the finest"""
    file = index.parts[key[0]].levels[key[1] - 1]
    path = folder / file.name
    with _named(path):
        _check_size(path, file.nbytes)
    level, *others = read_model(path, {"folder": index.id, "part": key[0], "level": key[1]}, is_sound)
    with _named(path):
        if others or len(level.points) != file.points:
            raise ValueError(f"it has {len(level.points):,} points, not {file.points:,}, or levels of detail itself")
        check_columns(level, whole)
        _check_told(level.tree, file)
    return level


def _check_told(tree: Tree, file: PartFile | LevelFile) -> None:
    """ValueError if the index says less of a tree than what kernels get memory for."""
    if longest_leaf(tree) != file.longest:
        raise ValueError(f"its longest leaf has {longest_leaf(tree)} blocks, not {file.longest}")


@contextmanager
def _named(path: Path) -> Iterator[None]:
    """Add a file's name to errors."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def _check_size(path: Path, nbytes: int) -> None:
    """ValueError if a file has another size than the index says."""
    size = path.stat().st_size
    if size != nbytes:
        raise ValueError(f"it has {size:,} bytes, not {nbytes:,}: it is cut off, or of another folder")
