"""Models as files, see `array_file`. A model's levels of detail follow it, as models of their own.

A file is not trusted: names, types, lengths and every number that a ray follows are checked before the first ray, so
that a damaged one is an error.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..cloud.georeference import Survey
from ..cloud.points import FARTHEST, Points
from ..engine.kernels.tree import BLOCK, GROUP, HEAD, LEAF, LONGEST, NODE, PATCH, SCATTER, STEP, Tree
from ..surface.tree.indices import check_indices
from .array_file import Arrays, Kind, Say, read_arrays, take_array, write_arrays

SAVED = ".pointray"  # the usual end of such a file's name
LAYOUT = [BLOCK, LEAF, NODE, GROUP, HEAD, PATCH]
# Version 3 has leaves of scattered points; a model without any is written as version 2, which earlier releases read.
# Another number of LEAF_BLOCKS needs another version.
SURFACE_ONLY = 2
KIND = Kind(
    "pointray model", 3, LAYOUT, "a saved model", "saved by another version of pointray: save it anew", (SURFACE_ONLY,)
)


class Level(NamedTuple):
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


@dataclass(frozen=True)
class Place:
    """A file that holds a model, as it was at one moment.

    path : absolute
    size : bytes
    written : when, in nanoseconds
    leveled : whether its levels of detail belong to the model
    index : of a folder, the file in it whose size and time these are; else empty
    """

    path: str
    size: int
    written: int
    leveled: bool = True
    index: str = ""

    @property
    def is_there(self) -> bool:
        """Whether this process sees the file, unchanged."""
        try:
            return replace(place_of(self.path, self.index), leveled=self.leveled) == self
        except OSError:
            return False


def place_of(path: str | os.PathLike[str], index: str = "") -> Place:
    """The place of a file. index : of a folder, the name of the file in it that stands for all"""
    facts = os.stat(os.path.join(path, index) if index else path)
    return Place(os.path.abspath(path), facts.st_size, facts.st_mtime_ns, index=index)


def write_model(
    path: str | os.PathLike[str], levels: Sequence[Level], say: Say, more: Mapping[str, Any] | None = None
) -> None:
    """Write a file that `read_model` reads; the file gets its name when all is written.

    Parameters
    ----------
    levels : sequence of Level
        The model, then its levels of detail.
    say : callable
        Told the share done.
    more : dict, optional
        What the description says besides, in a form that JSON can hold.
    """
    named = {
        f"{_prefix(k)}{name}": array for k, level in enumerate(levels) for name, array in _arrays_of(level).items()
    }
    settings = [level.settings for level in levels]
    about = {"settings": settings[0], "levels": settings[1:], "survey": levels[0].points.survey.facts}
    scattered = any(level.tree.head[SCATTER] for level in levels)
    kind = KIND if scattered else KIND._replace(version=SURFACE_ONLY)
    write_arrays(path, kind, {**about, **(more or {})}, named, say)


def _prefix(k: int) -> str:
    """The prefix of the names of a level's arrays: empty for the model itself."""
    return f"level{k}." if k else ""


def _arrays_of(level: Level) -> Arrays:
    """A level's arrays, by their names in a file."""
    points = level.points
    named = {f"points.{name}": getattr(points, name) for name in ("positions", "origin", "normals", "colors")}
    named |= {f"attribute.{name}": values for name, values in points.attributes.items()}
    named |= {"radii": level.radii, "bounds": level.bounds}
    named |= {f"tree.{name}": array for name, array in zip(Tree._fields, level.tree, strict=True)}
    return {name: array for name, array in named.items() if array is not None}


def read_model(
    path: str | os.PathLike[str], among: Mapping[str, Any] | None = None, is_sound: bool = False
) -> list[Level]:
    """The model of a file and its levels of detail: mapped, so that they are ready at once.

    Parameters
    ----------
    among : dict, optional
        What the description must say besides.
    is_sound : bool
        Whether the file has been checked before, and is the same.

    Raises
    ------
    OSError
        If the file cannot be opened.
    ValueError
        If it is no model, has another version, or is damaged.
    """
    try:
        about, found = read_arrays(path, KIND)
        if any(about.get(name) != value for name, value in (among or {}).items()):
            raise ValueError("it is another part, or of another folder")
        survey = survey_of(about)
        given = [(settings, _prefix(k)) for k, settings in enumerate(_settings_in(about))]
        levels = [_take_level(settings, found, prefix, survey, is_sound) for settings, prefix in given]
        for level in levels[1:]:
            check_columns(level, levels[0])
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
    return levels


def _settings_in(about: dict[str, Any]) -> list[dict[str, Any]]:
    """The settings of the model and of its levels of detail; an older file has no levels."""
    settings = [about.get("settings"), *_listed(about.get("levels", []))]
    if not all(isinstance(one, dict) for one in settings):
        raise ValueError("the model is damaged: its settings are none")
    return settings


def survey_of(about: dict[str, Any]) -> Survey:
    """What is known of the coordinates; an older file says nothing."""
    try:
        return Survey(**about.get("survey", {}))
    except (TypeError, ValueError) as error:
        raise ValueError(f"the model is damaged: its survey is none: {error}") from error


def _listed(value: Any) -> list[Any]:
    return value if isinstance(value, list) else [value]


def check_columns(level: Level, model: Level) -> None:
    """ValueError if a level of detail has not the columns and the origin of its model."""
    if _columns_of(level.points) != _columns_of(model.points):
        raise ValueError("the model is damaged: a level of detail has other attributes or colors")
    if not np.array_equal(level.points.origin, model.points.origin):
        raise ValueError("the model is damaged: a level of detail has another origin")


def _columns_of(points: Points) -> dict[str, Any]:
    """The columns that all levels of a model share."""
    return {"": points.colors is None, **{name: (v.dtype, v.shape[1:]) for name, v in points.attributes.items()}}


def _take_level(settings: dict[str, Any], found: Arrays, prefix: str, survey: Survey, is_sound: bool) -> Level:
    """The level whose arrays' names begin with a prefix, checked."""
    mine = {name.removeprefix(prefix): array for name, array in found.items() if name.startswith(prefix)}
    points = points_of(mine, survey)
    radii, bounds = (
        take_array(mine, "radii", np.float32, (len(points),)),
        take_array(mine, "bounds", np.float64, (2, 3)),
    )
    within = np.abs(bounds - points.origin) <= 2.0 * FARTHEST  # also false for NaN
    if not (within.all() and (bounds[0] <= bounds[1]).all()):
        raise ValueError("the model is damaged: its bounds are none")
    level = Level(settings, points, radii, bounds, take_tree(mine))
    if not is_sound:
        check_level(level.tree, len(points))
    return level


def check_level(tree: Tree, points: int) -> None:
    """ValueError if a ray could leave a tree that names so many points, see `check_indices`."""
    problems = check_indices(tree, points)
    if problems:
        raise ValueError(f"the model is damaged: {problems[0]}")


def points_of(found: Arrays, survey: Survey) -> Points:
    positions = take_array(found, "points.positions", np.float32, (-1, 3))
    origin = take_array(found, "points.origin", np.float64, (3,))
    names = [name for name in found if name.startswith("attribute.")]
    attributes = {name.removeprefix("attribute."): found.pop(name) for name in names}
    normals, colors = found.pop("points.normals", None), found.pop("points.colors", None)
    return Points.about(origin, positions, normals, colors, attributes, survey)


def take_tree(found: Arrays) -> Tree:
    whole = {"children", "spans", "refs", "order", "colors"}
    small = {"borders", "facing"}
    types = {name: np.int32 if name in whole else np.int8 if name in small else np.float32 for name in Tree._fields}
    found.setdefault("tree.noise", np.zeros(0, np.float32))  # a file that was saved before it was kept
    tree = Tree(*(take_array(found, f"tree.{name}", types[name], (-1,)) for name in Tree._fields))
    tree = tree._replace(head=tree.head.copy())  # the only array that is written to
    if len(tree.head) == HEAD and tree.head[LONGEST] == 0.0:  # the file was saved before this number was kept
        tree.head[LONGEST] = tree.leaves[STEP::LEAF].max(initial=0.0)
    return tree
