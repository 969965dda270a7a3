"""The splats listed near rays include all whose support a ray crosses, even if their sizes differ greatly."""

import numpy as np
import pytest

import pointray as pr
from pointray.engine.jit import borrow, keep_alive, kernel
from pointray.engine.kernels.scratch import COUNT_SPLATS, new_scratch, slot_of
from pointray.engine.kernels.tree import CELL, LEAF
from pointray.surface.intersect.gather import gather, list_blocks, list_splats, segment


@kernel
def _near(tree, leaf, ray, longest, out):
    memory = new_scratch(longest)
    scratch = borrow(memory)
    capsule = segment((ray[0], ray[1], ray[2]), (ray[3], ray[4], ray[5]), ray[6], ray[7])
    list_blocks(tree, leaf, capsule, scratch)
    gather(tree, scratch)
    list_splats(scratch, capsule)
    count = scratch.counts[COUNT_SPLATS]
    for k in range(count):
        out[k] = slot_of(scratch, scratch.listed[k])
    keep_alive(memory)
    return count


def over(model, leaf, ray):
    """Return the slots of a leaf's blocks whose support overlaps a part of a ray (in float64), and all slots."""
    first, count = model.tree.spans[2 * leaf : 2 * leaf + 2]
    used = model.tree.spheres.reshape(-1, 4, 16)[first : first + count, 3] >= 0
    blocks = model.tree.refs.reshape(-1, 16)[first : first + count][used].astype(np.int64)
    slots = (blocks[:, None] * 4 + np.arange(4)).reshape(-1)
    x, y, z, _, _, _, inverse = (
        model.tree.blocks.reshape(-1, 7, 4).transpose(1, 0, 2).reshape(7, -1)[:, slots].astype(float)
    )
    away = np.stack([x, y, z], axis=1) - ray[:3]
    t = np.clip(away @ ray[3:6], ray[6], ray[7])
    distances = np.linalg.norm(away - t[:, None] * ray[3:6], axis=1)
    return set(slots[distances < 1 / np.sqrt(inverse)].tolist()), set(slots.tolist())


@pytest.mark.parametrize("ratio", [1, 30, 3000])
def test_every_splat_that_a_ray_crosses_is_listed(ratio):
    """A coarse plane has a small area of fine points: the voxel is hundreds of their radii wide."""
    rng = np.random.default_rng(8)
    coarse, fine = rng.uniform(-1, 1, (800, 3)), rng.uniform(-0.2, 0.2, (400, 3))
    positions = np.concatenate([coarse, fine]) * (1, 1, 0)
    radii = np.repeat([0.3, 0.3 / ratio], [800, 400])
    model = pr.Model(pr.Points(positions, np.tile([0.0, 0, 1], (1200, 1))), radii)
    leaves = model.tree.leaves.reshape(-1, LEAF)
    longest = 16 * int(model.tree.spans[1::2].max())
    out, found = np.empty(4 * longest + 64, np.int64), 0
    for _ in range(600):
        leaf = int(rng.integers(len(leaves)))
        middle = positions[800 + rng.integers(400)] + rng.normal(size=3) * radii[-1] * 0.4
        d = rng.normal(size=3)
        d /= np.linalg.norm(d)
        length = np.linalg.norm(leaves[leaf, CELL + 3 : CELL + 6] - leaves[leaf, CELL : CELL + 3])
        ray = np.array([*(middle - length * rng.random() * d), *d, 0.0, length], np.float32)
        wanted, known = over(model, leaf, ray.astype(np.float64))
        listed = out[: _near(model.tree, leaf, ray, longest, out)].tolist()
        assert wanted <= set(listed) <= known and len(set(listed)) == len(listed)
        found += len(wanted)
    assert found > 600
