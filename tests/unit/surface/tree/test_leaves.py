"""Slabs of leaves and columns equal those of a slow float64 reference, near the origin and far from it."""

import numpy as np
import pytest

from helpers.clouds import sphere_points
from pointray.engine.jit import uncompiled
from pointray.engine.kernels.tree import NO_SURFACE
from pointray.surface.tree.build import Splats, build_tree
from pointray.surface.tree.columns import MARGIN, PAD as COLUMN_PAD, STEEP, WORTH, across
from pointray.surface.tree.leaves import PAD, limits_of
from pointray.surface.tree.settings import TRIM, TreeSettings

TOLERANCE = 2e-3  # radii: the square of a cosine is rounded, and its sine is taken to be a little too large


def slab(x, n, r, m):
    """Return the least and greatest m.x of any surface: the bound proved in `surface/tree/leaves.py`."""
    a, b, c, d = limits_of("apss", TRIM)
    cosine, away = (n @ m).min(), 1.0
    if cosine > 0:
        far = max(a + b / cosine**2, c + d / cosine**2)
        uneven = (r.min() + r.max()) / 2 / np.sqrt(r.min() * r.max())
        away = min(1.0, uneven * np.sqrt(max(0.0, 1 - cosine**2) * far))
    return (x @ m - away * r).min(), (x @ m + away * r).max()


def over(x, r, low, high):
    """Return which splats' supports overlap a box."""
    return (np.maximum(np.maximum(low - x, x - high), 0) ** 2).sum(axis=1) <= r**2


def columns(x, n, r, size, normal):
    """Return rows (at, u-slope, v-slope, low, high) of columns with splats; x is relative to the voxel's low corner."""
    u, v, w = axes = uncompiled(across)(*normal)
    rows, thickness = [], []
    for at in range(16):
        low, high = np.zeros(3), size.copy()
        for axis, k in zip(axes[:2], divmod(at, 4), strict=True):
            low[axis], high[axis] = (k - MARGIN) * size[axis] / 4, (k + 1 + MARGIN) * size[axis] / 4
        inside = over(x, r, low, high)
        if inside.any():
            total = n[inside].sum(axis=0)
            length = np.linalg.norm(total)
            m = total / length if abs(total[w]) > STEEP * length else normal
            least, most = slab(x[inside], n[inside], r[inside], m)
            ends = sorted(((least - COLUMN_PAD * r.mean()) / m[w], (most + COLUMN_PAD * r.mean()) / m[w]))
            rows.append((at, m[u] / m[w] * size[u] / 4, m[v] / m[w] * size[v] / 4, *ends))
            thickness.append(most - least)
    return rows, np.sum(thickness), len(rows)


@pytest.mark.parametrize(("shift", "size"), [(0.0, 1.0), (30.0, 1.0), (0.0, 1e-9), (0.0, 1e9)])
def test_slabs_equal_those_of_a_slow_reference(shift, size):
    rng = np.random.default_rng(8)
    normals = sphere_points(3000)
    positions = (size * (normals * [1.0, 0.7, 0.4] + shift)).astype(np.float32)
    radii = (size * rng.uniform(0.05, 0.09, 3000)).astype(np.float32)
    rows = np.arange(3000, dtype=np.int32)
    tree = build_tree(Splats(positions, normals, radii, rows, None), TreeSettings("apss", trim=TRIM))
    x, n, r = positions.astype(np.float64), normals.astype(np.float64), radii.astype(np.float64)
    leaves, patches = tree.leaves.reshape(-1, 16).astype(np.float64), tree.patches.reshape(-1, 4, 16)
    full, bounded = np.flatnonzero(tree.spans[1::2]), 0
    for leaf in full[:: max(len(full) // 40, 1)]:
        low, high, m = leaves[leaf, :3], leaves[leaf, 3:6], leaves[leaf, 6:9]
        inside = over(x, r, low, high)
        own, mean = (x[inside] - low, n[inside], r[inside]), r[inside].mean()
        total = own[1].sum(axis=0)
        assert m == pytest.approx(total / np.linalg.norm(total), abs=1e-5)
        assert leaves[leaf, 12] == pytest.approx(mean, rel=1e-5)
        least, most = slab(*own, m)
        found = leaves[leaf, 9:11] - low @ m
        rounding = 4 * np.spacing(np.float32(np.abs(x).max()))
        assert found == pytest.approx([least - PAD * mean, most + PAD * mean], abs=TOLERANCE * mean + rounding)
        wanted, sum_of, count = columns(*own, high - low, m)
        if np.isinf(patches[leaf, 2]).any():
            assert sum_of > 0.99 * WORTH * count * (most - least)
            continue
        bounded += 1
        assert (patches[leaf, 2] == NO_SURFACE).sum() == 16 - count
        for at, *numbers in wanted:
            assert patches[leaf, :, at] == pytest.approx(numbers, abs=5 * TOLERANCE * mean)
    assert bounded > 5
