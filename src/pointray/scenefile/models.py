"""The models of a scene file: scans, saved models and procedural models."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from inspect import signature
from pathlib import Path
from typing import Any, NamedTuple

from ..base.arguments import check_positive
from ..base.atomic_write import check_regular
from ..base.choices import NORMALS
from ..cloud.denoising.smooth import check_sigma
from ..cloud.normals.validation import select_normals
from ..io.files import check_readable, read
from ..io.known_formats import extensions
from ..io.reading import check_reading
from ..io.unpacking import PACKED
from ..model.model import SURFACE, Model
from ..model.model_file import SAVED
from ..model.model_folder import check_folder
from ..procedural_models import MOST, NAMES, procedural
from ..surface.splats.radii import radii_in
from ..surface.splats.scattered.spheres import check_drawing
from ..surface.tree.settings import check_settings
from .lines import Key
from .source import Source
from .words import TEXT, WHOLE, Word, check_table, optional, unknown, value_at, words_of

WORDS = words_of(Model, "points", "radii", "_scattered")
LEVELS_OPTION = {"levels": Word(("bool",), False)}
NORMALS_OPTION = {"normals": Word(("str",), False)}
READING = {  # arguments of `read`; the annotations of the last three are not TOML types
    **words_of(read, "path", "progress"),
    **{"keep": Word(("dict",), False), "drop": Word(("dict",), False), "intrinsics": Word(("ArrayLike",), False)},
}

Report = Callable[[str, float], None]


class Recipe(NamedTuple):
    """What a table under `models` of a scene file states: the contents of a model and how to build it.

    Attributes
    ----------
    key : Key
        Where it is in the file, for messages, such as ("models", "bust").
    file : Path or None
        Scan or saved model.
    procedural : (str, int, int)
        Name of the formula, number of points and seed; used if there is no file.
    arguments : dict
        Keyword arguments of `Model`.
    levels : bool
        Whether to make levels of detail.
    normals : {"auto", "file", "fit"}
        Normals of a scan to use. "auto": those of the file unless they are wrong; "file": those of the file;
        "fit": estimated.
    reading : dict
        Keyword arguments of `read` for a scan.
    """

    key: Key
    file: Path | None
    procedural: tuple[str, int, int]
    arguments: dict[str, Any]
    levels: bool
    normals: str = "auto"
    reading: Mapping[str, Any] = {}


def check_model(source: Source, key: Key) -> Recipe:
    """Check a table under `models` of a scene file and return its contents.

    Its scan or saved model must exist, but is not read.

    key : path of the table in the file, such as ("models", "bust")
    """
    table = value_at(source, key)
    if isinstance(table, dict) and "file" not in table and "procedural" not in table:
        raise source.error(key, "file or procedural is missing")
    if isinstance(table, dict) and "file" in table:
        values = check_table(source, key, {"file": TEXT, **WORDS, **LEVELS_OPTION, **NORMALS_OPTION, **READING})
        levels, file = values.pop("levels", False), source.path(values.pop("file"))
        _check_file(source, key, file, values)
        reading = {name: values.pop(name) for name in READING if name in values}
        with source.errors_at(key, reading):
            check_reading(reading)
        recipe = Recipe(key, file, ("", 0, 0), values, levels, values.pop("normals", "auto"), reading)
    else:
        words = {"procedural": TEXT, "points": WHOLE, "seed": optional(WHOLE), **WORDS, **LEVELS_OPTION}
        values = check_table(source, key, words)
        levels = values.pop("levels", False)
        formula = values.pop("procedural"), values.pop("points"), values.pop("seed", 0)
        recipe = Recipe(key, None, formula, values, levels)
        _check_procedural(source, key, *formula)
    bound = signature(Model).bind(None, **values)
    bound.apply_defaults()
    arguments = bound.arguments
    with source.errors_at(key, values):
        check_settings(arguments["surface"] or SURFACE, arguments["samples"], arguments["refine"], arguments["trim"])
        check_positive(arguments["radius_scale"], "radius_scale")
        check_sigma(arguments["smooth"], "smooth")
        check_drawing(arguments["scatter"], arguments["scatter_size"])
    return recipe


def _check_file(source: Source, key: Key, file: Path, values: dict[str, Any]) -> None:
    if file.suffix.lower() == SAVED and values:
        raise source.error((*key, next(iter(values))), f"cannot be set for a saved model ({file.name})")
    if values.get("normals", "auto") not in NORMALS:
        raise source.error((*key, "normals"), unknown("normals", values["normals"], NORMALS))
    with source.errors_at((*key, "file")):
        if file.is_dir() and file.suffix.lower() == SAVED:
            check_folder(file)
            return
        check_regular(file)
        if file.suffix.lower() not in (SAVED, *PACKED, *extensions()):  # its format is detected from the contents
            check_readable(file)


def check_contents(source: Source, recipe: Recipe) -> None:
    """Raise an error if the format of a model's scan cannot be detected from its contents.

    Called after the scene file is checked, so that its errors come first, and before any model is built.
    """
    if recipe.file is not None and recipe.file.suffix.lower() != SAVED:
        with source.errors_at((*recipe.key, "file")):
            check_readable(recipe.file)


def _check_procedural(source: Source, key: Key, name: str, count: int, seed: int) -> None:
    if name not in NAMES:
        raise source.error((*key, "procedural"), unknown("procedural model", name, NAMES))
    if not 1 <= count <= MOST:
        raise source.error((*key, "points"), f"must be between 1 and {MOST}, not {count}")
    if seed < 0:
        raise source.error((*key, "seed"), f"must not be negative, not {seed}")


def load_model(source: Source, recipe: Recipe, report: Report) -> Model:
    """Read or generate the points of a model and build it, with levels of detail if the scene file sets `levels`.

    report : called with the name of a stage and its completed fraction
    """
    model = _load(source, recipe, report)
    if recipe.levels and not model.levels and not model.parts:  # a saved model may have them
        with source.errors_at(recipe.key):
            model.make_levels(report)
    return model


def _load(source: Source, recipe: Recipe, report: Report) -> Model:
    """Read or generate the points of a model and build it, or load a saved model; do not add levels of detail.

    If the points of a scan have the attribute `radius`, it gives the radii of the splats.

    report : called with the name of a stage and its completed fraction
    """
    file = recipe.file
    report("reading", 0.0)
    if file is None:
        with source.errors_at(recipe.key):
            return Model(procedural(*recipe.procedural), **recipe.arguments, progress=report)
    with source.errors_at((*recipe.key, "file")):
        if file.suffix.lower() == SAVED:
            return Model.load(file)
        points = read(file, progress=report, **recipe.reading)
    report("normals", 0.0)
    with source.errors_at((*recipe.key, "normals") if recipe.normals == "file" else recipe.key):
        points = select_normals(points, recipe.normals, 'normals = "file"', report)
    with source.errors_at(recipe.key):
        return Model(points, radii_in(points), **recipe.arguments, progress=report)
