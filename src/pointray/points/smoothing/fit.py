"""Fits: the surface beside each point, from as many neighbours as the noise requires and the shape allows."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ...jit import Array, borrow, f64, kernel, next_tile, run
from ..normals.jets import LINE, SLIM, SLIM_VARIANCE, height, jet, jet_memory
from ..normals.planes import least_axis

Floats = NDArray[np.float32]

SIZES = 16, 32, 64, 128  # neighbours to choose from, the point itself among them
# The mean square of residuals that noise alone leaves, and the weight of what exceeds it, which is detail. Intervals of
# confidence that must intersect (Goldenshluger and Nemirovski 1997) were no better: at 0.1 spacings the statue's error
# is 0.079 with them and 0.064 so, at 1 spacing the dragon's 0.36 and 0.31.
SEEN, DETAIL = 0.64, 0.15
WIDE = 5.0  # standard deviations of the noise that a neighbourhood must reach: smaller ones know no direction
FEWEST = 6  # neighbours
# A fit to half the neighbours has at least so many times the variance: it is not tried where that alone is too much,
# which saves a tenth of a noisy model's time.
HALVED = 1.8
CHUNK = 512


@kernel
def _fit(
    work: Array, positions: Array, rows: Array, near: Array, normals: Array, sizes: Array, noise: Array, out: Array
) -> int:
    """Write to out[i] what takes positions[rows[i]] to the surface, the normal there, and the plane's.

    normals : (n, 3), or (0, 3); neighbours that look to the opposite side are left out
    noise : (m,) standard deviation of the points' distance from the surface
    """
    positions, near, normals, out = borrow(positions), borrow(near), borrow(normals), borrow(out)
    most = near.shape[1]
    d = np.empty((most, 3))
    memory = jet_memory(most)
    tile = next_tile(work)
    while tile >= 0:
        for i in range(tile * CHUNK, min((tile + 1) * CHUNK, len(out))):
            row, count = rows[i], 0
            for j in range(most):
                other = near[i, j]
                same = 1.0
                if len(normals) > 0:
                    same = 0.0
                    for c in range(3):
                        same += f64(normals[row, c]) * f64(normals[other, c])
                if same >= 0.0:
                    for c in range(3):
                        d[count, c] = f64(positions[other, c]) - f64(positions[row, c])
                    count += 1
            least, square, left = np.inf, f64(noise[i]) * f64(noise[i]), 0.0
            for s in range(len(sizes) - 1, -1, -1):
                k, largest = min(sizes[s], count), s == len(sizes) - 1
                if not largest and k == count:
                    continue
                reach = d[k - 1, 0] ** 2 + d[k - 1, 1] ** 2 + d[k - 1, 2] ** 2 if k > 0 else 0.0
                if k < FEWEST or (reach < WIDE * WIDE * square and not largest):
                    break
                n, residual, variance = jet(d, k, LINE if largest else SLIM, memory)
                if variance < SLIM_VARIANCE:
                    left = residual * residual if largest else left
                    h, spread = height(d, k, memory)
                    error = spread * square + DETAIL * max(residual * residual - SEEN * square, 0.0)
                    if error < least:
                        least = error
                        a = least_axis(memory[5], memory[6])
                        along = h * (n[0] * a[0] + n[1] * a[1] + n[2] * a[2])
                        for c in range(3):
                            out[i, c], out[i, 3 + c], out[i, 6 + c] = along * n[c], n[c], a[c]
                    if least <= HALVED * spread * square:
                        break
            out[i, 9], out[i, 10] = math.sqrt(max(left - SEEN * square, 0.0)), math.sqrt(least)
        tile = next_tile(work)
    return 0


def fit_surface(
    positions: Floats, rows: NDArray[np.int64], near: NDArray[np.int32], normals: Floats | None, noise: Floats
) -> tuple[Floats, Floats, Floats, Floats]:
    """The way from each of some points to the surface, the surface's normal there, and that of a plane.

    Parameters
    ----------
    positions : (n, 3) float32
    rows : (m,) int64
    near : (m, k) int32
        Neighbours of each of these rows, nearest first, itself among them.
    normals : (n, 3) float32 or None
        Known ones: neighbours that look to the opposite side do not count.
    noise : (m,) float32
        Standard deviation of the distance from the surface, in the unit of the positions.

    Returns
    -------
    shifts, normals, planes : (m, 3) float32
        0 where the neighbours lie on a line.
    errors : (m, 2) float32
        What the quadric through most neighbours leaves beyond noise, and the error of the chosen one, in the unit.
    """
    out = np.zeros((len(rows), 11), np.float32)
    known = np.zeros((0, 3), np.float32) if normals is None else normals
    sizes = np.array([k for k in SIZES if k <= near.shape[1]] or [near.shape[1]])
    run(_fit, -(-len(rows) // CHUNK), positions, rows, near, known, sizes, noise, out)
    return out[:, :3], out[:, 3:6], out[:, 6:9], out[:, 9:]
