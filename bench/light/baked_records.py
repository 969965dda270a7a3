"""Records of baked light as packed by pointray, and their reflections by pointray's own kernels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pointray.baking.pack import CHUNK, PER_PATCH, pack
from pointray.engine.jit import Array, keep_alive, kernel, run
from pointray.engine.kernels.records import RECORD
from pointray.engine.kernels.scratch import COUNT_NEAR, new_scratch
from pointray.shade.baked_sums import SUM_WEIGHTS, list_record, store_light, store_moments, sum_moments
from pointray.shade.harmonics import BAND_1, BAND_2, BAND_2_CROSS
from pointray.shade.lobes import reflect_baked

NONE = np.zeros(0, np.int32)
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
Floats = NDArray[np.float64]
Records = NDArray[np.int32]


def harmonics(w: Floats) -> Floats:
    """Bands 1 and 2 of unit directions (..., 3), as in `shade/harmonics.py`, (..., 8)."""
    x, y, z = np.moveaxis(w, -1, 0)
    cross = [2 * BAND_2_CROSS * a for a in (x * y, y * z, x * z)]
    second = [cross[0], cross[1], BAND_2 * (3 * z * z - 1), cross[2], BAND_2_CROSS * (x * x - y * y)]
    return np.stack([BAND_1 * y, BAND_1 * z, BAND_1 * x, *second], axis=-1)


def values_of(light: Floats, w: Floats, weights: Floats, normal: Floats) -> Floats:
    """What is known of a patch whose radiance is (n, 3) from the directions w, as `pack` takes it, (PER_PATCH,).

    weights : (n,), cosine times solid angle
    """
    # Even light times the cosine has the normal's harmonics times 2/3 and 1/4.
    flux, even = light * weights[:, None], harmonics(normal) * np.repeat([2 / 3, 1 / 4], [3, 5])
    irradiance, more = flux.sum(axis=0), flux.T @ (harmonics(w) - even)
    return np.concatenate([irradiance, np.zeros(3), LUMINANCE @ more, more[0, :3], more[2, :3]])


def pack_values(values: Floats, unit: float = 1.0) -> Records:
    """Records (n, RECORD) of values (n, PER_PATCH). unit : irradiance of a record's 1.0"""
    n = len(values)
    out = np.zeros((-(-n // 4) * 4, RECORD), np.int32)
    flat = np.ascontiguousarray(values, np.float32).reshape(n * PER_PATCH)
    run(pack, -(-n // CHUNK), NONE, NONE.view(np.uint8), flat, 1.0 / unit, out[:n].reshape(-1))
    return out


@kernel
def _reflect(records: Array, lobe: tuple[float, float], normals: Array, r: Array, out: Array) -> None:
    """(points, directions, 3) radiance. normals : (points, 3); r : (points, directions, 3)"""
    scratch = new_scratch(1)
    for p in range(len(normals)):
        scratch.counts[COUNT_NEAR] = 0
        list_record(p // 4, 0, p % 4, 1.0, scratch)
        scratch.part[SUM_WEIGHTS] = 1.0
        sum_moments(records, scratch)
        store_light(0, 0, 1.0, False, scratch)
        store_moments(0, 0, 1.0, scratch)
        normal = normals[p, 0], normals[p, 1], normals[p, 2]
        for k in range(r.shape[1]):
            light = reflect_baked(scratch, 0, lobe, normal, (r[p, k, 0], r[p, k, 1], r[p, k, 2]))
            for c in range(3):
                out[p, k, c] = light[c]
    keep_alive(scratch)


def reflected(records: Records, lobe: tuple[float, float], normals: Floats, r: Floats) -> Floats:
    """What a lobe of weight 1 about each direction r, (points, k, 3), reflects of a record's light, (points, k, 3).

    lobe : kind of a material, and the exponent
    """
    out = np.zeros(r.shape)
    _reflect(records.reshape(-1), lobe, np.ascontiguousarray(normals), np.ascontiguousarray(r), out)
    return out
