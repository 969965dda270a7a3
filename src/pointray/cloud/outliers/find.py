"""Strays: points that belong to no surface, by kind, and what is done with them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...base.arguments import check_callback, check_kind
from ...base.progress import Progress, part_of, tell
from ...base.warning_log import warn
from ..neighbors import distinct, kd_order
from ..normals.stations import check_eyes, eyes_of
from ..points import Points
from .floors import LEAST, Floors, find_floors
from .groups import adrift, thin
from .layers import faces_back
from .passes import merge_passes
from .veils import veiled

Floats = NDArray[np.float32]

LOOKED = 0.6  # share of the time until strays are found, where passes are merged, too
MOST_STATIONS = 64  # scanners for which veils are sought
FLOORED, GROUPED = 0.75, 0.85  # shares of the time until floors, and groups, are found


class Strays(NamedTuple):
    """The rows of a cloud that belong to no surface, each in one kind; (n,) bool each.

    layer : in a sparse second layer, up to six spacings before or behind a surface
    veil : between foreground and background, as seen from the scanner; only where that is known
    floating : in a small group that floats by itself, such as a bird, or part of one that walked by
    lone : alone
    """

    layer: NDArray[np.bool_]
    veil: NDArray[np.bool_]
    floating: NDArray[np.bool_]
    lone: NDArray[np.bool_]

    @property
    def any(self) -> NDArray[np.bool_]:
        """Which rows are strays of any kind, (n,) bool."""
        return np.asarray(self.layer | self.veil | self.floating | self.lone)

    def __str__(self) -> str:
        """How many there are, in words."""
        names = "of second layers", "in veils", "in floating groups", "alone"
        parts = [f"{int(rows.sum()):,} {name}" for rows, name in zip(self, names, strict=True) if rows.any()]
        return f"{int(self.any.sum()):,} strays" + (f" ({', '.join(parts)})" if parts else "")


def find_strays(points: Points, viewpoint: ArrayLike | None = None, progress: Progress | None = None) -> Strays:
    """Points that belong to no surface: second layers, veils, floating groups and lone points.

    Parameters
    ----------
    points : Points
    viewpoint : (3,) or (n, 3) array_like, optional
        World position of the scanner, or of the one that saw each point, NaN where that is unknown. None: the stations
        of `points.survey`, as for `estimate_normals`. Veils are found only where it is known.
    progress : callable, optional
        Called with the share done.

    Returns
    -------
    Strays
        Rows that are not finite are none, and of fewer than 20 different positions none is.
    """
    return _look(points, viewpoint, progress)[0]


def merge_layers(points: Points, viewpoint: ArrayLike | None = None, progress: Progress | None = None) -> Points:
    """The points with those of sparse second layers moved onto the surface beside them; all else stays as it is.

    Where it is known of which scan each point is and from where it was seen, scans that are about as dense as each
    other but do not fit are moved onto their mean, too.

    Parameters
    ----------
    points : Points
        The attribute "scan" or "point_source_id" tells of which scan each point is.
    viewpoint, progress
        As for `find_strays`. Where no place is known, normals tell from which side a surface was seen.
    """
    check_callback(progress)  # also where there is nothing to look at
    strays, offset = _look(points, viewpoint, part_of(progress, 0.0, LOOKED))
    eyes = None if viewpoint is None else check_eyes(viewpoint, len(points))
    if strays.layer.any():
        positions = points.positions.copy()
        positions[strays.layer] += offset[strays.layer]
        points = points.changed(positions=positions)
    merged = merge_passes(points, eyes, part_of(progress, LOOKED, 1.0))
    tell(progress, 1.0)
    return merged


def without_strays(
    points: Points, name: str, viewpoint: ArrayLike | None = None, progress: Progress | None = None
) -> Points:
    """The points without strays; a warning tells how many were left out. An error, if that would be all.

    name : what messages call the points
    """
    strays = find_strays(points, viewpoint, progress)
    if not (~strays.any & points.finite).any():
        raise ValueError(f"{name}: no point is left without the {strays}")
    warn(f"{name}: {strays} left out", stacklevel=2)
    return points.select(~strays.any) if strays.any.any() else points


def _look(points: Points, viewpoint: ArrayLike | None, progress: Progress | None) -> tuple[Strays, Floats]:
    """The strays, and the offset of each row to its floor."""
    check_kind(points, "points", Points, "Points")
    check_callback(progress)
    eyes = eyes_of(points) if viewpoint is None else check_eyes(viewpoint, len(points))
    finite = np.flatnonzero(points.finite)
    first, ids = distinct(points.positions[finite])
    kinds, offset = np.zeros((len(points), 4), np.bool_), np.zeros((len(points), 3), np.float32)
    if len(first) >= LEAST:
        rows = finite[first]
        path = kd_order(points.positions[rows])
        rank = np.empty(len(path), np.int64)
        rank[path] = np.arange(len(path))
        found, floors = _kinds(points, rows[path], eyes, progress)
        kinds[finite], offset[finite] = found[rank[ids]], floors.offset[rank[ids]]
    tell(progress, 1.0)
    return Strays(*(np.ascontiguousarray(column) for column in kinds.T)), offset


def _kinds(
    points: Points, rows: NDArray[np.int64], eyes: NDArray[np.float64] | None, progress: Progress | None
) -> tuple[NDArray[np.bool_], Floors]:
    """The kinds of rows at different places in kd order, (m, 4) bool, and their floors."""
    positions = np.ascontiguousarray(points.positions[rows])
    floors = find_floors(positions, part_of(progress, 0.0, FLOORED))
    off = np.flatnonzero(floors.off)
    off = off[~faces_back(points, rows, floors, off)]
    layer, lone = np.zeros((2, len(rows)), np.bool_)
    layer[off] = floors.in_layer[off]
    lone[off] = ~layer[off]
    lone |= thin(floors)
    tell(progress, FLOORED)
    floating = adrift(positions, floors, layer | lone)
    tell(progress, GROUPED)
    veil = _veils(points, positions, floors.core, rows, eyes)
    layer, floating = layer & ~veil, floating & ~(layer | veil)
    return np.stack([layer, veil, floating, lone & ~(layer | veil | floating)], axis=1), floors


def _veils(
    points: Points, positions: Floats, core: Floats, rows: NDArray[np.int64], eyes: NDArray[np.float64] | None
) -> NDArray[np.bool_]:
    """Which positions are in veils, as seen by the scanner of each."""
    veil = np.zeros(len(rows), np.bool_)
    if eyes is None:
        return veil
    own = np.broadcast_to(eyes, (len(points), 3))[rows]
    known = np.flatnonzero(np.isfinite(own).all(axis=1))
    stations, which = np.unique(own[known], axis=0, return_inverse=True)
    if len(stations) > MOST_STATIONS:  # a path, of which each place saw too little
        return veil
    for number, station in enumerate(stations):
        seen = known[which.reshape(-1) == number]
        if len(seen) >= LEAST:
            veil[seen] = veiled(positions[seen], core[seen], station - points.origin)
    return veil
