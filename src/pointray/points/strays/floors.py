"""The floor of each point: the surface near it, whether or not the point lies on it.

A point is off its floor if it lies farther from it than the floor's own noise explains, while the floor goes on beneath
the point, about as dense there as around it and on all sides, and little else is on the point's side. A bump of the
surface has no floor beneath it, an edge has one on one side only, and two sheets are about as dense as each other.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...jit import Array, borrow, kernel, next_tile, run
from ...kernels.vec import tangents
from ...neighbors import NeighborTree
from ...progress import Progress, part_of, tell
from .fits import fit, new_memory

Floats = NDArray[np.float32]
Rows = NDArray[np.int64]

AROUND = 48  # neighbours, the point itself included: a layer with a tenth of the points is seen up to 5 spacings away
LEAST = 20  # fewer points tell nothing
KEPT = 16  # neighbours that are kept: they share their noise
CORE = 8  # the neighbour whose distance says how dense it is

SUSPECT = 2.2  # noises off the fit, from which a point is examined
FAR, CLEAR, NEAR = 5.0, 3.2, 2.6  # noises off: surely; where its side holds more than the other; beside such points
BEYOND = 3  # so many more points lie on its side, beyond the noise, than twice those on the other side
SHOULDER = 0.8  # as a share of them: points at 2 to 3 noises. Rough ground has more, a layer fewer
BETWEEN = 0.6  # as a share of them: points nearer to the floor, beyond its noise. A slope has more
SPACINGS = 0.3  # and so many spacings off: what a quadric does not follow
ROUGH, ROUGHLY = 1.6, 0.1  # the fit's own noise, in the noise around and in spacings: one across two sheets has more
LEVEL = 3.0  # noises within which points belong to the floor

# How a floor is beneath a point, in the cylinder about the point that the neighbourhood fills: at least so many points;
# its middle off the axis, as a share of the radius (0.42 at a straight edge); the share of its points in the inner half
# (usually 0.25); points on the other point's side, as a share of the floor's.
ENOUGH, ASIDE, INNER, SPARSE = 12, 0.3, 0.1, 0.34
ENOUGH_BESIDE, ASIDE_BESIDE, SPARSE_BESIDE = 5, 0.55, 0.34  # for a point beside others that are off the floor
BESIDE, MOSTLY = 2, 0.5  # so many of them, among the neighbours, and this share of its company
OFF, MAYBE = 2.0, 1.0  # what the examination says

CHUNK = 1024  # points of a tile
ROWS = 1 << 17  # rows of a table at a time


class Floors(NamedTuple):
    """What is known of each position's floor.

    off : (n,) bool, whether it lies off its floor
    is_on : (n,) bool, whether it lies on a smooth one
    offset : (n, 3) float32, from where it is off, to the floor
    spacing : (n,) float32, of the floor's points, where it is off
    company : (n,) float32, points on its side of the floor, itself included, where it is off
    core : (n,) float32, distance to its `CORE`-th neighbour
    near : (n, k) int32, its nearest neighbours, itself first
    """

    off: NDArray[np.bool_]
    is_on: NDArray[np.bool_]
    offset: Floats
    spacing: Floats
    company: Floats
    core: Floats
    near: NDArray[np.int32]


@kernel
def _survey(work: Array, positions: Array, near: Array, first: int, out: Array) -> int:
    """Write to out[i] how far the row first + i is off the quadric, its noise, and a spacing."""
    positions, near, out, k = borrow(positions), borrow(near), borrow(out), near.shape[1]
    memory = new_memory(k)
    tile = next_tile(work)
    while tile >= 0:
        for i in range(tile * CHUNK, min((tile + 1) * CHUNK, len(out))):
            _, noise, far = fit(positions, first + i, near, i, False, memory)
            height = abs(memory[6][0])
            out[i, 0], out[i, 1] = height * far, noise * far
            out[i, 2] = far * math.sqrt(math.pi / k * max(1.0 - height * height, 0.01))
        tile = next_tile(work)
    return 0


@kernel
def _examine(work: Array, positions: Array, rows: Array, near: Array, noises: Array, out: Array) -> int:
    """Write to out[i] whether the row is off its floor, the offset to it, the floor's spacing, and the company."""
    positions, near, out, k = borrow(positions), borrow(near), borrow(out), near.shape[1]
    memory = new_memory(k)
    r, terms, x = memory[2], memory[5], memory[6]
    tile = next_tile(work)
    while tile >= 0:
        for i in range(tile * CHUNK, min((tile + 1) * CHUNK, len(out))):
            n, second, far = fit(positions, rows[i], near, i, True, memory)
            n, own, far = fit(positions, rows[i], near, i, False, memory)
            if second < own:
                n, own, far = fit(positions, rows[i], near, i, True, memory)
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
            sure = abs(height) > (CLEAR if one_sided else FAR) * noise and inner >= INNER * floor
            sure = sure and floor >= ENOUGH and aside <= ASIDE * wide and front <= SPARSE * floor
            maybe = floor >= ENOUGH_BESIDE and aside <= ASIDE_BESIDE * wide and front <= SPARSE_BESIDE * floor
            out[i, 0] = OFF if sure else (MAYBE if maybe else 0.0)
            if abs(height) <= max(NEAR * noise, SPACINGS * spacing) or between > BETWEEN * front:
                out[i, 0] = 0.0
            if own > ROUGH * noise + ROUGHLY * spacing:
                out[i, 0] = 0.0
            share = -height * far / (1.0 + x[1] ** 2 + x[2] ** 2)
            one, two = tangents(n)
            for c in range(3):
                out[i, 1 + c] = share * (n[c] - x[1] * one[c] - x[2] * two[c])
            out[i, 4], out[i, 5] = spacing * far, front
        tile = next_tile(work)
    return 0


def find_floors(positions: Floats, progress: Progress | None = None) -> Floors:
    """The floors of positions, which are all different and along a Morton curve; at least `LEAST` of them."""
    n, tree = len(positions), NeighborTree(positions)
    k = min(AROUND, n)
    core, near, fits = np.empty(n, np.float32), np.empty((n, min(KEPT, n)), np.int32), np.empty((n, 3), np.float32)
    for start in range(0, n, ROWS):
        part = slice(start, min(start + ROWS, n))
        distances, found = tree.query(k, positions[part])
        core[part], near[part] = distances[:, CORE], found[:, :KEPT]
        run(_survey, -(-len(found) // CHUNK), positions, found, start, fits[part])
        tell(progress, 0.8 * part.stop / n)
    height, noise, spacing = fits.T
    shared = _shared(noise / spacing, near) * spacing
    suspects = np.flatnonzero((height > SUSPECT * shared) & (height > 0.5 * SPACINGS * spacing))
    said, about = np.zeros(n, np.float32), np.zeros((n, 5), np.float32)
    examined = _examined(tree, positions, suspects, shared, part_of(progress, 0.8, 1.0))
    said[suspects], about[suspects] = examined[:, 0], examined[:, 1:]
    off = _with_those_beside(tree, positions, said, about[:, 4])
    is_on = (height <= np.maximum(FAR * shared, SPACINGS * spacing)) & (shared <= SPACINGS * spacing)
    return Floors(off, is_on & ~off, about[:, :3], about[:, 3], about[:, 4], core, near)


def _shared(noise: Floats, near: NDArray[np.int32]) -> Floats:
    """The median noise of each point's neighbours: that of one neighbourhood varies by a tenth."""
    shared = np.empty_like(noise)
    for start in range(0, len(noise), ROWS):
        shared[start : start + ROWS] = np.median(noise[near[start : start + ROWS]], axis=1)
    return shared


def _examined(tree: NeighborTree, positions: Floats, rows: Rows, noise: Floats, progress: Progress | None) -> Floats:
    """What `_examine` says of some rows."""
    out = np.zeros((len(rows), 6), np.float32)
    for start in range(0, len(rows), ROWS):
        some = rows[start : start + ROWS]
        found = tree.query(min(AROUND, len(positions)), positions[some])[1]
        run(_examine, -(-len(some) // CHUNK), positions, some, found, noise[some], out[start : start + ROWS])
        tell(progress, (start + len(some)) / len(rows))
    return out


def _with_those_beside(tree: NeighborTree, positions: Floats, said: Floats, company: Floats) -> NDArray[np.bool_]:
    """Those that are surely off, and those beside them that may be."""
    off, maybe = said == OFF, np.flatnonzero(said == MAYBE)
    if len(maybe):
        found = tree.query(min(AROUND, len(positions)), positions[maybe])[1]
        off[maybe] = (said[found] == OFF).sum(axis=1) >= np.maximum(BESIDE, MOSTLY * company[maybe])
    return off
