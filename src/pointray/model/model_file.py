"""Model files, see `array_file`. Levels of detail follow the model, each stored like a model.

Files are not trusted: names, types, lengths and every number that a ray follows are validated before the first ray, so
that a damaged file raises an error.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from ..base.arrays import Doubles, Floats
from ..base.progress import Progress
from ..cloud.georeference import Georeference
from ..cloud.points import FARTHEST, Points
from ..engine.kernels.tree import BLOCK, GROUP, HEAD, LEAF, LONGEST, NODE, PATCH, SCATTER, STEP, Tree
from ..surface.tree.indices import check_indices
from .array_file import Arrays, Kind, read_arrays, take_array, write_arrays

SAVED = ".pointray"  # file extension
LAYOUT = [BLOCK, LEAF, NODE, GROUP, HEAD, PATCH]
# Version 3 has leaves of scattered points; a model without any is written as version 2, which earlier releases read.
# Changing LEAF_BLOCKS requires a new version.
SURFACE_ONLY = 2
KIND = Kind(
    "pointray model", 3, LAYOUT, "a saved model", "saved by another version of pointray: save it again", (SURFACE_ONLY,)
)


class Level(NamedTuple):
    """A model, or one of its levels of detail, as stored in a file.

    Attributes
    ----------
    settings : dict
        Settings of the surface, the tree, smoothing and the drawing of scattered points, as JSON types.
    points : Points
    radii : (n,) float32
        Support radius of each point, 0 for points without a splat.
    bounds : (2, 3) float64
        Bounds of the points, world.
    tree : Tree
        The tree over the splats.
    """

    settings: dict[str, Any]
    points: Points
    radii: Floats
    bounds: Doubles
    tree: Tree


@dataclass(frozen=True)
class Place:
    """A file or folder that holds a model, with its state at one moment. Another process can open the same model by it.

    path : absolute
    size : bytes
    written : modification time in nanoseconds
    leveled : whether the model has the levels of detail that are in the file
    index : for a folder, the file in it that size and time refer to; else empty
    """

    path: str
    size: int
    written: int
    leveled: bool = True
    index: str = ""

    @property
    def is_there(self) -> bool:
        """Whether this process finds the file with the same size and modification time."""
        try:
            return replace(place_of(self.path, self.index), leveled=self.leveled) == self
        except OSError:
            return False


def place_of(path: str | os.PathLike[str], index: str = "") -> Place:
    """Return the path, size and modification time of a file or folder that holds a model.

    index : for a folder, the name of the file in it whose size and time represent it
    """
    facts = os.stat(os.path.join(path, index) if index else path)
    return Place(os.path.abspath(path), facts.st_size, facts.st_mtime_ns, index=index)


def write_model(
    path: str | os.PathLike[str], levels: Sequence[Level], report: Progress, more: Mapping[str, Any] | None = None
) -> None:
    """Write a model and its levels of detail to a file, which gets its name when it is complete. `read_model` reads it.

    Parameters
    ----------
    path : str or path
    levels : sequence of Level
        The model, then its levels of detail, from fine to coarse.
    report : callable
        Called with the fraction done.
    more : dict, optional
        Additional entries of the JSON description at the beginning of the file.
    """
    arrays = {
        f"{_prefix(k)}{name}": array for k, level in enumerate(levels) for name, array in _arrays_of(level).items()
    }
    settings = [level.settings for level in levels]
    about = {"settings": settings[0], "levels": settings[1:], "survey": levels[0].points.georeference.facts}
    scattered = any(level.tree.head[SCATTER] for level in levels)
    kind = KIND if scattered else KIND._replace(version=SURFACE_ONLY)
    write_arrays(path, kind, {**about, **(more or {})}, arrays, report)


def _prefix(k: int) -> str:
    """Return the prefix of a level's array names in a file: "level1." for k = 1, empty for the model itself (k = 0)."""
    return f"level{k}." if k else ""


def _arrays_of(level: Level) -> Arrays:
    """Return the arrays of a model or level of detail by their names in a file, such as "points.positions"."""
    points = level.points
    arrays = {f"points.{name}": getattr(points, name) for name in ("positions", "origin", "normals", "colors")}
    arrays |= {f"attribute.{name}": values for name, values in points.attributes.items()}
    arrays |= {"radii": level.radii, "bounds": level.bounds}
    arrays |= {f"tree.{name}": array for name, array in zip(Tree._fields, level.tree, strict=True)}
    return {name: array for name, array in arrays.items() if array is not None}


def read_model(
    path: str | os.PathLike[str], expected: Mapping[str, Any] | None = None, is_sound: bool = False
) -> list[Level]:
    """Read the model of a file and its levels of detail, from fine to coarse; arrays are mapped, so this is immediate.

    Parameters
    ----------
    path : str or path
    expected : dict, optional
        Entries that the JSON description at the beginning of the file must have; a ValueError if one differs.
    is_sound : bool
        Whether the trees have been validated before and the file is unchanged, so that this is not repeated.

    Returns
    -------
    list of Level
        The model, then its levels of detail.

    Raises
    ------
    OSError
        If the file cannot be opened.
    ValueError
        If the file is not a model, has another version, or is damaged.
    """
    try:
        about, found = read_arrays(path, KIND)
        if any(about.get(name) != value for name, value in (expected or {}).items()):
            raise ValueError("part does not belong to this folder")
        georeference = georeference_of(about)
        given = [(settings, _prefix(k)) for k, settings in enumerate(_settings_in(about))]
        levels = [_take_level(settings, found, prefix, georeference, is_sound) for settings, prefix in given]
        for level in levels[1:]:
            check_columns(level, levels[0])
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
    return levels


def _settings_in(about: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the settings of the model, then of its levels of detail; files of older versions have no levels.

    about : JSON description at the beginning of the file
    """
    settings = [about.get("settings"), *_listed(about.get("levels", []))]
    if not all(isinstance(one, dict) for one in settings):
        raise ValueError("the model is damaged: invalid settings")
    return settings


def georeference_of(about: dict[str, Any]) -> Georeference:
    """Return the georeference in the JSON description of a file (its entry "survey"); empty for files without one."""
    try:
        return Georeference(**about.get("survey", {}))
    except (TypeError, ValueError) as error:
        raise ValueError(f"the model is damaged: invalid georeference: {error}") from error


def _listed(value: Any) -> list[Any]:
    return value if isinstance(value, list) else [value]


def check_columns(level: Level, model: Level) -> None:
    """Raise a ValueError if a level of detail does not have the same colours, attributes or origin as its model."""
    if _columns_of(level.points) != _columns_of(model.points):
        raise ValueError("the model is damaged: a level of detail has different attributes or colors")
    if not np.array_equal(level.points.origin, model.points.origin):
        raise ValueError("the model is damaged: a level of detail has a different origin")


def _columns_of(points: Points) -> dict[str, Any]:
    """Return a dict to compare levels of a model by: whether colours are missing, dtype and row shape of attributes."""
    return {"": points.colors is None, **{name: (v.dtype, v.shape[1:]) for name, v in points.attributes.items()}}


def _take_level(
    settings: dict[str, Any], found: Arrays, prefix: str, georeference: Georeference, is_sound: bool
) -> Level:
    """Remove the arrays of one model or level of detail from those of a file; return them, validated, as a `Level`.

    settings : of the level, as stored; found : all arrays of the file by name
    prefix : beginning of the names of the level's arrays; georeference : of the points
    is_sound : whether the tree has been validated before, so that this is not repeated
    """
    mine = {name.removeprefix(prefix): array for name, array in found.items() if name.startswith(prefix)}
    points = points_of(mine, georeference)
    radii, bounds = (
        take_array(mine, "radii", np.float32, (len(points),)),
        take_array(mine, "bounds", np.float64, (2, 3)),
    )
    within = np.abs(bounds - points.origin) <= 2.0 * FARTHEST  # false for NaN as well
    if not (within.all() and (bounds[0] <= bounds[1]).all()):
        raise ValueError("the model is damaged: invalid bounds")
    level = Level(settings, points, radii, bounds, take_tree(mine))
    if not is_sound:
        check_level(level.tree, len(points))
    return level


def check_level(tree: Tree, points: int) -> None:
    """Raise a ValueError if an index or number in a tree is out of range, so that no damaged file can crash a kernel.

    points : number of points that the tree may refer to
    """
    problems = check_indices(tree, points)
    if problems:
        raise ValueError(f"the model is damaged: {problems[0]}")


def points_of(found: Arrays, georeference: Georeference) -> Points:
    positions = take_array(found, "points.positions", np.float32, (-1, 3))
    origin = take_array(found, "points.origin", np.float64, (3,))
    names = [name for name in found if name.startswith("attribute.")]
    attributes = {name.removeprefix("attribute."): found.pop(name) for name in names}
    normals, colors = found.pop("points.normals", None), found.pop("points.colors", None)
    return Points.about(origin, positions, normals, colors, attributes, georeference)


def take_tree(found: Arrays) -> Tree:
    whole = {"children", "spans", "refs", "order", "colors"}
    small = {"borders", "facing"}
    types = {name: np.int32 if name in whole else np.int8 if name in small else np.float32 for name in Tree._fields}
    found.setdefault("tree.noise", np.zeros(0, np.float32))  # missing in older files
    tree = Tree(*(take_array(found, f"tree.{name}", types[name], (-1,)) for name in Tree._fields))
    tree = tree._replace(head=tree.head.copy())  # the only array that is written to
    if len(tree.head) == HEAD and tree.head[LONGEST] == 0.0:  # missing in older files
        tree.head[LONGEST] = tree.leaves[STEP::LEAF].max(initial=0.0)
    return tree
