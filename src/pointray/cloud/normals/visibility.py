"""Visibility test of stations: can the scanner have stood there?

Files of merged or moved clouds contain viewpoints that are coordinate shifts, or meaningless. A scanner sees one
surface in each direction. From any other place surfaces hide each other: the nearest point in direction often belongs
to another surface. In foliage this is true of scanners as well, so only points on smooth surfaces count.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...base.arrays import Doubles, Flags, Floats, Rows
from ..georeference import SCAN
from ..neighbors import distinct, neighbors
from ..points import Points

SAMPLE, MOST = 20_000, 60_000  # sampled points per station; in total
FEW = 100  # stations with fewer pairs of points are accepted
NEAR, FLAT = 9, 0.1  # points that decide whether a surface is smooth; largest ratio of the two smallest eigenvalues
APART = 3.0  # points are on different surfaces if their ranges differ by so many times the distance of NEAR points
# Share of pairs on different surfaces above which a station is ignored. From the scanner it is up to 0.02 on real
# scans, 0.03 with 16 spinning rings, 0.05 on a tree of 3,000 leaves; from elsewhere 0.2 to 0.38 on real merged scans.
HIDDEN = 0.1


def ignored_stations(points: Points) -> tuple[int, ...]:
    """Return the indices of the stations of `points.georeference` from which their points cannot have been seen.

    From there too many points of a sample would be hidden by others. `eyes_of` defines which station saw which points.
    """
    count = len(points.georeference.stations)
    if not count:
        return ()
    some = points.select(station_sample(len(points), count))
    some = some.select(some.finite)
    scans = some.attributes.get(SCAN)
    if scans is None or scans.ndim != 1:
        scans = np.zeros(len(some)) if count == 1 else np.full(len(some), -1)
    stations = np.array(points.georeference.stations, np.float64) - points.origin
    return tuple(k for k, eye in enumerate(stations) if hidden_share(some.positions[scans == k], eye) > HIDDEN)


def station_sample(total: int, stations: int) -> Rows:
    """Return random rows of a cloud of `total` points, ascending, to test `stations` scanner positions with."""
    wanted = min(SAMPLE * stations, MOST)
    if total <= wanted:
        return np.arange(total)
    return np.unique(np.random.default_rng(0).integers(0, total, wanted))


def hidden_share(positions: Floats, eye: Doubles) -> float:
    """Return the share of pairs of points, in nearly one direction from a position, that are on different surfaces.

    A scanner sees one surface in each direction, so from its position the share is small. 0 if there are few pairs.

    positions : (n, 3); eye : (3,) in the same coordinates
    """
    places = positions[station_sample(len(positions), 1)]
    places = np.ascontiguousarray(places[distinct(places)[0]])
    away = places - eye
    ranges = np.hypot(np.hypot(away[:, 0], away[:, 1]), away[:, 2])  # avoids overflow
    seen = (ranges > 0) & np.isfinite(ranges)
    places, ranges = places[seen], ranges[seen]
    if len(places) < max(FEW, NEAR):
        return 0.0
    distances, near = neighbors(places, NEAR)
    smooth, spacing = _are_smooth(places[near]), distances[:, -1]
    beside = _nearest_in_direction(away[seen] / ranges[:, None])
    pairs = smooth & smooth[beside]
    if np.count_nonzero(pairs) < FEW:
        return 0.0
    apart = np.abs(ranges - ranges[beside]) > APART * np.maximum(spacing, spacing[beside])
    return float(apart[pairs].mean())


def _are_smooth(groups: Floats) -> Flags:
    """Return which groups of neighbouring points, (n, k, 3), lie near a plane or a line, (n,) bool."""
    offsets = groups.astype(np.float64) - groups.mean(axis=1, keepdims=True)
    values = np.linalg.eigvalsh(np.einsum("nki,nkj->nij", offsets, offsets))
    return np.asarray(values[:, 0] < FLAT * values[:, 1])


def _nearest_in_direction(directions: Doubles) -> NDArray[np.int32]:
    """Return the row of the direction that is nearest to each one, other than itself, (n,).

    They are centred and scaled before the search: seen from afar, all may be close together.

    directions : (n, 3) unit vectors
    """
    centred = directions - directions.mean(axis=0)
    near = neighbors((centred / (np.abs(centred).max() or 1.0)).astype(np.float32), 2)[1]
    return np.where(near[:, 1] == np.arange(len(near)), near[:, 0], near[:, 1])
