"""The lattice of samples along each ray, t = k * step, and which part of it is evaluated in a voxel.

That part goes from the last sample before the voxel to the first one behind it. The voxel, the slab and the tight box
only choose it, so neither they nor the size of the voxels decide what is found.
"""

from __future__ import annotations

from typing import NamedTuple

from ...engine.jit import f32, inline
from ...engine.kernels.tree import LEAF, STEP, Tree
from ...engine.simd import F16, ONE, ZERO, Mask, broadcast16, select, trunc, vabs, vmax, vmin

MOST_STEPS = f32(2.0**22)  # counted from where a ray enters the model's bounds
TOGETHER = f32(16.0)  # samples whose positions are counted from the same place
BEHIND = f32(1e-30)  # instead of 0 where a ray begins, so that it has a sign, see `scratch.BEGIN`


class SampleRange(NamedTuple):
    """Which samples of the rays are evaluated: numbers of the first and the last one; and where the rays begin.

    begin : negative where a ray begins elsewhere, or on no surface, so that the start rule does not apply; then never 0
    """

    first: F16
    last: F16
    begin: F16


@inline
def sample_range(tree: Tree, leaf: int, interval: tuple[F16, F16, F16], begin: F16) -> tuple[SampleRange, Mask]:
    """Which samples are evaluated, and a mask of the rays whose samples float32 can tell apart.

    interval : where the rays enter the voxel, and the part in which the surface can be (tight box, slab)
    begin : where the rays begin, see `scratch.BEGIN`
    The lattice's next samples on both sides lie outside the slab and the voxel: see `surface/tree/cells.py`.
    """
    enter, low, high = interval
    step = tree.leaves[leaf * LEAF + STEP]
    # Tested where the surface may begin: where the ray ends must not decide.
    fine = low < MOST_STEPS * step
    # The start rule needs f where the ray begins: if that is in this voxel, the samples go back to there.
    low = select(fine, select(enter <= begin, vmin(low, begin), low), broadcast16(ZERO))
    high = select(fine, vmin(high, broadcast16(MOST_STEPS * step + MOST_STEPS * step)), broadcast16(ZERO))
    # t is never negative here: truncation is the floor.
    first, last = trunc(low / step), trunc(high / step) + ONE
    starts = (first * step <= begin) & (begin <= last * step)
    return SampleRange(first, last, select(starts, begin, ZERO - vmax(vabs(begin), broadcast16(BEHIND)))), fine


@inline
def span(tree: Tree, leaf: int, sampled: SampleRange) -> tuple[F16, F16]:
    """t of the first and the last sample."""
    step = tree.leaves[leaf * LEAF + STEP]
    return sampled.first * step, sampled.last * step


@inline
def stretch(tree: Tree, leaf: int) -> F16:
    """The length of the stretches of a ray along which positions are counted from the same place, see `start_of`."""
    return broadcast16(TOGETHER * tree.leaves[leaf * LEAF + STEP])


@inline
def start_of(t: F16, length: F16) -> F16:
    """Where the stretch begins in which t is: half a step before a sample.

    It depends on t alone. So a sample has the same bits whichever voxel it is evaluated in, and whichever rays are
    traced together.
    """
    return trunc(t / length + f32(0.5) / TOGETHER) * length
