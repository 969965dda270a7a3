"""The lattice of samples along each ray, t = k * step, and the range of it that is evaluated in a voxel.

The range extends from the last sample before the voxel to the first one behind it. Voxel, slab and tight box only
select the range, so that neither they nor the size of the voxels affect the hits.
"""

from __future__ import annotations

from typing import NamedTuple

from ...engine.jit import f32, inline
from ...engine.kernels.tree import LEAF, STEP, Tree
from ...engine.simd import F16, ONE, ZERO, Mask, Real, broadcast16, select, trunc, vabs, vmax, vmin

MOST_STEPS = f32(2.0**22)  # from the ray's entry into the model's bounds
SAMPLES_PER_BASE = f32(16.0)  # samples whose positions are relative to the same base point
NONZERO_BEGIN = f32(1e-30)  # replaces 0 as the start of a ray, so that it can have a sign, see `scratch.BEGIN`


class SampleRange(NamedTuple):
    """Samples to evaluate in a voxel, for 16, 8 or four rays: a range of the lattice t = k step for each.

    first, last : indices k of the first and the last sample
    begin : t where the ray begins if that is in the range, so that the start rule applies; negative if the ray begins
        elsewhere, or on no surface
    """

    first: Real
    last: Real
    begin: Real


@inline
def sample_range(tree: Tree, leaf: int, interval: tuple[Real, Real, Real], begin: Real) -> tuple[SampleRange, Mask]:
    """Return the samples to evaluate in a leaf, and a mask of the rays whose samples are distinct in float32.

    interval : (enter, low, high), t where the rays enter the voxel, and between which (low, high) the surface can be;
        the first and the last sample lie outside of that part
    begin : t where the rays begin; negative if they start on no surface
    """
    enter, low, high = interval
    step = tree.leaves[leaf * LEAF + STEP]
    # Tested where the surface may begin, because the end of the ray must not decide.
    fine = low < MOST_STEPS * step
    # The start rule needs f where the ray begins: if that is in this voxel, the range is extended back to there.
    low = select(fine, select(enter <= begin, vmin(low, begin), low), ZERO)
    high = select(fine, vmin(high, MOST_STEPS * step + MOST_STEPS * step), ZERO)
    # t is never negative here, so truncation equals floor.
    first, last = trunc(low / step), trunc(high / step) + ONE
    starts = (first * step <= begin) & (begin <= last * step)
    return SampleRange(first, last, select(starts, begin, ZERO - vmax(vabs(begin), NONZERO_BEGIN))), fine


@inline
def span(tree: Tree, leaf: int, sampled: SampleRange) -> tuple[Real, Real]:
    """Return t of the first and the last sample to evaluate in a leaf."""
    step = tree.leaves[leaf * LEAF + STEP]
    return sampled.first * step, sampled.last * step


@inline
def base_spacing(tree: Tree, leaf: int) -> F16:
    """Return the length of ray segments in which positions are relative to the same base point: 16 samples."""
    return broadcast16(SAMPLES_PER_BASE * tree.leaves[leaf * LEAF + STEP])


@inline
def base_of(t: Real, length: Real) -> Real:
    """Return t of the base point of the ray segment that contains t. length : of segments, 16 samples of the leaf

    Positions relative to a point nearby are precise in float32. The base depends on t alone, and is half a step before
    a sample. So a sample has the same bits in every voxel that evaluates it, and beside any other rays.
    """
    return trunc(t / length + f32(0.5) / SAMPLES_PER_BASE) * length
