"""The lights and materials of a scene file: each says by `kind` which class it is, and has that class's words."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple, get_args

import numpy as np

from ..points.files import check_regular
from ..shade.environment import EnvironmentLight
from ..shade.lights import Light
from ..shade.materials import Material
from .lines import Key
from .source import Source
from .words import TEXT, check_table, unknown, value_at, words_of


def _by_kind(classes: Iterable[Any]) -> dict[str, Any]:
    return {known.__name__.removesuffix("Light").lower(): known for known in classes}


LIGHTS = _by_kind([*get_args(Light), EnvironmentLight])


def materials() -> dict[str, Any]:
    """Material classes by kind, wherever they stand."""
    return _by_kind(Material.__subclasses__())


class Lamp(NamedTuple):
    """A light that is not made yet: its picture has not been read."""

    key: Key
    kind: Any
    values: dict[str, Any]


def check_material(source: Source, key: Key) -> Material:
    """What a table under `materials` says."""
    kind, values = _check_kind(source, key, materials())
    with source.telling(key, values):
        material: Material = kind(**values)
    return material


def check_lights(source: Source, keys: list[Key]) -> list[Lamp]:
    """What the tables of `lights` say; pictures are looked for, not read."""
    lamps = [_check_light(source, key) for key in keys]
    for lamp in [lamp for lamp in lamps if lamp.kind is EnvironmentLight][1:]:
        raise source.error(lamp.key, "the scene has an environment already")
    return lamps


def _check_light(source: Source, key: Key) -> Lamp:
    kind, values = _check_kind(source, key, LIGHTS)
    without = dict(values)
    if isinstance(values.get("image"), str):
        values["image"] = source.path(values["image"])
        with source.telling((*key, "image")):
            check_regular(values["image"])
        without["image"] = np.zeros((2, 2, 3))
    with source.telling(key, values):
        kind(**without)
    return Lamp(key, kind, values)


def make_light(source: Source, lamp: Lamp) -> Any:
    """The light; if it is a picture, it is read."""
    with source.telling((*lamp.key, "image")):
        return lamp.kind(**lamp.values)


def _check_kind(source: Source, key: Key, known: dict[str, Any]) -> tuple[Any, dict[str, Any]]:
    table = value_at(source, key)
    if not isinstance(table, dict) or "kind" not in table:
        raise source.error(key, "kind is missing")
    name = table["kind"]
    if not isinstance(name, str) or name not in known:
        raise source.error((*key, "kind"), unknown("kind", name, known))
    values = check_table(source, key, {"kind": TEXT, **words_of(known[name])})
    del values["kind"]
    return known[name], values
