"""Leaves: slab and tight box of each voxel, from a conservative test of where the surface can be (paper, part IV).

Let m be a unit vector, S and c the largest sine and the least cosine between m and the normals of a voxel's splats,
c > 0. At a point x let P and N be the weighted means, d^2 and v^2 the weighted variances of the positions and normals,
e = |x - P|, and C = E[(n_i - N).(p_i - P)], so that |C| <= v d. Then

    paper   f = N.(x - P)
    imls    f = N.(x - P) - C = E[n_i.(x - p_i)]
    apss    f = N.(x - P) - K,   K = C / 2 (d^2 - e^2) / max(d^2, (d^2 + e^2) / 4)

Where f = 0, x - P has a component along N, of length |K| / |N|, and one perpendicular to it, of length at most e. So
with b the angle between N and m, |m.(x - P)| is at most e sin b + |K| / |N|. As N is in the unit ball, N.m >= c, and
v^2 = 1 - |N|^2, this is at most S (e^2 + k^2 / c^2)^(1/2), k = |K| / v. Now r^2 = E[r_i^2] is at least d^2 + e^2 and,
for hits, (e / trim)^2. So the bound, divided by S r and squared, is at most that of `limits_of`: for apss with e <= d a
quarter of 1 + 1 / c^2, else trim^2 (1 + BEND / c^2). For imls one splat has n_i.(x - p_i) >= 0 and one has <= 0: m.x is
at least m.p_i - S r_i for the first and at most m.p_i + S r_i for the second. Let t be S times the square root of that
limit, times q >= E[r_i^2]^(1/2) / E[r_i]. Then all surface in the voxel is in the slab

    min_j (m.p_j - t r_j)  <=  m.x  <=  max_j (m.p_j + t r_j).

A slab that misses the voxel proves it empty. The tight box encloses the balls of all splats, clipped to slab and voxel.
`surface/tree/columns.py` bounds the surface in a leaf more closely, column by column.
"""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np

from ...engine.jit import Array, f32, f64, i64, inline, kernel, next_tile
from ...engine.kernels import tree as tr
from ...engine.simd import (
    F16,
    INF,
    ONE,
    ZERO,
    bits,
    broadcast16,
    count_bits,
    join4,
    load16,
    mask16,
    reduce_max,
    reduce_min,
    select,
    store_packed,
    vmax,
    vmin,
    vsqrt,
)
from .blocks import PER_BLOCK
from .cells import Cells
from .columns import LANES, PARTS, Limits, Members, N, R, along, fill_patches, live, slab_along, sum_of_row
from .near import distances, four_from

BEND = 0.361  # maximum of k^2 / e^2 for e > d
LEEWAY = 0.1  # a step may be 2**0.1 times the requested length, so that nearly equal radii share one lattice
SLIGHT = 1e-5  # mean radii by which the slab is extended for the tight box: a ball may just touch it
PAD = 1e-3  # mean radii by which slabs and boxes are padded, against rounding

Slab: TypeAlias = tuple[float, float, float, float, float]  # unit normal m, least and greatest m.x


def limits_of(surface: str, trim: float) -> Limits:
    """Return four numbers a, b, d, e that bound how far surface can be from its splats, from which slabs are computed.

    The distance is along a direction m. Divided by the radius and by the largest sine between m and the normals, and
    squared, it is at most max(a + b / c^2, d + e / c^2), where c is the least cosine between m and the normals.

    surface : kind of surface
    trim : largest distance of a hit from the mean centre of its splats, in their mean radii

    With a looser bound for `apss`, rays at 1 million points took 1.08 (far view), 1.10 (near), 1.21 (shadows), 1.15
    (bounces) times as long, and equally long at 32,000 points.
    """
    far = min(1.0, trim) ** 2
    if surface == "apss":
        return 0.25, 0.25, far, BEND * far
    return 0.0, 0.0, far if surface == "paper" else 1.0, 0.0


def longest_step(samples: int) -> float:
    """Return the maximum distance of samples along a ray in a leaf, divided by the least support radius there.

    samples : samples per support diameter
    """
    return float(2.0**LEEWAY * 2.0 / samples)


@inline
def _members(blocks: Array, refs: Array, span: Array, cell: Array, rows: Array) -> Members:
    """Gather the splats whose support overlaps a voxel, with positions relative to the voxel's least corner.

    blocks : (blocks * 28,), the splats; refs : numbers of the blocks that voxels list
    span : the voxel's range in refs; cell : the voxel's box
    rows : memory for `Members.rows`
    """
    room, count = len(rows) // PARTS, 0
    box = (cell[0], cell[1], cell[2], cell[3], cell[4], cell[5])
    for s in range(span[0], span[1], 4):
        (i, j, k, m), valid = four_from(refs, s, span[1])
        i, j, k, m = tr.BLOCK * i, tr.BLOCK * j, tr.BLOCK * k, tr.BLOCK * m
        x, y = join4(blocks, i, j, k, m), join4(blocks, i + tr.PY, j + tr.PY, k + tr.PY, m + tr.PY)
        z = join4(blocks, i + tr.PZ, j + tr.PZ, k + tr.PZ, m + tr.PZ)
        r2 = ONE / join4(blocks, i + tr.INV_R2, j + tr.INV_R2, k + tr.INV_R2, m + tr.INV_R2)
        there = (distances(box, x, y, z) <= r2) & (x < tr.FAR) & mask16(valid)
        if bits(there) == 0:
            continue
        store_packed(rows, count, there, x - cell[0])
        store_packed(rows, room + count, there, y - cell[1])
        store_packed(rows, 2 * room + count, there, z - cell[2])
        for row in range(3):
            n = tr.NX + PER_BLOCK * row
            store_packed(rows, (N + row) * room + count, there, join4(blocks, i + n, j + n, k + n, m + n))
        store_packed(rows, R * room + count, there, vsqrt(r2))
        count += count_bits(bits(there))
    return Members(rows, room, count)


@inline
def _slab(members: Members, limits: Limits) -> Slab:
    """Return the slab of a voxel: the mean normal m of its splats, and the least and largest m.x of any surface in it.

    members : splats over the voxel; positions x are relative to the voxel's least corner
    limits : the numbers of `limits_of`, which bound how far surface can be from its splats
    """
    mx, my, mz = sum_of_row(members, N), sum_of_row(members, N + 1), sum_of_row(members, N + 2)
    length = math.sqrt(mx * mx + my * my + mz * mz)
    if length < 1e-6:
        mx, my, mz, length = 0.0, 0.0, 1.0, 1.0
    m = f32(mx / length), f32(my / length), f32(mz / length)  # rounded like the record that rays read
    low, high = slab_along(members, m, limits)
    return m[0], m[1], m[2], low, high


@inline
def _farthest(m: float, r: F16, low: F16, high: F16) -> F16:
    """Return how far 16 balls, each clipped to a slab, extend in the direction of an axis from their centres.

    m : cosine of the angle between the axis and the slab's normal; r : radii
    low, high : the slab's two planes along its normal, relative to each ball's centre
    """
    height = vmin(vmax(r * m, low), high)
    across = f32(math.sqrt(max(0.0, 1.0 - m * m)))
    return height * m + vsqrt(vmax((r - height) * (r + height), broadcast16(ZERO))) * across


@inline
def _tight_box(members: Members, slab: Slab, mean: float, cell: Array, box: Array) -> None:
    """Shrink `box`, in place, to a box around the supports of a voxel's splats, each clipped to the voxel's slab.

    members : splats over the voxel; mean : their mean radius; cell : the voxel's box
    """
    m, slight = (slab[0], slab[1], slab[2]), f32(SLIGHT * mean)
    rows, room, inf = members.rows, members.room, broadcast16(INF)
    for c in range(3):
        least, greatest = inf, ZERO - inf
        for first in range(0, members.number, LANES):
            x, r, height = load16(rows, c * room + first), load16(rows, R * room + first), along(members, 0, first, m)
            low, high = slab[3] - slight - height, slab[4] + slight - height
            there = live(members, first) & (low <= r) & (high >= ZERO - r)
            greatest = select(there, vmax(x + _farthest(m[c], r, low, high), greatest), greatest)
            least = select(there, vmin(x - _farthest(-m[c], r, low, high), least), least)
        box[c] = max(box[c], f64(cell[c]) + f64(reduce_min(least)))
        box[3 + c] = min(box[3 + c], f64(cell[c]) + f64(reduce_max(greatest)))


@inline
def _cut_by_slab(slab: Slab, box: Array) -> None:
    """Shrink a box to its part inside of a slab, axis by axis, in place; it becomes empty if the slab misses it."""
    mx, my, mz, low, high = slab
    m = (mx, my, mz)
    least = greatest = 0.0
    for c in range(3):
        least += min(m[c] * box[c], m[c] * box[3 + c])
        greatest += max(m[c] * box[c], m[c] * box[3 + c])
    if least > high or greatest < low:
        box[0], box[3] = np.inf, -np.inf
        return
    for c in range(3):
        if abs(m[c]) < 1e-3:
            continue
        # The other two axes contribute at least rest_least and at most rest_greatest to m.x.
        rest_least = least - min(m[c] * box[c], m[c] * box[3 + c])
        rest_greatest = greatest - max(m[c] * box[c], m[c] * box[3 + c])
        a, b = (low - rest_greatest) / m[c], (high - rest_least) / m[c]
        box[c] = max(box[c], min(a, b))
        box[3 + c] = min(box[3 + c], max(a, b))


@inline
def _is_marked(marks: Array, refs: Array, span: Array) -> bool:
    """Return whether a voxel lists a block with a marked splat: one on an open border, or on one of two close sheets.

    marks : (blocks * 4 * 3,), for each splat a direction if it is marked, else zero; or of length 0 if none is
    refs : numbers of the blocks that voxels list; span : the voxel's range in refs
    """
    if marks.size == 0:
        return False
    for s in range(span[0], span[1]):
        at = i64(refs[s]) * 3 * PER_BLOCK
        for c in range(3 * PER_BLOCK):
            if marks[at + c] != 0:
                return True
    return False


@kernel
def fill_leaves(
    work: Array,
    cells: Cells,
    blocks: Array,
    marks: tuple[Array, Array],
    settings: tuple[Limits, int, float, int],
    out: tuple[Array, Array, Array, Array],
) -> None:
    """Compute slab, slabs of columns and tight box of each voxel, and write them to `out` as records of leaves.

    A voxel without surface gets an inverted box (lo = inf, hi = -inf).

    cells : kd-tree whose leaves are the voxels
    blocks : (blocks * 28,), the splats
    marks : (borders, facing), int8, each (blocks * 4 * 3,), or of length 0 if no splat has one, where
        `borders` is the outward direction of each splat on an open border, else zero
        `facing` is the normal of each splat with another sheet close by, else zero
    settings : (limits, samples, reference, cut), where
        `limits` are the numbers of `limits_of`, which bound how far surface can be from its splats
        `samples` is the number of samples per support diameter
        `reference` is the 2% quantile of the model's support radii; the sample distance of each leaf is that for this
            radius times a power of two
        `cut` is 1; 0, for tests, leaves slabs infinite and boxes as large as their voxels
    out : (nodes, records, patches, tight), where
        `nodes`, (leaves,), is given and holds the numbers of the leaf nodes in `cells`
        `records`, (leaves * 16,), receives voxel, slab and sample distance of each leaf
        `patches`, (leaves * 64,), receives the slabs of its columns
        `tight`, (leaves, 6), receives its tight box
    """
    boxes, spans, refs = cells.boxes, cells.spans, cells.refs
    limits, samples, reference, cut = settings
    nodes, records, patches, tight = out
    borders, facing = marks
    longest = 0
    for node in nodes:
        longest = max(longest, spans[node, 1] - spans[node, 0])
    rows = np.empty((longest * PER_BLOCK + LANES) * PARTS, np.float32)
    words = np.empty(longest * PER_BLOCK, np.int64)
    tile = next_tile(work)
    while tile >= 0:
        for leaf in range(tile * 64, min((tile + 1) * 64, nodes.size)):
            cell = boxes[nodes[leaf]]
            members = _members(blocks, refs, spans[nodes[leaf]], cell, rows)
            record = records[leaf * tr.LEAF : (leaf + 1) * tr.LEAF]
            box = tight[leaf]
            box[:] = cell
            record[:] = 0.0
            patch = patches[leaf * tr.PATCH : (leaf + 1) * tr.PATCH]
            patch[:] = 0.0
            patch[tr.PATCH_LOW : tr.PATCH_HIGH], patch[tr.PATCH_HIGH :] = -np.inf, np.inf
            record[tr.CELL : tr.CELL + 6] = cell
            record[tr.SLAB + 2], record[tr.SLAB_LO], record[tr.SLAB_HI] = 1.0, -np.inf, np.inf
            if members.number == 0:
                box[0], box[3] = np.inf, -np.inf
                continue
            mean, least = sum_of_row(members, R) / members.number, cells.least[nodes[leaf]]
            # Each step is the reference step times a power of two, so that different sample lattices are nested.
            record[tr.STEP] = (
                2.0 * reference / samples * 2.0 ** math.floor(math.log2(max(least, 1e-30) / reference) + LEEWAY)
            )
            record[tr.RADIUS], record[tr.LEAST] = mean, least
            record[tr.BORDERED] = 1.0 if _is_marked(borders, refs, spans[nodes[leaf]]) else 0.0
            record[tr.SHEETED] = 1.0 if _is_marked(facing, refs, spans[nodes[leaf]]) else 0.0
            if cut == 0:
                continue
            near = _slab(members, limits)
            _tight_box(members, near, mean, cell, box)
            base = f64(near[0]) * cell[0] + f64(near[1]) * cell[1] + f64(near[2]) * cell[2]
            slab = (near[0], near[1], near[2], base + near[3], base + near[4])
            _cut_by_slab(slab, box)
            pad = PAD * mean
            record[tr.SLAB : tr.SLAB + 3] = near[:3]
            record[tr.SLAB_LO], record[tr.SLAB_HI] = slab[3] - pad, slab[4] + pad
            if not (box[0] <= box[3] and box[1] <= box[4] and box[2] <= box[5]):
                box[0], box[3] = np.inf, -np.inf
                continue
            fill_patches(members, cell, mean, (near[:3], near[4] - near[3], limits), words, patch)
            for c in range(3):
                box[c] -= pad
                box[3 + c] += pad
        tile = next_tile(work)


@kernel
def fill_groups(work: Array, cells: Cells, nodes: Array, bounds: Array, out: tuple[Array, Array, Array]) -> None:
    """Copy each leaf's list of blocks into groups of 16, with the blocks' bounding spheres; write both to `out`.

    cells : kd-tree of the voxels; nodes : numbers of its leaf nodes
    bounds : (blocks * 4,), centre and radius of each block's bounding sphere
    out : (spans, spheres, refs), where
        `spans`, (leaves * 2,), is given and holds first group and number of groups of each leaf
        `spheres`, (groups * 64,), receives 4 rows (centre x y z, radius) of 16 bounding spheres for each group
        `refs`, (groups * 16,), receives the numbers of the blocks
    """
    spans, spheres, refs = out
    tile = next_tile(work)
    while tile >= 0:
        for leaf in range(tile * 64, min((tile + 1) * 64, nodes.size)):
            begin, end = cells.spans[nodes[leaf]]
            for g in range(spans[2 * leaf + 1]):
                group = spans[2 * leaf] + g
                for k in range(16):
                    s = begin + 16 * g + k
                    b = cells.refs[s] if s < end else 0
                    refs[group * 16 + k] = b
                    for c in range(3):
                        spheres[group * tr.GROUP + 16 * c + k] = bounds[b * 4 + c]
                    r = bounds[b * 4 + 3]
                    spheres[group * tr.GROUP + 48 + k] = r if s < end else f32(np.nan)
        tile = next_tile(work)
