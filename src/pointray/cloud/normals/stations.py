"""Signs of normals from scanner positions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...base.arguments import check_numbers, vector
from ...base.arrays import Doubles, Flags, Floats
from ...base.warning_log import warn
from ..georeference import SCAN
from ..points import Points
from .orientation import agree
from .outward import inward_groups
from .visibility import ignored_stations

CLOSE, FEW = 8, 100  # nearest points by which a viewpoint counts as among the points; fewer points decide nothing
AMONG = 1.25  # largest ratio of the last one's distance from the viewpoint to that from the nearest point


def eyes_of(points: Points, ignored: Sequence[int] | None = None) -> Doubles | None:
    """Return the scanner position that saw each point: (n, 3) or (3,) float64, world; None if none is known.

    Rows of unknown scanners are NaN. The attribute "scan" holds the index of each point's station; a single station
    without that attribute saw all points.

    ignored : indices of stations to ignore. None: found by `ignored_stations`; the points must be the whole cloud
    """
    ignored = ignored_stations(points) if ignored is None else ignored
    stations = np.array(points.georeference.stations, np.float64).reshape(-1, 3)
    scans = points.attributes.get(SCAN)
    if scans is None or scans.ndim != 1:
        return stations[0] if len(stations) == 1 and not ignored else None
    with np.errstate(invalid="ignore"):
        known = (scans >= 0) & (scans < len(stations)) & (scans == np.rint(scans)) & ~np.isin(scans, ignored)
    if not known.any():
        return None
    eyes = np.full((len(points), 3), np.nan)
    eyes[known] = stations[scans[known].astype(np.int64)]
    return eyes


def check_eyes(viewpoint: ArrayLike, n: int) -> Doubles:
    """Validate the scanner position, or those of n points, NaN where unknown; return them as (3,) or (n, 3) float64."""
    eyes = check_numbers(viewpoint, "viewpoint", "three numbers, or three for each point").astype(np.float64)
    if eyes.ndim != 2:
        return vector(viewpoint, "viewpoint")
    if eyes.shape != (n, 3):
        raise ValueError(f"viewpoint must have the shape (3,) or ({n}, 3), a row for each point, not {eyes.shape}")
    return eyes


def check_outside(positions: Floats, eye: Doubles) -> None:
    """Raise a ValueError if a scanner position lies among the points, as if in a wall.

    Points exactly at that position do not count: scanners write lost returns there.

    positions : (n, 3); eye : (3,) in the same coordinates
    """
    distances = np.linalg.norm(positions - eye, axis=1)
    distances[distances == 0] = np.inf
    if np.isfinite(distances).sum() < FEW:
        return
    nearest = int(distances.argmin())
    around = np.linalg.norm(positions - positions[nearest], axis=1)
    if np.partition(distances, CLOSE)[CLOSE] < AMONG * np.partition(around, CLOSE)[CLOSE]:
        raise ValueError(
            f"the viewpoint lies among the points, {distances[nearest]:.3g} from the nearest: "
            "pass the position of the scanner"
        )


def warn_of_ignored(ignored: Sequence[int], count: int) -> None:
    """Warn that some stations of a file are ignored, as their points cannot have been seen from there.

    ignored : indices of these stations; count : number of all
    """
    if not ignored:
        return
    which = "the viewpoint of the file is not a scanner position"
    if count > 1:
        which = f"{len(ignored):,} of {count:,} viewpoints of the file are not scanner positions"
    warn(f"{which}: ignored for normals", stacklevel=3)


def warn_of_lost_scans(points: Points) -> None:
    """Warn if points belong to scans (by the attribute "scan") for which a file with stations has no station."""
    scans, count = points.attributes.get(SCAN), len(points.georeference.stations)
    if scans is None or scans.ndim != 1 or not count:
        return
    with np.errstate(invalid="ignore"):
        lost = np.isfinite(scans) & (scans >= 0) & ~((scans < count) & (scans == np.rint(scans)))
    if lost.any():
        warn(
            f"{lost.sum():,} of {len(points):,} points belong to scans such as {scans[lost][0]:g}, but stations "
            f"are given only for 0 to {count - 1}: their normals follow those of neighbours; pass viewpoint= if known",
            stacklevel=3,
        )


def is_known(eyes: NDArray[Any]) -> Flags:
    """Return which scanner positions, (n, 3), are known, (n,) bool: those that are finite."""
    return np.asarray(np.isfinite(eyes).all(axis=1))


def faced(positions: Floats, normals: Floats, eyes: NDArray[Any]) -> Flags:
    """Return which normals do not face away from the scanner, (n,) bool; true where its position is unknown.

    positions, normals, eyes : (n, 3) points, their normals, and the scanner position of each
    """
    return ~(np.einsum("ij,ij->i", normals, eyes - positions) < 0)


def orient_unknown(positions: Floats, normals: Floats, near: NDArray[np.int32], known: Flags) -> None:
    """Turn normals of points whose scanner is unknown so that they agree with the others, in place.

    In each connected group the normals with known scanners vote; a group without any is turned outward, as by `orient`.

    positions, normals, near : (n, 3), (n, 3), and (n, k) rows of the neighbours, the point itself first
    known : (n,) whether the scanner is known, and the normal turned towards it
    """
    signs, groups = agree(positions, normals, near)
    votes = np.bincount(groups[known], signs[known], groups.max() + 1)
    seen = np.bincount(groups[known], minlength=len(votes)) > 0
    away = votes < 0
    if not seen.all():
        away[~seen] = inward_groups(positions, normals, signs, groups)[~seen]
    normals[~known] *= (signs * np.where(away, -1, 1)[groups])[~known, None]
