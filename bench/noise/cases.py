"""The cases of `compare.py` with closed shapes: torus, statue, dragon, edges."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from bench.helpers.truth import FOLDER
from bench.noise.clouds import (
    EDGE_POINTS,
    LATTICE_POINTS,
    STATUE_POINTS,
    TORUS_POINTS,
    Cloud,
    Cube,
    Dragon,
    Procedural,
    Torus,
    noisy,
)
from bench.noise.measure import RAYS, Found, Row, around, measured, rms
from bench.noise.surfaces import POISSON, RIMLS, Surface, ours, surfaces
from bench.noise.tables import Figure, Limit, figures

TORUS = {0.1: (0.039, 0.03), 0.3: (0.10, 0.07), 0.5: (0.15, 0.10), 1.0: (0.25, 0.18)}
DEGREES = {0.1: 1.5, 0.3: 3.0, 0.5: 5.0, 1.0: 8.0}
SHAPES = ("statue", "dragon")
NEAR_EDGE, AT_EDGE = 3.0, 0.5  # h


def slack(noise: float) -> float:
    """How deep inside the solid, in h, a ray must have been to count as lost."""
    return 0.5 + 2 * noise


def torus_case(
    noise: float, surface: Surface | None = None, n: int = TORUS_POINTS, rays: int = RAYS, seed: int = 1
) -> Row:
    """The row of one surface of the noisy torus; None: pointray's.

    To measure points moved by a method of one's own: `ours(replace(cloud, positions=moved))` of
    `cloud = noisy(Torus(), n, noise, seed)`.
    """
    cloud = noisy(Torus(), n, noise, seed)
    made = ours(cloud) if surface is None else surface
    return next(iter(measured(cloud, [lambda: made], lambda: around(cloud, rays), slack(noise))))[0]


def torus(noises: Iterable[float], others: list[str], n: int = TORUS_POINTS, rays: int = RAYS) -> Iterator[Figure]:
    """The torus at every noise."""
    for noise in noises:
        cloud = noisy(Torus(), n, noise)
        limits = _torus_limits(noise)
        for row, _ in measured(cloud, surfaces(cloud, others), lambda c=cloud: around(c, rays), slack(noise)):
            yield from figures("torus", row, limits)


def _torus_limits(noise: float) -> dict[str, Limit]:
    """What is asked, in between too."""
    noises = list(TORUS)
    asked, aim = (float(np.interp(noise, noises, [TORUS[x][k] for x in noises])) for k in (0, 1))
    degrees = float(np.interp(noise, noises, list(DEGREES.values())))
    return {
        "depth": Limit(asked, aim),
        "bias": Limit(0.05, 0.025),
        "normals": Limit(degrees, degrees / 2),
        "lost": Limit(0.001, 0.0),
    }


def clouds(
    shapes: Iterable[str], noises: Iterable[float], others: list[str], rays: int = RAYS, folder: Path = FOLDER
) -> Iterator[Figure]:
    """The statue and the dragon, with Poisson of depth 10. RIMLS is too slow for them."""
    some = [peer for peer in others if peer != RIMLS]
    limits = {"depth": Limit(1.0, 1 / 1.5, times=POISSON)}
    for name in shapes:
        known = Dragon(folder) if name == "dragon" else Procedural(name)
        for noise in noises:
            cloud = noisy(known, STATUE_POINTS, noise)
            for row, _ in measured(cloud, surfaces(cloud, some, 10), lambda c=cloud: around(c, rays), slack(noise)):
                yield from figures("clouds", row, limits)


def edges(others: list[str], noise: float = 0.3, rays: int = 4 * RAYS) -> Iterator[Figure]:
    """The cube near its edges, and the lattice, whose struts are 5 h thick, as a whole."""
    cube = noisy(Cube(), EDGE_POINTS, noise)
    limits = {name: Limit(0.5, 0.0, times=POISSON) for name in ("high", "worst")}
    for row, found in measured(cube, surfaces(cube, others), lambda: around(cube, rays), slack(noise)):
        yield from _cube_edges(cube, row, found, limits)
    some = [name for name in others if name != RIMLS]
    lattice = noisy(Procedural("lattice"), LATTICE_POINTS, noise)
    for row, _ in measured(lattice, surfaces(lattice, some), lambda: around(lattice, rays), slack(noise)):
        yield from figures("edges", row, limits)


def _cube_edges(cloud: Cloud, row: Row, found: Found, limits: dict[str, Limit]) -> Iterator[Figure]:
    """Errors of the hits within 3 h of an edge; at the very edge their mean: negative is rounded, positive a ridge."""
    from_edge = Cube().edges(found.x) / cloud.h
    near, at = found.distance[from_edge < NEAR_EDGE], found.distance[from_edge < AT_EDGE]
    if len(at):
        row.depth, row.bias = rms(near), float(at.mean())
        row.high, row.worst = float(np.quantile(np.abs(near), 0.999)), float(np.abs(near).max())
    yield from figures("edges", row, limits)
