"""The blocks near a segment of a ray: what the surface is evaluated from, listed once a voxel."""

from __future__ import annotations

import numpy as np

from ..jit import inline
from ..records import GROUP
from ..scratch import COUNT_NEAR
from ..simd import load16, pack, spread16, vabs, vmax
from .surface import ZERO


@inline
def gather_near(tree, leaf, scratch, middle, d, half):  # type: ignore[no-untyped-def]
    """List the leaf's blocks whose bounding sphere is near the segment of half length `half` along d about a point."""
    first, count = tree.spans[2 * leaf], tree.spans[2 * leaf + 1]
    n = 0
    for group in range(first, first + count):
        at = np.int64(group) * GROUP
        x = load16(tree.spheres, at) - middle[0]
        y = load16(tree.spheres, at + 16) - middle[1]
        z = load16(tree.spheres, at + 32) - middle[2]
        along = x * d[0] + y * d[1] + z * d[2]
        beyond = vmax(vabs(along) - half, spread16(ZERO))
        square = x * x + y * y + z * z - along * along + beyond * beyond
        near = square < load16(tree.spheres, at + 48)
        n += pack(near, tree.refs, np.int64(group) * 16, scratch.near, n)
    scratch.counts[COUNT_NEAR] = n


@inline
def keep_sheet(tree, scratch, d):  # type: ignore[no-untyped-def]
    """Drop the listed blocks of sheets that face along d: of two sheets close together one is seen at a time."""
    n = 0
    for k in range(scratch.counts[COUNT_NEAR]):
        block = scratch.near[k]
        at = 3 * np.int64(block)
        along = tree.facing[at] * d[0] + tree.facing[at + 1] * d[1] + tree.facing[at + 2] * d[2]
        if along <= ZERO:
            scratch.near[n] = block
            n += 1
    scratch.counts[COUNT_NEAR] = n
