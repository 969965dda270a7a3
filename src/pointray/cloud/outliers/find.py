"""Detection of strays (points that belong to no surface) by kind, and their removal or merging."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...base.arguments import check_callback
from ...base.arrays import Doubles, Flags, Floats, Rows
from ...base.progress import Progress, StageProgress, in_stage, part_of, report_progress
from ...base.warning_log import warn
from ..conversion import PointsLike, check_points
from ..neighbors import distinct, kd_order
from ..normals.stations import check_eyes, eyes_of
from ..points import Points
from .floors import LEAST, Floors, find_floors
from .groups import find_floating, find_sparse
from .layers import faces_back
from .passes import merge_passes
from .veils import find_veils

CLASSIFIED = 0.6  # progress after strays are found, where passes are merged as well
MOST_STATIONS = 64  # with more scanner positions, veils are not searched
FLOORED, GROUPED = 0.75, 0.85  # progress after floors, and after groups, are found


class Strays(NamedTuple):
    """Result of `find_strays`: rows of a cloud that belong to no surface. A row has at most one kind.

    Attributes
    ----------
    layer : (n,) bool
        In a sparse second layer, up to six spacings in front of or behind a surface.
    veil : (n,) bool
        Mixed returns between foreground and background, as seen from the scanner, if that is known.
    floating : (n,) bool
        In a small separate group, such as a bird, or part of a person walking by.
    lone : (n,) bool
        Isolated: off a surface, but not in a layer, or much sparser than the points around.

    Examples
    --------
    >>> print(pr.find_strays(pr.procedural("sphere", 1000)))
    0 strays
    """

    layer: NDArray[np.bool_]
    veil: NDArray[np.bool_]
    floating: NDArray[np.bool_]
    lone: NDArray[np.bool_]

    @property
    def any(self) -> NDArray[np.bool_]:
        """Rows that are strays of any kind, (n,) bool."""
        return np.asarray(self.layer | self.veil | self.floating | self.lone)

    def __str__(self) -> str:
        """Return the numbers of strays, of all and of each kind, as a line for users."""
        names = "in second layers", "mixed returns", "in floating groups", "isolated"
        parts = [f"{int(rows.sum()):,} {name}" for rows, name in zip(self, names, strict=True) if rows.any()]
        return f"{int(self.any.sum()):,} strays" + (f" ({', '.join(parts)})" if parts else "")


def find_strays(
    points: PointsLike, viewpoint: ArrayLike | None = None, progress: StageProgress | None = None
) -> Strays:
    """Find points that belong to no surface: second layers, veils, floating groups and isolated points.

    A second layer consists of sparse points in front of a surface or behind it, as of a scan that does not fit. A veil
    consists of mixed returns between foreground and background.

    Parameters
    ----------
    points : Points, or what `as_points` accepts
    viewpoint : (3,) or (n, 3) array_like, optional
        World position of the scanner, or of the scanner that saw each point, NaN where unknown. None: the stations of
        `points.georeference`; the attribute "scan" holds each point's station. Veils are found only where it is known.
    progress : callable, optional
        Called as `progress(stage, share)` with the name of the stage and its completed share, 0 to 1.

    Returns
    -------
    Strays
        `layer`, `veil`, `floating`, `lone` and `any` of them, (n,) bool each. All false for rows that are not finite,
        and with fewer than 20 distinct positions.

    Raises
    ------
    TypeError
        If an argument has the wrong type.
    ValueError
        If `viewpoint` has the wrong shape.

    Examples
    --------
    >>> ball = pr.procedural("sphere", 1000).positions
    >>> points = pr.Points(np.concatenate([ball, [[0, 0, 3]]]))
    >>> np.flatnonzero(pr.find_strays(points).any).tolist()
    [1000]
    """
    check_callback(progress)
    return _classify(check_points(points), viewpoint, in_stage(progress, "finding strays"))[0]


def merge_layers(
    points: PointsLike, viewpoint: ArrayLike | None = None, progress: StageProgress | None = None
) -> Points:
    """Move the points of sparse second layers onto the surface next to them; other points are unchanged.

    A second layer is a duplicate of a surface in front of it or behind it, such as from a misaligned scan.
    If each point's scan and scanner are known, equally dense scans that do not fit each other are moved onto their mean
    as well.

    Parameters
    ----------
    points : Points, or what `as_points` accepts
        The attribute "scan" or "point_source_id" holds the scan of each point.
    viewpoint : (3,) or (n, 3) array_like, optional
        World position of the scanner, or of the scanner that saw each point, NaN where unknown. None: the stations of
        `points.georeference`. Where no position is known, normals show from which side a surface was seen.
    progress : callable, optional
        Called as `progress(stage, share)` with the name of the stage and its completed share, 0 to 1.

    Returns
    -------
    Points
        The same rows with other positions; `points` itself if none is moved.

    Raises
    ------
    TypeError
        If an argument has the wrong type.
    ValueError
        If `viewpoint` has the wrong shape.

    Examples
    --------
    >>> points = pr.procedural("sphere", 1000)
    >>> pr.merge_layers(points) is points
    True
    """
    points = check_points(points)
    check_callback(progress)
    report = in_stage(progress, "merging layers")
    strays, offset = _classify(points, viewpoint, part_of(report, 0.0, CLASSIFIED))
    eyes = None if viewpoint is None else check_eyes(viewpoint, len(points))
    if strays.layer.any():
        positions = points.positions.copy()
        positions[strays.layer] += offset[strays.layer]
        points = points.changed(positions=positions)
    merged = merge_passes(points, eyes, part_of(report, CLASSIFIED, 1.0))
    report_progress(report, 1.0)
    return merged


def without_strays(
    points: Points, name: str, viewpoint: ArrayLike | None = None, progress: StageProgress | None = None
) -> Points:
    """Remove strays, with a warning that gives their number; raise a ValueError if no point would remain.

    name : of the points, for messages
    viewpoint : (3,) or (n, 3) world position of the scanner; None: the stations of the georeference
    """
    strays = find_strays(points, viewpoint, progress)
    if not (~strays.any & points.finite).any():
        raise ValueError(f"{name}: no points remain after removing {strays}")
    warn(f"{name}: {strays} removed", stacklevel=2)
    return points.select(~strays.any) if strays.any.any() else points


def _classify(points: Points, viewpoint: ArrayLike | None, progress: Progress | None) -> tuple[Strays, Floats]:
    """Return the strays among points, by kind, and the offset of each point to the surface beneath it, (n, 3).

    The offset is 0 where a point is not off its surface.

    viewpoint : (3,) or (n, 3) world position of the scanner; None: the stations of the georeference
    """
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
    report_progress(progress, 1.0)
    return Strays(*(np.ascontiguousarray(column) for column in kinds.T)), offset


def _kinds(points: Points, rows: Rows, eyes: Doubles | None, progress: Progress | None) -> tuple[Flags, Floors]:
    """Classify distinct positions as strays; return their kinds, (m, 4) bool, and the surface near each.

    The columns are: in a second layer, a mixed return, in a floating group, and isolated.

    rows : (m,) rows of the points, in kd order
    eyes : (3,) or (n, 3) world position of the scanner that saw each point, NaN where unknown
    """
    positions = np.ascontiguousarray(points.positions[rows])
    floors = find_floors(positions, part_of(progress, 0.0, FLOORED))
    off = np.flatnonzero(floors.off)
    off = off[~faces_back(points, rows, floors, off)]
    layer, isolated = np.zeros((2, len(rows)), np.bool_)
    layer[off] = floors.in_layer[off]
    isolated[off] = ~layer[off]
    isolated |= find_sparse(floors)
    report_progress(progress, FLOORED)
    floating = find_floating(positions, floors, layer | isolated)
    report_progress(progress, GROUPED)
    veil = _veils(points, positions, floors.core, rows, eyes)
    layer, floating = layer & ~veil, floating & ~(layer | veil)
    return np.stack([layer, veil, floating, isolated & ~(layer | veil | floating)], axis=1), floors


def _veils(points: Points, positions: Floats, core: Floats, rows: Rows, eyes: Doubles | None) -> Flags:
    """Return which positions, (m,) bool, are mixed returns between foreground and background of their scanner.

    positions, core : (m, 3), and (m,) distance of each to its eighth neighbour
    rows : (m,) the row of `points` of each position
    eyes : (3,) or (n, 3) world position of the scanner that saw each point, NaN where unknown
    """
    veil = np.zeros(len(rows), np.bool_)
    if eyes is None:
        return veil
    own = np.broadcast_to(eyes, (len(points), 3))[rows]
    known = np.flatnonzero(np.isfinite(own).all(axis=1))
    stations, which = np.unique(own[known], axis=0, return_inverse=True)
    if len(stations) > MOST_STATIONS:  # a moving scanner: each position saw too little
        return veil
    for number, station in enumerate(stations):
        seen = known[which.reshape(-1) == number]
        if len(seen) >= LEAST:
            veil[seen] = find_veils(positions[seen], core[seen], station - points.origin)
    return veil
