"""Measure a surface by rays: signed distances of the hits from the exact surface, normals, and rays that miss.

Distances are those to the nearest point of the exact surface, not along the rays; positive is outside. Rays are lines
through the ball around the shape, uniform in position and direction (`measure.lines`), so they come from all sides.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from bench.helpers.measure import lines, unit
from bench.helpers.truth import Floats
from bench.noise.clouds import Cloud
from bench.noise.surfaces import Surface

RAYS = 100_000
FAR = 10.0  # h: hits farther from the exact surface do not count in the errors; their share is reported
CELL = 6.0  # h: the size of the cells in which roughness is measured


@dataclass
class Row:
    """What rays through one surface of one cloud found. Lengths are in h, shares in per cent.

    depth, bias : rms and mean of the signed distances; high, worst : the 99.9% quantile and the largest of their size
    normals : rms of the angles to the exact normals, degrees; flipped : share of normals over 90 degrees off
    roughness : rms of the distances about their mean in cells of 6 h: noise, and jumps between layers
    lost : rays that were more than 0.5 h + 2 sigma inside the solid before they hit anything, share of all hits
    far : hits more than 10 h from the surface; seconds : to make the surface
    """

    cloud: str
    surface: str
    hits: int
    depth: float
    bias: float
    high: float
    worst: float
    normals: float
    flipped: float
    roughness: float
    lost: float
    far: float
    seconds: float


@dataclass(frozen=True)
class Found:
    """Hits within FAR of the exact surface. x : places; distance : signed, in h; cosines : between the normals"""

    x: Floats
    distance: Floats
    cosines: Floats
    normals: Floats
    lost: float
    far: float


def found_by(surface: Surface, cloud: Cloud, rays: Iterable[tuple[Floats, Floats]], slack: float = 0.5) -> Found:
    """Trace rays. A ray is lost if it was more than `slack` h inside before it hit anything."""
    parts, lost, far, hits = [], 0, 0, 0
    for origins, directions in rays:
        t, normals = surface.cast(origins, directions)
        hit = np.flatnonzero(np.isfinite(t))
        x = origins[hit] + t[hit, None] * directions[hit]
        distance, exact = cloud.exact.compare(x)
        lost += _lost(cloud, origins, directions, t, hit[(exact * directions[hit]).sum(axis=1) > 0], slack)
        near = np.abs(distance) <= FAR * cloud.h
        far, hits = far + int((~near).sum()), hits + len(hit)
        cosines = np.clip((exact * normals[hit]).sum(axis=1), -1, 1)
        parts.append((x[near], distance[near] / cloud.h, cosines[near], exact[near]))
    joined = [np.concatenate(column) for column in zip(*parts, strict=True)]
    return Found(*joined, 100 * lost / max(hits, 1), 100 * far / max(hits, 1))


def _lost(cloud: Cloud, origins: Floats, directions: Floats, t: Floats, behind: Floats, slack: float) -> int:
    """How many rays came through the surface: they hit nothing, or a side that faces away."""
    asked = np.concatenate([np.flatnonzero(~np.isfinite(t)), behind])
    deep = cloud.exact.depth(origins[asked], directions[asked], t[asked], cloud.h)
    return int((deep > slack * cloud.h).sum())


def row_of(surface: Surface, cloud: Cloud, found: Found) -> Row:
    """The figures of the hits."""
    d, angles = found.distance, np.degrees(np.arccos(found.cosines))
    if not len(d):
        return Row(cloud.label, surface.name, 0, *[np.nan] * 7, found.lost, found.far, surface.seconds)
    return Row(
        cloud.label,
        surface.name,
        len(d),
        rms(d),
        float(d.mean()),
        float(np.quantile(np.abs(d), 0.999)),
        float(np.abs(d).max()),
        rms(angles),
        100 * float((found.cosines < 0).mean()),
        roughness(found, cloud.h),
        found.lost,
        found.far,
        surface.seconds,
    )


def rms(values: Floats) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.square(values, dtype=np.float64).mean()))


def roughness(found: Found, h: float) -> float:
    """Rms of the distances about the mean of those in the same cell, of cells with 5 hits or more.

    Cells are cubes; hits of sides that face different ways are parted by the greatest component of their normals.
    """
    axis = np.abs(found.normals).argmax(axis=1)
    side = 2 * axis + (found.normals[np.arange(len(axis)), axis] > 0)
    keys = np.concatenate([np.floor(found.x / (CELL * h)), side[:, None]], axis=1).astype(np.int64)
    cell = np.unique(keys, axis=0, return_inverse=True)[1].reshape(-1)
    count = np.bincount(cell)
    mean = np.bincount(cell, found.distance) / count
    rest = (found.distance - mean[cell])[count[cell] >= 5]
    return rms(rest) if len(rest) else np.nan


def around(cloud: Cloud, count: int, seed: int = 7) -> Iterable[tuple[Floats, Floats]]:
    """Lines through the ball around a shape."""
    return lines(cloud.bounds, count, seed)


def aimed(targets: Floats, normals: Floats, away: float, seed: int = 7) -> tuple[Floats, Floats]:
    """Rays that end at targets, from a distance, within 60 degrees of the normals: origins, directions."""
    rng = np.random.default_rng(seed)
    d = unit(rng.normal(size=targets.shape))
    d *= np.where((d * normals).sum(axis=1) > 0, -1.0, 1.0)[:, None]
    d = unit(d - 0.6 * normals)  # the steepest tangent, d normal to the surface, comes to 59 degrees
    return targets - away * d, d


def measured(
    cloud: Cloud,
    makers: Iterable[Callable[[], Surface]],
    rays: Callable[[], Iterable[tuple[Floats, Floats]]],
    slack: float = 0.5,
) -> Iterable[tuple[Row, Found]]:
    """A row and the hits of each surface."""
    for make in makers:
        surface = make()
        found = found_by(surface, cloud, rays(), slack)
        yield row_of(surface, cloud, found), found
