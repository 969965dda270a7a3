"""Support of every splat: its radius, open borders, and sheets close together."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.arrays import Flags, Floats, Indices
from ...base.progress import Progress, part_of, report_progress
from ...cloud.neighbors import NeighborTree, distinct, take
from ...cloud.sampled_statistics import of_distinct_positions
from ...cloud.statistics import CloudStatistics
from .cells import NEIGHBORS
from .fringe import trim_fringe
from .radii import choose_radii
from .sheets import find_sheets
from .voronoi import Neighborhood

# The surface has gaps if more than TIGHT_SHARE of the radii are smaller than TIGHT times those that cover it.
TIGHT, TIGHT_SHARE = 0.9, 1e-3
CROWD = 16  # most splats kept at one position
# Fractions of the run time at which the neighbour tree and the radii are complete.
SORTED, CHOSEN = 0.1, 0.98
REPORTED_SHARE = 1e-5  # isolated points are reported above this share: a mesh of 400,000 vertices has one


class Support(NamedTuple):
    """Radii of n splats, and which of them lie on open borders or on sheets close together.

    radii : (n,) float32, support radii
    borders : (n, 3) float32, outward direction for splats on an open border, else zero; None if not computed
    sheets : (n,) int8, 1 for splats with an opposite sheet close by, else 0; None if no splat has one
    tight : whether many radii are too small to cover the surface
    position_ids : (n,) int32, equal for splats at equal positions; None if all positions differ
    isolated : (n,) bool, isolated points whose radii were reduced
    """

    radii: Floats
    borders: Floats | None
    sheets: NDArray[np.int8] | None
    tight: bool
    position_ids: Indices | None
    isolated: Flags

    @property
    def crowded(self) -> Flags:
        """Mask (n,) of splats that share their position with 16 earlier ones; they are left out to keep rays fast."""
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
        """Message for the user that radii of isolated points were reduced; empty if there are only a few."""
        return isolated_note(int(self.isolated.sum()), len(self.isolated))


def isolated_note(count: int, total: int) -> str:
    """Return a message that discs of `count` isolated points of `total` were reduced; empty up to 1 in 100,000."""
    if count <= REPORTED_SHARE * total:
        return ""
    points, whose = ("1 isolated point", "its") if count == 1 else (f"{count:,} isolated points", "their")
    return f"{points}: disc size limited to that of {whose} neighbours"


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
    statistics: CloudStatistics | None = None,
    others: Floats | None = None,
    noise: Floats | None = None,
) -> Support:
    """Find the support of every splat with one neighbour search: its radius, open borders, and sheets close together.

    Parameters
    ----------
    positions : (n, 3) float32
        Finite, in kd order or another order that keeps neighbours together.
    normals : (n, 3) float32
        Unit normals.
    radii : (n,) float32 or None
        Given radii. None: the smallest that cover the surface, see `choose_radii`.
    scale : float
        Factor for all radii.
    borders, sheets : bool
        Whether to find borders and sheets. Sheets require `borders`. 20 or fewer different positions have none.
    within : (float, (n,) float32), optional
        Lower and upper limits of chosen radii.
    apart : bool
        Whether all positions are known to be distinct.
    progress : callable, optional
    statistics : CloudStatistics, optional
        Statistics of the whole cloud, if the splats are a part of one. Default: those of the splats.
    others : (m, 3) float32, optional
        Scattered points of the same cloud, such as leaves. They get no support; chosen discs span narrower gaps beside
        them.
    noise : (n,) float32, optional
        Standard deviation of the noise of each point. Frayed borders are trimmed where it is greater than 0.

    Raises
    ------
    ValueError
        If all positions are equal and no radii are given.
    """
    rows, ids = (None, None) if apart else _places(positions)
    # Positions are nearly always distinct; not copying them saves 0.5 GiB of peak memory for 24 million points.
    sites = positions if rows is None else take(positions, rows)
    given = None if radii is None else radii * np.float32(scale)
    borders = borders and len(sites) > NEIGHBORS
    none = np.zeros(len(positions), np.bool_)
    if given is not None and not borders:
        return Support(given, None, None, False, ids, none)
    facing = normals if rows is None else take(normals, rows)
    tree = NeighborTree(sites, in_order=True)
    report_progress(progress, SORTED)
    statistics = CloudStatistics.of(len(sites)) if statistics is None else of_distinct_positions(statistics, ids)
    found = choose_radii(sites, facing, part_of(progress, SORTED, CHOSEN), tree, statistics, others)
    if borders and noise is not None:
        trim_fringe(sites, facing, tree, found, (noise if rows is None else noise[rows]) > 0, statistics)
    covering = found.radii
    isolated = _spread(found.isolated, ids) if given is None else none
    if within is not None:
        covering = np.clip(covering, np.float32(within[0]), within[1] if rows is None else within[1][rows])
    chosen = _spread(covering, ids) * np.float32(scale) if given is None else given
    if not borders:
        return Support(chosen, None, None, False, ids, isolated)
    at_sites = chosen if rows is None else chosen[rows]
    tight = statistics.share("tight radii", at_sites < TIGHT * covering) > TIGHT_SHARE
    sides: NDArray[Any] | None = None
    if sheets:
        some = np.flatnonzero(found.facing)
        neighborhood = Neighborhood(some, tree.rows_at(NEIGHBORS + 1, sites[some]))
        sides = find_sheets(sites, facing, at_sites, found.near, neighborhood)
        sides = None if sides is None else _spread(sides, ids)
    return Support(chosen, _spread(found.borders, ids), sides, tight, ids, isolated)


def _places(positions: Floats) -> tuple[Indices, Indices] | tuple[None, None]:
    """Return the first row at each of m distinct positions (m,), and the index of each point's position (n,).

    Return None for both if all positions differ.
    """
    rows, ids = distinct(positions)
    return (None, None) if len(rows) == len(ids) else (rows, ids)


def _spread(values: NDArray[Any], ids: Indices | None) -> NDArray[Any]:
    """Expand values of m distinct positions to n splats. ids : (n,) position of each splat, or None if all differ"""
    return values if ids is None else values[ids]
