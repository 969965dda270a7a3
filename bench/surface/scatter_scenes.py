"""Labelled outdoor scenes for `scatter.py`: ground, a house, trees, shrubs, a fence, wires, a car.

A scene is exact geometry: a height field, rectangles, cylinders, and leaves as flat discs. `scatter_scanners.py` scans
it. Lengths are metres, z is up, the street runs along x at y = -12.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

CLASSES = "ground", "wall", "roof", "car", "trunk", "fence", "crown", "shrub", "wire", "stray"
GROUND, WALL, ROOF, CAR, TRUNK, FENCE, CROWN, SHRUB, WIRE, STRAY = range(len(CLASSES))
GROUNDS = "level", "sloped", "rough"
SIDE = 25.0  # half the side of the scanned square
ROUGH = 0.15  # amplitude of the rough ground
LEAF, LEAVES = 0.04, 160.0  # radius, and number in a cubic metre of a crown
TWIG, TWIGS = 0.025, 500.0  # the same of a shrub
STREET = -12.0


class Scene(NamedTuple):
    """Exact geometry with labels.

    height : heights of the ground at x and y; relief : (lowest, highest) of them
    rectangles : (m, 3, 3) corner and two sides; cylinders : (m, 7) ends and radius; leaves : (m, 7) middle, normal and
    radius; each with labels (m,)
    """

    height: Callable[[Floats, Floats], Floats]
    relief: tuple[float, float]
    rectangles: tuple[Floats, NDArray[np.int64]]
    cylinders: tuple[Floats, NDArray[np.int64]]
    leaves: tuple[Floats, NDArray[np.int64]]


def make_scene(seed: int) -> Scene:
    """Return a scene: which one depends on the seed, and so does its ground (level, sloped or rough, in turn)."""
    rng = np.random.default_rng(seed)
    height, relief = _ground(GROUNDS[seed % 3], rng)
    rectangles = [*_house(height, rng), *_car(height, rng)]
    cylinders, leaves = [*_fence(height, rng), *_wires(height, rng)], []
    for x, y in np.array([[-15, 10], [14, 12], [-14, -4], [17, -5]]) + rng.uniform(-2, 2, (4, 2)):
        trunk, crown = _tree(x, y, height, rng)
        cylinders.append(trunk)
        leaves.append((crown, CROWN))
    for x, y in np.array([[-9, -7], [9, -7], [-4, 17], [4, 18], [20, 4], [-20, 2]]) + rng.uniform(-1, 1, (6, 2)):
        size = np.array([rng.uniform(0.9, 1.6), rng.uniform(0.9, 1.6), rng.uniform(0.7, 1.2)])
        middle = np.array([x, y, float(height(x, y)) + 0.6 * size[2]])
        leaves.append((_leaves(middle, size, TWIGS, TWIG, rng), SHRUB))
    return Scene(height, relief, _joined(rectangles), _joined(cylinders), _all_leaves(leaves))


def _joined(shapes: list[tuple[Floats, int]]) -> tuple[Floats, NDArray[np.int64]]:
    return np.stack([shape for shape, _ in shapes]), np.array([label for _, label in shapes])


def _all_leaves(groups: list[tuple[Floats, int]]) -> tuple[Floats, NDArray[np.int64]]:
    return np.concatenate([rows for rows, _ in groups]), np.repeat(
        [label for _, label in groups], [len(rows) for rows, _ in groups]
    )


def _ground(kind: str, rng: np.random.Generator) -> tuple[Callable[[Floats, Floats], Floats], tuple[float, float]]:
    """Return the heights of a ground and their bounds within twice the scene's size."""
    if kind == "level":
        return lambda x, y: 0.0 * (x + y), (-1e-3, 1e-3)
    angle, slope = rng.uniform(0, 2 * math.pi), math.tan(math.radians(rng.uniform(8, 18)))
    a, b = slope * math.cos(angle), slope * math.sin(angle)
    if kind == "sloped":
        return lambda x, y: a * x + b * y, (-3 * slope * SIDE, 3 * slope * SIDE)
    waves = rng.normal(size=(6, 2)) * np.repeat([0.5, 1.5], 3)[:, None]  # metres of a wave: 12 and 4
    phases, sizes = rng.uniform(0, 2 * math.pi, 6), np.repeat([ROUGH, ROUGH / 4], 3)

    def height(x: Floats, y: Floats) -> Floats:
        rows = [size * np.sin(u * x + v * y + p) for (u, v), p, size in zip(waves, phases, sizes, strict=True)]
        return np.sum(rows, axis=0)

    return height, (-float(sizes.sum()), float(sizes.sum()))


def _box(low: Floats, high: Floats, turn: float, label: int, faces: str) -> list[tuple[Floats, int]]:
    """Return sides of a box, turned around its vertical axis: of "x", "y" both, of "t" the top."""
    size, middle = high - low, (low + high) / 2
    c, s = math.cos(turn), math.sin(turn)
    turned = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])  # rows are the images of the axes
    x, y, z = size[:, None] * turned
    corner = middle - (x + y + z) / 2
    sides = {"x": [(corner, y, z), (corner + x, y, z)], "y": [(corner, x, z), (corner + y, x, z)]}
    sides["t"] = [(corner + z, x, y)]
    return [(np.stack(side), label) for face in faces for side in sides[face]]


def _house(height: Callable[[Floats, Floats], Floats], rng: np.random.Generator) -> list[tuple[Floats, int]]:
    """Return walls, gables cut off flat, and a roof of two slopes with eaves."""
    long, wide, tall = rng.uniform(9, 13), rng.uniform(7, 9), rng.uniform(4, 6)
    turn, eaves, rise = rng.uniform(-0.3, 0.3), 0.6, rng.uniform(0.5, 0.9)
    base = float(height(np.float64(0), np.float64(4)))
    low = np.array([-long / 2, 4 - wide / 2, base - 2.0])
    walls = _box(low, np.array([long / 2, 4 + wide / 2, base + tall]), turn, WALL, "xy")
    c, s = math.cos(turn), math.sin(turn)
    along, across = np.array([c, s, 0.0]), np.array([-s, c, 0.0])
    ridge = np.array([0.0, 4.0, base + tall + rise * wide / 2])
    slopes = []
    for side in (-1.0, 1.0):
        down = side * across * (wide / 2 + eaves) - np.array([0, 0, rise * (wide / 2 + eaves)])
        slopes.append((np.stack([ridge - along * (long / 2 + eaves), along * (long + 2 * eaves), down]), ROOF))
    return [*walls, *slopes]


def _car(height: Callable[[Floats, Floats], Floats], rng: np.random.Generator) -> list[tuple[Floats, int]]:
    """Return a car of two boxes at the side of the street."""
    x, y, turn = rng.uniform(-6, 6), STREET + 3.0, rng.uniform(-0.1, 0.1)
    at = np.array([x, y, float(height(np.float64(x), np.float64(y)))])
    body = _box(at + [-2.2, -0.9, 0.3], at + [2.2, 0.9, 0.9], turn, CAR, "xyt")
    return [*body, *_box(at + [-1.3, -0.8, 0.9], at + [1.0, 0.8, 1.5], turn, CAR, "xyt")]


def _tree(
    x: float, y: float, height: Callable[[Floats, Floats], Floats], rng: np.random.Generator
) -> tuple[tuple[Floats, int], Floats]:
    """Return a trunk and the leaves of a crown."""
    base, tall = float(height(np.float64(x), np.float64(y))), rng.uniform(3.0, 4.0)
    size = np.array([rng.uniform(2, 3), rng.uniform(2, 3), rng.uniform(2.2, 3.2)])
    trunk = np.array([x, y, base - 0.3, x, y, base + tall + size[2], rng.uniform(0.12, 0.25)])
    return (trunk, TRUNK), _leaves(np.array([x, y, base + tall + size[2]]), size, LEAVES, LEAF, rng)


def _leaves(middle: Floats, size: Floats, density: float, radius: float, rng: np.random.Generator) -> Floats:
    """Return leaves of random directions in an ellipsoid, concentrated in clumps."""
    count = int(density * 4 / 3 * math.pi * size.prod())
    lumps = _in_ball(max(count // 400, 6), rng)
    places = np.concatenate(
        [_in_ball(count // 2, rng), lumps[rng.integers(len(lumps), size=count - count // 2)] * 0.85]
    )
    places[count // 2 :] += rng.normal(scale=0.1, size=(count - count // 2, 3))
    normals = _unit(rng.normal(size=(count, 3)))
    return np.column_stack([middle + places * size, normals, rng.uniform(0.6, 1.4, count) * radius])


def _in_ball(count: int, rng: np.random.Generator) -> Floats:
    return _unit(rng.normal(size=(count, 3))) * rng.random((count, 1)) ** (1 / 3)


def _unit(rows: Floats) -> Floats:
    return np.asarray(rows / np.linalg.norm(rows, axis=1, keepdims=True))


def _fence(height: Callable[[Floats, Floats], Floats], rng: np.random.Generator) -> list[tuple[Floats, int]]:
    """Return posts and three rails, two and a half metres at a time."""
    y = -8.5 + rng.uniform(-0.3, 0.3)
    xs = np.arange(-22.0, 22.1, 2.5)
    feet = np.column_stack([xs, np.full(len(xs), y), height(xs, np.full(len(xs), y))])
    posts = [(np.concatenate([foot - [0, 0, 0.2], foot + [0, 0, 1.2], [0.05]]), FENCE) for foot in feet]
    spans = [(a, b, [0, 0, level]) for a, b in zip(feet[:-1], feet[1:], strict=True) for level in (0.4, 0.8, 1.1)]
    return [*posts, *((np.concatenate([a + up, b + up, [0.03]]), FENCE) for a, b, up in spans)]


def _wires(height: Callable[[Floats, Floats], Floats], rng: np.random.Generator) -> list[tuple[Floats, int]]:
    """Return three wires that sag, over the street."""
    wires = []
    for y, tall in zip((-9.0, -7.0, -5.0), rng.uniform(7, 9, 3), strict=True):
        x = np.linspace(-30, 30, 13)
        z = float(height(np.float64(0), np.float64(y))) + tall + 1.2 * (x / 30) ** 2 + 3.0
        line = np.column_stack([x, np.full(13, y), z])
        wires += [(np.concatenate([a, b, [0.012]]), WIRE) for a, b in zip(line[:-1], line[1:], strict=True)]
    return wires
