"""Hashes of what baked light depends on. They detect changes of a scene, and files that belong to another scene."""

from __future__ import annotations

import hashlib
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from ..engine.kernels import records as rec
from ..model.model import Model
from ..scene.world import Snapshot

KINDS = {rec.MODEL: "model", rec.PLANE: "plane", rec.CATCHER: "shadow catcher"}
COLORED = slice(rec.PLANE_COLOR, rec.PLANE_CHECKER + 1)  # colours within a plane's record

_MODEL_KEYS: WeakKeyDictionary[Model, dict[str, str]] = WeakKeyDictionary()  # hashing a million points takes 0.1 s


class Keys(NamedTuple):
    """Hashes that identify a baked scene, equal in every process, and for models that were saved and loaded.

    shapes : for each instance, by its number and in the scene's order, hashes by the name of what they cover, such as
        "points" or "transform"
    clips : hash of the clip planes
    light : hash of lights, sky, materials and colours
    """

    shapes: dict[int, dict[str, str]]
    clips: str
    light: str


def scene_keys(scene: Snapshot) -> Keys:
    """Return hashes of all that baked light depends on: each instance, the clip planes, and lights with materials."""
    world = scene.world
    models, planes = [_model_keys(model) for model in scene.models], _plane_keys(scene)
    shapes = {}
    for number, record in zip(scene.keys[:-1].tolist(), world.instances.reshape(-1, rec.INSTANCE), strict=True):
        kind, shape = int(record[rec.KIND]), int(record[rec.SHAPE_ROW])
        found = (
            {**models[shape], "transform": _hex_digest(record[rec.TO_MODEL :])}
            if kind == rec.MODEL
            else {"place": planes[shape]}
        )
        shapes[number] = {"kind": KINDS[kind], **found}
    return Keys(
        shapes, _hex_digest(world.clips), _hex_digest(light_key(scene), *(model.tree.colors for model in scene.models))
    )


def _model_keys(model: Model) -> dict[str, str]:
    """Return hashes of a model's points, radii, splats in their stored order and levels of detail, by these names."""
    if model not in _MODEL_KEYS:
        points, tree = model.points, model.tree
        normals = np.zeros(0) if points.normals is None else points.normals
        _MODEL_KEYS[model] = {
            "points": _hex_digest(points.positions, normals, points.origin),
            "radii": _hex_digest(model.radii),
            "surface": _hex_digest(repr(model.settings).encode(), tree.blocks, tree.order),
        }
    levels = [key for level in model.levels for key in _model_keys(level).values()]
    return {**_MODEL_KEYS[model], "levels of detail": _hex_digest(*(key.encode() for key in levels))}


def _plane_keys(scene: Snapshot) -> list[str]:
    """Return a hash of each plane's position and orientation, without its colours."""
    planes = np.delete(scene.world.planes.reshape(-1, rec.PLANE_SIZE), COLORED, axis=1)
    return [_hex_digest(plane) for plane in planes]


def difference(baked: list[dict[str, Any]], clips: Any, scene: Keys) -> str | None:
    """Describe how the geometry of a scene differs from that of the baked scene; return None if it does not differ.

    baked : for each baked instance, hashes by the name of what they cover; clips : hash of the baked clip planes
    scene : hashes of the present scene
    """
    if len(baked) != len(scene.shapes):
        return f"{len(baked)} instances were baked, this scene has {len(scene.shapes)}"
    for before, (number, now) in zip(baked, scene.shapes.items(), strict=True):
        for name, key in now.items():
            if before.get(name) != key:
                return f"instance {number} differs in its {name}"
    return None if clips == scene.clips else "its clip planes differ"


def geometry_key(scene: Snapshot) -> tuple[Any, ...]:
    """Return a key that changes if rays between surfaces could meet something else, valid in this process only.

    Its elements are the models, their levels of detail, and one hash of all else: placements, planes, clip planes, and
    which surfaces are mirrors or glass.
    """
    world = scene.world
    records = world.instances.reshape(-1, rec.INSTANCE).copy()
    kinds = world.materials[rec.MATERIAL_KIND :: rec.MATERIAL_SIZE][records[:, rec.MATERIAL].astype(int)]
    specular = np.where(np.isin(kinds, (rec.MIRROR, rec.DIELECTRIC)), kinds, -1.0)
    records[:, rec.MATERIAL : rec.MATERIAL + 2] = 0.0
    planes = np.delete(world.planes.reshape(-1, rec.PLANE_SIZE), COLORED, axis=1)
    levels = tuple(model.levels for model in scene.models)
    return scene.models, levels, _digest(scene.keys, records, specular, planes, world.clips)


def lacks_levels(before: tuple[Any, ...], now: tuple[Any, ...]) -> bool:
    """Return whether two keys from `geometry_key` differ only in the models' levels of detail."""
    return before != now and (before[0], before[2]) == (now[0], now[2])


def light_key(scene: Snapshot) -> bytes:
    """Return a hash of all that baked light depends on besides geometry: lights, sky, materials and colours."""
    world = scene.world
    return _digest(world.lights, world.sky, world.sky_colors, material_key(scene))


def material_key(scene: Snapshot) -> bytes:
    """Return a hash of the materials and colours of all surfaces."""
    world = scene.world
    colors = world.planes.reshape(-1, rec.PLANE_SIZE)[:, COLORED]
    used = world.instances.reshape(-1, rec.INSTANCE)[:, rec.MATERIAL : rec.MATERIAL + 2]
    return _digest(world.materials, used, colors, world.paints, world.map_positions, world.map_colors)


def _hex_digest(*parts: NDArray[Any] | bytes) -> str:
    """Return a 16-byte hash of bytes and of arrays as hexadecimal digits."""
    return _digest(*parts).hex()


def _digest(*parts: NDArray[Any] | bytes) -> bytes:
    """Return a 16-byte hash of bytes and of arrays, including their shapes and dtypes."""
    digest = hashlib.blake2b(digest_size=16)
    for part in parts:
        array = np.frombuffer(part, np.uint8) if isinstance(part, bytes) else part
        digest.update(f"{array.dtype.str}{array.shape}".encode())
        digest.update(np.ascontiguousarray(array).reshape(-1).data)
    return digest.digest()
