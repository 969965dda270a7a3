"""The lights and materials of a scene file: `kind` is the name of a class, other keys are its parameters."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple, get_args

import numpy as np

from ..base.atomic_write import check_regular
from ..shade.environment import EnvironmentLight
from ..shade.lights import Light
from ..shade.materials import material_kinds
from ..shade.materials.base import Material
from .lines import Key
from .source import Source
from .words import TEXT, check_table, unknown, value_at, words_of


def _by_kind(classes: Iterable[Any]) -> dict[str, Any]:
    return {each.__name__.removesuffix("Light").lower(): each for each in classes}


LIGHTS = _by_kind([*get_args(Light), EnvironmentLight])


class CheckedLight(NamedTuple):
    """A light of a scene file, checked. The image of an environment light has not been read.

    Attributes
    ----------
    key : Key
        Where it is in the file, for messages, such as ("lights", 0).
    kind : class
        Such as `SunLight`.
    values : dict
        Keyword arguments of the class.
    """

    key: Key
    kind: Any
    values: dict[str, Any]


def check_material(source: Source, key: Key) -> Material:
    """Check a table under `materials` of a scene file and return the material.

    key : path of the table in the file, such as ("materials", "gold")
    """
    kind, values = _check_kind(source, key, material_kinds())
    with source.errors_at(key, values):
        material: Material = kind(**values)
    return material


def check_lights(source: Source, keys: list[Key]) -> list[CheckedLight]:
    """Check the tables of `lights` in a scene file and return their contents.

    The image of an environment light must exist, but is not read.

    keys : paths of the tables in the file, such as ("lights", 0)
    """
    lights = [_check_light(source, key) for key in keys]
    for light in [light for light in lights if light.kind is EnvironmentLight][1:]:
        raise source.error(light.key, "only one environment light is supported")
    return lights


def _check_light(source: Source, key: Key) -> CheckedLight:
    kind, values = _check_kind(source, key, LIGHTS)
    trial = dict(values)  # with an empty image
    if isinstance(values.get("image"), str):
        values["image"] = source.path(values["image"])
        with source.errors_at((*key, "image")):
            check_regular(values["image"])
        trial["image"] = np.zeros((2, 2, 3))
    with source.errors_at(key, values):
        kind(**trial)
    return CheckedLight(key, kind, values)


def make_light(source: Source, light: CheckedLight) -> Any:
    """Create a checked light of a scene file, for `Scene.add_light`; read its image, if any."""
    with source.errors_at((*light.key, "image")):
        return light.kind(**light.values)


def _check_kind(source: Source, key: Key, classes: dict[str, Any]) -> tuple[Any, dict[str, Any]]:
    table = value_at(source, key)
    if not isinstance(table, dict) or "kind" not in table:
        raise source.error(key, "kind is missing")
    name = table["kind"]
    if not isinstance(name, str) or name not in classes:
        raise source.error((*key, "kind"), unknown("kind", name, classes))
    values = check_table(source, key, {"kind": TEXT, **words_of(classes[name])})
    del values["kind"]
    return classes[name], values
