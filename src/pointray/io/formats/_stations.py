"""Division of points by scanner position, for formats that store scans one after the other."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...cloud.geographic import in_file
from ...cloud.georeference import SCAN
from ...cloud.points import Points
from ._losses import Losses


class Scan(NamedTuple):
    """The points of one scanner position.

    Attributes
    ----------
    station : (3,) tuple of float or None
        Scanner position in the coordinates of the file; None if it is unknown.
    rows : (m,) int array or None
        Row numbers of its points; None: all points.
    size : int
        Number of its points.
    """

    station: tuple[float, float, float] | None
    rows: NDArray[np.integer[Any]] | None
    size: int

    def part(self, begin: int, end: int) -> slice | NDArray[np.integer[Any]]:
        """Return what selects its points `begin` to `end` from the arrays of all points."""
        return slice(begin, end) if self.rows is None else self.rows[begin:end]


def scans_to_write(points: Points, losses: Losses) -> list[Scan]:
    """Divide points by the attribute "scan", an index of the scanner positions; return the scans with points.

    Points of no position come last. `losses` receives texts about what changes.
    """
    stations = _stations_of(points)
    number = points.attributes.get(SCAN)
    if not stations or (number is None and len(stations) == 1):
        return [Scan(stations[0] if stations else None, None, len(points))]
    if number is None or number.ndim > 1 or number.dtype.kind not in "iu":
        losses.append("cannot store the scanner positions: no attribute scan assigns points to them")
        return [Scan(None, None, len(points))]
    known = (number >= 0) & (number < len(stations))
    index = np.where(known, number, len(stations)).astype(np.int32)
    ends = np.cumsum(np.bincount(index, minlength=len(stations) + 1))
    if len(points) == ends[0] or len(points) == ends[-1] - ends[-2]:  # all are in one scan
        order: NDArray[np.integer[Any]] | None = None
    else:
        order = np.argsort(index, kind="stable")
        if (index[1:] < index[:-1]).any():
            losses.append("stores the points scan by scan, in another order")
    places: list[tuple[float, float, float] | None] = [*stations, None]
    scans = [
        Scan(place, None if order is None else order[begin:end], int(end - begin))
        for place, begin, end in zip(places, (0, *ends[:-1]), ends, strict=True)
        if end > begin
    ]
    empty = len(stations) - sum(scan.station is not None for scan in scans)
    if empty:
        losses.append(f"cannot store {empty} scanner position{'s' * (empty > 1)} without points")
    return scans


def _stations_of(points: Points) -> list[tuple[float, float, float]]:
    georeference = points.georeference
    if not georeference.stations:
        return []
    rows = in_file(georeference, np.array(georeference.stations, np.float64))
    return [(float(x), float(y), float(z)) for x, y, z in rows]
