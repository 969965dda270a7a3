"""Points whose radius nothing around them explains: strays, alone or in small groups, and scatter that is no surface.

A disc q times as wide as usual has to be part of a surface of such discs. Others that are about as wide, at most one a
cell of its own size, count for it where they lie on a smooth sheet with it: of a plane or a circle's arc through both,
the way between two points is at right angles to the sum of their normals. It takes q of them; and among many, as in
scatter, where some fit by chance, a share that grows with q.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..neighbors import distinct, neighbors

NOTICE = 3.0  # medians: a disc so wide is noticed, and asked for
OTHERS = 10.0  # so many others are enough, however wide a disc is: a sphere of 100 points explains itself
COMPANY = 20  # of so many around, q must fit; of more, as large a share
AROUND = 32  # others that are looked at
WITHIN = 6.0  # reaches: how far they lie
ALIKE = 0.5  # they reach at least so far, measured by the least reach in an octave
CELL = 2.1  # one a cell of so many reaches counts: a scan line dense in points is no company
SMOOTH = 0.2  # of the distance, or of LEVEL reaches where that is more: how far two points may lie off an arc
LEVEL = 1.5
TURNED = 0.3  # cosine of two normals, of either sign, below which nothing says that they are of one sheet
ROUNDS = 4  # in which the company of what has none is taken away
CHUNK = 1 << 15  # rows at a time
BESIDE = 8  # neighbours that say how wide an unexplained disc may be

Floats = NDArray[np.float32]
Rows = NDArray[np.int64]


def keep_strays_small(positions: Floats, normals: Floats, reach: Floats, near: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Make unexplained discs no wider than those beside them, in place.

    Parameters
    ----------
    positions : (n, 3) float32
        All different.
    normals : (n, 3) float32, unit
    reach : (n,) float32
        How far each point's cell reaches; the discs are as much wider as supports overlap.
    near : (n, k) int32
        Rows of each point's neighbours, itself first.

    Returns
    -------
    (n,) bool
        Which were made smaller.
    """
    usual = np.float32(np.median(reach))
    lone = np.zeros(len(reach), np.bool_)
    lone[_unexplained(positions, normals, reach, usual)] = True
    rows = np.flatnonzero(lone)
    if len(rows):
        beside = near[rows, 1:]
        limit = _first_medians(np.where(lone[beside], np.float32(np.nan), reach[beside]), usual)
        lone[rows] = reach[rows] > limit
        reach[rows] = np.minimum(reach[rows], limit)
    return lone


def _first_medians(values: Floats, otherwise: np.float32) -> Floats:
    """Median of the first BESIDE numbers in each row, NaN left out; where there is none, what is given."""
    known = ~np.isnan(values)
    first = np.where(known & (np.cumsum(known, axis=1) <= BESIDE), values, np.float32(np.inf))
    count = np.minimum(known.sum(axis=1), BESIDE)
    middle = np.sort(first, axis=1)[np.arange(len(values)), np.maximum(count - 1, 0) // 2]
    return np.where(count > 0, middle, otherwise)


def _unexplained(positions: Floats, normals: Floats, reach: Floats, usual: np.float32) -> Rows:
    """The rows of discs that are noticed and have too few others for company, who have not too few themselves."""
    noticed = np.flatnonzero(reach > NOTICE * usual)
    if len(noticed) == 0:
        return noticed
    fit, around = _company(positions, normals, reach, noticed, usual)
    wanted = np.minimum(reach[noticed] / usual, OTHERS) * np.maximum(around / COMPANY, 1)
    explained = np.append(np.ones(len(reach), np.bool_), False)  # the last one: row -1, nobody
    for _ in range(ROUNDS):
        stays = explained[fit].sum(axis=1) >= wanted
        if (stays == explained[noticed]).all():
            break
        explained[noticed] = stays
    return noticed[~explained[noticed]]


def _company(
    positions: Floats, normals: Floats, reach: Floats, noticed: Rows, usual: np.float32
) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Which others near each row lie on a smooth sheet with it, (m, AROUND), else -1; and how many there are."""
    fit, around = np.full((len(noticed), AROUND), -1, np.int32), np.zeros(len(noticed), np.int64)
    octaves = np.floor(np.log2(reach[noticed] / (NOTICE * usual)))
    for octave in np.unique(octaves):
        least = NOTICE * usual * np.float32(2.0) ** np.float32(octave)
        wide = np.flatnonzero(reach >= ALIKE * least)
        others = wide[distinct(positions[wide], float(CELL * least))[0]]
        asked = np.flatnonzero(octaves == octave)
        for start in range(0, len(asked), CHUNK):
            some = asked[start : start + CHUNK]
            rows = noticed[some]
            distances, near = neighbors(positions[others], AROUND, positions[rows])
            here = (distances > 0) & (distances < WITHIN * reach[rows, None])
            near = others[near].astype(np.int32)
            smooth = _on_one_sheet(positions, normals, rows, near, np.float32(LEVEL) * reach[rows])
            fit[some, : near.shape[1]] = np.where(here & smooth, near, -1)
            around[some] = here.sum(axis=1)
    return fit, around


def _on_one_sheet(
    positions: Floats, normals: Floats, rows: Rows, near: NDArray[np.int32], level: Floats
) -> NDArray[np.bool_]:
    """Which of the points near each row lie on a common arc with it, of both normals of either sign."""
    away, n, m = positions[near] - positions[rows, None], normals[rows], normals[near]
    cosines = np.einsum("ijk,ik->ij", m, n)
    across = np.einsum("ijk,ik->ij", away, n) + np.copysign(1, cosines) * np.einsum("ijk,ijk->ij", away, m)
    distances = np.sqrt(np.einsum("ijk,ijk->ij", away, away))
    return np.asarray(
        (np.abs(across) <= 2 * SMOOTH * np.maximum(distances, level[:, None])) & (np.abs(cosines) >= TURNED)
    )
