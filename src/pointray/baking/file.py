"""Files of baked light: records for rendering, sky visibility, and the keys of the scene. See `array_file`.

Links are not stored: they are many times larger, and are needed only to change lights.

Files are not trusted: all indices that kernels follow, and the unit of the light, are checked before the first image.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.progress import Progress
from ..engine.kernels.records import DIRECT, INDIRECT, INSTANCE, KIND, MODEL, MOMENTS, RECORD, SHAPE_ROW, SPREAD
from ..model.array_file import Arrays, Kind, read_arrays, take_array, write_arrays
from ..model.model import Model
from ..scene.world import Snapshot
from .fingerprints import Keys, difference, scene_keys
from .levels import is_valid_spread
from .lookup_tables import LightTables
from .patches import BLOCK_SPLATS
from .planes import Grid
from .settings import BakeSettings

LAYOUT = [RECORD, INDIRECT, DIRECT, MOMENTS, SPREAD]
# Increase the version when the bits of a record change their meaning, or when arrays are added.
FILE = Kind("pointray baked light", 2, LAYOUT, "a file of baked light", "saved by another version of pointray")
LARGEST_UNIT = float(np.finfo(np.float32).max) / 2**16  # light then fits into float32
FARTHEST, LEAST_HALF, MOST_EDGE = 1e30, 1e-9, 1 << 14  # limits of grids, within which no position overflows
COARSEST = 32  # highest level: one patch is left, however many there were


class StoredLight(NamedTuple):
    """Contents of a file of baked light.

    settings : of the bake
    keys : hashes of the baked scene, which detect that a file belongs to another scene
    kept : the light that rendering reads
    skies : fraction of the sky visible from the front, in 65535ths, uint16, by instance number: for each splat of the
        model in its tree's order, or for each record of coarser light
    """

    settings: BakeSettings
    keys: Keys
    kept: LightTables
    skies: dict[int, NDArray[np.uint16]]


def write_light(path: str | os.PathLike[str], light: StoredLight, report: Progress) -> None:
    """Write baked light to a file that `read_light` reads. The file gets its name once it is complete.

    report : called with the completed fraction
    """
    kept, row_of = light.kept, {number: row for row, number in enumerate(light.keys.shapes)}
    about = {
        "settings": {name: value for name, value in asdict(light.settings).items() if name != "threads"},
        "unit": kept.unit,
        "shapes": list(light.keys.shapes.values()),
        "clips": light.keys.clips,
        "light": light.keys.light,
    }
    sides = list(dict.fromkeys((row_of[number], sign) for number, sign, _ in kept.records))
    grids = [(*grid.middle, grid.half, grid.edge) for grid in kept.grids.values()]
    spreads = {id(spread): spread for spread in kept.spreads.values()}
    numbers = {key: k for k, key in enumerate(spreads)}
    coarse = [
        (row_of[number], kept.levels[number], numbers[id(spread)], len(kept.records[number, 1, 0]))
        for number, spread in kept.spreads.items()
    ]
    arrays: Arrays = {
        "sides": np.array(sides, np.int32).reshape(-1, 2),
        "coarse": np.array(coarse, np.int32).reshape(-1, 4),
        "spreads": np.concatenate([np.zeros(0, np.int32), *(part for spread in spreads.values() for part in spread)]),
        "grids": np.array(grids, np.float64).reshape(-1, 4),
        "records": np.concatenate([*kept.records.values(), np.zeros((0, RECORD), np.int32)]),
        "skies": np.concatenate([*light.skies.values(), np.zeros(0, np.uint16)]),
    }
    write_arrays(path, FILE, about, arrays, report)


def read_light(path: str | os.PathLike[str], scene: Snapshot) -> StoredLight:
    """Read the baked light of a scene from a file, by memory mapping, and check all values that kernels rely on.

    Raises
    ------
    OSError
        If the file cannot be opened.
    ValueError
        If the file is not baked light, is from another version, is damaged, or belongs to another scene.
    """
    try:
        about, found = read_arrays(path, FILE)
        return _take_light(about, found, scene, _check_scene(about, scene))
    except ValueError as error:
        raise ValueError(f"{path}: {' '.join(str(error).split())}: bake again") from error


def _check_scene(about: dict[str, Any], scene: Snapshot) -> Keys:
    """Compare a file of baked light with the given scene: return the hashes of the baked scene.

    Raise ValueError if the geometry differs; other lights and materials are allowed.

    about : description at the beginning of the file
    """
    shapes, clips, light = (about.get(name) for name in ("shapes", "clips", "light"))
    if not (isinstance(shapes, list) and all(isinstance(shape, dict) for shape in shapes) and isinstance(light, str)):
        raise ValueError("the baked light is damaged: the keys of its scene are missing")
    keys = scene_keys(scene)
    differs = difference(shapes, clips, keys)
    if differs:
        raise ValueError(f"the light belongs to another scene: {differs}")
    return keys._replace(light=light)


def _take_light(about: dict[str, Any], found: Arrays, scene: Snapshot, keys: Keys) -> StoredLight:
    """Build the baked light from the contents of a file; raise ValueError if a value could lead kernels out of bounds.

    about : description at the beginning of the file; found : its arrays, by name; keys : hashes of the scene
    """
    settings, unit = _settings_of(about.get("settings")), about.get("unit")
    if not isinstance(unit, float) or not 0.0 < unit <= LARGEST_UNIT:  # also for NaN
        raise ValueError(f"the baked light is damaged: invalid unit {unit!r}")
    models, numbers = _models_of(scene), list(keys.shapes)
    sides = _take_sides(found, len(models))
    planes = list(dict.fromkeys(row for row, _ in sides if models[row] is None))
    grids = {numbers[row]: grid for row, grid in zip(planes, _take_grids(found, len(planes)), strict=True)}
    coarse = _take_coarse(found, sides, models)
    spreads = {numbers[row]: spread for row, spread in _take_spreads(found, coarse, models).items()}
    sizes, slots, levels = {}, {}, {}
    for row, sign in sides:
        number, model = numbers[row], models[row]
        if model is None:
            sizes[number, sign, 0] = grids[number].edge ** 2
            continue
        for level, size in enumerate(_slots_of(model) if row not in coarse else [coarse[row].records]):
            sizes[number, sign, level] = size
        if sign > 0:
            slots[number] = sizes[number, sign, 0]
            levels[number] = coarse[row].level if row in coarse else 0
    records = take_array(found, "records", np.int32, (sum(sizes.values()), RECORD))
    skies = take_array(found, "skies", np.uint16, (sum(slots.values()),))
    kept = LightTables(unit, dict(_parts(records, sizes)), grids, spreads, levels)
    return StoredLight(settings, keys, kept, dict(_parts(skies, slots)))


def _settings_of(values: Any) -> BakeSettings:
    try:
        return BakeSettings(**values)
    except (ValueError, TypeError) as error:
        raise ValueError(f"the baked light is damaged: invalid settings: {error}") from error


def _models_of(scene: Snapshot) -> list[Model | None]:
    """Return the model of each instance of a scene, in the order of the instances; None for a plane."""
    rows = scene.world.instances.reshape(-1, INSTANCE)
    return [scene.models[int(row[SHAPE_ROW])] if row[KIND] == MODEL else None for row in rows]


def _take_sides(found: Arrays, instances: int) -> list[tuple[int, int]]:
    """Return the sides of instances with light in a file: (row of the instance, 1 for front or -1 for back).

    They are in increasing order of rows, fronts first; ValueError if not.

    found : arrays of the file; instances : number of instances of the scene
    """
    sides = take_array(found, "sides", np.int32, (-1, 2))
    rows, signs = sides.astype(np.int64).T
    known = (rows >= 0) & (rows < instances) & (np.abs(signs) == 1)
    if not (known.all() and (np.diff(2 * rows - signs // 2) > 0).all()):
        raise ValueError("the baked light is damaged: a side belongs to no instance")
    return [(row, sign) for row, sign in sides.tolist()]


def _take_grids(found: Arrays, count: int) -> list[Grid]:
    """Return the grids in which the light of planes is stored in a file; raise ValueError if one is invalid.

    found : arrays of the file; count : number of planes with light
    """
    table = take_array(found, "grids", np.float64, (count, 4))
    half, edge = table[:, 2], table[:, 3]
    good = (np.abs(table) <= FARTHEST).all(axis=1) & (half >= LEAST_HALF)  # false for NaN
    if not (good & (edge >= 2) & (edge <= MOST_EDGE) & (edge == 2 * np.floor(edge / 2))).all():
        raise ValueError("the baked light is damaged: invalid grid of a plane")
    return [Grid(int(edge), (u, v), half) for u, v, half, edge in table.tolist()]


class CoarseLight(NamedTuple):
    """Coarser light of an instance in a file: fewer records than splats, between which splats interpolate.

    level : k for a record per 4^(k - 1) patches; records : number of records of each side
    spread : index of the interpolation table in the file; instances of a model may share one
    """

    level: int
    spread: int
    records: int


def _take_coarse(found: Arrays, sides: list[tuple[int, int]], models: list[Model | None]) -> dict[int, CoarseLight]:
    """Return which instances have coarser light in a file, by row of the instance; ValueError if it is damaged.

    found : arrays of the file; sides : (row, sign) of all sides with light; models : of each instance, None for a plane
    """
    table = take_array(found, "coarse", np.int32, (-1, 4)).astype(np.int64)
    fronts = [row for row, sign in sides if sign > 0 and models[row] is not None]
    rows, levels, spreads, records = table.T
    new = np.maximum.accumulate(np.concatenate([[-1], spreads]))[:-1] + 1  # number of the next spread not yet used
    good = np.isin(rows, fronts) & (levels >= 1) & (levels <= COARSEST) & (spreads >= 0) & (spreads <= new)
    if not (good & (records >= 1)).all() or (np.diff(rows) <= 0).any():
        raise ValueError("the baked light is damaged: coarser light belongs to no instance")
    return {row: CoarseLight(*rest) for row, *rest in table.tolist()}


def _take_spreads(
    found: Arrays, coarse: dict[int, CoarseLight], models: list[Model | None]
) -> dict[int, tuple[NDArray[np.int32], ...]]:
    """Return interpolation tables of coarser light in a file, by row of the instance; ValueError if one is damaged.

    A table has for each block the four records that its splats blend, see `records.SPREAD`; there is one for the model
    and one for each of its levels of detail.

    found : arrays of the file; coarse : instances with coarser light; models : of each instance, None for a plane
    """
    users: dict[int, tuple[Model, int]] = {}
    for row, item in coarse.items():
        model = models[row]
        if model is None or users.setdefault(item.spread, (model, item.records)) != (model, item.records):
            raise ValueError("the baked light is damaged: coarser light belongs to another model")
    sizes = {
        (k, level): slots // BLOCK_SPLATS * SPREAD
        for k, (model, _) in users.items()
        for level, slots in enumerate(_slots_of(model))
    }
    blocks = dict(_parts(take_array(found, "spreads", np.int32, (sum(sizes.values()),)), sizes))
    if not all(is_valid_spread(part, users[k][1]) for (k, _), part in blocks.items()):
        raise ValueError("the baked light is damaged: coarser light refers to missing records")
    spreads = {k: tuple(part for (of, _), part in blocks.items() if of == k) for k in users}
    return {row: spreads[item.spread] for row, item in coarse.items()}


def _slots_of(model: Model) -> list[int]:
    """Return the numbers of splats, unused slots included, of a model's tree and those of its levels of detail."""
    return [tree.order.size for tree in (model.tree, *(level.tree for level in model.levels))]


def _parts(array: NDArray[Any], sizes: Mapping[Any, int]) -> Iterator[tuple[Any, NDArray[Any]]]:
    """Split an array along its first axis: yield (key, part) for each key and length in `sizes`, in order."""
    begin = 0
    for name, size in sizes.items():
        yield name, array[begin : begin + size]
        begin += size
