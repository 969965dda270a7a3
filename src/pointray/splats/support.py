"""The support of every splat: its radius, whether the surface ends beside it, and whether it is of close sheets."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..neighbors import distinct, neighbors
from ..progress import Progress, part_of
from .radii import NEIGHBORS, choose_radii
from .sheets import find_sheets

# If more than TIGHT_SHARE of the radii are smaller than TIGHT times the covering ones, the surface has gaps.
TIGHT, TIGHT_SHARE = 0.9, 1e-3
CROWD = 16  # splats at one position
PLACED, FOUND, CHOSEN = 0.05, 0.75, 0.98  # shares of the time after which positions, neighbours, radii are known
HANDFUL = 1e-5  # share of lone points below which they are not mentioned: a mesh of 400,000 vertices has one


class Support(NamedTuple):
    """The support of n splats.

    radii : (n,) float32
    borders : (n, 3) float32, the direction out of the surface on an open border, else zero; None if not searched for
    sheets : (n,) int8, 1 for splats of sheets close together, else 0; None if there are none
    tight : whether many radii are too small to cover the surface
    position_ids : (n,) int64, equal for splats at one position
    lone : (n,) bool, strays whose chosen radii were made smaller
    """

    radii: NDArray[np.float32]
    borders: NDArray[np.float32] | None
    sheets: NDArray[np.int8] | None
    tight: bool
    position_ids: NDArray[np.int64]
    lone: NDArray[np.bool_]

    @property
    def crowded(self) -> NDArray[np.bool_]:
        """Which splats share their position with CROWD splats of lower numbers: rays would have to test all of them."""
        if np.bincount(self.position_ids).max() <= CROWD:
            return np.zeros(len(self.position_ids), np.bool_)
        order = np.argsort(self.position_ids, kind="stable")
        start = np.searchsorted(self.position_ids[order], self.position_ids[order])
        crowded = np.empty(len(order), np.bool_)
        crowded[order] = np.arange(len(order)) - start >= CROWD
        return crowded

    @property
    def note(self) -> str:
        """A message about lone points, if there are more than a handful."""
        count = int(self.lone.sum())
        if count <= HANDFUL * len(self.lone):
            return ""
        points, whose = ("1 lone point is", "its") if count == 1 else (f"{count:,} lone points are", "their")
        return f"{points} drawn no larger than {whose} neighbours' supports"


def find_support(
    positions: NDArray[np.float32],
    normals: NDArray[np.float32],
    radii: NDArray[np.float32] | None,
    scale: float,
    *,
    borders: bool,
    sheets: bool,
    within: tuple[float, NDArray[np.float32]] | None = None,
    progress: Progress | None = None,
) -> Support:
    """The support of every splat, all of it from one search for neighbours.

    Parameters
    ----------
    positions : (n, 3) float32
        Finite.
    normals : (n, 3) float32, unit
    radii : (n,) float32 or None
        Given radii. None: the smallest that cover the surface, see `choose_radii`.
    scale : float
        Factor for all radii.
    borders, sheets : bool
        What to search for besides radii; sheets only with borders. NEIGHBORS positions or fewer have neither.
    within : (float, (n,) float32), optional
        Lower and upper limits of chosen radii.
    progress : callable, optional

    Raises
    ------
    ValueError
        If all positions are equal and no radii are given.
    """
    rows, ids = distinct(positions)
    given = None if radii is None else radii * np.float32(scale)
    borders = borders and len(rows) > NEIGHBORS
    none = np.zeros(len(ids), np.bool_)
    if given is not None and not borders:
        return Support(given, None, None, False, ids, none)
    # Nearly always all positions are distinct; then avoiding copies saves half a GiB at the peak for 24 million points.
    sites = (positions, normals) if len(rows) == len(positions) else (positions[rows], normals[rows])
    hood = neighbors(sites[0], NEIGHBORS + 1, progress=part_of(progress, PLACED, FOUND))
    covering, ends, strays = choose_radii(*sites, *hood, part_of(progress, FOUND, CHOSEN))
    lone = strays[ids] if given is None else none
    if within is not None:
        covering = np.clip(covering, np.float32(within[0]), within[1][rows])
    chosen = covering[ids] * np.float32(scale) if given is None else given
    if not borders:
        return Support(chosen, None, None, False, ids, lone)
    tight = bool((chosen[rows] < TIGHT * covering).mean() > TIGHT_SHARE)
    sides: NDArray[Any] | None = find_sheets(*sites, chosen[rows], hood[1]) if sheets else None
    return Support(chosen, ends[ids], None if sides is None else sides[ids], tight, ids, lone)
