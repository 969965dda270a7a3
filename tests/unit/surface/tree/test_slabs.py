"""The bound proved in `surface/tree/leaves.py` holds: the surface f = 0 of any few splats lies in their slab."""

import numpy as np
import pytest

from helpers.marks import long
from helpers.naive import KINDS
from helpers.naive_slabs import LINES, TRIM, outside
from pointray.engine.jit import run
from pointray.surface.tree.leaves import limits_of


def clouds_of(rng, count, splats):
    """Return splats (count, splats, 13) whose normals lie in cones of all widths, and the axes of the cones."""
    x = rng.normal(size=(count, splats, 3)) * rng.uniform(0.05, 0.7, (count, 1, 1))
    spread = rng.choice([0.03, 0.2, 0.6, 2.0], (count, 1, 1))
    n = np.array([0, 0, 1]) + spread * rng.normal(size=(count, splats, 3))
    # Half of the clouds are bent like spheres and saddles, where the three surfaces differ.
    bend = rng.uniform(-1.5, 1.5, (count, 1, 2)) * (rng.random((count, 1, 1)) < 0.5)
    n[..., :2] += bend * x[..., :2]
    n[..., 2] = np.abs(n[..., 2]) + 0.02
    n /= np.linalg.norm(n, axis=2, keepdims=True)
    r = np.exp(rng.normal(size=(count, splats, 1)) * rng.choice([0.0, 0.1, 0.5], (count, 1, 1)))
    m = n.sum(axis=1)
    return np.concatenate([x, n, r, np.zeros((count, splats, 6))], axis=2), m / np.linalg.norm(m, axis=1, keepdims=True)


@pytest.mark.parametrize(
    ("surface", "trim", "count"),
    [
        *(("apss", TRIM, 60), ("paper", TRIM, 40)),
        *(long(surface, trim, 200) for surface in ("apss", "paper", "imls") for trim in (TRIM, 0.4, 5.0)),
    ],
)
def test_all_surface_lies_in_the_slab(surface, trim, count):
    """count : number of clouds for each number of splats"""
    rng = np.random.default_rng(11)
    shares, zeros = [], 0
    for splats in (1, 2, 3, 5, 8):
        clouds, normals = clouds_of(rng, count, splats)
        lines = rng.normal(size=(len(clouds), LINES, 2, 3))
        lines[:, :, 1] /= np.linalg.norm(lines[:, :, 1], axis=2, keepdims=True)
        lines[:, :, 0] = clouds[:, :1, :3] + 0.4 * lines[:, :, 0] - lines[:, :, 1]
        out = np.empty(len(clouds), np.int64), np.empty(len(clouds))
        settings = KINDS[surface], trim, limits_of(surface, trim)
        run(outside, len(clouds), clouds, normals, lines, settings, out)
        zeros += out[0].sum()
        shares.append(out[1][out[0] > 0])
    shares = np.concatenate(shares)
    assert zeros > 30 * count
    assert shares.max() <= 1
    assert shares.max() > 0.9  # a slab that is much too thick proves nothing
