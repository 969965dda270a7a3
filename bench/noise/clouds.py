"""Noisy clouds of surfaces known exactly, for `compare.py`: torus, cube, lattice, statue, dragon.

Points are random and uniform in area (the statue's and the dragon's are given), each moved by a Gaussian that is alike
in all directions. Its standard deviation is in spacings h = sqrt(area / n).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

import pointray as pr
from bench.helpers.truth import FOLDER, Floats, Mesh, Shape
from pointray.procedural_models import area

TORUS_POINTS, EDGE_POINTS, LATTICE_POINTS, STATUE_POINTS = 100_000, 100_000, 300_000, 1_000_000


class Exact(Protocol):
    """A surface with a side: closed shapes and walls."""

    name: str
    area: float
    bounds: Floats  # (2, 3)

    def points(self, n: int, rng: np.random.Generator) -> tuple[Floats, Floats]:
        """Positions on the surface and normals, (n, 3) each."""

    def compare(self, x: Floats) -> tuple[Floats, Floats]:
        """Signed distance to the surface, (m,), positive outside, and the unit normal at its nearest point, (m, 3)."""

    def depth(self, origins: Floats, directions: Floats, ends: Floats, h: float) -> Floats:
        """How deep inside the solid rays get before `ends`, (m,)."""


@dataclass(frozen=True)
class Cloud:
    """Points of a surface. normals : the exact ones of the places they were moved from; eye : the scanner, if any"""

    exact: Exact
    label: str
    positions: Floats
    normals: Floats
    h: float
    eye: Floats | None = None

    @property
    def bounds(self) -> Floats:
        """A box around the exact surface and most of the noise."""
        return self.exact.bounds + np.array([[-4.0], [4.0]]) * self.h


def noisy(exact: Exact, n: int, noise: float, seed: int = 1) -> Cloud:
    """Points of a surface with noise of `noise` spacings in each of the three directions."""
    rng = np.random.default_rng(seed)
    positions, normals = exact.points(n, rng)
    h = float(np.sqrt(exact.area / len(positions)))
    moved = positions + noise * h * rng.normal(size=positions.shape)
    return Cloud(exact, f"{exact.name} {noise:g} h", moved, normals, h)


class Formula:
    """A solid with an exact signed distance."""

    name: str
    area: float
    bounds: Floats

    def points(self, n: int, rng: np.random.Generator) -> tuple[Floats, Floats]:
        """As in `Exact`."""
        raise NotImplementedError

    def compare(self, x: Floats) -> tuple[Floats, Floats]:
        """As in `Exact`."""
        raise NotImplementedError

    def depth(self, origins: Floats, directions: Floats, ends: Floats, h: float) -> Floats:
        """Rays walk by 0.7 of the distance, at least a tenth of a spacing, to behind the box."""
        t, least = np.zeros(len(ends)), np.full(len(ends), np.inf)
        middle, size = self.bounds.mean(axis=0), np.linalg.norm(self.bounds[1] - self.bounds[0])
        ends = np.minimum(ends, np.linalg.norm(origins - middle, axis=1) + size / 2)
        alive = np.flatnonzero(t < ends)
        while len(alive):
            f = self.compare(origins[alive] + t[alive, None] * directions[alive])[0]
            least[alive] = np.minimum(least[alive], f)
            t[alive] += np.maximum(0.7 * np.abs(f), 0.1 * h)
            alive = alive[t[alive] < ends[alive]]
        return np.maximum(-least, 0.0)


class Torus(Formula):
    """The torus of radii 1 and 0.4 about the axis z."""

    name, area = "torus", 1.6 * np.pi**2
    bounds = np.array([[-1.4, -1.4, -0.4], [1.4, 1.4, 0.4]])

    def points(self, n: int, rng: np.random.Generator) -> tuple[Floats, Floats]:
        """Rejection sampling: both angles are uniform, accepted by the length of the circle of latitude."""
        u, v = rng.uniform(0, 2 * np.pi, (2, 2 * n + 1000))
        kept = np.flatnonzero(rng.uniform(0, 1.4, len(u)) < 1 + 0.4 * np.cos(v))[:n]
        u, v = u[kept], v[kept]
        normals = np.stack([np.cos(v) * np.cos(u), np.cos(v) * np.sin(u), np.sin(v)], axis=1)
        return np.stack([np.cos(u), np.sin(u), 0 * u], axis=1) + 0.4 * normals, normals

    def compare(self, x: Floats) -> tuple[Floats, Floats]:
        """Distance and direction from the ring in the middle."""
        ring = x * [1, 1, 0] / np.maximum(np.hypot(x[:, 0], x[:, 1]), 1e-300)[:, None]
        away = x - ring
        distance = np.linalg.norm(away, axis=1)
        return distance - 0.4, away / np.maximum(distance, 1e-300)[:, None]


class Cube(Formula):
    """The cube from -1 to 1."""

    name, area = "cube", 24.0
    bounds = np.array([[-1.0] * 3, [1.0] * 3])

    def points(self, n: int, rng: np.random.Generator) -> tuple[Floats, Floats]:
        """Random points of random faces."""
        faces, normals = rng.integers(0, 6, n), np.zeros((n, 3))
        normals[np.arange(n), faces // 2] = faces % 2 * 2.0 - 1
        return np.where(normals != 0, normals, rng.uniform(-1, 1, (n, 3))), normals

    def compare(self, x: Floats) -> tuple[Floats, Floats]:
        """The normal is that of the face that x is farthest out of."""
        beyond = np.abs(x) - 1
        most = beyond.argmax(axis=1)
        normals = np.zeros(x.shape)
        normals[np.arange(len(x)), most] = np.sign(x[np.arange(len(x)), most])
        outside = np.linalg.norm(np.maximum(beyond, 0), axis=1)
        return outside + np.minimum(beyond.max(axis=1), 0), normals

    def edges(self, x: Floats) -> Floats:
        """Distance to the nearest edge, (m,)."""
        off, beyond = (np.abs(x) - 1) ** 2, np.maximum(np.abs(x) - 1, 0) ** 2
        return np.sqrt((off.sum(axis=1, keepdims=True) - off + beyond).min(axis=1))


class Procedural:
    """A shape of `pr.procedural`: statue (even points) or lattice (random ones)."""

    def __init__(self, name: str) -> None:
        self.name, self.area = name, area(name)
        self._shape = Shape(name)
        self.bounds = pr.procedural(name, 20_000).bounds

    def points(self, n: int, rng: np.random.Generator) -> tuple[Floats, Floats]:
        """The statue's points are even, as generated by `pr.procedural`."""
        if self.name == "statue":
            made = pr.procedural(self.name, n)
            return made.positions.astype(np.float64), np.asarray(made.normals, np.float64)
        return self._shape.points(n, "random", int(rng.integers(1 << 31)))

    def compare(self, x: Floats) -> tuple[Floats, Floats]:
        """The distance is `pr.procedural_distance`."""
        return np.asarray(pr.procedural_distance(self.name, x)), self._shape.compare(x)[1]

    def depth(self, origins: Floats, directions: Floats, ends: Floats, h: float) -> Floats:
        """As in `bench/helpers/truth.py`."""
        return self._shape.depth(origins, directions, ends, h)


class Dragon:
    """The mesh of the Stanford dragon, its vertices the points. Raises a ValueError if it is missing."""

    name = "dragon"

    def __init__(self, folder: Path = FOLDER) -> None:
        self._mesh = Mesh("dragon", folder)
        self.area = self._mesh.area
        vertices = self._mesh.points(0, "vertices", 0)[0]
        self.bounds = np.stack([vertices.min(axis=0), vertices.max(axis=0)])

    def points(self, n: int, rng: np.random.Generator) -> tuple[Floats, Floats]:
        """All vertices."""
        return self._mesh.points(n, "vertices", 0)

    def compare(self, x: Floats) -> tuple[Floats, Floats]:
        """The side is the one from which the normal's line leads back to the surface."""
        distance, normals = self._mesh.compare(x)
        step = distance[:, None] * normals
        outside = self._mesh.compare(x - step)[0] <= self._mesh.compare(x + step)[0]
        return np.where(outside, distance, -distance), normals

    def depth(self, origins: Floats, directions: Floats, ends: Floats, h: float) -> Floats:
        """As in `bench/helpers/truth.py`."""
        return self._mesh.depth(origins, directions, ends, h)
