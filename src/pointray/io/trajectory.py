"""Trajectories: where a scanner that moves was when it saw each point."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.arguments import check_kind, check_path
from ..cloud.geographic import LocalFrame, in_file
from ..cloud.points import Points
from .files import headers, read

TIMES = ("gps_time", "time", "t", "timestamp", "gpstime", "gps_seconds", "seconds")  # names of times, likeliest first
WORDS = re.compile(r"[A-Za-z]{2,}")  # in a header or a comment; numbers have single letters, if any
NO_NUMBERS = re.compile(r"\b(nan|inf|infinity)\b", re.IGNORECASE)
HOW = "name its columns in the first line, like time,x,y,z"

Doubles = NDArray[np.float64]


class Trajectory(NamedTuple):
    """Where a scanner was: times that do not fall, (m,) float64, and world positions, (m, 3) float64."""

    times: Doubles
    positions: Doubles


def read_trajectory(path: str | os.PathLike[str]) -> Trajectory:
    """Read a trajectory: text or a cloud with times, in the order of its times.

    Raises
    ------
    ValueError
        If there are no times, rows with numbers that are not finite, fewer than two rows, or times that fall.
    """
    name = Path(path).name
    rows = read(path, columns=_columns(path))
    times = next((rows.attributes[time] for time in TIMES if time in rows.attributes), None)
    if times is None or times.ndim != 1:
        raise ValueError(f"{name}: a trajectory needs times, and there is no column gps_time or time: {HOW}")
    times = times.astype(np.float64)
    for what, bad in (
        ("has a time or a position that is not a finite number: leave it out", ~(np.isfinite(times) & rows.finite)),
        ("has an earlier time than the row before: sort the rows by time", np.diff(times, prepend=-np.inf) < 0),
    ):
        if bad.any():
            raise ValueError(f"{name}: row {int(bad.argmax()) + 1:,} of the trajectory {what}")
    if len(times) < 2:
        raise ValueError(f"{name}: a trajectory needs at least two rows: for a scanner that stands pass its viewpoint")
    return Trajectory(times, in_file(rows.survey, rows.world))


def _columns(path: str | os.PathLike[str]) -> str | None:
    """The columns of a text without any words: time, x, y, z, others."""
    _, format, listing = next(iter(headers(path)))
    names = listing.facts.get("columns")
    if names is None or len(names) < 4 or set(TIMES) & set(names[1:]):
        return None
    with Path(path).open("rb") as file:
        head = file.read(4096).decode("utf-8", "replace")
    if WORDS.search(NO_NUMBERS.sub("", head)):
        return None
    return ",".join(["gps_time", "x", "y", "z", *"-" * (len(names) - 4)])


def eyes_along(points: Points, trajectory: str | os.PathLike[str] | Trajectory) -> Doubles:
    """Where the scanner was when it saw each point, for `estimate_normals(points, viewpoint=...)`.

    Parameters
    ----------
    points : Points
        With the attribute gps_time.
    trajectory : path or Trajectory
        A file: text with columns time, x, y, z, in this order or named in its first line, or a cloud with gps_time, its
        rows sorted by time. Coordinates and times as in the file of the points, in degrees if that has degrees.

    Returns
    -------
    (n, 3) float64
        World, linear between the rows of the trajectory; NaN for points before its first or after its last time.

    Raises
    ------
    ValueError
        If the points have no times, none of them lies within the trajectory, or the trajectory is damaged.
    """
    check_kind(points, "points", Points, "Points")
    times = points.attributes.get("gps_time")
    if times is None or times.ndim != 1:
        raise ValueError("a trajectory needs the points' times, and they have no attribute gps_time: pass a viewpoint")
    if not isinstance(trajectory, Trajectory):
        trajectory = read_trajectory(check_path(trajectory, "trajectory"))
    path = trajectory
    seen = times.astype(np.float64)
    inside = (seen >= path.times[0]) & (seen <= path.times[-1])
    if not inside.any():
        finite = seen[np.isfinite(seen)]
        of = f"{finite.min():.10g} to {finite.max():.10g}" if len(finite) else "not finite"
        raise ValueError(
            f"no point was seen during the trajectory: times of points are {of}, of the trajectory "
            f"{path.times[0]:.10g} to {path.times[-1]:.10g}: give both in the same reckoning (LAS may count "
            "from 1,000,000,000)"
        )
    eyes, frame = np.full((len(points), 3), np.nan), LocalFrame.of(points.survey)
    positions = path.positions if frame is None else frame.to_local(path.positions)
    for axis in range(3):
        eyes[inside, axis] = np.interp(seen[inside], path.times, positions[:, axis])
    return eyes
