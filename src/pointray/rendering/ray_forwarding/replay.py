"""Rendering kernels without models: hits are read from a table of answers of other workers.

In each wave a sample of a tile runs from its start, with all answers so far. At the first missing answer it stores the
rays of its tile as a query; from then on its rays hit nothing, and its result is discarded. After the last wave no
answer is missing, and the result is that of the original kernels, by the same code with the same numbers.

That code is not repeated here: the functions that trace rays have versions for a `ReplayWorld` (`version_for`), which
Numba calls wherever the original kernels call them.
"""

from __future__ import annotations

from collections import namedtuple
from typing import Any, NamedTuple

import numpy as np

from ...engine.jit import Array, borrow, i64, inline, kernel, routine, uncompiled, version_for
from ...engine.kernels import scratch as sc
from ...engine.kernels.records import World
from ...engine.kernels.scratch import Scratch, load3, store3
from ...engine.kernels.vec import load3_flat
from ...engine.simd import Bits
from ...shade.shading_points import margin_of
from ...surface.trace.hits import describe_tile
from ...surface.trace.instance import through_instance
from ...surface.trace.instance_bvh import begin_walk
from ...surface.trace.world import find_hits, occlude_tile, trace_tile
from ..film import EDGE, Corner
from ..integrate import BLOCK_EDGE, Pass, begin_sample, quick_frame, sampled_frame

# Fields of a ray of a query, RAY float64; its t_min is 0.
RAY = 8
RAY_ORIGIN, RAY_DIRECTION, RAY_END, RAY_SIDE = 0, 3, 6, 7  # side: see `scratch.SIDE_OF`
# Fields of a hit, FACTS float64; margin: see `scratch.SHADING_MARGIN`.
FACTS = 9
FACT_INSTANCE, FACT_T, FACT_NORMAL, FACT_COLOR, FACT_MARGIN = 0, 1, 2, 5, 8
MISS = -1

# State of a thread's sample, in `scratch.stack`, which only the traversal of models uses otherwise.
COLUMN, ROW, SAMPLE = 0, 1, 2  # first pixel of the tile; sample index
TURN = 3  # number of queries since the start of the sample
SILENT = 4  # 1: no answers are left


class ReplayTable(NamedTuple):
    """Hits that workers have returned for a piece of an image (answers), and the rays to send next (queries).

    In each wave all samples run from the start and read hits from the table, until one is missing: then the rays of the
    tile are stored as a query. A unit is one sample of one tile; units are ordered by block and tile.

    Attributes
    ----------
    first_block, across : int
        Number of the piece's first block; blocks in a row of the image.
    first, samples : int
        First sample index, and number of samples, of each tile.
    units : int
        Number of units.
    turns : int
        Number of answered waves.
    last : bool
        Whether no hit is missing: all units run to their end.
    begins : (turns * units,) int64
        For each wave and unit, the index in `found` of the answer for the first ray of the unit's query; -1: no query.
    found : (n,) int64
        Answer for each ray of all queries: index of its hit in `facts`, 0 for a blocked shadow ray, -1 for a miss.
    facts : (m * FACTS,) float64
        Hits: instance, t, normal, colour, and the offset of secondary rays from the surface.
    asked : (units,) int64
        For each unit, the rays of its tile that must be sent next, as bits; 0: none.
    kinds : (units,) uint8
        1 if these rays are tested for occlusion, 0 if for the closest hit.
    rays : (units * TILE * RAY,) float64
        Data of these rays: origin, direction, largest t, side (+1 if a ray that starts on a surface is outside of it,
        -1 if inside).
    """

    first_block: int
    across: int
    first: int
    samples: int
    units: int
    turns: int
    last: bool
    begins: Array
    found: Array
    facts: Array
    asked: Array
    kinds: Array
    rays: Array


# A `World` with answers.
ReplayWorld: Any = namedtuple("ReplayWorld", [*World._fields, "recall"])  # type: ignore[misc]  # noqa: PYI024


@version_for(ReplayWorld, begin_walk)
@inline
def _no_walk(world: Any, scratch: Scratch) -> int:
    """Return 0, the number of instances to visit: for a `ReplayWorld`, workers intersect them; only planes are left."""
    return 0


@version_for(ReplayWorld, through_instance)
@inline
def _no_instance(world: Any, offset: int, rays: int, any_hit: bool, scratch: Scratch) -> None:
    """Do nothing: for a `ReplayWorld`, workers intersect the models of instances, and a table holds the hits."""


@inline
def _unit_of(recall: ReplayTable, stack: Array) -> int:
    """Return the index of the sample of a tile that a thread computes among all samples of all tiles of the piece.

    stack : the thread's state, with column and row of the tile and the sample index
    """
    block = stack[ROW] // BLOCK_EDGE * recall.across + stack[COLUMN] // BLOCK_EDGE - recall.first_block
    tile = stack[ROW] // EDGE % 2 * 2 + stack[COLUMN] // EDGE % 2
    return i64(block * 4 + tile) * recall.samples + stack[SAMPLE] - recall.first


@inline
def _is_open(scratch: Scratch, i: int) -> bool:
    """Return whether ray i of the tile may hit models: some of it lies before the nearest hit with a plane."""
    return scratch.world[sc.T_MIN + i] <= scratch.world[sc.NEAREST + i]


@version_for(ReplayWorld, begin_sample)
@inline
def _begin_sample(world: Any, corner: Corner, sample: int, scratch: Scratch) -> None:
    """Store in scratch memory which sample begins, to find its hits in the table of the `ReplayWorld`.

    corner : column and row of the tile's first pixel; sample : index of the sample
    """
    stack = scratch.stack
    stack[COLUMN], stack[ROW], stack[SAMPLE], stack[TURN], stack[SILENT] = corner[0], corner[1], sample, 0, 0


@routine
def _recall_tile(world: Any, any_hit: bool, scratch: Scratch) -> None:
    """Read the hits of the tile's rays with models from the world's table; if it lacks them, store the rays to be sent.

    Planes have been intersected before. If hits are lacking, all further rays of the sample hit nothing; its result is
    discarded.

    any_hit : whether to test for occlusion only
    """
    scratch, world = borrow(scratch), borrow(world)
    recall, stack = world.recall, scratch.stack
    asked = i64(0)
    for i in range(sc.TILE):
        scratch.world[sc.LOCAL + i] = 0.0  # margin of the hit
        asked |= i64(_is_open(scratch, i)) << i
    unit, turn = _unit_of(recall, stack), i64(stack[TURN])
    if recall.turns > 0 and not recall.last and recall.begins[(recall.turns - 1) * recall.units + unit] < 0:
        stack[SILENT] = 1  # it had no query in the previous wave
    if asked != 0 and stack[SILENT] == 0:
        stack[TURN] += 1
        begin = recall.begins[turn * recall.units + unit] if turn < recall.turns else i64(-1)
        if begin >= 0:
            _take(recall, begin, any_hit, scratch)
            return
        _ask(recall, unit, asked, any_hit, scratch)
        stack[SILENT] = 1
    if stack[SILENT] != 0:
        for i in range(sc.TILE):
            scratch.numbers[sc.INSTANCE_OF + i] = -1


@inline
def _take(recall: ReplayTable, begin: int, any_hit: bool, scratch: Scratch) -> None:
    """Read the hits of a tile's rays with models, which workers have returned, from the table into scratch memory.

    recall : the table; begin : index of the first of these hits in `recall.found`
    any_hit : whether the rays are tested for occlusion only
    """
    wide, numbers = scratch.world, scratch.numbers
    k = begin
    for i in range(sc.TILE):
        if not _is_open(scratch, i):
            continue
        row = recall.found[k]
        k += 1
        if row < 0:
            continue
        numbers[sc.LEAF_OF + i] = -1
        if any_hit:
            numbers[sc.INSTANCE_OF + i] = 0
            continue
        at = row * FACTS
        numbers[sc.INSTANCE_OF + i] = i64(recall.facts[at + FACT_INSTANCE])
        wide[sc.NEAREST + i] = recall.facts[at + FACT_T]
        store3(wide, sc.NORMAL + i, load3_flat(recall.facts, at + FACT_NORMAL))
        store3(wide, sc.COLOR + i, load3_flat(recall.facts, at + FACT_COLOR))
        wide[sc.LOCAL + i] = recall.facts[at + FACT_MARGIN]


@inline
def _ask(recall: ReplayTable, unit: int, asked: Bits, any_hit: bool, scratch: Scratch) -> None:
    """Store some of the tile's rays in a table, to be sent to the workers that hold the models.

    recall : the table; unit : index of the tile's sample among all samples of all tiles in the table
    asked : the rays (bits); any_hit : whether to test for occlusion only
    """
    recall.asked[unit] = asked
    recall.kinds[unit] = 1 if any_hit else 0
    for i in range(sc.TILE):
        if (asked >> i) & 1 != 0:
            at = (unit * sc.TILE + i) * RAY
            o, d = load3(scratch.world, sc.ORIGIN + i), load3(scratch.world, sc.DIRECTION + i)
            for c in range(3):
                recall.rays[at + RAY_ORIGIN + c] = o[c]
                recall.rays[at + RAY_DIRECTION + c] = d[c]
            recall.rays[at + RAY_END] = scratch.world[sc.NEAREST + i]
            recall.rays[at + RAY_SIDE] = scratch.world[sc.SIDE_OF + i]


@version_for(ReplayWorld, trace_tile)
@inline
def _recall_closest(world: Any, scratch: Scratch) -> None:
    """Find the closest hits of the tile's rays: intersect planes here, and read hits with models from a table.

    The table of the `ReplayWorld` holds the hits that workers have returned; lacking ones are requested.
    """
    find_hits(world, False, scratch)
    _recall_tile(world, False, scratch)


@version_for(ReplayWorld, occlude_tile)
@inline
def _recall_occlusion(world: Any, scratch: Scratch) -> None:
    """Find which rays of the tile are blocked: intersect planes here, and read hits with models from a table.

    The table of the `ReplayWorld` holds the hits that workers have returned; lacking ones are requested.
    """
    find_hits(world, True, scratch)
    _recall_tile(world, True, scratch)


@version_for(ReplayWorld, describe_tile)
@inline
def _keep_colors(world: Any, seen_only: bool, scratch: Scratch) -> None:
    """Do nothing: the hits that workers have returned for a `ReplayWorld` include their colours."""


@version_for(ReplayWorld, margin_of)
@inline
def _margin_of(world: Any, scratch: Scratch, i: int) -> float:
    """Return the offset of secondary rays from the surface at hit i of the tile, as a worker has returned it."""
    return scratch.world[sc.LOCAL + i]


_quick, _sampled = routine(uncompiled(quick_frame)), routine(uncompiled(sampled_frame))


@kernel
def recalled_quick(work: Array, world: Any, camera: Array, job: Pass, film: Array, image: Array) -> None:
    """Render blocks of an image with "phong", "normal", "depth" or "color", by hits that workers have returned.

    work : counter from which threads take blocks; world : a `ReplayWorld`, which has the table of these hits
    camera : (16,), eye, axes, projection and lens; job : settings and range of samples
    film : (h, w, k), k sums over the samples of each pixel, or empty; image : (h, w, 4), mean RGB and alpha
    """
    _quick(work, world, camera, job, film, image)


@kernel
def recalled_sampled(work: Array, world: Any, camera: Array, job: Pass, film: Array, image: Array) -> None:
    """Render blocks of an image with the integrator "ao" or "path", by hits that workers have returned.

    work : counter from which threads take blocks; world : a `ReplayWorld`, which has the table of these hits
    camera : (16,), eye, axes, projection and lens; job : settings and range of samples
    film : (h, w, k), k sums over the samples of each pixel, or empty; image : (h, w, 4), mean RGB and alpha
    """
    _sampled(work, world, camera, job, film, image)


def replay_kernel_for(frame: Any) -> Any:
    """Return the kernel that replaces `quick_frame` or `sampled_frame` when workers intersect the models.

    frame : one of these two
    """
    return {quick_frame: recalled_quick, sampled_frame: recalled_sampled}[frame]


def empty_table(units: int, first_block: int, across: int, samples: tuple[int, int]) -> ReplayTable:
    """Return a table of hits for a piece of an image before any rays are sent.

    units : tiles of the piece times samples of each; first_block : number of the piece's first block in the image
    across : blocks in a row of the image; samples : range of sample indices
    """
    return ReplayTable(
        first_block,
        across,
        samples[0],
        samples[1] - samples[0],
        units,
        0,
        False,
        np.zeros(0, np.int64),
        np.zeros(0, np.int64),
        np.zeros(0),
        np.zeros(units, np.int64),
        np.zeros(units, np.uint8),
        np.empty(units * sc.TILE * RAY),
    )
