"""The city of `scale.py`: statues on relief ground, a given number of distinct points in tiles on disk.

A city is a grid of cells. Half of a cell's points are a statue with random position, rotation and scales, the other
half the ground beneath it. Cells are generated one by one and reproducibly.
"""

from __future__ import annotations

import json
import math
import shutil
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import pointray as pr

EDGE = 4.0  # of a cell; a statue is about 2 high
PER_CELL, LEAST_CELLS = 200_000, 4  # points of a cell, if the city is large
PER_TILE = 4_000_000  # points of a tile, about
TEMPLATES = 6  # clouds of the statue, of different points, that stand in turn
SCALES = 0.8, 1.3  # of a statue, along each axis
SUNK = 0.1  # how deep a statue stands in the ground
ORIGIN = np.array([391_000.0, 5_819_000.0, 34.0])
# Of the ground: radians a unit along x and y, and height.
HILLS, BUMPS, STONES = (
    ((0.21, 0.13, 1.2), (-0.11, 0.17, 0.9)),
    ((0.9, 0.5, 0.12), (-0.7, 1.1, 0.1)),
    ((5.3, 3.1, 0.012),),
)
WAVES = HILLS + BUMPS + STONES
EYES, FLIGHT = 1.4, 1.6  # heights of cameras above the ground
INDEX = "city.json"

Floats = NDArray[np.float64]
Report = Callable[[float], None]


@dataclass(frozen=True)
class City:
    """Settings of a city: `points` in files of a format, ply, las or laz, with or without normals."""

    points: int
    format: str = "ply"
    normals: bool = True

    @cached_property
    def cells(self) -> int:
        """How many there are."""
        return max(round(self.points / PER_CELL), LEAST_CELLS)

    @cached_property
    def side(self) -> int:
        """Cells in a row."""
        return math.ceil(math.sqrt(self.cells))

    @property
    def width(self) -> float:
        """Edge of the city, which begins at the origin."""
        return self.side * EDGE

    def points_of(self, cell: int) -> int:
        """How many points a cell has."""
        return (cell + 1) * self.points // self.cells - cell * self.points // self.cells

    @property
    def statue(self) -> int:
        """How many points a statue has."""
        return self.points // self.cells // 2

    def tiles(self) -> list[range]:
        """The cells of each tile."""
        per_tile = max(min(PER_TILE * self.cells // self.points, self.cells // LEAST_CELLS), 1)
        return [range(k, min(k + per_tile, self.cells)) for k in range(0, self.cells, per_tile)]

    def middle_of(self, cell: int) -> Floats:
        """The position of its statue, (2,), about the origin."""
        return (np.array([cell % self.side, cell // self.side]) + 0.5) * EDGE

    # ------------------------------------------------------------------------------------------------------- cameras

    def eye(self, x: float, y: float, above: float) -> Floats:
        """A place above the ground, world."""
        return ORIGIN + np.array([x, y, float(ground(np.array([[x, y]]))[0][0]) + above])

    def far(self, size: tuple[int, int]) -> pr.Camera:
        """The whole city, from above."""
        top = sum(wave[2] for wave in WAVES)
        box = ORIGIN + np.array([[0.0, 0.0, -top], [self.width, self.width, top + 2.5]])
        return pr.Camera.frame(box, (0.45, -1.0, 0.6), size=size)

    def near(self, size: tuple[int, int]) -> pr.Camera:
        """A statue in the middle of the city, seen from the front, and the city behind it."""
        x, y = self.middle_of(self.cells // 2)
        return pr.Camera.look_at(self.eye(x + 0.6, y - 2.4, EYES), self.eye(x, y, 1.1), fov=55, size=size)

    def flight(self, frames: int, size: tuple[int, int]) -> list[pr.Camera]:
        """Above the ground, from one corner through the city in bends."""
        way = np.linspace(0.12, 0.88, frames + 1)
        x, y = way, 0.5 + 0.3 * np.sin(2 * np.pi * way)
        places = [self.eye(a * self.width, b * self.width, FLIGHT) for a, b in zip(x, y, strict=True)]
        steps = np.diff(places, axis=0)
        steps[:, 2] = 0.0
        ahead = steps / np.linalg.norm(steps, axis=1, keepdims=True)
        targets = [place + 4.0 * step - (0, 0, 0.8) for place, step in zip(places, ahead, strict=False)]
        return [
            pr.Camera.look_at(place, target, fov=55, size=size) for place, target in zip(places, targets, strict=False)
        ]


def ground(places: Floats) -> tuple[Floats, Floats]:
    """Heights of the ground at places (n, 2), and its slopes there, (n, 2)."""
    height, slope = np.zeros(len(places)), np.zeros((len(places), 2))
    for k, (a, b, high) in enumerate(WAVES):
        angle = places @ (a, b) + k
        height += high * np.sin(angle)
        slope += (high * np.cos(angle))[:, None] * (a, b)
    return height, slope


@cache
def _template(points: int, seed: int) -> pr.Points:
    return pr.procedural("statue", points, seed)


class Sculptor:
    """Makes the cells of a city."""

    def __init__(self, city: City) -> None:
        self.city = city

    def cell(self, cell: int) -> dict[str, NDArray[Any]]:
        """The points of a cell: positions, about the origin, normals, colors, and what they are of."""
        count = self.city.points_of(cell)
        parts = [self._statue(cell), self._ground(cell, count - self.city.statue)]
        return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}

    def _statue(self, cell: int) -> dict[str, NDArray[Any]]:
        rng = np.random.default_rng([1, cell])
        cloud = _template(self.city.statue, cell % TEMPLATES)
        scales, turn = rng.uniform(*SCALES, 3), rng.uniform(0, 2 * np.pi)
        c, s = math.cos(turn), math.sin(turn)
        rotation = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        x, y = self.city.middle_of(cell) + rng.uniform(-0.5, 0.5, 2)
        foot = np.array([x, y, float(ground(np.array([[x, y]]))[0][0]) - SUNK])
        assert cloud.normals is not None and cloud.colors is not None
        normals = (cloud.normals / scales) @ rotation.T
        return {
            "positions": (cloud.positions * scales) @ rotation.T + foot,
            "normals": normals / np.linalg.norm(normals, axis=1, keepdims=True),
            "colors": cloud.colors,
            "classification": np.full(len(cloud), 6, np.uint8),  # a building, in LAS
        }

    def _ground(self, cell: int, count: int) -> dict[str, NDArray[Any]]:
        rng = np.random.default_rng([2, cell])
        side = math.ceil(math.sqrt(count))
        chosen = np.sort(rng.permutation(side * side)[:count])
        places = np.column_stack([chosen % side, chosen // side]) + rng.uniform(0, 1, (count, 2))
        places = self.city.middle_of(cell) + (places / side - 0.5) * EDGE
        height, slope = ground(places)
        normals = np.column_stack([-slope, np.ones(count)])
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        steep = np.clip(4 * (1 - normals[:, 2:]), 0, 1)
        colors = (1 - steep) * (96, 132, 74) + steep * (150, 126, 98) + rng.uniform(-12, 12, (count, 1))
        return {
            "positions": np.column_stack([places, height]),
            "normals": normals,
            "colors": colors.astype(np.uint8),
            "classification": np.full(count, 2, np.uint8),  # ground
        }


def make(city: City, folder: Path, report: Report = lambda share: None) -> list[Path]:
    """Return the files of a city, in order. Existing files of the same city are reused."""
    wanted, index = asdict(city), folder / INDEX
    if folder.exists() and (not index.exists() or json.loads(index.read_text()) != wanted):
        shutil.rmtree(folder)
    folder.mkdir(parents=True, exist_ok=True)
    index.write_text(json.dumps(wanted))
    sculptor, tiles = Sculptor(city), city.tiles()
    paths = [folder / f"tile-{k:03d}.{city.format}" for k in range(len(tiles))]
    for k, (path, cells) in enumerate(zip(paths, tiles, strict=True)):
        if not path.exists():
            beside = path.with_name(f"part-of-{path.name}")
            pr.write(beside, _points_of(city, (sculptor.cell(cell) for cell in cells)))
            beside.rename(path)
        report((k + 1) / len(tiles))
    return paths


def _points_of(city: City, cells: Iterator[dict[str, NDArray[Any]]]) -> pr.Points:
    kept = [{**cell, "positions": cell["positions"].astype(np.float32)} for cell in cells]
    columns = {name: np.concatenate([cell[name] for cell in kept]) for name in kept[0]}
    normals = columns["normals"].astype(np.float32) if city.normals else None
    attributes = {"classification": columns["classification"]}
    return pr.Points.about(ORIGIN, columns["positions"], normals, columns["colors"], attributes)
