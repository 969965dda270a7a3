"""Surfaces of solids that are made of ellipsoids, boxes and capsules, fields and foliage, as points with normals."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

Rng = np.random.Generator
N = 5000  # points of a cloud, about


class Cloud(NamedTuple):
    """Positions and unit normals that point outwards, (n, 3) each."""

    positions: np.ndarray
    normals: np.ndarray

    def select(self, rows: np.ndarray) -> Cloud:
        return Cloud(self.positions[rows], self.normals[rows])


class Ellipsoid(NamedTuple):
    center: tuple[float, float, float]
    radii: tuple[float, float, float]

    def area(self) -> float:
        a, b, c = self.radii
        return 4 * np.pi * ((a * b) ** 1.6 / 3 + (b * c) ** 1.6 / 3 + (a * c) ** 1.6 / 3) ** (1 / 1.6)

    def holds(self, p: np.ndarray) -> np.ndarray:
        return (((p - self.center) / self.radii) ** 2).sum(axis=1) < 1

    def sample(self, n: int, rng: Rng) -> Cloud:
        unit = unit_rows(rng.normal(size=(n, 3)))
        return Cloud(self.center + unit * self.radii, unit_rows(unit / self.radii))


class Box(NamedTuple):
    center: tuple[float, float, float]
    half: tuple[float, float, float]

    def area(self) -> float:
        a, b, c = self.half
        return 8 * (a * b + b * c + a * c)

    def holds(self, p: np.ndarray) -> np.ndarray:
        return (np.abs(p - self.center) < self.half).all(axis=1)

    def sample(self, n: int, rng: Rng) -> Cloud:
        half = np.array(self.half)
        axis = rng.choice(3, n, p=(1 / half) / (1 / half).sum())
        unit, normals = rng.uniform(-1, 1, (n, 3)), np.zeros((n, 3))
        unit[np.arange(n), axis] = normals[np.arange(n), axis] = rng.choice((-1.0, 1.0), n)
        return Cloud(self.center + unit * half, normals)


class Capsule(NamedTuple):
    start: tuple[float, float, float]
    end: tuple[float, float, float]
    radius: float

    def area(self) -> float:
        return 2 * np.pi * self.radius * (2 * self.radius + float(np.linalg.norm(np.subtract(self.end, self.start))))

    def _nearest(self, p: np.ndarray) -> np.ndarray:
        along = np.subtract(self.end, self.start)
        return self.start + np.clip((p - self.start) @ along / (along @ along), 0, 1)[:, None] * along

    def holds(self, p: np.ndarray) -> np.ndarray:
        return np.linalg.norm(p - self._nearest(p), axis=1) < self.radius

    def sample(self, n: int, rng: Rng) -> Cloud:
        around = self.start + rng.random((n, 1)) * np.subtract(self.end, self.start) + rng.normal(size=(n, 3))
        nearest = self._nearest(around)
        normals = unit_rows(around - nearest)
        return Cloud(nearest + self.radius * normals, normals)


Part = Ellipsoid | Box | Capsule


def unit_rows(rows: np.ndarray) -> np.ndarray:
    return rows / np.linalg.norm(rows, axis=1, keepdims=True)


def solid(parts: Sequence[Part], rng: Rng, n: int = N) -> Cloud:
    """Points on the surface of the union of some parts."""
    areas = np.array([part.area() for part in parts])
    clouds = []
    for k, (part, share) in enumerate(zip(parts, areas / areas.sum(), strict=True)):
        cloud = part.sample(max(int(n * share), 20), rng)
        inside = np.zeros(len(cloud.positions), bool)
        for other in (*parts[:k], *parts[k + 1 :]):
            inside |= other.holds(cloud.positions)
        clouds.append(cloud.select(~inside))
    return joined(*clouds)


def joined(*clouds: Cloud) -> Cloud:
    return Cloud(*(np.concatenate(arrays) for arrays in zip(*clouds, strict=True)))


def ground(width: float, depth: float, n: int, rng: Rng, rough: float = 0.0) -> Cloud:
    """A field about the origin, with waves as high as `rough`."""
    x, y = (rng.random((n, 2)) - 0.5).T * np.array([[width], [depth]])
    k = rng.uniform(2, 6, 2) / np.array([width, depth])
    a, b = rng.uniform(0, 6, 2)
    slope = [-rough * k[0] * np.cos(k[0] * x + a), rough * k[1] * np.sin(k[1] * y + b), np.ones(n)]
    heights = rough * (np.sin(k[0] * x + a) + np.cos(k[1] * y + b))
    return Cloud(np.stack([x, y, heights], axis=1), unit_rows(np.stack(slope, axis=1)))


def leaves(center: Sequence[float], radii: Sequence[float], n: int, rng: Rng, cone: bool = False) -> Cloud:
    """Points within an ellipsoid, denser outside, or within a cone that stands on its base."""
    unit = unit_rows(rng.normal(size=(n, 3)))
    rows = unit * rng.random((n, 1)) ** 0.25
    if cone:
        height = 1 - np.sqrt(rng.random(n))
        rows = np.column_stack(
            [unit_rows(unit[:, :2]) * ((1 - height) * rng.random(n) ** 0.3)[:, None], 2 * height - 1]
        )
    return Cloud(center + rows * np.array(radii), unit_rows(rng.normal(size=(n, 3))))
