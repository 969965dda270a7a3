"""Generated scans with defects for `noise.py`: layers, plates, drift, veils, strays."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bench.helpers.truth import Floats
from bench.noise.clouds import Cloud, Formula, Torus

NOISE = 0.1  # h
LAYER_POINTS, SHARE = 100_000, 0.1  # of the dense layer; of them in the sparse one
RADIUS = 5.0  # of the wall's curve, which is 2 wide
STEP, BEAM = np.radians(0.1), 0.4  # between the beams of the scanner; radius of a beam, in steps
RANGE_NOISE = 0.002
FRONT = 0.05  # a veil's points are farther from everything than that


class Wall(Formula):
    """A gently curved wall over x, y from -1 to 1: a piece of a sphere that touches z = 0 from below.

    offset : along the normals; tilt : turned about y, in degrees
    """

    name = "wall"
    bounds = np.array([[-1, -1, -0.25], [1, 1, 0.05]])

    def __init__(self, offset: float = 0.0, tilt: float = 0.0) -> None:
        self.radius = RADIUS + offset
        self.center = -RADIUS * np.array([np.sin(np.radians(tilt)), 0, np.cos(np.radians(tilt))])
        x, y = np.meshgrid(*[np.linspace(-1, 1, 201)] * 2)
        self.area = float(4 * (RADIUS / np.sqrt(RADIUS**2 - x**2 - y**2)).mean())

    def points(self, n: int, rng: np.random.Generator) -> tuple[Floats, Floats]:
        """Uniform in area, by rejection sampling over the square according to the slope."""
        x = rng.uniform(-1, 1, (2 * n + 1000, 2))
        cosine = np.sqrt(1 - (x**2).sum(axis=1) / RADIUS**2)
        x = x[rng.uniform(0, 1.1, len(x)) < 1 / cosine][:n]
        normals = np.column_stack([x, np.sqrt(RADIUS**2 - (x**2).sum(axis=1))]) / RADIUS
        return self.center + self.radius * normals, normals

    def compare(self, x: Floats) -> tuple[Floats, Floats]:
        """Distance and direction from the sphere's center."""
        away = x - self.center
        distance = np.linalg.norm(away, axis=1)
        return distance - self.radius, away / np.maximum(distance, 1e-300)[:, None]


class Plate(Formula):
    """Both sides of a thin plate, 2 x 2, without its rim."""

    name, area = "plate", 8.0

    def __init__(self, thickness: float) -> None:
        self.half = thickness / 2
        self.bounds = np.array([[-1, -1, -self.half], [1, 1, self.half]])

    def points(self, n: int, rng: np.random.Generator) -> tuple[Floats, Floats]:
        """Random points of random sides."""
        side = rng.integers(0, 2, n) * 2.0 - 1
        normals = np.stack([0 * side, 0 * side, side], axis=1)
        return np.column_stack([rng.uniform(-1, 1, (n, 2)), self.half * side]), normals

    def compare(self, x: Floats) -> tuple[Floats, Floats]:
        """Distance from the nearer side."""
        normals = np.zeros(x.shape)
        normals[:, 2] = np.where(x[:, 2] < 0, -1.0, 1.0)
        return np.abs(x[:, 2]) - self.half, normals


class Room(Formula):
    """What a scanner at the origin sees: a wall 10 away, and a ball and a pole half way before it."""

    name, area = "room", 0.0
    bounds = np.array([[-4.7, 3.9, -3.7], [4.7, 10.1, 3.7]])
    _ball, _pole = np.array([-1.5, 5.0, 0.0]), np.array([1.0, 5.0])

    def points(self, n: int, rng: np.random.Generator) -> tuple[Floats, Floats]:
        """None: `veil` scans it."""
        raise NotImplementedError

    def compare(self, x: Floats) -> tuple[Floats, Floats]:
        """The nearest of the three."""
        ball, pole = x - self._ball, x[:, :2] - self._pole
        sizes = np.linalg.norm(ball, axis=1), np.linalg.norm(pole, axis=1)
        distances = np.stack([10.0 - x[:, 1], sizes[0] - 1.0, sizes[1] - 0.15])
        normals = np.zeros((3, *x.shape))
        normals[0, :, 1] = -1
        normals[1] = ball / np.maximum(sizes[0], 1e-300)[:, None]
        normals[2, :, :2] = pole / np.maximum(sizes[1], 1e-300)[:, None]
        nearest = distances.argmin(axis=0), np.arange(len(x))
        return distances[nearest], normals[nearest]

    def ranges(self, d: Floats) -> Floats:
        """Distance along directions from the origin to the first hit."""
        found = 10.0 / d[:, 1]
        for center, radius, k in ((self._ball, 1.0, 3), (self._pole, 0.15, 2)):
            a, b = (d[:, :k] ** 2).sum(axis=1), d[:, :k] @ center
            root = b * b - a * (center @ center - radius**2)
            found = np.where(root > 0, np.minimum(found, (b - np.sqrt(np.maximum(root, 0))) / a), found)
        return found


@dataclass(frozen=True)
class Scene:
    """A cloud, the parts that its surface may follow, and which of its points are strays or good (the rest: neither).

    targets : points of the exact surface to which rays are sent, and the normals there
    """

    cloud: Cloud
    strays: NDArray[np.bool_]
    good: NDArray[np.bool_]
    targets: tuple[Floats, Floats]
    others: tuple[Formula, ...] = ()


def _joined(label: str, exact: Formula, parts: list[tuple[Floats, Floats]], h: float, targets: Formula) -> Scene:
    """Points of some surfaces with noise; all but those of the first are strays."""
    rng = np.random.default_rng(3)
    positions, normals = (np.concatenate(column) for column in zip(*parts, strict=True))
    positions = positions + NOISE * h * rng.normal(size=positions.shape)
    good = np.arange(len(positions)) < len(parts[0][0])
    places, across = targets.points(40_000, rng)
    inner = np.abs(places[:, :2]).max(axis=1) < 0.9
    cloud = Cloud(exact, label, positions, normals, h)
    return Scene(cloud, ~good, good, (places[inner], across[inner]))


def layers(gap: float, seen: bool = False, share: float = SHARE, n: int = LAYER_POINTS) -> Scene:
    """A wall, and a sparse second layer `gap` spacings in front of it; seen : whether the scanner is known."""
    rng = np.random.default_rng(1)
    wall = Wall()
    h = float(np.sqrt(wall.area / n))
    ghost = Wall(gap * h).points(int(share * n), rng)
    made = _joined(f"layer {gap:g} h before", wall, [wall.points(n, rng), ghost], h, wall)
    if not seen:
        return made
    cloud = replace(made.cloud, label=f"{made.cloud.label}, scanner known", eye=np.array([0.0, 0.0, 10.0]))
    return replace(made, cloud=cloud)


def plate(thickness: float, n: int = LAYER_POINTS) -> Scene:
    """A plate that is some spacings thick: two real sheets, which must stay two."""
    h = float(np.sqrt(Plate.area / n))
    exact = Plate(thickness * h)
    parts = [exact.points(n, np.random.default_rng(1))]
    return _joined(f"plate {thickness:g} h thick", exact, parts, h, exact)


def drift(degrees: float = 1.0, n: int = LAYER_POINTS) -> Scene:
    """Two scans of a wall, one turned about the middle of the wall; the exact surface is half way."""
    rng = np.random.default_rng(1)
    middle, one, other = Wall(), Wall(tilt=-degrees / 2), Wall(tilt=degrees / 2)
    h = float(np.sqrt(middle.area / n))
    parts = [wall.points(n // 2, rng) for wall in (one, other)]
    made = _joined(f"drift of {degrees:g} degree", middle, parts, h, middle)
    all_good = np.ones(len(made.good), np.bool_)
    return Scene(made.cloud, ~all_good, all_good, made.targets, (one, other))


def strays(kind: str, n: int = LAYER_POINTS, share: float = 0.01) -> Scene:
    """A torus with strays: "anywhere" in a box a quarter larger, or "close", 4 to 20 spacings off the surface."""
    rng = np.random.default_rng(1)
    torus = Torus()
    h = float(np.sqrt(torus.area / n))
    positions, normals = torus.points(n, rng)
    positions = positions + NOISE * h * rng.normal(size=positions.shape)
    count = int(share * n)
    if kind == "anywhere":
        extra = 1.25 * rng.uniform(*torus.bounds, (count, 3))
    else:
        on, across = torus.points(count, rng)
        extra = on + (h * rng.uniform(4, 20, count) * rng.choice([-1, 1], count))[:, None] * across
    positions = np.concatenate([positions, extra])
    normals = np.concatenate([normals, torus.compare(extra)[1]])
    good = np.arange(len(positions)) < n
    off = ~good & (np.abs(torus.compare(positions)[0]) > 3 * h)
    cloud = Cloud(torus, f"1% strays {kind}", positions, normals, h)
    return Scene(cloud, off, good, torus.points(40_000, rng))


def veil() -> Scene:
    """A scan with mixed pixels: the range of a beam is the mean over its 19 parts, which may hit different things."""
    room, rng = Room(), np.random.default_rng(1)
    azimuth, height = np.meshgrid(np.radians(np.arange(-25, 25, 0.1)), np.radians(np.arange(-20, 20, 0.1)))
    angles = np.stack([azimuth.ravel(), height.ravel()], axis=1)
    turns = [2 * np.pi * k / m + 0.1 for m in (6, 12) for k in range(m)]
    parts = BEAM * STEP * np.stack([np.cos(turns), np.sin(turns)], axis=1)
    parts[:6] /= 2
    offsets = np.concatenate([np.zeros((1, 2)), parts])
    ranges = np.mean([room.ranges(_directions(angles + offset)) for offset in offsets], axis=0)
    d = _directions(angles)
    positions = d * (ranges + RANGE_NOISE * rng.normal(size=len(d)))[:, None]
    distance, normals = room.compare(positions)
    good = np.abs(distance) < 4 * RANGE_NOISE
    exact = d * room.ranges(d)[:, None]
    cloud = Cloud(room, "veil", positions, normals, float(10 * STEP), np.zeros(3))
    return Scene(cloud, np.abs(distance) > FRONT, good, (exact, room.compare(exact)[1]))


def _directions(angles: Floats) -> Floats:
    """Unit directions of azimuths from +y and heights, (n, 2)."""
    a, b = angles.T
    return np.stack([np.sin(a) * np.cos(b), np.cos(a) * np.cos(b), np.sin(b)], axis=1)
