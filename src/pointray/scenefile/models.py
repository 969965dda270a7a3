"""The models of a scene file: of a scan, a saved model or one of those made by formula."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from inspect import signature
from pathlib import Path
from typing import Any, NamedTuple

from ..arguments import check_positive
from ..choices import NORMALS
from ..model import SURFACE, Model, _check_settings
from ..model_file import SAVED
from ..points import procedural, read
from ..points.files import check_readable, check_regular
from ..points.procedural import MOST, NAMES
from ..points.trust import trusted
from ..splats.radii import radii_in
from .lines import Key
from .source import Source
from .words import TEXT, WHOLE, Word, check_table, optional, unknown, value_at, words_of

WORDS = words_of(Model, "points", "radii")
LEVELS = {"levels": Word(("bool",), False)}
WHOSE = {"normals": Word(("str",), False)}  # of a scan: whose

Say = Callable[[str, float], None]


class Recipe(NamedTuple):
    """How a model is made.

    Attributes
    ----------
    file : Path or None
    procedural : (str, int, int)
        Name, points and seed, where there is no file.
    how : dict
        What `Model` is told.
    levels : bool
        Whether it gets levels of detail.
    normals : str
        Whose normals a scan has: "auto", "file" or "fit".
    """

    key: Key
    file: Path | None
    procedural: tuple[str, int, int]
    how: dict[str, Any]
    levels: bool
    normals: str = "auto"


def check_model(source: Source, key: Key) -> Recipe:
    """What a table under `models` says; files are looked for, not read."""
    table = value_at(source, key)
    if isinstance(table, dict) and "file" not in table and "procedural" not in table:
        raise source.error(key, "file or procedural is missing")
    if isinstance(table, dict) and "file" in table:
        values = check_table(source, key, {"file": TEXT, **WORDS, **LEVELS, **WHOSE})
        levels, file = values.pop("levels", False), source.path(values.pop("file"))
        _check_file(source, key, file, values)
        recipe = Recipe(key, file, ("", 0, 0), values, levels, values.pop("normals", "auto"))
    else:
        words = {"procedural": TEXT, "points": WHOLE, "seed": optional(WHOLE), **WORDS, **LEVELS}
        values = check_table(source, key, words)
        levels = values.pop("levels", False)
        made = values.pop("procedural"), values.pop("points"), values.pop("seed", 0)
        recipe = Recipe(key, None, made, values, levels)
        _check_procedural(source, key, *made)
    told = signature(Model).bind(None, **values)
    told.apply_defaults()
    how = told.arguments
    with source.telling(key, values):
        _check_settings(how["surface"] or SURFACE, how["samples"], how["refine"], how["trim"])
        check_positive(how["radius_scale"], "radius_scale")
    return recipe


def _check_file(source: Source, key: Key, file: Path, how: dict[str, Any]) -> None:
    if file.suffix.lower() == SAVED and how:
        raise source.error((*key, next(iter(how))), f"is part of a saved model ({file.name})")
    if how.get("normals", "auto") not in NORMALS:
        raise source.error((*key, "normals"), unknown("kind of normals", how["normals"], NORMALS))
    with source.telling((*key, "file")):
        (check_regular if file.suffix.lower() == SAVED else check_readable)(file)


def _check_procedural(source: Source, key: Key, name: str, count: int, seed: int) -> None:
    if name not in NAMES:
        raise source.error((*key, "procedural"), unknown("procedural model", name, NAMES))
    if not 1 <= count <= MOST:
        raise source.error((*key, "points"), f"must be between 1 and {MOST}, not {count}")
    if seed < 0:
        raise source.error((*key, "seed"), f"must not be negative, not {seed}")


def load_model(source: Source, recipe: Recipe, say: Say) -> Model:
    """Read and build it, and its levels of detail if they are asked for."""
    model = _load(source, recipe, say)
    if recipe.levels and not model.levels:  # a saved model may have brought them
        with source.telling(recipe.key):
            model.make_levels(say)
    return model


def _load(source: Source, recipe: Recipe, say: Say) -> Model:
    """The model alone. A scan's points may bring radii: the attribute `radius`."""
    file = recipe.file
    say("reading", 0.0)
    if file is None:
        with source.telling(recipe.key):
            return Model(procedural(*recipe.procedural), **recipe.how, progress=say)
    with source.telling((*recipe.key, "file")):
        if file.suffix.lower() == SAVED:
            return Model.load(file)
        points = read(file, partial(say, "reading"))
    say("normals", 0.0)
    with source.telling((*recipe.key, "normals") if recipe.normals == "file" else recipe.key):
        points = trusted(points, recipe.normals, 'normals = "file"', partial(say, "normals"))
    with source.telling(recipe.key):
        return Model(points, radii_in(points), **recipe.how, progress=say)
