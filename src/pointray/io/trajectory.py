"""Trajectories: the position of a moving scanner at the time of each point."""

from __future__ import annotations

import os
import re
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..base.arguments import check_path, real_numbers
from ..cloud.conversion import PointsLike, check_points
from ..cloud.geographic import LocalFrame, in_file
from .files import headers, read
from .unpacking import packing_of, unpacked

TIMES = ("gps_time", "time", "t", "timestamp", "gpstime", "gps_seconds", "seconds")  # names of times, likeliest first
WORDS = re.compile(r"[A-Za-z]{2,}")  # words of a header or comment; numbers contain single letters at most
NO_NUMBERS = re.compile(r"\b(nan|inf|infinity)\b", re.IGNORECASE)
ADVICE = "name its columns in the first line, for example time,x,y,z"


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Path of a moving scanner, from which `eyes_along` finds the scanner position at the time of each point.

    Parameters
    ----------
    times : (m,) array_like
        At least two, none less than the one before, in the time base of the points' gps_time.
    positions : (m, 3) array_like
        World positions at these times; degrees if the points' file has degrees.

    Raises
    ------
    ValueError
        If a shape is wrong, a number is not finite, or times decrease.

    Examples
    --------
    >>> trajectory = pr.Trajectory((0, 10), [(0, 0, 100), (50, 0, 100)])
    >>> points = pr.Points([(20, 0, 0)], attributes={"gps_time": np.array([5.0])})
    >>> pr.eyes_along(points, trajectory).tolist()
    [[25.0, 0.0, 100.0]]
    """

    times: NDArray[np.float64]
    positions: NDArray[np.float64]

    def __post_init__(self) -> None:
        times = real_numbers(self.times, "times").astype(np.float64)
        positions = real_numbers(self.positions, "positions").astype(np.float64)
        if times.ndim != 1 or len(times) < 2 or not np.isfinite(times).all() or (np.diff(times) < 0).any():
            raise ValueError("times must be at least two finite numbers, none less than the one before")
        if positions.shape != (len(times), 3) or not np.isfinite(positions).all():
            raise ValueError(f"positions must be finite, of shape ({len(times)}, 3) like times, not {positions.shape}")
        object.__setattr__(self, "times", times)
        object.__setattr__(self, "positions", positions)


def read_trajectory(path: str | os.PathLike[str]) -> Trajectory:
    """Read the path of a moving scanner from a text file with a time in each row, or from a cloud with times.

    Raises
    ------
    ValueError
        If there are no times, a row is not finite, there are fewer than two rows, or times decrease.
    """
    name = Path(path).name
    rows = read(path, columns=_columns(path))
    times = next((rows.attributes[time] for time in TIMES if time in rows.attributes), None)
    if times is None or times.ndim != 1:
        raise ValueError(f"{name}: times of the trajectory not found: expected a column gps_time or time; {ADVICE}")
    times = times.astype(np.float64)
    for what, bad in (
        ("has a time or a position that is not a finite number: remove the row", ~(np.isfinite(times) & rows.finite)),
        ("has an earlier time than the previous row: sort the rows by time", np.diff(times, prepend=-np.inf) < 0),
    ):
        if bad.any():
            raise ValueError(f"{name}: row {int(bad.argmax()) + 1:,} of the trajectory {what}")
    if len(times) < 2:
        raise ValueError(f"{name}: expected at least two rows; for a static scanner pass its position as viewpoint")
    return Trajectory(times, in_file(rows.georeference, rows.world))


def _columns(path: str | os.PathLike[str]) -> str | None:
    """Return the columns of a text file without a header, as an argument of `read`: gps_time,x,y,z and - for others.

    Return None if the file names its columns, has fewer than four, or is not text.
    """
    _, format, listing = next(iter(headers(path)))
    names = listing.facts.get("columns")
    if names is None or len(names) < 4 or set(TIMES) & set(names[1:]):
        return None
    file = Path(path)
    with unpacked(file) if packing_of(file) else nullcontext(file) as inner, inner.open("rb") as stream:
        head = stream.read(4096).decode("utf-8", "replace")
    if WORDS.search(NO_NUMBERS.sub("", head)):
        return None
    return ",".join(["gps_time", "x", "y", "z", *"-" * (len(names) - 4)])


def eyes_along(points: PointsLike, trajectory: str | os.PathLike[str] | Trajectory) -> NDArray[np.float64]:
    """Return the scanner position at the time of each point, for `estimate_normals(points, viewpoint=...)`.

    Parameters
    ----------
    points : Points, or what `as_points` accepts
        With the attribute gps_time.
    trajectory : path or Trajectory
        A text file with the columns time, x, y, z, in this order or named in its first line, or a cloud with gps_time;
        rows sorted by time. Coordinates and times are those of the file of the points, degrees if it has degrees.

    Returns
    -------
    (n, 3) float64
        World positions, linearly interpolated; NaN for points before the first or after the last time.

    Raises
    ------
    TypeError
        If an argument has the wrong type.
    OSError
        If the file cannot be opened.
    ValueError
        If the points have no times, none lies within the trajectory, or the trajectory is invalid.

    Examples
    --------
    >>> with open("path.txt", "w") as file:
    ...     print("time,x,y,z", "0,0,0,2", "10,5,0,2", sep=chr(10), file=file)
    >>> points = pr.Points([[0, 3, 0], [1, 3, 0]], attributes={"gps_time": [0.0, 4.0]})
    >>> pr.eyes_along(points, "path.txt").tolist()
    [[0.0, 0.0, 2.0], [2.0, 0.0, 2.0]]
    """
    points = check_points(points)
    times = points.attributes.get("gps_time")
    if times is None or times.ndim != 1:
        raise ValueError("a trajectory needs the attribute gps_time of the points, which is missing: pass a viewpoint")
    if not isinstance(trajectory, Trajectory):
        trajectory = read_trajectory(check_path(trajectory, "trajectory"))
    path = trajectory
    seen = times.astype(np.float64)
    inside = (seen >= path.times[0]) & (seen <= path.times[-1])
    if not inside.any():
        finite = seen[np.isfinite(seen)]
        of = f"{finite.min():.10g} to {finite.max():.10g}" if len(finite) else "not finite"
        raise ValueError(
            f"no point lies within the time range of the trajectory: times of points are {of}, of the trajectory "
            f"{path.times[0]:.10g} to {path.times[-1]:.10g}; use the same time base for both (LAS may subtract "
            "1,000,000,000)"
        )
    eyes, frame = np.full((len(points), 3), np.nan), LocalFrame.of(points.georeference)
    positions = path.positions if frame is None else frame.to_local(path.positions)
    for axis in range(3):
        eyes[inside, axis] = np.interp(seen[inside], path.times, positions[:, axis])
    return eyes
