"""Wide discs: strays, whose width no disc around them explains, and discs that a wide neighbour makes unnecessary.

A disc q times as wide as usual must be part of a surface of similar discs. Other discs about as wide, counted once per
cell of its own size, are its company if they lie on a smooth sheet with it: on a plane or a circle's arc through both,
the line between two points is at right angles to the sum of their normals. A disc needs q such discs. Among many discs,
as in scatter, a share that grows with q must fit, as some fit by chance. A disc whose company is stray is stray too.

Where the density drops sharply, dense and sparse points both reach across the gap, so both would cover the middle. At
an edge, the wide discs of dense points would also cover detail on the other side. So they reach only as far as needed.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...cloud.neighbors import distinct, neighbors

NOTICE = 3.0  # medians of reach: a disc wider than this is examined
OTHERS = 10.0  # this many other discs are enough however wide a disc is: a sphere of 100 points explains itself
COMPANY = 20  # up to this many discs around, q must fit; beyond, the same share. In scatter 1/3 to 1/2 fit by chance
AROUND = 32  # other discs that are examined
WITHIN = 6.0  # in reaches of the disc: the greatest distance of its company
ALIKE = 0.5  # the company reaches at least this share of the least reach in an octave
CELL = 2.1  # in reaches: one disc counts per cell of this size, so that a dense scan line is no company
SMOOTH = 0.2  # how far two points may lie off an arc, as a share of their distance, or of LEVEL reaches if that is more
LEVEL = 1.5
TURNED = 0.3  # cosine of two normals, of either sign, below which they do not count as one sheet
ROUNDS = 4  # rounds in which strays are removed from the company of others
BESIDE = 8  # neighbours that decide how wide a stray's disc may be
# A dense point is crowded if it reaches over CROWDED times as far as those around it. It keeps the share SPARED of its
# reach if a sparse point, within ACROSS reaches, reaches as far. Beside a step of density by 30, 12 of 40,000 rays pass
# through with 0.6, none with 0.75 (but discs overlap too little), 0.85 and 1; beside Nefertiti's base 246,939 rays lose
# 198 hits with 0.75, 324 with 0.85, 714 with 1.
CROWDED, SPARED, ACROSS = 2.0, 0.85, 2.0
CHUNK = 1 << 15  # rows at a time

Floats = NDArray[np.float32]
Rows = NDArray[np.int64]
Around = Callable[[NDArray[np.int64]], NDArray[np.int32]]


class Company(NamedTuple):
    """Wide discs and their company.

    rows : (m,) int64, the discs; fit : (m, AROUND) int32, the others that lie on a smooth sheet with each, -1 for none;
    around : (m,) int64, how many others are near each disc
    """

    rows: Rows
    fit: NDArray[np.int32]
    around: NDArray[np.int64]


def limit_wide(
    positions: Floats, normals: Floats, reach: Floats, around: Around, usual_here: Floats, middle: float
) -> NDArray[np.bool_]:
    """Make strays reach no farther than their neighbours, and other discs no farther than needed, in place.

    Parameters
    ----------
    positions : (n, 3) float32
        All different.
    normals : (n, 3) float32, unit
    reach : (n,) float32
        How far each point's cell reaches; discs are wider by the overlap of the supports.
    around : callable
        Gives the neighbours of some rows, themselves first, (m, k) int32.
    usual_here : (n,) float32
        How far the cells around each point reach.
    middle : float
        How far half of all cells reach.

    Returns
    -------
    (n,) bool
        Which points are strays.
    """
    usual = np.float32(middle)
    stray = np.zeros(len(reach), np.bool_)
    rows = np.flatnonzero(reach > NOTICE * usual)
    if len(rows) == 0:
        return stray
    company = _find_company(positions, normals, reach, rows, usual)
    rows = _find_strays(reach, company, usual)
    stray[rows] = True
    beside = around(rows)[:, 1:]
    limit = _first_medians(np.where(stray[beside], np.float32(np.nan), reach[beside]), usual)
    stray[rows] = reach[rows] > limit
    reach[rows] = np.minimum(reach[rows], limit)
    _spare(positions, reach, company, usual, usual_here)
    return stray


def _find_company(positions: Floats, normals: Floats, reach: Floats, rows: Rows, usual: np.float32) -> Company:
    """The company of each row, found octave by octave, as other discs must be about as wide."""
    company = Company(rows, np.full((len(rows), AROUND), -1, np.int32), np.zeros(len(rows), np.int64))
    octaves = np.floor(np.log2(reach[rows] / (NOTICE * usual)))
    for octave in np.unique(octaves):
        least = NOTICE * usual * np.float32(2.0) ** np.float32(octave)
        wide = np.flatnonzero(reach >= ALIKE * least)
        others = wide[distinct(positions[wide], float(CELL * least))[0]]
        asked = np.flatnonzero(octaves == octave)
        for start in range(0, len(asked), CHUNK):
            some = asked[start : start + CHUNK]
            here = rows[some]
            distances, found = neighbors(positions[others], AROUND, positions[here])
            found = others[found].astype(np.int32)
            close = (distances > 0) & (distances < WITHIN * reach[here, None])
            smooth = _on_one_sheet(positions, normals, here, found, np.float32(LEVEL) * reach[here])
            company.fit[some, : found.shape[1]] = np.where(close & smooth, found, -1)
            company.around[some] = close.sum(axis=1)
    return company


def _on_one_sheet(
    positions: Floats, normals: Floats, rows: Rows, found: NDArray[np.int32], level: Floats
) -> NDArray[np.bool_]:
    """Which of the points found for each row lie on an arc with it, within SMOOTH; normals may have either sign."""
    away, n, m = positions[found] - positions[rows, None], normals[rows], normals[found]
    cosines = np.einsum("ijk,ik->ij", m, n)
    off = np.einsum("ijk,ik->ij", away, n) + np.copysign(1, cosines) * np.einsum("ijk,ijk->ij", away, m)
    scale = np.maximum(np.sqrt(np.einsum("ijk,ijk->ij", away, away)), level[:, None])
    return np.asarray((np.abs(off) <= 2 * SMOOTH * scale) & (np.abs(cosines) >= TURNED))


def _find_strays(reach: Floats, company: Company, usual: np.float32) -> Rows:
    """The rows that have too little company, not counting company that is stray itself."""
    rows, fit, around = company
    wanted = np.minimum(reach[rows] / usual, OTHERS)
    wanted *= np.maximum(around / COMPANY * np.sqrt(wanted / OTHERS), 1)
    explained = np.append(np.ones(len(reach), np.bool_), False)  # the last entry is row -1, no disc
    for _ in range(ROUNDS):
        stays = explained[fit].sum(axis=1) >= wanted
        if (stays == explained[rows]).all():
            break
        explained[rows] = stays
    strays: Rows = rows[~explained[rows]]
    return strays


def _first_medians(values: Floats, otherwise: np.float32) -> Floats:
    """Median of the first BESIDE numbers in each row, without NaN; `otherwise` where there is no number."""
    known = ~np.isnan(values)
    first = np.where(known & (np.cumsum(known, axis=1) <= BESIDE), values, np.float32(np.inf))
    count = np.minimum(known.sum(axis=1), BESIDE)
    middle = np.sort(first, axis=1)[np.arange(len(values)), np.maximum(count - 1, 0) // 2]
    return np.where(count > 0, middle, otherwise)


def _spare(positions: Floats, reach: Floats, company: Company, usual: np.float32, usual_here: Floats) -> None:
    """Let dense points beside sparse ones reach less far, in place."""
    crowded = reach > np.maximum(CROWDED * usual_here, NOTICE * usual)
    some = crowded[company.rows]
    rows, fit = company.rows[some], company.fit[some]
    distances = np.linalg.norm(positions[fit] - positions[rows, None], axis=2)
    sparse = (fit >= 0) & ~crowded[fit] & (reach[fit] > SPARED * reach[rows, None])
    rows = rows[(sparse & (distances < ACROSS * reach[rows, None])).any(axis=1)]
    reach[rows] = np.maximum(np.float32(SPARED) * reach[rows], np.float32(CROWDED) * usual_here[rows])
