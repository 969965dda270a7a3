"""Models as files, see `array_file`. A model's levels of detail follow it, as models of their own.

A file is not trusted: names, types, lengths and every number that a ray follows are checked before the first ray, so
that a damaged one is an error.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .array_file import Arrays, Kind, Say, read_arrays, take_array, write_arrays
from .data import FARTHEST, Points
from .kernels.tree import BLOCK, GROUP, HEAD, LEAF, LONGEST, NODE, PATCH, STEP, Tree
from .survey import Survey
from .tree.indices import check_indices

SAVED = ".pointray"  # the usual end of such a file's name
LAYOUT = [BLOCK, LEAF, NODE, GROUP, HEAD, PATCH]
KIND = Kind("pointray model", 2, LAYOUT, "a saved model", "saved by another version of pointray: save it anew")


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
    about = {"settings": settings[0], "levels": settings[1:], "survey": parts[0].points.survey.facts}
    write_arrays(path, KIND, about, named, say)


def _prefix(k: int) -> str:
    """The prefix of the names of a part's arrays: empty for the model itself."""
    return f"level{k}." if k else ""


def _arrays_of(part: Part) -> Arrays:
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
    try:
        about, found = read_arrays(path, KIND)
        survey = _survey_in(about)
        parts = [_take_part(settings, found, _prefix(k), survey) for k, settings in enumerate(_settings_in(about))]
        for part in parts[1:]:
            if _columns_of(part.points) != _columns_of(parts[0].points):
                raise ValueError("the model is damaged: a level of detail has other attributes or colors")
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
    return parts


def _settings_in(about: dict[str, Any]) -> list[dict[str, Any]]:
    """The settings of the model and of its levels of detail; an older file has no levels."""
    settings = [about.get("settings"), *_listed(about.get("levels", []))]
    if not all(isinstance(one, dict) for one in settings):
        raise ValueError("the model is damaged: its settings are none")
    return settings


def _survey_in(about: dict[str, Any]) -> Survey:
    """What is known of the coordinates; an older file says nothing."""
    try:
        return Survey(**about.get("survey", {}))
    except (TypeError, ValueError) as error:
        raise ValueError(f"the model is damaged: its survey is none: {error}") from error


def _listed(value: Any) -> list[Any]:
    return value if isinstance(value, list) else [value]


def _columns_of(points: Points) -> dict[str, Any]:
    """The columns that all levels of a model share."""
    return {"": points.colors is None, **{name: (v.dtype, v.shape[1:]) for name, v in points.attributes.items()}}


def _take_part(settings: dict[str, Any], found: Arrays, prefix: str, survey: Survey) -> Part:
    """The part whose arrays' names begin with a prefix, checked."""
    mine = {name.removeprefix(prefix): array for name, array in found.items() if name.startswith(prefix)}
    points = _take_points(mine, survey)
    radii, bounds = (
        take_array(mine, "radii", np.float32, (len(points),)),
        take_array(mine, "bounds", np.float64, (2, 3)),
    )
    within = np.abs(bounds - points.origin) <= 2.0 * FARTHEST  # also false for NaN
    if not (within.all() and (bounds[0] <= bounds[1]).all()):
        raise ValueError("the model is damaged: its bounds are none")
    part = Part(settings, points, radii, bounds, _take_tree(mine))
    problems = check_indices(part.tree, len(points))
    if problems:
        raise ValueError(f"the model is damaged: {problems[0]}")
    return part


def _take_points(found: Arrays, survey: Survey) -> Points:
    positions = take_array(found, "points.positions", np.float32, (-1, 3))
    origin = take_array(found, "points.origin", np.float64, (3,))
    names = [name for name in found if name.startswith("attribute.")]
    attributes = {name.removeprefix("attribute."): found.pop(name) for name in names}
    normals, colors = found.pop("points.normals", None), found.pop("points.colors", None)
    return Points.about(origin, positions, normals, colors, attributes, survey)


def _take_tree(found: Arrays) -> Tree:
    whole = {"children", "spans", "refs", "order", "colors"}
    small = {"borders", "facing"}
    types = {name: np.int32 if name in whole else np.int8 if name in small else np.float32 for name in Tree._fields}
    found.setdefault("tree.noise", np.zeros(0, np.float32))  # a file that was saved before it was kept
    tree = Tree(*(take_array(found, f"tree.{name}", types[name], (-1,)) for name in Tree._fields))
    if len(tree.head) == HEAD and tree.head[LONGEST] == 0.0:  # the file was saved before this number was kept
        tree.head[LONGEST] = tree.leaves[STEP::LEAF].max(initial=0.0)
    return tree
