"""The support of every splat: its radius, whether the surface ends beside it, and whether it is of close sheets."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.progress import Progress, part_of, tell
from ...cloud.neighbors import NeighborTree, distinct, take
from ...cloud.sampled_statistics import of_places
from ...cloud.statistics import CloudStatistics
from .cells import NEIGHBORS
from .fringe import trim_fringe
from .radii import choose_radii
from .sheets import find_sheets
from .voronoi import Neighborhood

# If more than TIGHT_SHARE of the radii are smaller than TIGHT times the covering ones, the surface has gaps.
TIGHT, TIGHT_SHARE = 0.9, 1e-3
CROWD = 16  # splats at one position
# Shares of the time after which the tree and radii are known.
SORTED, CHOSEN = 0.1, 0.98
HANDFUL = 1e-5  # share of lone points below which they are not mentioned: a mesh of 400,000 vertices has one

Floats = NDArray[np.float32]
Rows = NDArray[np.int32]


class Support(NamedTuple):
    """The support of n splats.

    radii : (n,) float32
    borders : (n, 3) float32, the direction out of the surface on an open border, else zero; None if not searched for
    sheets : (n,) int8, 1 for splats of sheets close together, else 0; None if there are none
    tight : whether many radii are too small to cover the surface
    position_ids : (n,) int32, equal for splats at one position; None if no two are at one
    lone : (n,) bool, strays whose chosen radii were made smaller
    """

    radii: Floats
    borders: Floats | None
    sheets: NDArray[np.int8] | None
    tight: bool
    position_ids: Rows | None
    lone: NDArray[np.bool_]

    @property
    def crowded(self) -> NDArray[np.bool_]:
        """Which splats share their position with CROWD splats of lower numbers: rays would have to test all of them."""
        ids = self.position_ids
        if ids is None or np.bincount(ids).max() <= CROWD:
            return np.zeros(len(self.radii), np.bool_)
        order = np.argsort(ids, kind="stable")
        start = np.searchsorted(ids[order], ids[order])
        crowded = np.empty(len(order), np.bool_)
        crowded[order] = np.arange(len(order)) - start >= CROWD
        return crowded

    @property
    def note(self) -> str:
        """A message about lone points, if there are more than a handful."""
        return lone_note(int(self.lone.sum()), len(self.lone))


def lone_note(count: int, total: int) -> str:
    """A message about so many lone points, if they are more than a handful."""
    if count <= HANDFUL * total:
        return ""
    points, whose = ("1 lone point is", "its") if count == 1 else (f"{count:,} lone points are", "their")
    return f"{points} drawn no larger than {whose} neighbours' supports"


def find_support(
    positions: Floats,
    normals: Floats,
    radii: Floats | None,
    scale: float,
    *,
    borders: bool,
    sheets: bool,
    within: tuple[float, Floats] | None = None,
    apart: bool = False,
    progress: Progress | None = None,
    usual: CloudStatistics | None = None,
    others: Floats | None = None,
    noise: Floats | None = None,
) -> Support:
    """The support of every splat, all of it from one search for neighbours.

    Parameters
    ----------
    positions : (n, 3) float32
        Finite, in kd order, or in another one that keeps neighbours together.
    normals : (n, 3) float32, unit
    radii : (n,) float32 or None
        Given radii. None: the smallest that cover the surface, see `choose_radii`.
    scale : float
        Factor for all radii.
    borders, sheets : bool
        What to search for besides radii; sheets only with borders. NEIGHBORS positions or fewer have neither.
    within : (float, (n,) float32), optional
        Lower and upper limits of chosen radii.
    apart : bool
        Whether all positions are known to be different.
    progress : callable, optional
    usual, others : optional
        See `choose_radii`.
    noise : (n,) float32, optional
        Standard deviation of the noise of each point; frayed borders are trimmed where there is some.

    Raises
    ------
    ValueError
        If all positions are equal and no radii are given.
    """
    rows, ids = (None, None) if apart else _places(positions)
    # Nearly always all positions are distinct; then avoiding copies saves half a GiB at the peak for 24 million points.
    sites = positions if rows is None else take(positions, rows)
    given = None if radii is None else radii * np.float32(scale)
    borders = borders and len(sites) > NEIGHBORS
    none = np.zeros(len(positions), np.bool_)
    if given is not None and not borders:
        return Support(given, None, None, False, ids, none)
    facing = normals if rows is None else take(normals, rows)
    tree = NeighborTree(sites, in_order=True)
    tell(progress, SORTED)
    usual = CloudStatistics.of(len(sites)) if usual is None else of_places(usual, ids)
    found = choose_radii(sites, facing, part_of(progress, SORTED, CHOSEN), tree, usual, others)
    if borders and noise is not None:
        trim_fringe(sites, facing, tree, found, (noise if rows is None else noise[rows]) > 0, usual)
    covering = found.radii
    lone = _spread(found.lone, ids) if given is None else none
    if within is not None:
        covering = np.clip(covering, np.float32(within[0]), within[1] if rows is None else within[1][rows])
    chosen = _spread(covering, ids) * np.float32(scale) if given is None else given
    if not borders:
        return Support(chosen, None, None, False, ids, lone)
    at_sites = chosen if rows is None else chosen[rows]
    tight = usual.share("tight radii", at_sites < TIGHT * covering) > TIGHT_SHARE
    sides: NDArray[Any] | None = None
    if sheets:
        some = np.flatnonzero(found.facing)
        hood = Neighborhood(some, tree.rows_at(NEIGHBORS + 1, sites[some]))
        sides = find_sheets(sites, facing, at_sites, found.near, hood)
        sides = None if sides is None else _spread(sides, ids)
    return Support(chosen, _spread(found.borders, ids), sides, tight, ids, lone)


def _places(positions: Floats) -> tuple[Rows, Rows] | tuple[None, None]:
    """See `distinct`; None if all positions are different."""
    rows, ids = distinct(positions)
    return (None, None) if len(rows) == len(ids) else (rows, ids)


def _spread(values: NDArray[Any], ids: Rows | None) -> NDArray[Any]:
    """What is known of each place, for each splat."""
    return values if ids is None else values[ids]
