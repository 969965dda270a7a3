"""What baked light depends on, as hashes: they tell what has changed in a scene, and whether a file is of another."""

from __future__ import annotations

import hashlib
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from ..engine.kernels.records import (
    CATCHER,
    DIELECTRIC,
    INSTANCE,
    KIND,
    MATERIAL,
    MATERIAL_KIND,
    MATERIAL_SIZE,
    MIRROR,
    MODEL,
    PLANE,
    PLANE_CHECKER,
    PLANE_COLOR,
    PLANE_SIZE,
    SHAPE_ROW,
    TO_MODEL,
)
from ..model.model import Model
from ..scene.world import Snapshot

KINDS = {MODEL: "model", PLANE: "plane", CATCHER: "shadow catcher"}
COLORED = slice(PLANE_COLOR, PLANE_CHECKER + 1)  # of a plane's record

_KNOWN: WeakKeyDictionary[Model, dict[str, str]] = WeakKeyDictionary()  # for a million points they take 0.1 s


class Keys(NamedTuple):
    """Of which scene light is baked, the same in every process, and for models that were saved and loaded.

    shapes : of each instance, by its number, in the scene's order: hashes by what they are of, such as "points"
    clips : hash of the clip planes
    light : hash of lights, sky, materials and colours
    """

    shapes: dict[int, dict[str, str]]
    clips: str
    light: str


def keys_of(scene: Snapshot) -> Keys:
    """The keys of a scene."""
    world = scene.world
    models, planes = [_keys_of(model) for model in scene.models], _places(scene)
    shapes = {}
    for number, record in zip(scene.keys[:-1].tolist(), world.instances.reshape(-1, INSTANCE), strict=True):
        kind, shape = int(record[KIND]), int(record[SHAPE_ROW])
        found = {**models[shape], "transform": _text(record[TO_MODEL:])} if kind == MODEL else {"place": planes[shape]}
        shapes[number] = {"kind": KINDS[kind], **found}
    return Keys(shapes, _text(world.clips), _text(lights_of(scene), *(model.tree.colors for model in scene.models)))


def _keys_of(model: Model) -> dict[str, str]:
    """The hashes of a model: what its light depends on, and the order in which its splats are kept."""
    if model not in _KNOWN:
        points, tree = model.points, model.tree
        normals = np.zeros(0) if points.normals is None else points.normals
        _KNOWN[model] = {
            "points": _text(points.positions, normals, points.origin),
            "radii": _text(model.radii),
            "surface": _text(repr(model.settings).encode(), tree.blocks, tree.order),
        }
    levels = [key for level in model.levels for key in _keys_of(level).values()]
    return {**_KNOWN[model], "levels of detail": _text(*(key.encode() for key in levels))}


def _places(scene: Snapshot) -> list[str]:
    """The hash of where each plane is."""
    planes = np.delete(scene.world.planes.reshape(-1, PLANE_SIZE), COLORED, axis=1)
    return [_text(plane) for plane in planes]


def difference(baked: list[dict[str, Any]], clips: Any, scene: Keys) -> str | None:
    """How a scene's geometry differs from that of keys, in words; None: it does not."""
    if len(baked) != len(scene.shapes):
        return f"{len(baked)} instances were baked, the scene has {len(scene.shapes)}"
    for before, (number, now) in zip(baked, scene.shapes.items(), strict=True):
        for name, key in now.items():
            if before.get(name) != key:
                return f"instance {number} differs in its {name}"
    return None if clips == scene.clips else "its clip planes differ"


def shape_of(scene: Snapshot) -> tuple[Any, ...]:
    """What links depend on, within this process: the geometry, and which surfaces are mirrors or glass."""
    world = scene.world
    records = world.instances.reshape(-1, INSTANCE).copy()
    kinds = world.materials[MATERIAL_KIND::MATERIAL_SIZE][records[:, MATERIAL].astype(int)]
    specular = np.where(np.isin(kinds, (MIRROR, DIELECTRIC)), kinds, -1.0)
    records[:, MATERIAL : MATERIAL + 2] = 0.0
    planes = np.delete(world.planes.reshape(-1, PLANE_SIZE), COLORED, axis=1)
    levels = tuple(model.levels for model in scene.models)
    return scene.models, levels, _digest(scene.keys, records, specular, planes, world.clips)


def lacks_levels(before: tuple[Any, ...], now: tuple[Any, ...]) -> bool:
    """Whether two shapes, see `shape_of`, differ in levels of detail only."""
    return before != now and (before[0], before[2]) == (now[0], now[2])


def lights_of(scene: Snapshot) -> bytes:
    """What the light depends on besides."""
    world = scene.world
    return _digest(world.lights, world.sky, world.sky_colors, materials_of(scene))


def materials_of(scene: Snapshot) -> bytes:
    """What the surfaces reflect and emit."""
    world = scene.world
    colors = world.planes.reshape(-1, PLANE_SIZE)[:, COLORED]
    used = world.instances.reshape(-1, INSTANCE)[:, MATERIAL : MATERIAL + 2]
    return _digest(world.materials, used, colors, world.paints, world.map_positions, world.map_colors)


def _text(*parts: NDArray[Any] | bytes) -> str:
    """A hash in hexadecimal digits."""
    return _digest(*parts).hex()


def _digest(*parts: NDArray[Any] | bytes) -> bytes:
    """A hash of arrays, with their shapes, and bytes."""
    digest = hashlib.blake2b(digest_size=16)
    for part in parts:
        array = np.frombuffer(part, np.uint8) if isinstance(part, bytes) else part
        digest.update(f"{array.dtype.str}{array.shape}".encode())
        digest.update(np.ascontiguousarray(array).reshape(-1).data)
    return digest.digest()
