"""Scanners for the scenes of `scatter_scenes.py`: from an aircraft, from stations on the ground, from a vehicle.

Each casts rays at the exact geometry; leaves are discs of a model. Beams have a width: objects thinner than the beam
return it as if they were as wide.
"""

from __future__ import annotations

import math
import warnings
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import pointray as pr
from bench.surface.scatter_scenes import CROWN, FENCE, GROUND, SHRUB, SIDE, STRAY, STREET, WIRE, Scene

Floats = NDArray[np.float64]

SAMPLINGS = "airborne 4", "airborne 1", "terrestrial", "vehicle"
RETURNS, GOES_ON = 4, 0.7  # of one beam from the air, and the share of beams that go on behind leaves
STEP = 0.008  # angle between the rays of a station, radians
BEAM = 0.006  # width of the beams, radians
STATIONS = (-9.0, -10.0, 1.7), (10.0, 16.0, 1.7), (19.0, -10.0, 1.7)
LINES, ALONG = 0.25, 0.012  # distance between a vehicle's profiles, metres; angle between rays of a profile
FAR = 32.0  # reach of the vehicle's scanner
STRAYS = 0.002  # share of the rays that return from somewhere in the air
FARTHEST = 600.0  # metres that a ray can go
STEPS = 48  # samples along a ray on which the ground is found, then bisected


class Labelled(NamedTuple):
    """A scan with the truth: positions (n, 3), labels (n,), rows of CLASSES, spacing (n,) of a surface there."""

    positions: Floats
    labels: NDArray[np.int64]
    spacing: Floats

    def noisy(self, noise: float, rng: np.random.Generator) -> NDArray[np.float32]:
        """Return the positions with Gaussian noise in each coordinate; `noise` is in spacings."""
        moved = self.positions + noise * self.spacing[:, None] * rng.normal(size=self.positions.shape)
        return moved.astype(np.float32)


class Caster:
    """First hits of rays with a scene."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        leaves = scene.leaves[0]
        cloud = pr.Points(leaves[:, :3], leaves[:, 3:6])
        self._leaves = pr.Scene()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of normals that differ: so they do
            self._leaves.add(pr.Model(cloud, leaves[:, 6].astype(np.float32), surface="disc", trim=None))

    def cast(
        self, origins: Floats, directions: Floats, t_min: Floats, width: float
    ) -> tuple[Floats, NDArray[np.int64]]:
        """Return the distance and the label of what each ray hits first beyond t_min; inf and -1 of a miss.

        width : the beam's, per unit of distance
        """
        t, labels = self._ground(origins, directions, t_min), np.full(len(origins), GROUND)
        for (corner, u, v), label in zip(*self._scene.rectangles, strict=True):
            _nearer(t, labels, _rectangle(origins, directions, corner, u, v), label, t_min)
        for row, label in zip(*self._scene.cylinders, strict=True):
            _nearer(t, labels, _cylinder(origins, directions, row, width), label, t_min)
        hits = self._leaves.intersect(origins, directions, t_min=t_min)
        found = np.flatnonzero(hits.point >= 0)
        leaf = np.full(len(t), np.inf)
        leaf[found] = hits.t[found]
        closer = leaf < t
        t[closer], labels[closer] = leaf[closer], self._scene.leaves[1][hits.point[closer]]
        labels[~np.isfinite(t)] = -1
        return t, labels

    def _ground(self, origins: Floats, directions: Floats, t_min: Floats) -> Floats:
        low, high = self._scene.relief
        with np.errstate(divide="ignore", invalid="ignore"):
            ends = np.sort((np.array([[low], [high]]) - origins[:, 2]) / directions[:, 2], axis=0)
        begin, end = np.maximum(np.nan_to_num(ends[0], nan=0.0, neginf=0.0), t_min), np.minimum(ends[1], FARTHEST)
        some = np.flatnonzero(begin < end)
        t = np.full(len(origins), np.inf)
        a, b = begin[some], end[some]
        at, bottom = np.full(len(some), np.inf), np.zeros(len(some), np.bool_)
        before = a
        for k in range(1, STEPS + 1):
            now = a + (b - a) * k / STEPS
            below = self._above(origins[some], directions[some], now) <= 0
            first = below & ~bottom
            at[first] = self._bisect(origins[some][first], directions[some][first], before[first], now[first])
            bottom |= below
            before = now
        t[some] = at
        return t

    def _bisect(self, origins: Floats, directions: Floats, above: Floats, below: Floats) -> Floats:
        for _ in range(24):
            middle = (above + below) / 2
            up = self._above(origins, directions, middle) > 0
            above, below = np.where(up, middle, above), np.where(up, below, middle)
        return below

    def _above(self, origins: Floats, directions: Floats, t: Floats) -> Floats:
        at = origins + t[:, None] * directions
        return np.asarray(at[:, 2] - self._scene.height(at[:, 0], at[:, 1]))


def _nearer(t: Floats, labels: NDArray[np.int64], other: Floats, label: int, t_min: Floats) -> None:
    """Keep the nearer hits, in place."""
    closer = (other < t) & (other > t_min)
    t[closer], labels[closer] = other[closer], label


def _rectangle(origins: Floats, directions: Floats, corner: Floats, u: Floats, v: Floats) -> Floats:
    n = np.cross(u, v)
    with np.errstate(divide="ignore", invalid="ignore"):
        t = ((corner - origins) @ n) / (directions @ n)
        at = origins + t[:, None] * directions - corner
        a, b = (at @ u) / (u @ u), (at @ v) / (v @ v)
    return np.where((a >= 0) & (a <= 1) & (b >= 0) & (b <= 1) & (t > 0), t, np.inf)


def _cylinder(origins: Floats, directions: Floats, row: Floats, width: float) -> Floats:
    """Distance at which a beam meets a cylinder: its front, or its middle if the beam is wider."""
    a, axis, radius = row[:3], row[3:6] - row[:3], row[6]
    length = float(np.linalg.norm(axis))
    axis = axis / length
    across = np.cross(directions, axis)
    size = np.maximum(np.linalg.norm(across, axis=1), 1e-9)
    offset = a - origins
    apart = np.abs((offset * across).sum(axis=1)) / size
    t = (np.cross(offset, axis) * across).sum(axis=1) / size**2  # of the place closest to the axis
    beam = width * np.abs(t) / 2
    front = t - np.sqrt(np.maximum(radius**2 - apart**2, 0)) / size
    along = ((origins + t[:, None] * directions) - a) @ axis
    hit = (apart <= np.maximum(radius, beam)) & (along >= 0) & (along <= length) & (front > 0)
    return np.where(hit, front, np.inf)


def scan(scene: Scene, sampling: str, rng: np.random.Generator) -> Labelled:
    """Scan a scene with one of SAMPLINGS."""
    caster = Caster(scene)
    if sampling.startswith("airborne"):
        rows = _airborne(caster, float(sampling.split()[1]), rng)
    else:
        rows = _terrestrial(caster, rng) if sampling == "terrestrial" else _vehicle(caster, rng)
    positions, labels, spacing = (np.concatenate(column) for column in zip(*rows, strict=True))
    inside = np.abs(positions[:, :2]).max(axis=1) < SIDE
    return Labelled(positions[inside], labels[inside], spacing[inside])


def _returns(
    origins: Floats, directions: Floats, t: Floats, labels: NDArray[np.int64], spacing: Floats
) -> tuple[Floats, NDArray[np.int64], Floats]:
    hit = labels >= 0
    return origins[hit] + t[hit, None] * directions[hit], labels[hit], spacing[hit]


def _with_strays(t: Floats, labels: NDArray[np.int64], rng: np.random.Generator, share: tuple[float, float]) -> None:
    """Let some rays return from the air, at a share of the distance, in place."""
    stray = (rng.random(len(t)) < STRAYS) & (labels >= 0)
    t[stray] *= rng.uniform(*share, stray.sum())
    labels[stray] = STRAY


def _airborne(caster: Caster, density: float, rng: np.random.Generator) -> list[tuple[Floats, ...]]:
    """Beams in zigzag lines from a height of 400 metres, 20 degrees aside, several returns each."""
    step = 1 / math.sqrt(density)
    x, y = np.meshgrid(np.arange(-SIDE, SIDE, step), np.arange(-SIDE, SIDE, step))
    x = (
        x
        + np.where(np.arange(len(x))[:, None] % 2 == 0, 0.35, -0.35) * step
        + rng.normal(scale=0.15 * step, size=x.shape)
    )
    y = y + 0.5 * x % step + rng.normal(scale=0.15 * step, size=x.shape)
    ground = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    plane = np.column_stack([np.full(x.size, 145.0 * rng.choice([-1, 1])), ground[:, 1], np.full(x.size, 400.0)])
    directions = ground - plane
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    rows, t_min, spacing = [], np.full(len(x.ravel()), 300.0), np.full(x.size, step)
    for number in range(RETURNS):
        t, labels = caster.cast(plane, directions, t_min, 0.0006)
        t_next = t + 0.25
        if number == 0:
            _with_strays(t, labels, rng, (0.95, 0.99))
        rows.append(_returns(plane, directions, t, labels, spacing))
        on = np.isin(labels, (CROWN, SHRUB, WIRE, FENCE)) & (rng.random(len(labels)) < GOES_ON)
        plane, directions, t_min, spacing = plane[on], directions[on], t_next[on], spacing[on]
    return rows


def _terrestrial(caster: Caster, rng: np.random.Generator) -> list[tuple[Floats, ...]]:
    """Rays at equal angles from three stations."""
    rows = []
    for x, y, z in STATIONS:
        z += float(caster._scene.height(np.float64(x), np.float64(y)))
        up, around = np.arange(-0.9, 1.0, STEP), np.arange(0, 2 * math.pi, STEP)
        elevation, azimuth = (a.ravel() for a in np.meshgrid(up, around, indexing="ij"))
        keep = rng.random(len(azimuth)) < np.cos(elevation)  # as many rays in each solid angle
        rows.append(_from_place(caster, np.array([x, y, z]), elevation[keep], azimuth[keep], rng))
    return rows


def _from_place(
    caster: Caster, place: Floats, elevation: Floats, azimuth: Floats, rng: np.random.Generator
) -> tuple[Floats, ...]:
    c = np.cos(elevation)
    directions = np.column_stack([c * np.cos(azimuth), c * np.sin(azimuth), np.sin(elevation)])
    origins = np.broadcast_to(place, directions.shape)
    t, labels = caster.cast(origins, directions, np.full(len(directions), 1.0), BEAM)
    _with_strays(t, labels, rng, (0.3, 0.9))
    return _returns(origins, directions, t, labels, STEP * np.where(np.isfinite(t), t, 0))


def _vehicle(caster: Caster, rng: np.random.Generator) -> list[tuple[Floats, ...]]:
    """Profiles across the street, every LINES metres, tilted by 20 degrees."""
    xs = np.arange(-SIDE - 5, SIDE + 5, LINES)
    angles = np.arange(-0.45 * math.pi, 1.45 * math.pi, ALONG)  # straight down is not seen
    x, angle = (a.ravel() for a in np.meshgrid(xs, angles, indexing="ij"))
    z = caster._scene.height(x, np.full(len(x), STREET)) + 2.2
    origins = np.column_stack([x, np.full(len(x), STREET), z])
    tilt = math.radians(20)
    ahead, aside = math.sin(tilt), math.cos(tilt)
    directions = np.column_stack([ahead * np.cos(angle), aside * np.cos(angle), np.sin(angle)])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    origins = origins + rng.normal(scale=0.002, size=(len(x), 1)) * [1, 0, 0]
    t, labels = caster.cast(origins, directions, np.full(len(x), 0.5), BEAM)
    labels[t > FAR] = -1
    _with_strays(t, labels, rng, (0.3, 0.9))
    return [_returns(origins, directions, t, labels, np.sqrt(LINES * ALONG * np.where(np.isfinite(t), t, 0)))]
