"""Top of the kd-tree of a cloud that does not fit into memory: which points belong to which part.

A part is an aligned range of the order of `order.kd_order` with a power of two of points (the last part may have
fewer). It is a subtree of the kd-tree and can be sorted alone. The points are read level by level: the cut
coordinate of a span is found by radix selection, 16 bits at a time, which takes two passes for any number of spans.
If several points of a span lie exactly on its cut, a third pass finds which of them belong to the first half: those
with the lowest rows.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.arrays import Floats, Rows
from ...base.progress import Progress, part_of, report_progress
from ...engine.jit import Array, i64, inline, kernel, next_tile, run, thread_count, uncompiled
from .order import first_part

HALF = 16  # bits of a digit
DIGITS = 1 << HALF
ZERO = 1 << 31  # the key of 0
ROOM = 1 << 28  # bytes of the counts: limits the number of threads that count separately
LOOKS = 0.4, 0.8  # progress of a level after its upper digits, and after its lower digits

Chunks = Callable[[], Iterable[Floats]]


class Cuts(NamedTuple):
    """Top levels of a kd-tree over a cloud too large for memory; its leaves are the parts of the cloud.

    axes : (m,) int64, split axis of each node
    keys : (m,) int64, split coordinate, encoded as an integer that sorts like the float32, see `_key`
    ties : (m,) int64, points exactly at that coordinate belong to the first child if their row is below this
    children : (m, 2) int64, another node, or ~part for a leaf
    """

    axes: Rows
    keys: Rows
    ties: Rows
    children: Rows

    def parts_of(self, positions: Floats, row: int) -> Rows:
        """Return the number of the part that each position belongs to, (m,).

        positions : (m, 3) float32, the rows of the cloud from `row` on
        """
        parts = np.empty(len(positions), np.int64)
        run(_find_parts, -(-len(parts) // DIGITS), _bits_of(positions), row, self, parts)
        return parts


class _Span(NamedTuple):
    """Range of the kd order that is to be split.

    place, points : its first place and its length
    node, side : parent node, -1 for the root, and which of its two children this is
    """

    place: int
    points: int
    node: int
    side: int


@inline
def _key(bits: int) -> int:
    """Return an integer, 0 to 2^32, that sorts like the float32 with these bits, for radix selection; -0 equals 0."""
    return i64(bits) + ZERO if bits >= 0 else -i64(bits)


@inline
def _part_of(bits: Array, i: int, row: int, cuts: Cuts) -> int:
    """Return the part that a point belongs to: traverse the kd-tree `cuts` from its root.

    bits : (n, 3) int32, the bits of float32 coordinates
    i, row : the point's index in `bits`, and its row in the cloud
    """
    node = i64(0) if len(cuts.axes) > 0 else i64(-1)
    while node >= 0:
        key = _key(bits[i, cuts.axes[node]])
        is_second = key > cuts.keys[node] or (key == cuts.keys[node] and row >= cuts.ties[node])
        node = cuts.children[node, 1 if is_second else 0]
    return ~node


@kernel
def _find_parts(work: Array, bits: Array, row: int, cuts: Cuts, parts: Array) -> None:
    tile = next_tile(work)
    while tile >= 0:
        for i in range(tile * DIGITS, min((tile + 1) * DIGITS, len(bits))):
            parts[i] = _part_of(bits, i, row + i, cuts)
        tile = next_tile(work)


@kernel
def _count_upper(work: Array, bits: Array, row: int, cuts: Cuts, slots: Array, bounds: Array, counts: Array) -> None:
    """Find the extent of each range of points that is to be split, and count coordinates by their upper 16 bits.

    The first pass of a radix selection of split coordinates. Coordinates are compared as keys: integers that sort like
    them. Each tile (work unit of a thread) has arrays of its own.

    bits : (n, 3) int32, bits of the coordinates of a chunk, which begins at `row` of the cloud
    cuts : upper levels of the kd-tree, which assign points to parts
    slots : (parts,) the span (range to be split) that begins with this part, or -1
    bounds : (tiles, spans, 6) updated with the least keys along x, y, z, then the greatest ones
    counts : (tiles, spans, 3, 2^16) int32, increased: how many keys along each axis have these upper 16 bits
    """
    tile = next_tile(work)
    while tile >= 0:
        for i in range(tile * len(bits) // len(bounds), (tile + 1) * len(bits) // len(bounds)):
            span = slots[_part_of(bits, i, row + i, cuts)]
            if span >= 0:
                for c in range(3):
                    key = _key(bits[i, c])
                    bounds[tile, span, c] = min(bounds[tile, span, c], key)
                    bounds[tile, span, 3 + c] = max(bounds[tile, span, 3 + c], key)
                    counts[tile, span, c, key >> HALF] += 1
        tile = next_tile(work)


@kernel
def _count_lower(work: Array, bits: Array, row: int, cuts: Cuts, slots: Array, chosen: Array, counts: Array) -> None:
    """Count the points of each range that is to be split by the lower 16 bits of their coordinate.

    The second pass of a radix selection: only points count whose upper 16 bits are those of the split coordinate.

    bits : (n, 3) int32, bits of the coordinates of a chunk, which begins at `row` of the cloud
    cuts : upper levels of the kd-tree, which assign points to parts
    slots : (parts,) the span (range to be split) that begins with this part, or -1
    chosen : (spans, 2) split axis, and upper bits of the split coordinate's key, an integer that sorts like it
    counts : (tiles, spans, 2^16) int32, increased: how many keys along the split axis have these lower 16 bits
    """
    tile = next_tile(work)
    while tile >= 0:
        for i in range(tile * len(bits) // len(counts), (tile + 1) * len(bits) // len(counts)):
            span = slots[_part_of(bits, i, row + i, cuts)]
            if span >= 0:
                key = _key(bits[i, chosen[span, 0]])
                if key >> HALF == chosen[span, 1]:
                    counts[tile, span, key & (DIGITS - 1)] += 1
        tile = next_tile(work)


@kernel
def _find_ties(bits: Array, row: int, cuts: Cuts, slots: Array, chosen: Array, left: Array, ties: Array) -> None:
    """Find which points exactly at a split coordinate belong to the first half: those with the lowest rows.

    bits : (n, 3) int32, bits of the coordinates of a chunk, which begins at `row` of the cloud
    cuts : upper levels of the kd-tree, which assign points to parts
    slots : (parts,) the span (range to be split) that begins with this part, or -1
    chosen : (spans, 2) split axis, and key of the split coordinate (an integer that sorts like it)
    left : (spans,) number of such points that the first half still lacks; reduced by those found
    ties : (spans,) receives the row after the last one that belongs to the first half
    """
    for i in range(len(bits)):
        span = slots[_part_of(bits, i, row + i, cuts)]
        if span >= 0 and left[span] > 0 and _key(bits[i, chosen[span, 0]]) == chosen[span, 1]:
            left[span] -= 1
            if left[span] == 0:
                ties[span] = row + i + 1


def find_cuts(chunks: Chunks, count: int, size: int, progress: Progress | None = None) -> Cuts:
    """Split a cloud too large for memory into parts along the kd order: build the top of the kd-tree.

    Parameters
    ----------
    chunks : callable
        Called for each pass; yields all points as (m, 3) float32 chunks, finite, always in the same order.
    count : int
        Number of points.
    size : int
        Points of a part, a power of two.
    progress : callable, optional
        Called with the fraction done.

    Raises
    ------
    ValueError
        If the chunks hold a different number of points.
    """
    none = np.zeros(0, np.int64)
    cuts = Cuts(none, none, none, np.zeros((0, 2), np.int64))
    spans = [_Span(0, count, -1, 0)] if count > size else []
    levels, level = max(-(-count // size) - 1, 1).bit_length(), 0
    while spans:
        cloud = _Cloud(chunks, count, cuts, np.full(-(-count // size), -1))
        cloud.slots[[span.place // size for span in spans]] = np.arange(len(spans))
        sizes = np.array([uncompiled(first_part)(span.points) for span in spans])
        found = _cut(cloud, sizes, part_of(progress, level / levels, (level + 1) / levels))
        children, halves = cuts.children.tolist(), []
        for node, (span, first) in enumerate(zip(spans, sizes.tolist(), strict=True), len(cuts.axes)):
            if span.node >= 0:
                children[span.node][span.side] = node
            children.append([~(span.place // size), ~((span.place + first) // size)])
            halves += [_Span(span.place, first, node, 0), _Span(span.place + first, span.points - first, node, 1)]
        axes, keys, ties = (np.concatenate(pair) for pair in zip(cuts[:3], found, strict=True))
        cuts = Cuts(axes, keys, ties, np.array(children))
        spans, level = [half for half in halves if half.points > size], level + 1
    report_progress(progress, 1.0)
    return cuts


class _Cloud(NamedTuple):
    """Points of a cloud that is read in chunks, and its ranges that are to be split.

    chunks : called for each pass over the points; yields (m, 3) float32 arrays
    points : number of points
    cuts : upper levels of the kd-tree, found so far
    slots : (parts,) index of the range that begins with this part, or -1
    """

    chunks: Chunks
    points: int
    cuts: Cuts
    slots: Rows

    def read(self, look: Callable[[NDArray[np.int32], int], Any], progress: Progress | None) -> None:
        """Read all points once: call `look` with the coordinates' bits (int32) and the first row of each chunk."""
        row = 0
        for chunk in self.chunks():
            look(_bits_of(chunk), row)
            row += len(chunk)
            report_progress(progress, min(row / self.points, 1.0))
        if row != self.points:
            raise ValueError(f"{row:,} points were read where {self.points:,} were expected")


def _cut(cloud: _Cloud, sizes: Rows, progress: Progress | None) -> tuple[Rows, Rows, Rows]:
    """Find where to split each range of points: return (spans,) split axes, keys of the split coordinates, and rows.

    Keys are integers that sort like coordinates. A point exactly at the split coordinate belongs to the first half if
    its row is below the returned one.

    sizes : (spans,) number of points of the first half
    """
    spans, rest = len(sizes), (cloud.cuts, cloud.slots)
    tiles = min(max(ROOM // (spans * 3 * DIGITS * 4), 1), thread_count())
    bounds = np.tile([2 * ZERO + 1] * 3 + [-1] * 3, (tiles, spans, 1))
    upper = np.zeros((tiles, spans, 3, DIGITS), np.int32)
    cloud.read(
        lambda bits, row: run(_count_upper, tiles, bits, row, *rest, bounds, upper), part_of(progress, 0.0, LOOKS[0])
    )
    low, high = _values_of(bounds[..., :3].min(axis=0)), _values_of(bounds[..., 3:].max(axis=0))
    axes = np.argmax(high - low, axis=1)  # the first of equal extents, as in `order`
    digits, before = _digits_at(upper[:, np.arange(spans), axes], sizes)
    lower, chosen = np.zeros((tiles, spans, DIGITS), np.int32), np.column_stack([axes, digits])
    cloud.read(lambda bits, row: run(_count_lower, tiles, bits, row, *rest, chosen, lower), part_of(progress, *LOOKS))
    last, below = _digits_at(lower, sizes - before)
    keys, left, ties = digits * DIGITS + last, sizes - before - below, np.zeros(spans, np.int64)
    if left.any():
        chosen = np.column_stack([axes, keys])
        cloud.read(lambda bits, row: _find_ties(bits, row, *rest, chosen, left, ties), part_of(progress, LOOKS[1], 1.0))
    return axes, keys, ties


def _digits_at(counts: NDArray[np.int32], ranks: Rows) -> tuple[Rows, Rows]:
    """Return which 16-bit digit the point of a given rank has in each range, and how many points have lower digits.

    counts : (tiles, spans, 2^16) how often each digit occurs
    ranks : (spans,) number of points of the range that sort before it
    """
    ends = counts.sum(axis=0, dtype=np.int64).cumsum(axis=1)
    digits = np.array([np.searchsorted(row, rank, side="right") for row, rank in zip(ends, ranks, strict=True)])
    before = np.where(digits > 0, ends[np.arange(len(ends)), digits - 1], 0)
    return digits, before


def _values_of(keys: Rows) -> Floats:
    """Decode keys, integers that sort like float32 coordinates, to these coordinates."""
    return np.where(keys >= ZERO, keys - ZERO, -keys).astype(np.int32).view(np.float32)


def _bits_of(positions: Floats) -> NDArray[np.int32]:
    return np.ascontiguousarray(positions, np.float32).view(np.int32)
