"""Examination of points that may lie off their floor (see `floors`), with a fit to each one's neighbours.

A point is off its floor if its distance exceeds the floor's noise, and the floor continues beneath the point, on all
sides and about as dense there as around it, and few other points are on the point's side. A bump of the surface has no
floor beneath it, an edge has one on one side only, and two sheets are equally dense.
"""

from __future__ import annotations

import math

import numpy as np

from ...base.arrays import Flags, Floats, Rows
from ...base.progress import Progress, report_progress
from ...engine.jit import Array, borrow, kernel, next_tile, run
from ...engine.kernels.vec import tangents
from ..neighbors import NeighborTree
from .fits import fit, new_memory
from .local_fits import AROUND

FAR, CLEAR, NEAR = 5.0, 3.2, 2.6  # distance in noises: certain; with most points on its side; beside such points
# Less is enough by this factor of the noise, for noise of up to LITTLE spacings: of a layer 0.5 spacings off 93% are
# found, not 87%. Of a torus with noise of 0.3 spacings 0.16% are lost; 0.24% if this applied to all noise.
LITTLE, FAR_LESS, CLEAR_LESS = 0.1, 0.8, 0.3
BEYOND = 3  # its side must hold this many points more, beyond the noise, than twice those on the other side
SHOULDER = 0.8  # largest share of points at 2 to 3 noises. Rough ground has more, a layer fewer
BETWEEN = 0.6  # largest share of points nearer to the floor, beyond its noise. A slope has more
SPACINGS = 0.3  # least distance in spacings: what a quadric does not follow
ROUGH, ROUGHLY = 1.6, 0.1  # greatest noise of the fit, in local noises and in spacings: across two sheets it is larger
LEVEL = 3.0  # noises within which points belong to the floor

# Requirements on the floor beneath a point, in the cylinder that the neighbourhood fills: number of points; offset of
# their mean from the axis, relative to the radius (0.42 at a straight edge); share of them in the inner half (usually
# 0.25); points on the point's own side, relative to the floor's.
ENOUGH, ASIDE, INNER, SPARSE = 12, 0.3, 0.1, 0.34
ENOUGH_BESIDE, ASIDE_BESIDE, SPARSE_BESIDE = 5, 0.55, 0.34  # for a point next to others that are off
OFF, MAYBE, DOUBT = 3.0, 2.0, 1.0  # verdicts

# A point joins others that are off: number of these in its neighbourhood, unless it may be off by itself; their share
# of the points at their height, and these relative to the floor's. Heights are equal within a share of the height and
# within spacings, or half as much again for MAYBE. Of a layer 4 spacings off 92% are found without this rule.
BESIDE, MOSTLY, SPARSE_THERE = 2, 0.5, 0.6
SAME, SAME_SPACINGS, MAYBE_SAME = 0.4, 1.0, 1.5

CHUNK = 1024  # points of a tile
ROWS = 1 << 17  # rows of a table at a time


@kernel
def _examine(work: Array, positions: Array, rows: Array, near: Array, noises: Array, out: Array) -> None:
    """Fit a surface to the neighbours of each row and decide whether the row is a stray off it.

    work : gives each thread its next tile, 1024 rows
    positions, rows : (n, 3) points, and (m,) the rows
    near : (m, k) nearest neighbours of these rows
    noises : (m,) standard deviation of the points around from their surface
    out : (m, 6) receives the verdict; the offset to the surface, x y z; the surface's point spacing; the number of
        neighbours on the row's side of the surface

    Verdicts are `OFF` (certainly off the surface), `MAYBE` (off only if at least one point next to the row is `OFF`)
    and `DOUBT` (off only if at least two are).
    """
    positions, near, out, k = borrow(positions), borrow(near), borrow(out), near.shape[1]
    first, other = new_memory(k), new_memory(k)
    tile = next_tile(work)
    while tile >= 0:
        for i in range(tile * CHUNK, min((tile + 1) * CHUNK, len(out))):
            n, own, far = fit(positions, rows[i], near, i, k, False, first)
            m, second, far = fit(positions, rows[i], near, i, k, True, other)
            if second < own:
                n, own = m, second
                r, terms, x = other[2], other[5], other[6]
            else:
                r, terms, x = first[2], first[5], first[6]
            noise, height = noises[i] / far, -x[0]
            wide = math.sqrt(max(1.0 - height * height, 0.0))
            level = max(LEVEL * noise, SPACINGS * math.sqrt(math.pi / k) * max(wide, 0.1))
            floor = inner = front = behind = between = shoulder = p_sum = q_sum = 0.0
            for j in range(k):
                p, q = terms[j, 1], terms[j, 2]
                off, lateral = (r[j] if height > 0.0 else -r[j]), p * p + q * q
                if lateral > wide * wide:
                    continue
                if abs(off) <= level:
                    floor += 1.0
                    p_sum, q_sum = p_sum + p, q_sum + q
                    inner += 1.0 if lateral <= 0.25 * wide * wide else 0.0
                    shoulder += 1.0 if off > 2.0 * noise else 0.0
                elif off > 0.0:
                    front += 1.0
                    between += 1.0 if off < 0.7 * abs(height) else 0.0
                else:
                    behind += 1.0
            count = max(floor, 1.0)
            spacing = wide * math.sqrt(math.pi / count)
            aside = math.sqrt(p_sum * p_sum + q_sum * q_sum) / count
            one_sided = front >= 2.0 * behind + BEYOND and shoulder <= SHOULDER * front
            little = min(noise, LITTLE * spacing)
            far_off = CLEAR * noise - CLEAR_LESS * little if one_sided else FAR * noise - FAR_LESS * little
            sure = abs(height) > far_off and inner >= INNER * floor
            sure = sure and floor >= ENOUGH and aside <= ASIDE * wide and front <= SPARSE * floor
            maybe = floor >= ENOUGH_BESIDE and aside <= ASIDE_BESIDE * wide and front <= SPARSE_BESIDE * floor
            out[i, 0] = OFF if sure else (MAYBE if maybe else DOUBT)
            if abs(height) <= max(NEAR * noise, SPACINGS * spacing) or between > BETWEEN * front:
                out[i, 0] = DOUBT
            if own > ROUGH * noise + ROUGHLY * spacing:
                out[i, 0] = DOUBT
            share = -height * far / (1.0 + x[1] ** 2 + x[2] ** 2)
            one, two = tangents(n)
            for c in range(3):
                out[i, 1 + c] = share * (n[c] - x[1] * one[c] - x[2] * two[c])
            out[i, 4], out[i, 5] = spacing * far, front
        tile = next_tile(work)


@kernel
def _join(
    work: Array, positions: Array, rows: Array, near: Array, verdicts: Array, details: Array, joins: Array, out: Array
) -> None:
    """Decide which uncertain rows are off their surface: those beside points certainly off, at the height of these.

    work : gives each thread its next tile, 1024 rows
    positions, rows : (n, 3) points, and (m,) the uncertain rows
    near : (m, k) nearest neighbours of these rows
    verdicts : (n,) `OFF` (certainly off), `MAYBE` (off only beside at least one such point) or `DOUBT` (beside two)
    details : (n, 5) offset to the surface, x y z; its point spacing; number of neighbours on the point's side of it
    joins : (m,) bool, receives whether each row is off
    out : (m, 5) receives the same details of these rows, but the number of neighbours at the height of the points off
    """
    positions, near, details, out = borrow(positions), borrow(near), borrow(details), borrow(out)
    tile = next_tile(work)
    while tile >= 0:
        for i in range(tile * CHUNK, min((tile + 1) * CHUNK, len(rows))):
            count = x = y = z = a = b = c = spacing = 0.0
            for j in near[i]:
                if verdicts[j] == OFF:
                    count += 1.0
                    x, y, z = x + positions[j, 0], y + positions[j, 1], z + positions[j, 2]
                    a, b, c, spacing = a + details[j, 0], b + details[j, 1], c + details[j, 2], spacing + details[j, 3]
            joins[i], is_maybe = False, verdicts[rows[i]] == MAYBE
            height = math.sqrt(a * a + b * b + c * c) / max(count, 1.0)
            if count < (1.0 if is_maybe else BESIDE) or height == 0.0:
                continue
            x, y, z, spacing = x / count, y / count, z / count, spacing / count
            u, v, w = a / (count * height), b / (count * height), c / (count * height)
            limit = min(SAME * height, SAME_SPACINGS * spacing)
            same = floor = own = 0.0
            for j in near[i]:
                down = (positions[j, 0] - x) * u + (positions[j, 1] - y) * v + (positions[j, 2] - z) * w
                same += 1.0 if abs(down) <= limit else 0.0
                floor += 1.0 if abs(down - height) <= limit else 0.0
                own = down if j == rows[i] else own
            is_sparse = count >= MOSTLY * same and floor >= ENOUGH_BESIDE and same <= SPARSE_THERE * floor
            joins[i] = is_sparse and abs(own) <= limit * (MAYBE_SAME if is_maybe else 1.0)
            out[i, 0], out[i, 1], out[i, 2] = (height - own) * u, (height - own) * v, (height - own) * w
            out[i, 3], out[i, 4] = spacing, same
        tile = next_tile(work)


def examine_rows(
    tree: NeighborTree, positions: Floats, rows: Rows, noise: Floats, progress: Progress | None = None
) -> Floats:
    """Fit a surface to the neighbours of each row and decide whether the row is a stray off it.

    tree : of the positions
    positions : (n, 3) in kd order
    rows : (m,)
    noise : (m,) standard deviation of the points around from their surface

    Returns
    -------
    (m, 6) float32
        Verdict; offset to the surface, x y z; the surface's point spacing; number of neighbours on the row's side of
        the surface. Verdicts are `OFF` (certainly off the surface), `MAYBE` (off only if at least one point next to the
        row is `OFF`) and `DOUBT` (all other rows: off only if at least two are).
    """
    out = np.zeros((len(rows), 6), np.float32)
    for start in range(0, len(rows), ROWS):
        part = slice(start, start + ROWS)
        found = tree.query(AROUND, positions[rows[part]])[1]
        run(_examine, -(-len(found) // CHUNK), positions, rows[part], found, noise[part], out[part])
        report_progress(progress, (start + len(found)) / len(rows))
    return out


def join(tree: NeighborTree, positions: Floats, verdicts: Floats, details: Floats) -> Flags:
    """Return which points are off their surface, (n,) bool: certain ones, and others next to these at the same height.

    tree, positions : search tree of the positions, (n, 3)
    verdicts : (n,) `OFF` (certainly off), `MAYBE` or `DOUBT` (off only beside others) for examined points, else 0
    details : (n, 5) offset to the surface, x y z; its point spacing; number of neighbours on the point's side of it;
        updated for points found to be off beside others
    """
    off, rest = verdicts == OFF, np.flatnonzero((verdicts == MAYBE) | (verdicts == DOUBT))
    found_off, details_of_them = [rest[:0]], [details[:0]]
    for start in range(0, len(rest), ROWS):
        rows = rest[start : start + ROWS]
        near = tree.query(AROUND, positions[rows])[1]
        joins, out = np.zeros(len(rows), np.bool_), np.zeros((len(rows), 5), np.float32)
        run(_join, -(-len(rows) // CHUNK), positions, rows, near, verdicts, details, joins, out)
        found_off.append(rows[joins])
        details_of_them.append(out[joins])
    joined = np.concatenate(found_off)
    off[joined], details[joined] = True, np.concatenate(details_of_them)
    return np.asarray(off)
