"""Flat splats (the paper's figure 1a): each point a disc of its radius, at right angles to its normal. The baseline."""

from __future__ import annotations

import numpy as np

from ..jit import inline
from ..records import BLOCK, INV_R2, NX, NY, NZ, PX, PY, PZ, Hit
from ..scratch import COUNT_NEAR
from ..simd import bits, lane, lowest, repeat4

ONE, INF = np.float32(1.0), np.float32(np.inf)


@inline
def search_discs(tree, leaf, scratch, frame, enter, leave):  # type: ignore[no-untyped-def]
    """The nearest disc of the near blocks that the ray meets inside of the voxel: four discs at once.

    frame : where the first sample is, t there, and the ray
    """
    place, start, ray = frame
    nearest = INF
    nx = ny = nz = np.float32(0.0)
    for k in range(scratch.counts[COUNT_NEAR]):
        slot = np.int64(scratch.near[k]) * BLOCK
        qx, qy, qz = (
            repeat4(tree.blocks, slot + PX) - place[0],
            repeat4(tree.blocks, slot + PY) - place[1],
            repeat4(tree.blocks, slot + PZ) - place[2],
        )
        mx, my, mz = repeat4(tree.blocks, slot + NX), repeat4(tree.blocks, slot + NY), repeat4(tree.blocks, slot + NZ)
        s = (qx * mx + qy * my + qz * mz) / (mx * ray.dx + my * ray.dy + mz * ray.dz)
        vx, vy, vz = s * ray.dx - qx, s * ray.dy - qy, s * ray.dz - qz
        inside = (vx * vx + vy * vy + vz * vz) * repeat4(tree.blocks, slot + INV_R2) <= ONE
        t = s + start
        left = bits(inside & (t >= enter) & (t <= leave) & (t < nearest)) & 15
        while left != 0:
            j = lowest(left)
            left &= left - 1
            if lane(t, j) < nearest:
                nearest = lane(t, j)
                nx, ny, nz = lane(mx, j), lane(my, j), lane(mz, j)
    return Hit(nearest, nx, ny, nz, leaf if nearest < INF else -1)
