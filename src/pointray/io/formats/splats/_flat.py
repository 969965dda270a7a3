"""Conversion of points to Gaussian splats, for the writers: a flat Gaussian in the plane of each point's disc.

Its standard deviation is WIDTH support radii. Viewers then show the surface as closed as pointray does, and no larger:
`bench/looks/splats.py` measures the share of the picture that is covered in only one of the two.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....base.arrays import Flags, Floats
from ....base.progress import Progress, part_of, report_progress
from ....base.warning_log import warn
from ....cloud.neighbors import neighbors
from ....cloud.normals.estimate import repair_normals
from ....cloud.points import Points
from .._source import CHUNK
from ._common import shortest_axes
from ._own_shapes import THICKNESS, are_elongated, round_discs, scales_of, turns_of

# Standard deviations in radii. Statue of 60,000 points in close-up: widths of 0.50, 0.55 and 0.60 leave 0.17%, 0.04%
# and 0.01% of the surface open, cover 0.33%, 0.39% and 0.46% beside it, and change colours by 2.8, 2.4 and 2.5 of 255.
# A sphere of 0.71 covers as much area as one with a sharp edge.
WIDTH, BALL = 0.55, 0.71
OPACITY = 254 / 255  # the largest below 1 in 8 bits: its logit is finite
NEAREST, REACH = 8, 0.75  # neighbours, and the support radius in distances to the last: the median of real scans
WIDEST = 2.0  # upper limit in median radii of the neighbours
CLAY = (200, 177, 160)  # sRGB of points without colours, as in pictures
RADIUS, SCALE, ROTATION, ALPHA = "radius", "scale", "rotation", "opacity"  # attributes that are used
LISTED = 4  # attributes named in a message


class FlatSplats:
    """Gaussian splats of the valid rows of a cloud, which are converted part by part.

    Parameters
    ----------
    points : Points
        Points with the normal 0 become spheres. Missing normals are estimated, with a warning. The attribute `radius`
        holds support radii; the attributes `scale`, `rotation` and `opacity`, as read from files of splats, are kept.
    progress : callable, optional
        Called with the completed fraction of the preparation.

    Attributes
    ----------
    count : int
        Number of splats.
    positions : (count, 3) float32
        Relative to the origin of the points.
    lost : list of str
        What files of splats cannot store, in words.
    """

    def __init__(self, points: Points, progress: Progress | None = None) -> None:
        valid = valid_rows(points)
        self.lost = _lost(points, valid)
        cloud = points if valid.all() else points.select(np.flatnonzero(valid))
        self.count, self.positions, self._colors = len(cloud), cloud.positions, cloud.colors
        self._opacity = self._fractions(cloud.attributes.get(ALPHA))
        self._scales = _own_scales(cloud)
        self._turns = self._own_turns(cloud.attributes.get(ROTATION))
        if self._scales is not None and self._turns is not None and cloud.normals is None:
            self._normals = shortest_axes(self._scales, self._turns)
        else:
            self._normals = _normals_of(cloud, part_of(progress, 0.0, 0.5))
        if self._scales is None:
            radii = _radii_of(cloud.attributes.get(RADIUS))
            self._radii = neighbor_radii(cloud.positions, progress) if radii is None else radii
        report_progress(progress, 1.0)

    def _own_turns(self, values: NDArray[Any] | None) -> Floats | None:
        """Return the quaternions of splats that were read, or None; report what is lost without them."""
        if self._scales is None:
            return None
        found = turns_of(values)
        if found is None:
            if long := int(are_elongated(self._scales).sum()):
                self.lost.append(
                    f"makes {counted(long, 'elongated splat')} round, because the points have no attribute {ROTATION}"
                    " of four columns"
                )
            self._scales = round_discs(self._scales)
            return None
        turns, invalid = found
        if invalid:
            self.lost.append(f"does not rotate {counted(invalid, 'splat')} with an invalid {ROTATION}")
        return turns

    def _fractions(self, values: NDArray[Any] | None) -> Floats | None:
        """Return an attribute as opacities, opaque where it is invalid; None without one number per point."""
        if values is None or values.ndim != 1:
            return None
        valid = (values >= 0) & (values <= 1)
        if invalid := len(values) - int(valid.sum()):
            self.lost.append(f"makes {counted(invalid, 'point')} opaque, whose {ALPHA} is not between 0 and 1")
        return np.where(valid, values, OPACITY).astype(np.float32)

    def parts(self, progress: Progress | None = None) -> Iterator[slice]:
        """Yield ranges of rows, and report the completed fraction after each."""
        for start in range(0, self.count, CHUNK):
            stop = min(start + CHUNK, self.count)
            yield slice(start, stop)
            report_progress(progress, stop / self.count)

    def normals(self, part: slice) -> Floats:
        """Return unit normals, (m, 3) float32; 0 for spheres."""
        normals = self._normals[part].astype(np.float64)
        with np.errstate(over="ignore", invalid="ignore"):
            length = np.linalg.norm(normals, axis=1, keepdims=True)
            known = np.isfinite(length) & (length > 0)
            return np.where(known, normals / np.where(known, length, 1), 0).astype(np.float32)

    def colors(self, part: slice) -> NDArray[np.uint8]:
        """Return sRGB colours, (m, 3) uint8."""
        if self._colors is not None:
            return self._colors[part]
        return np.broadcast_to(np.array(CLAY, np.uint8), (part.stop - part.start, 3))

    def opacity(self, part: slice) -> Floats:
        """Return opacities, (m,) float32."""
        if self._opacity is not None:
            return self._opacity[part]
        return np.full(part.stop - part.start, OPACITY, np.float32)

    def shapes(self, part: slice) -> tuple[Floats, Floats]:
        """Return standard deviations along the axes, (m, 3) float32, and unit quaternions w, x, y, z, (m, 4) float32.

        Splats that were read have their own. Of others, the axis that is turned to the normal is the one for which w is
        largest: it is at least 0.45, so that formats which store the other components precisely also determine w.
        """
        if self._scales is not None and self._turns is not None:
            return self._scales[part], self._turns[part]
        normals = self.normals(part)
        every, axis = np.arange(len(normals)), np.argmax(normals, axis=1)
        if self._scales is not None:
            wide, thin = self._scales[part].T
        else:
            radii, flat = self._radii[part], normals.any(axis=1)
            wide = radii * np.where(flat, np.float32(WIDTH), np.float32(BALL))
            thin = wide * np.where(flat, np.float32(THICKNESS), np.float32(1))
        scales = np.repeat(wide[:, None], 3, axis=1)
        scales[every, axis] = thin
        return scales, _turned_to(normals, axis)


def _turned_to(normals: Floats, axis: NDArray[np.intp]) -> Floats:
    """Return the quaternions w, x, y, z, (m, 4), of the shortest rotations of coordinate axes to unit vectors.

    normals : (m, 3) unit vectors, or 0 for no rotation; axis : (m,) coordinate axes, 0 to 2
    """
    every, wide = np.arange(len(normals)), normals.astype(np.float64)
    turns = np.zeros((len(normals), 4))
    turns[:, 0] = 1 + wide[every, axis]  # q = (1 + e n, e x n)
    after, before = (axis + 1) % 3, (axis + 2) % 3
    turns[every, 1 + after] = -wide[every, before]
    turns[every, 1 + before] = wide[every, after]
    return (turns / np.linalg.norm(turns, axis=1, keepdims=True)).astype(np.float32)


def neighbor_radii(positions: Floats, progress: Progress | None = None) -> Floats:
    """Return support radii from the distances of neighbours, (n,) float32, greater than 0.

    positions : (n, 3) float32, finite
    """
    near = neighbors(positions, NEAREST + 1, progress=part_of(progress, 0.5, 1.0))
    radii = np.float32(REACH) * near.distances[:, -1]
    usual = radii[radii > 0]
    if not len(usual):
        return np.ones(len(radii), np.float32)  # all positions are equal
    radii = np.where(radii > 0, radii, np.median(usual)).astype(np.float32)
    for start in range(0, len(radii), CHUNK):
        part = slice(start, start + CHUNK)
        around = np.median(radii[near.indices[part]], axis=1)
        near.distances[part, 0] = np.minimum(radii[part], np.float32(WIDEST) * around)
    return near.distances[:, 0].copy()


def _normals_of(points: Points, progress: Progress | None) -> Floats:
    """Return normals, (n, 3); missing ones are estimated, or 0 where there are too few points for that."""
    if points.normals is not None:
        return points.normals
    try:
        found, message = repair_normals(points, progress)
    except ValueError:  # fewer than three distinct positions
        return np.zeros_like(points.positions)
    if message is not None:
        warn(message, stacklevel=2)
    assert found.normals is not None
    return found.normals


def _radii_of(values: NDArray[Any] | None) -> Floats | None:
    """Return an attribute as radii; None unless it is one positive number per point."""
    if values is None or values.ndim != 1:
        return None
    with np.errstate(over="ignore"):
        radii = values.astype(np.float32)
    return radii if ((radii > 0) & (radii < np.inf)).all() else None


def _lost(points: Points, valid: Flags) -> list[str]:
    """Return what files of splats cannot store of points, in words. valid : (n,), the rows that become splats"""
    lost, finite, georeference = [], points.finite, points.georeference
    missing, invalid = len(points) - int(finite.sum()), int((finite & ~valid).sum())
    if points.origin.any():
        place = ", ".join(f"{x:,.15g}".replace(",", "") for x in points.origin)
        lost.append(f"stores positions relative to ({place}), because viewers of splats use 32-bit floats")
    if missing:
        lost.append(f"leaves out {counted(missing, 'row')} without a finite position")
    if invalid:
        lost.append(f"leaves out {counted(invalid, 'splat')} with an invalid {SCALE}")
    used = (RADIUS, SCALE, ALPHA, ROTATION) if has_scales(points) else (RADIUS, SCALE, ALPHA)
    lost += [*_lost_attributes(points, used), *_unused(points)]
    if georeference.crs:
        lost.append("cannot store the coordinate system")
    if georeference.stations:
        lost.append("cannot store the scanner positions")
    return lost


def lost_of_model(points: Points) -> list[str]:
    """Return what is lost of the attributes of a model's points when its discs are written, in words."""
    if scales_of(points.attributes.get(SCALE)) is None:
        return _lost_attributes(points, (RADIUS, ALPHA))
    replaced = "writes discs of the model instead of the shapes of the splats that were read"
    return [*_lost_attributes(points, (RADIUS, ALPHA, SCALE, ROTATION)), replaced]


def _lost_attributes(points: Points, used: Sequence[str]) -> list[str]:
    """Return a text on the attributes of points that files of splats cannot store; an empty list without any."""
    others = [name for name in points.attributes if name not in used]
    if not others:
        return []
    more = f" and {len(others) - LISTED:,} more" if len(others) > LISTED else ""
    return [f"cannot store the attribute{'s' * (len(others) > 1)} {', '.join(others[:LISTED])}{more}"]


def _unused(points: Points) -> list[str]:
    """Return texts on attributes that files of splats could store, were their values valid."""
    radii, scales, opacity = (points.attributes.get(name) for name in (RADIUS, SCALE, ALPHA))
    lost = []
    if radii is not None and _radii_of(radii) is None:
        lost.append(f"ignores the attribute {RADIUS}: expected one positive number per point")
    if scales is not None and radii is not None:
        lost.append(f"ignores the attribute {SCALE}, because there is an attribute {RADIUS}")
    elif scales is not None and not has_scales(points):
        lost.append(f"ignores the attribute {SCALE}: expected two or three positive numbers per point")
    if opacity is not None and opacity.ndim != 1:
        lost.append(f"ignores the attribute {ALPHA}: expected one number per point")
    return lost


def counted(count: int, what: str) -> str:
    """Return a number with a noun, for messages."""
    return f"{count:,} {what}{'s' * (count != 1)}"


def _own_scales(points: Points) -> Floats | None:
    return None if RADIUS in points.attributes else scales_of(points.attributes.get(SCALE))


def has_scales(points: Points) -> bool:
    """Return whether points are splats that were read from a file: they have standard deviations, and no radii."""
    return _own_scales(points) is not None


def valid_rows(points: Points) -> Flags:
    """Return which points become splats, (n,) bool: those with a finite position and, if it was read, a valid scale."""
    scales = _own_scales(points)
    return points.finite if scales is None else points.finite & scales.any(axis=1)
