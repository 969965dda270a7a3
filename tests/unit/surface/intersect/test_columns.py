"""`narrow` returns the part of a ray in which a voxel's columns can hold the surface; compared with small steps."""

from typing import NamedTuple

import numpy as np
import pytest

from helpers.marks import long
from pointray.engine.jit import kernel
from pointray.engine.kernels.tree import CELL, LEAF, NO_SURFACE, SLAB
from pointray.engine.simd import load16, store
from pointray.surface.intersect.columns import axes_of, narrow, narrow_one

STEPS = 20_000


class Tree(NamedTuple):
    """The part of a tree that `narrow` reads."""

    leaves: np.ndarray
    patches: np.ndarray


class Leaf:
    """A leaf with its columns."""

    def __init__(self, rng, limited=True):
        low = rng.normal(size=3)
        self.cell = np.concatenate([low, low + rng.uniform(0.5, 3, 3)]).astype(np.float32)
        self.normal = rng.normal(size=3).astype(np.float32)
        self.slopes = rng.uniform(-0.4, 0.4, (2, 16))
        middle, half = rng.uniform(-0.5, 3.5, 16), rng.uniform(0.01, 0.6, 16)
        self.low, self.high = middle - half, middle + half
        empty = rng.random(16) < 0.3
        self.low[empty] = self.high[empty] = NO_SURFACE
        if not limited:
            self.low[:], self.high[:] = -np.inf, np.inf

    @property
    def tree(self):
        record = np.zeros(LEAF, np.float32)
        record[CELL : CELL + 6], record[SLAB : SLAB + 3] = self.cell, self.normal
        return Tree(record, np.concatenate([*self.slopes, self.low, self.high]).astype(np.float32))

    def holds(self, x):
        """Whether points (n, 3) lie in the slab of their column."""
        w = int(np.abs(self.normal).argmax())
        u, v = (w + 1) % 3, (w + 2) % 3
        local = x - self.cell[:3].astype(float)
        i, j = 4 * local[:, [u, v]].T / (self.cell[3:] - self.cell[:3])[[u, v]][:, None]
        column = np.clip(i.astype(int), 0, 3) * 4 + np.clip(j.astype(int), 0, 3)
        height = local[:, w] + self.slopes[0][column] * i + self.slopes[1][column] * j
        return (self.low[column] <= height) & (height <= self.high[column])


@kernel
def _narrow(tree, rows, out):
    axes = axes_of(tree, 0)
    u, v, w = axes
    rays = (
        (load16(rows, 16 * u), load16(rows, 16 * v), load16(rows, 16 * w)),
        (load16(rows, 48 + 16 * u), load16(rows, 48 + 16 * v), load16(rows, 48 + 16 * w)),
        (load16(rows, 96 + 16 * u), load16(rows, 96 + 16 * v)),
    )
    low, high = narrow(tree, 0, axes, rays, (load16(rows, 144), load16(rows, 160)))
    store(out, 0, low)
    store(out, 16, high)
    return 0


@kernel
def _narrow_one_by_one(tree, rows, out):
    axes = axes_of(tree, 0)
    u, v, w = axes
    for k in range(16):
        ray = (
            (rows[16 * u + k], rows[16 * v + k], rows[16 * w + k]),
            (rows[48 + 16 * u + k], rows[48 + 16 * v + k], rows[48 + 16 * w + k]),
            (rows[96 + 16 * u + k], rows[96 + 16 * v + k]),
        )
        out[k], out[16 + k] = narrow_one(tree, 0, axes, ray, (rows[144 + k], rows[160 + k]))
    return 0


def narrowed(leaf, rows, function=_narrow):
    """Return the parts of 16 rays (rows for `_narrow`) that can hit the surface."""
    out = np.zeros(32, np.float32)
    function(leaf.tree, rows, out)
    return out[:16], out[16:]


def through(leaf, rng):
    """Return 16 rays (origins, directions) through a leaf's voxel, some along an axis, with their entry and exit t."""
    low, high = leaf.cell[:3].astype(float), leaf.cell[3:].astype(float)
    d = rng.normal(size=(16, 3))
    d[:4] = np.eye(3)[rng.integers(3, size=4)] * rng.choice([-1, 1], (4, 1)) + 1e-20
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    o = low + rng.random((16, 3)) * (high - low) - rng.uniform(0, 5, (16, 1)) * d
    with np.errstate(over="ignore"):
        a, b = (low - o) / d, (high - o) / d
    return o, d, np.maximum(np.minimum(a, b).max(axis=1), 0), np.maximum(a, b).min(axis=1)


@pytest.mark.parametrize("seed", [0, 1, 2, *map(long, range(3, 12))])
def test_rays_are_narrowed_to_the_slabs_of_their_columns(seed):
    """Both functions agree: the one for 16 rays and the one for a single ray."""
    rng = np.random.default_rng(seed)
    leaf, met = Leaf(rng, limited=seed > 0), 0
    for _ in range(10):
        o, d, enter, leave = through(leaf, rng)
        rows = np.concatenate([o.T.ravel(), d.T.ravel(), (1 / d).T.ravel(), enter, leave]).astype(np.float32)
        found = [narrowed(leaf, rows, function) for function in (_narrow, _narrow_one_by_one)]
        for k in range(16):
            t = np.linspace(enter[k], leave[k], STEPS)
            inside = t[leaf.holds(o[k] + t[:, None] * d[k])]
            width = 2 * (t[1] - t[0]) + 1e-4
            met += len(inside) > 0
            for low, high in found:
                if len(inside) == 0:
                    assert not low[k] + width < high[k]
                    continue
                assert low[k] == pytest.approx(inside[0], abs=width) and high[k] == pytest.approx(inside[-1], abs=width)
    assert met > 20


def test_a_leaf_of_nan_does_not_hang():
    """A damaged file may contain such leaves. The result does not matter, but the loop over columns must end."""
    leaf = Leaf(np.random.default_rng(0))
    o, d, enter, leave = through(leaf, np.random.default_rng(1))
    rows = np.concatenate([o.T.ravel(), d.T.ravel(), (1 / d).T.ravel(), enter, leave]).astype(np.float32)
    for cell in (np.nan, np.inf, -np.inf, 0.0):
        leaf.cell = np.full(6, cell, np.float32)
        narrowed(leaf, rows)
        leaf.low[:] = cell
        narrowed(leaf, rows)
