"""Division of points by scanner position, and back, for formats that store scans one after the other."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...cloud.geographic import in_file
from ...cloud.georeference import SCAN
from ...cloud.points import Points
from ._losses import Losses

NO_SCAN = -1  # attribute "scan" of points of unknown scanners, as they are read again


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


class Division(NamedTuple):
    """Scans of a file to be written.

    Attributes
    ----------
    scans : list of Scan
        Scans with points. Points of no scanner position come last.
    states_scan : bool
        Whether readers find the attribute "scan" by the scans, so that it needs no column.
    """

    scans: list[Scan]
    states_scan: bool


def scans_to_write(points: Points, losses: Losses) -> Division:
    """Divide points by the attribute "scan", an index of the scanner positions.

    losses : receives texts about what changes
    """
    stations = _stations_of(points)
    number = points.attributes.get(SCAN)
    usable = number is not None and number.ndim == 1
    if not stations or (not usable and len(stations) == 1):
        return Division([Scan(stations[0] if stations else None, None, len(points))], False)
    if number is None or not usable:
        losses.append("cannot store the scanner positions: no attribute scan assigns points to them")
        return Division([Scan(None, None, len(points))], False)
    with np.errstate(invalid="ignore"):
        known = (number >= 0) & (number < len(stations)) & (number == np.rint(number))
    index = np.full(len(points), len(stations), np.int32)
    index[known] = number[known]
    counts = np.bincount(index, minlength=len(stations) + 1)
    ends = np.cumsum(counts)
    if len(points) == ends[0] or len(points) == counts[-1]:  # all are in one scan
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
    used = counts[:-1] > 0
    states_scan = bool(used.any())
    if states_scan and (np.append(np.cumsum(used) - 1, NO_SCAN)[index] != number).any():
        losses.append("renumbers the attribute scan")
    empty = len(stations) - int(used.sum())
    if empty:
        losses.append(f"cannot store {empty} scanner position{'s' * (empty > 1)} without points")
    return Division(scans, states_scan)


def scan_numbers(placed: Sequence[bool]) -> list[int]:
    """Return the attribute "scan" of each scan of a file: the index of its scanner position.

    Scans without a position get -1, -2 and so on if others have one, otherwise their number in the file.

    placed : whether the file states the scanner position of each scan
    """
    if not any(placed):
        return list(range(len(placed)))
    known = np.cumsum(placed)
    return [int(n - 1 if here else n - k - 1) for k, (n, here) in enumerate(zip(known, placed, strict=True))]


def _stations_of(points: Points) -> list[tuple[float, float, float]]:
    georeference = points.georeference
    if not georeference.stations:
        return []
    rows = in_file(georeference, np.array(georeference.stations, np.float64))
    return [(float(x), float(y), float(z)) for x, y, z in rows]
