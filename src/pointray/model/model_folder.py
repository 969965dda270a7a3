"""Folders of models in parts: an index in JSON, the points of all parts, and a file with the tree of each part.

    city.pointray/index.json             contents of the folder
    city.pointray/points.pointray        positions, normals, colours, attributes and radii, part after part
    city.pointray/part-0000.pointray     the tree over the splats of a part and those of others that reach into it
    city.pointray/part-0000-1.pointray   a level of detail of the part, a saved model: 1 is the finest

A part is an aligned range of the kd order of the surface's points, or of the scattered points, which follow those of
the surface. Rows refer to all points; in the file of a level of detail, to its own points. All files are validated, see
`model_file`.
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

from ..base.arrays import Doubles, Floats
from ..base.atomic_write import replacing
from ..cloud.points import Points
from ..engine.kernels.tree import BOUNDS, HEAD, LONGEST, SCATTER, Tree, no_tree
from ..surface.tree.stored import find_surface_bounds, longest_leaf, radii_of
from . import model_file
from .array_file import Kind, Pieces, read_arrays, take_array, write_arrays
from .model_file import Level

INDEX, POINTS = "index.json", "points.pointray"
UNFINISHED = "unfinished"  # subfolder with intermediate results until preparation is complete
# Version 3 has scattered points; a folder without any is written as version 2, which earlier releases read.
FORMAT, VERSION, SURFACE_ONLY = "pointray parts", 3, 2
MOST = 2**31  # rows are int32 in trees
OUTDATED = "written by another version of pointray: run `pointray prepare` again"
POINTS_KIND = Kind("pointray points", SURFACE_ONLY, [], "the points of a model in parts", OUTDATED)
PART_KIND = Kind("pointray part", VERSION, model_file.LAYOUT, "a part of a model", OUTDATED, (SURFACE_ONLY,))

Report = Callable[[float], None]


class LevelFile(NamedTuple):
    """A level of detail of a part, as described in the index file (index.json) of a model in parts.

    name : name of the level's file
    points : number of points of the level
    spacing : median support radius; for scattered points that of a surface with points as dense as these
    longest : number of blocks in the longest leaf
    nbytes, sha256 : size of the file in bytes, and its SHA-256 in hexadecimal digits
    """

    name: str
    points: int
    spacing: float
    longest: int
    nbytes: int
    sha256: str


class PartFile(NamedTuple):
    """A part, as described in the index file (index.json) of a model in parts.

    name : name of the part's file
    points : number of the part's own points; bounds : (2, 3), bounds of these points, world
    reach : (2, 3) bounds of all that rays can hit, relative to the points' origin; None: nothing
    spacing : median support radius of all splats in the file; for scattered points that of a surface with points as
        dense as these
    longest : number of blocks in the longest leaf
    nbytes, sha256 : size of the file in bytes, and its SHA-256 in hexadecimal digits
    levels : the part's levels of detail, from fine to coarse
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
        """Return the index entry of a part from its fields as read from JSON, a dict like `PartFile.facts`."""
        return cls(**{**facts, "levels": [LevelFile(**level) for level in facts["levels"]]})

    @property
    def facts(self) -> dict[str, Any]:
        """Fields of the entry as JSON values, for the index file; `PartFile.of` makes the entry from them."""
        return {**self._asdict(), "levels": [level._asdict() for level in self.levels]}


class Index(NamedTuple):
    """Contents of the index file of a model in parts.

    id : hexadecimal number, stored in all files of the folder, by which files of another folder are recognised
    settings : settings of the model as JSON types
    survey : georeference of the coordinates
    bounds : (2, 3), bounds of all points, world
    supports : (6,), box around all supports, relative to the points' origin; a ray's samples start where the ray enters
        this box
    longest : longest distance between a ray's samples in any part, in the points' unit
    nbytes, sha256 : size in bytes and SHA-256 of the file with all points
    parts : entries of the parts of the surface, then of the parts of scattered points
    scattered : number of scattered points (drawn as spheres or discs), which are the last rows of the points
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
        """Entries of all parts, and of all their levels of detail."""
        return [*self.parts, *(level for part in self.parts for level in part.levels)]


def digest_of(path: Path) -> tuple[int, str]:
    """Return the size of a file in bytes and its SHA-256, a string of 64 hexadecimal digits."""
    with path.open("rb") as file:
        return os.fstat(file.fileno()).st_size, hashlib.file_digest(file, "sha256").hexdigest()


def write_points(
    folder: Path, id: str, origin: Doubles, columns: Mapping[str, Pieces], report: Report
) -> tuple[int, str]:
    """Write the file with the points of all parts of a model; return its size in bytes and its SHA-256.

    id : hexadecimal number of the folder; origin : (3,), world position of the coordinates' origin
    columns : arrays or columns on disk by their names in the file, which are "points.positions", optionally
        "points.normals" and "points.colors", then attributes and radii
    report : called with the fraction done
    """
    points = {name: column for name, column in columns.items() if name.startswith("points.")}
    write_arrays(folder / POINTS, POINTS_KIND, {"folder": id}, {**points, "points.origin": origin, **columns}, report)
    return digest_of(folder / POINTS)


def write_part(folder: Path, id: str, number: int, points: int, bounds: Doubles, tree: Tree) -> PartFile:
    """Write the file with the tree of a part; return its entry for the index file, without levels.

    The entry's spacing is the median of all radii, as if no points were drawn as spheres or discs.

    id : hexadecimal number of the folder; number : number of the part, from 0
    points : number of the part's own points; bounds : (2, 3), bounds of these points, world
    tree : over the part's splats and those of other parts that reach into it
    """
    path = folder / f"part-{number:04d}.pointray"
    named = {f"tree.{name}": array for name, array in zip(Tree._fields, tree, strict=True)}
    kind = PART_KIND if tree.head[SCATTER] else PART_KIND._replace(version=SURFACE_ONLY)
    write_arrays(path, kind, {"folder": id, "part": number}, named, lambda share: None)
    reach = find_surface_bounds(tree)
    box = None if reach is None else reach.tolist()
    spacing = float(np.median(radii_of(tree))) if box else 0.0
    return PartFile(path.name, points, bounds.tolist(), box, spacing, longest_leaf(tree), *digest_of(path), [])


def write_level(folder: Path, id: str, part: int, number: int, level: Level) -> LevelFile:
    """Write the file of a level of detail of a part; return its entry for the index file.

    id : hexadecimal number of the folder
    part : number of the part, from 0; number : number of the level, 1 for the finest
    level : points, radii and tree of the level
    """
    path = folder / f"part-{part:04d}-{number}.pointray"
    model_file.write_model(path, [level], lambda share: None, {"folder": id, "part": part, "level": number})
    spacing = float(np.median(level.radii))
    return LevelFile(path.name, len(level.points), spacing, longest_leaf(level.tree), *digest_of(path))


def write_index(folder: Path, index: Index) -> None:
    """Write index.json, which lists the files of a model in parts, last: a folder without an index is no model."""
    facts = {**index._asdict(), "parts": [part.facts for part in index.parts]}
    if not index.scattered:
        del facts["scattered"]
    version = VERSION if index.scattered else SURFACE_ONLY
    text = json.dumps({"format": FORMAT, "version": version, **facts}, indent=1)
    with replacing(folder / INDEX) as file:
        file.write(text.encode())


def read_folder(path: str | os.PathLike[str]) -> tuple[Index, Level]:
    """Read the index of a model in parts, and its points, memory-mapped; return both.

    The points come as a `Level` with the settings and bounds of the whole model and a tree without splats. File sizes
    are compared with the index. Parts and levels of detail are not opened.

    Raises
    ------
    OSError
        If a file cannot be opened; the error names it.
    ValueError
        If there is no index, or a file is damaged, has another version or belongs to another folder; the message names
        the file.
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
    """Raise a ValueError if a folder has no valid index.json, the index file of a model in parts."""
    _read_index(Path(path))


def verify_folder(path: str | os.PathLike[str]) -> None:
    """Raise a ValueError if the size or SHA-256 of any file of a model in parts differs from its index file.

    Reads all files.
    """
    folder = Path(path)
    index = _read_index(folder)
    expected = {file.name: (file.nbytes, file.sha256) for file in index.files} | {POINTS: (index.nbytes, index.sha256)}
    for name, facts in expected.items():
        with _named(folder / name):
            if digest_of(folder / name) != facts:
                raise ValueError("SHA-256 differs from the index: the file is damaged or belongs to another folder")


def _read_index(folder: Path) -> Index:
    path = folder / INDEX
    if not path.is_file() and (folder / UNFINISHED).is_dir():
        raise ValueError(f"{folder}: preparation is unfinished: run the same `pointray prepare` again to resume")
    if not path.is_file():
        raise ValueError(f"{folder}: not a model in parts: {INDEX} is missing")
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
    """Raise a ValueError if a value of the index has the wrong type or is out of range."""
    files = index.files
    names = {file.name for file in files if isinstance(file.name, str) and file.name.endswith(model_file.SAVED)}
    if not files or len(names) != len(files) or any(Path(name).name != name for name in names):
        raise ValueError("its parts are missing or are not files of the folder")
    if not isinstance(index.settings, dict) or not isinstance(index.survey, dict) or not isinstance(index.id, str):
        raise ValueError("invalid settings, survey or id")
    whole = [
        index.nbytes,
        index.scattered,
        *(number for file in files for number in (file.points, file.longest, file.nbytes)),
    ]
    if not all(isinstance(number, int) and 0 <= number < 2**63 for number in whole):
        raise ValueError("invalid number of points, blocks or bytes")
    if index.scattered > sum(part.points for part in index.parts):
        raise ValueError("more scattered points than points")
    boxes = [index.bounds, *(part.bounds for part in index.parts)]
    boxes += [part.reach for part in index.parts if part.reach is not None]
    if not all(_is_box(np.array(box, np.float64)) for box in boxes):
        raise ValueError("invalid bounds")
    supports = np.array(index.supports, np.float64)
    if supports.shape != (6,) or not np.isfinite(supports).all() or not 0 <= float(index.longest) < math.inf:
        raise ValueError("invalid bounds of supports or longest step")
    for part in index.parts:
        spacings = [float(level.spacing) for level in part.levels]
        if not 0 <= float(part.spacing) < math.inf or not all(0 < spacing < math.inf for spacing in spacings):
            raise ValueError("invalid spacing")
        if spacings != sorted(spacings):
            raise ValueError("levels of detail are not from fine to coarse")


def _is_box(box: Doubles) -> bool:
    return box.shape == (2, 3) and bool(np.isfinite(box).all() and (box[0] <= box[1]).all())


def _read_points(folder: Path, index: Index) -> tuple[Points, Floats]:
    path = folder / POINTS
    with _named(path):
        _check_size(path, index.nbytes)
        about, found = read_arrays(path, POINTS_KIND)
        if about.get("folder") != index.id:
            raise ValueError("file belongs to another folder")
        points = model_file.points_of(found, model_file.georeference_of({"survey": index.survey}))
        radii = take_array(found, "radii", np.float32, (len(points),))
        if sum(part.points for part in index.parts) != len(points):
            raise ValueError(f"it has {len(points):,} points; the parts have another number")
    return points, radii


def read_part(folder: Path, index: Index, key: tuple[int, int], whole: Level, is_valid: bool = False) -> Level:
    """Read and validate the file of a part; return its tree, memory-mapped, with all points and radii of the model.

    key : number of the part, and 0, the level that stands for the part itself
    whole : all points of the model, as `read_folder` returns them
    is_valid : whether the tree was validated before and is unchanged, so that this is not repeated
    """
    part = index.parts[key[0]]
    path = folder / part.name
    with _named(path):
        _check_size(path, part.nbytes)
        about, found = read_arrays(path, PART_KIND)
        if about.get("folder") != index.id or about.get("part") != key[0]:
            raise ValueError("part does not belong to this folder, or has another number")
        tree = model_file.take_tree(found)
        if len(tree.head) == HEAD:
            tree.head[BOUNDS : BOUNDS + 6], tree.head[LONGEST] = index.supports, index.longest
        if not is_valid:
            model_file.check_level(tree, len(whole.points))
        _check_leaves(tree, part)
    return Level(index.settings, whole.points, whole.radii, np.array(part.bounds), tree)


def read_level(folder: Path, index: Index, key: tuple[int, int], whole: Level, is_valid: bool = False) -> Level:
    """Read and validate the file of a part's level of detail; return its points, radii and tree, memory-mapped.

    key : number of the part, and number of the level, 1 for the finest
    whole : all points of the model, as `read_folder` returns them; the level must have the same colours and attributes
    is_valid : whether the tree was validated before and is unchanged, so that this is not repeated
    """
    file = index.parts[key[0]].levels[key[1] - 1]
    path = folder / file.name
    with _named(path):
        _check_size(path, file.nbytes)
    level, *others = model_file.read_model(path, {"folder": index.id, "part": key[0], "level": key[1]}, is_valid)
    with _named(path):
        if others or len(level.points) != file.points:
            raise ValueError(f"expected {file.points:,} points without levels of detail, got {len(level.points):,}")
        model_file.check_columns(level, whole)
        _check_leaves(level.tree, file)
    return level


def _check_leaves(tree: Tree, file: PartFile | LevelFile) -> None:
    """Raise a ValueError if the number of blocks in a tree's longest leaf differs from its index entry.

    Kernels allocate memory by the number in the entry.

    file : the entry of the part or level that the tree belongs to
    """
    if longest_leaf(tree) != file.longest:
        raise ValueError(f"expected a longest leaf of {file.longest} blocks, got {longest_leaf(tree)}")


@contextmanager
def _named(path: Path) -> Iterator[None]:
    """Put the path of a file before the message of a ValueError raised in the `with` block."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def _check_size(path: Path, nbytes: int) -> None:
    """Raise a ValueError if a file does not have the size in bytes that the folder's index file states."""
    size = path.stat().st_size
    if size != nbytes:
        raise ValueError(f"expected {nbytes:,} bytes, got {size:,}: the file is truncated or belongs to another folder")
