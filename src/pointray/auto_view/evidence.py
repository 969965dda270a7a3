"""Evidence for the up direction in a scan's shape: each source scores six axes.

Scores lie between -1 and 1; 0 is neutral. `WEIGHTS` in upright.py scale them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..base.arrays import Doubles, Flags, Rows
from .planes import Planes, fit_planes
from .stability import Ends

AXES = ("x", "-x", "y", "-y", "z", "-z")
LEVEL, PLUMB = 0.95, 0.1  # |cosine| between axis and normal: smallest of horizontal planes, largest of walls
SLABS, SLAB = 40, 2  # layers over the height; adjacent layers that the ground may occupy
THINNEST = 0.015  # smallest layer thickness, as a share of the width
TWO_SIDED = 2.0  # penalty for a horizontal surface at the opposite end
BANDS, WALL = 8, 0.5  # bands over the height; a column with a larger share of occupied bands is a wall
COLUMNS = 12  # across the view along the axis
BELOW = 5.0  # penalty for planes below the ground
SLICES = 20  # of the height, in which the width is measured
THIN = 0.4  # largest width of a trunk, as a share of the greatest width
CENTRED = 0.4  # largest distance of a trunk from the centre, as a share of the greatest width
CROWN = 3  # smallest number of slices about as wide as the widest
LONG = 0.25  # smallest length of a trunk, as a share of the height
FEW = 5  # points in a slice that are too few to judge
AROUND = 16  # sectors about a scanner
BELT = 75.0  # degrees: largest range of elevation that a rotating scanner sees


class Shape(NamedTuple):
    """Points and local planes of a scan, from which the functions of this file score axes as its up direction.

    Attributes
    ----------
    positions, normals : (n, 3) float64
        Without outliers; unknown normals are zero.
    planes : Planes
        Fitted to neighbourhoods of some of the points.
    eye : (3,) float64
        Possible scanner position: the only known one, or else the origin of world coordinates.
    stations : (k, 3) float64
        Known scanner positions.
    """

    positions: Doubles
    normals: Doubles
    planes: Planes
    eye: Doubles
    stations: Doubles

    @classmethod
    def of(cls, positions: Doubles, normals: Doubles, eye: Doubles, stations: Doubles) -> Shape:
        return cls(positions, normals, fit_planes(positions), eye, stations)


Scores = Doubles  # (6,), of `AXES`


def both_ways(scores: list[float]) -> Scores:
    """Expand scores of x, y and z to x, -x, y, -y, z and -z, (6,), the same in both directions."""
    return np.repeat(np.array(scores, np.float64), 2)


def opposed(scores: list[float]) -> Scores:
    """Expand scores of x, y and z to x, -x, y, -y, z and -z, (6,), with opposite signs in opposite directions."""
    return both_ways(scores) * np.array([1, -1] * 3)


def stands(shape: Shape) -> tuple[Scores, Scores, Scores]:
    """Score axes as up by how well the scan stands on its lower end: positive if well, negative if badly.

    Returns three arrays, (6,), for x, -x, y, -y, z and -z: by a stable stance (broad base below the centre, small top),
    by feet, and by a flat lower end.
    """
    ends = [Ends.of(shape.positions, axis) for axis in range(3)]
    stances = np.concatenate([end.stances() for end in ends])
    return stances, opposed([end.feet() for end in ends]), opposed([end.flatness() for end in ends])


def faces(shape: Shape) -> Scores:
    """Score axes, x, -x, y, -y, z and -z, as up by the mean normal: (6,), from -1 to 1.

    Scanners mostly see upper sides, so most normals point up.
    """
    known = shape.normals.any(axis=1)
    return opposed(list(shape.normals[known].mean(axis=0))) if known.any() else np.zeros(6)


def walls(shape: Shape) -> Scores:
    """Score axes, x, -x, y, -y, z and -z, as vertical by walls along them: (6,), from 0 to 1.

    Walls must face several directions. On terrain, steep planes share one direction.
    """
    scores = []
    for axis in range(3):
        upright = shape.planes.flat & (np.abs(shape.planes.normals[:, axis]) < PLUMB)
        if not upright.any():
            scores.append(0.0)
            continue
        # doubled angle: opposite directions count as one
        angle = 2.0 * np.arctan2(*np.delete(shape.planes.normals[upright], axis, axis=1).T)
        one_way = float(np.hypot(np.cos(angle).mean(), np.sin(angle).mean()))
        scores.append(float(upright.mean()) * (1.0 - one_way))
    return both_ways(scores)


def ground(shape: Shape) -> tuple[Scores, Scores]:
    """Score axes, x, -x, y, -y, z and -z, as up, once by the ground and once by the objects on it.

    Returns two arrays, (6,). The first, from 0 to 1, is high with a horizontal surface below everything. The second,
    from -1 to 1, is high if the objects on that surface lie below half of the height.
    """
    floors, things = [], []
    for axis in range(3):
        layers = Layers.of(shape.planes, axis)
        below, above = layers.floor(), layers.upside_down().floor()
        floors += [below * max(1 - TWO_SIDED * above, 0), above * max(1 - TWO_SIDED * below, 0)]
        things.append(min(2 * max(below, above), 1) * layers.lowness())
    return np.array(floors), opposed(things)


class Layers(NamedTuple):
    """Counts of local planes, fitted to neighbourhoods of a scan's points, in a 3D grid of layers along an axis.

    Attributes
    ----------
    planes, level : (layers, COLUMNS, COLUMNS) int64
        Count of all planes, and of those perpendicular to the axis, in each cell. The first index is the layer.
    """

    planes: Rows
    level: Rows

    @classmethod
    def of(cls, planes: Planes, axis: int) -> Layers:
        height = planes.positions[:, axis] - planes.positions[:, axis].min()
        across = np.delete(planes.positions, axis, axis=1)
        across = across - across.min(axis=0)
        width = float(across.max()) or 1.0
        thick = max(float(height.max()) / SLABS, THINNEST * width)
        layer = (height / thick).astype(int)
        cells = np.minimum((across / width * COLUMNS).astype(int), COLUMNS - 1)
        level = planes.flat & (np.abs(planes.normals[:, axis]) > LEVEL)
        shape = (int(layer.max()) + 1, COLUMNS, COLUMNS)
        key = np.ravel_multi_index((layer, cells[:, 0], cells[:, 1]), shape)
        counts = [np.bincount(rows, minlength=int(np.prod(shape))).reshape(shape) for rows in (key, key[level])]
        return cls(*counts)

    def upside_down(self) -> Layers:
        return Layers(self.planes[::-1], self.level[::-1])

    def floor(self) -> float:
        """Return how much of the scan, seen along the axis, a level surface in its lower half covers: 0 to 1.

        Planes below that surface reduce the result.
        """
        whole = np.asarray(self.planes.any(axis=0))
        rim = whole & ~_within(whole)
        best, total = 0.0, self.planes.sum()
        for k in range((len(self.planes) + 1) // 2):
            floor = np.asarray(self.level[k : k + SLAB].any(axis=0))
            shares = floor[whole].mean(), floor[rim].mean() if rim.any() else 0.0
            below = float(self.planes[: max(k - 1, 0)].sum()) / total
            best = max(best, float(np.sqrt(shares[0] * shares[1])) * max(1 - BELOW * below, 0))
        return best

    def lowness(self) -> float:
        """Return how far below half of the height objects on the ground lie, from -1 (above it) to 1.

        Planes of walls, and of the lowest and highest layers, do not count.
        """
        inner = self.planes[SLAB:-SLAB]
        if len(inner) < BANDS:
            return 0.0
        bands = np.stack([band.sum(axis=0) for band in np.array_split(inner, BANDS)])
        bands = bands * ((bands > 0).mean(axis=0) < WALL)
        counts = bands.sum(axis=(1, 2))
        if counts.sum() < FEW:
            return 0.0
        middle = float(counts @ (np.arange(BANDS) + 0.5)) / float(counts.sum()) / BANDS
        return 1.0 - 2.0 * middle


def _within(whole: Flags) -> Flags:
    """Return the cells of a grid whose four neighbours are occupied. whole : (m, m) bool, the occupied cells"""
    wide = np.pad(whole, 1)
    return wide[:-2, 1:-1] & wide[2:, 1:-1] & wide[1:-1, :-2] & wide[1:-1, 2:]


def foliage(shape: Shape) -> Scores:
    """Score axes, x, -x, y, -y, z and -z, as up by foliage above surfaces: (6,), from -1 to 1.

    Foliage fills a volume; surfaces are trunks and the ground. 0 if less than 5% or more than 95% are foliage.
    """
    scattered = shape.planes.scattered
    share = float(scattered.mean()) if len(scattered) else 0.0
    if not 0.05 < share < 0.95:
        return np.zeros(6)
    middle = [shape.planes.positions[rows].mean(axis=0) for rows in (scattered, ~scattered)]
    sizes = np.ptp(shape.positions, axis=0)
    weight = min(share, 1 - share) * 4
    return opposed(list(np.clip((middle[0] - middle[1]) / np.where(sizes > 0, sizes, 1.0) * weight, -1, 1)))


def trunk(shape: Shape) -> Scores:
    """Score axes, x, -x, y, -y, z and -z, as up by a long thin trunk below a wide crown: (6,), from -1 to 1.

    Trees, lamps and signs have one.
    """
    scores = []
    for axis in range(3):
        runs = [_trunk_length(shape.positions, axis, sign) for sign in (1.0, -1.0)]
        scores.append(runs[0] - runs[1])
    return opposed(scores)


def _trunk_length(positions: Doubles, axis: int, sign: float) -> float:
    """Return the length of a trunk at the lower end of an axis: 1 for half of the height or more, 0 for none.

    positions : (n, 3); axis : 0, 1 or 2; sign : 1, or -1 to look at its upper end
    """
    height = sign * positions[:, axis]
    across = np.delete(positions, axis, axis=1)
    slice_of = np.minimum((height - height.min()) / (np.ptp(height) or 1.0) * SLICES, SLICES - 1).astype(int)
    middles, widths = np.full((SLICES, 2), np.nan), np.full(SLICES, np.nan)
    for k in range(SLICES):
        rows = across[slice_of == k]
        if len(rows) >= FEW:
            middles[k] = np.median(rows, axis=0)
            widths[k] = np.quantile(np.linalg.norm(rows - middles[k], axis=1), 0.8)
    widest = float(np.sort(np.nan_to_num(widths))[-CROWN])  # excludes the ground, which fills one or two slices
    if not widest > 0:
        return 0.0
    thinness = np.nan_to_num(1 - widths / (THIN * widest))
    thinness[np.linalg.norm(np.nan_to_num(middles) - np.median(across, axis=0), axis=1) > CENTRED * widest] = 0.0
    start = int(not thinness[0] > 0)  # the first slice may be ground
    ends = np.flatnonzero(thinness[start:] <= 0)
    length = int(ends[0]) if len(ends) else SLICES - start
    return min(2.0 * float(thinness[start : start + length].sum()) / SLICES, 1.0) if length >= LONG * SLICES else 0.0


def turning(shape: Shape) -> Scores:
    """Score axes, x, -x, y, -y, z and -z, as vertical by how flat a belt the points form around the scanner.

    A rotating scanner sees all around itself, but not far up and down. Scores, (6,), are from 0 to 1, and 1 if all
    points have the same elevation.
    """
    away = shape.planes.positions - shape.eye
    far = np.linalg.norm(away, axis=1)
    away = away[far > 0] / far[far > 0, None]
    scores = []
    for axis in range(3):
        elevation = np.degrees(np.arcsin(np.clip(away[:, axis], -1, 1)))
        sector = np.arctan2(*np.delete(away, axis, axis=1).T) / (2 * np.pi) * AROUND
        seen = len(np.unique(np.floor(sector[np.abs(elevation) < 60]))) / AROUND
        span = float(np.ptp(np.quantile(elevation, [0.01, 0.99]))) if len(elevation) else 180.0
        scores.append(max(1 - span / BELT, 0.0) if seen > 0.8 else 0.0)
    return both_ways(scores)


def stationed(shape: Shape) -> Scores:
    """Score axes, x, -x, y, -y, z and -z, as vertical by scanner positions, which have similar heights: (6,).

    -1 for the axis along which they spread most; 0 if there are fewer than two.
    """
    if len(shape.stations) < 2:
        return np.zeros(6)
    spread = shape.stations.std(axis=0)
    return both_ways(list(-spread / (spread.max() or 1.0)))
