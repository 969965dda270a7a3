"""Clouds with known up direction: objects, plants, rooms, streets and camera frames, from random parameters.

All are made with z upwards; `turned` gives them another up axis.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from helpers.upright_parts import Box, Capsule, Cloud, Ellipsoid, N, Part, Rng, ground, joined, leaves, solid, unit_rows
from pointray.auto_view.upright import axis_direction

# ----------------------------------------------------------------------------------------------------------- scenes


def tree(rng: Rng, floor: bool = False, cone: bool = False) -> Cloud:
    height, wide = rng.uniform(4, 12), rng.uniform(0.15, 0.3)
    stem, crown = height * rng.uniform(0.3, 0.6), height * wide
    bottom = crown if cone else 0.5 * (height - stem)
    lean = rng.normal(size=2) * 0.02 * height
    top = (*lean, stem + 0.3 * bottom)
    thick = height * rng.uniform(0.012, 0.03)
    trunk = solid([Capsule((0, 0, thick), top, thick)], rng, int(N * rng.uniform(0.15, 0.4)))
    middle = (*lean, 0.5 * (height + stem))
    parts = [trunk, leaves(middle, (crown, crown * rng.uniform(0.8, 1.2), 0.5 * (height - stem)), N // 2, rng, cone)]
    if floor:
        parts.append(ground(*rng.uniform(0.3, 1.2, 2) * height, N // 3, rng, 0.01 * height))
    return joined(*parts)


def forest(rng: Rng) -> Cloud:
    wide, parts = rng.uniform(20, 40), []
    for _ in range(int(rng.integers(5, 12))):
        one = tree(rng, cone=bool(rng.random() < 0.5))
        some = one.select(rng.choice(len(one.positions), N // 10, replace=False))
        parts.append(some._replace(positions=some.positions + (*rng.uniform(-0.5, 0.5, 2) * wide, 0)))
    return joined(ground(wide, wide, N // 2, rng, 0.3), *parts)


def head(rng: Rng) -> Cloud:
    """A head, its neck and shoulders, open below."""
    r = rng.uniform(0.9, 1.1)
    wide = rng.uniform(1.6, 2.4)
    parts = [
        Ellipsoid((0, 0, 0), (0.75 * r, 0.95 * r, 1.15)),
        Ellipsoid((0, -0.95 * r, -0.1), (0.15, 0.25, 0.2)),
        Capsule((0, 0.15, -2.2), (0, 0.1, -0.5), 0.5 * r),
        Capsule((-wide * 0.7, 0.2, -2.4), (wide * 0.7, 0.2, -2.4), rng.uniform(0.5, 0.7)),
        Ellipsoid((0, 0.2, -3.0), (wide, 0.8, 1.2)),
    ]
    cloud = solid(parts, rng)
    return cloud.select(cloud.positions[:, 2] > rng.uniform(-3.2, -2.5))


def bare_head(rng: Rng) -> Cloud:
    """A head that ends at its neck."""
    r = rng.uniform(0.85, 1.1)
    parts = [
        Ellipsoid((0, 0, 0), (0.75 * r, 0.95, 1.15)),
        Ellipsoid((0, -0.95, -0.1), (0.15, 0.25, 0.2)),
        Ellipsoid((0, -0.5, -0.8), (0.45, 0.5, 0.4)),
        Capsule((0, 0.2, -3), (0, 0.15, -0.4), 0.5 * r),
    ]
    cloud = solid(parts, rng)
    return cloud.select(cloud.positions[:, 2] > rng.uniform(-1.9, -1.5))


def person(rng: Rng) -> Cloud:
    h, foot = rng.uniform(0.95, 1.1), rng.uniform(0.1, 0.25)
    arm = rng.uniform(0.25, 0.6)
    parts: list[Part] = [Ellipsoid((0, 0, 1.2 * h), (0.2, 0.13, 0.35)), Ellipsoid((0, 0, 1.68 * h), (0.09, 0.11, 0.13))]
    for side in (-1, 1):
        parts += [Capsule((side * foot, 0, 0.08), (side * 0.1, 0, 0.95 * h), 0.08)]
        parts += [Capsule((side * foot, -0.15, 0.05), (side * foot, 0.05, 0.05), 0.05)]
        parts += [Capsule((side * 0.18, 0, 1.42 * h), (side * arm, rng.normal() * 0.1, 0.9 * h), 0.045)]
    return solid(parts, rng)


def animal(rng: Rng) -> Cloud:
    long, leg, thick = rng.uniform(0.8, 1.6), rng.uniform(0.5, 1.0), rng.uniform(0.2, 0.35)
    parts: list[Part] = [Capsule((-long / 2, 0, leg + thick), (long / 2, 0, leg + thick), thick)]
    parts += [Capsule((long / 2, 0, leg + thick), (0.9 * long, 0, leg + 2.2 * thick), 0.6 * thick)]
    parts += [Ellipsoid((long, 0, leg + 2.8 * thick), (0.9 * thick, 0.6 * thick, 0.6 * thick))]
    for x in (-long / 2, long / 2):
        parts += [Capsule((x, y * thick, 0.1), (x, 0.7 * y * thick, leg), 0.3 * thick) for y in (-0.8, 0.8)]
    return solid(parts, rng)


def chair(rng: Rng) -> Cloud:
    w, h, back = rng.uniform(0.4, 0.6), rng.uniform(0.4, 0.55), rng.uniform(0.35, 0.6)
    parts = [Box((x * w / 2, y * w / 2, h / 2), (0.02, 0.02, h / 2)) for x in (-0.9, 0.9) for y in (-0.9, 0.9)]
    parts += [Box((0, 0, h), (w / 2, w / 2, 0.02)), Box((0, w / 2, h + back / 2), (w / 2, 0.02, back / 2))]
    return solid(parts, rng)


def table(rng: Rng) -> Cloud:
    """A table with things on it."""
    w, d, h = rng.uniform(0.8, 1.8), rng.uniform(0.6, 0.9), rng.uniform(0.6, 0.8)
    parts: list[Part] = [Box((x * w / 2, y * d / 2, h / 2), (0.03, 0.03, h / 2)) for x in (-0.9, 0.9) for y in (-1, 1)]
    parts += [Box((0, 0, h), (w / 2, d / 2, 0.02))]
    for _ in range(3):
        size = rng.uniform(0.05, 0.12, 3)
        parts += [Box((*rng.uniform(-0.35, 0.35, 2), h + 0.02 + size[2]), tuple(size))]
    return solid(parts, rng)


def lamp(rng: Rng) -> Cloud:
    """A street lamp or a traffic sign: a post and something wider on top, with or without a foot."""
    h, r = rng.uniform(2, 6), rng.uniform(0.2, 0.6)
    parts: list[Part] = [Capsule((0, 0, 0), (0, 0, h), rng.uniform(0.03, 0.08))]
    parts += [Ellipsoid((0, 0, h), (r, r, r)) if rng.random() < 0.5 else Box((0, 0, h), (r, 0.03, r))]
    return solid(parts, rng)


def car(rng: Rng) -> Cloud:
    """A car on its wheels, whose bottom was not seen."""
    long, wide, h = rng.uniform(3.8, 4.8), rng.uniform(1.6, 1.9), rng.uniform(0.35, 0.45)
    parts: list[Part] = [Box((0, 0, 0.3 + h), (long / 2, wide / 2, h))]
    parts += [Box((-0.1 * long, 0, 0.3 + 2 * h + 0.25), (0.28 * long, 0.45 * wide, 0.3))]
    parts += [Ellipsoid((x * long, y * wide, 0.33), (0.33, 0.12, 0.33)) for x in (-0.3, 0.3) for y in (-0.5, 0.5)]
    cloud = solid(parts, rng)
    return cloud.select((cloud.normals[:, 2] > -0.9) | (cloud.positions[:, 2] < 0.2))


def house(rng: Rng) -> Cloud:
    """A house with a gabled roof and perhaps a field about it; seen from outside."""
    w, d, h, roof = rng.uniform(6, 12), rng.uniform(6, 9), rng.uniform(3, 6), rng.uniform(2, 4)
    walls = solid([Box((0, 0, h / 2), (w / 2, d / 2, h / 2))], rng, N // 2)
    walls = walls.select(np.abs(walls.normals[:, 2]) < 0.5)
    x, t, side = rng.uniform(-0.55, 0.55, N // 2) * w, rng.random(N // 2), rng.choice((-1.0, 1.0), N // 2)
    slope = np.array([0.0, roof, d / 2]) / np.hypot(roof, d / 2)
    top = Cloud(np.column_stack([x, side * t * d / 2, h + roof * (1 - t)]), np.outer(np.ones(len(x)), slope))
    top.normals[:, 1] *= side
    parts = [walls, top]
    if rng.random() < 0.5:
        field = ground(1.6 * w, 1.8 * d, N // 2, rng)
        parts.append(field.select(~Box((0, 0, 0), (w / 2, d / 2, 1)).holds(field.positions)))
    return joined(*parts)


def room(rng: Rng, ceiling: bool = True, seen: bool = False, n: int = N) -> Cloud:
    """A room with furniture; seen : by a scanner in its middle, whose points are denser nearby."""
    size = np.array([*rng.uniform(3, 8, 2), rng.uniform(2.4, 3.2)])
    shell = solid([Box(tuple(size / 2), tuple(size / 2))], rng, 4 * n)
    shell = shell._replace(normals=-shell.normals)
    if not ceiling:
        shell = shell.select(shell.normals[:, 2] > -0.5)
    furniture: list[Part] = []
    for _ in range(int(rng.integers(3, 8))):
        half = rng.uniform(0.2, 0.6, 3)
        furniture.append(Box((*(half[:2] + rng.random(2) * (size[:2] - 2 * half[:2])), half[2]), tuple(half)))
    things = solid(furniture, rng, n)
    hidden = np.zeros(len(shell.positions), bool)
    for part in furniture:
        hidden |= part._replace(half=tuple(np.array(part.half) + 0.01)).holds(shell.positions)
    cloud = joined(shell.select(~hidden), things.select(things.positions[:, 2] > 0.02))
    if seen:
        return visible(cloud, np.array([*size[:2] / 2, 1.5]), rng)
    return cloud.select(rng.choice(len(cloud.positions), n, replace=False))


def street(rng: Rng, n: int = N) -> Cloud:
    long, wide = rng.uniform(30, 60), rng.uniform(12, 20)
    parts: list[Part] = []
    for side in (-1, 1):
        for x in np.arange(-long / 2, long / 2, 10.0):
            h = rng.uniform(4, 12)
            parts.append(Box((x + 5, side * (wide / 2 + 2), h / 2), (4.8, 2, h / 2)))
    for _ in range(5):
        parts.append(Box((rng.uniform(-0.4, 0.4) * long, rng.choice((-0.25, 0.25)) * wide, 0.75), (2.2, 0.9, 0.75)))
        parts.append(Capsule((rng.uniform(-0.4, 0.4) * long, 0.4 * wide, 0), (0, 0.4 * wide, 5), 0.08))
    parts = [p if not isinstance(p, Capsule) else p._replace(end=(*p.start[:2], 5.0)) for p in parts]
    built = solid(parts, rng, n)
    seen = (built.normals[:, 2] > -0.5) & (np.abs(built.positions[:, 1]) < wide / 2 + 0.1)
    return joined(built.select(seen), ground(long, wide, n // 2, rng, 0.02))


def terrain(rng: Rng) -> Cloud:
    """Hills with some houses and trees on them."""
    wide = rng.uniform(80, 200)
    hills = ground(wide, wide * rng.uniform(0.6, 1), N, rng, wide * rng.uniform(0.01, 0.04))
    parts = [hills]
    for _ in range(6):
        at = hills.positions[rng.integers(len(hills.positions))]
        size = rng.uniform(3, 6, 3)
        one = solid([Box((0, 0, 0), tuple(size))], rng, 150)
        parts.append(Cloud(one.positions + at, one.normals).select(one.normals[:, 2] > -0.5))
    return joined(*parts)


def vase(rng: Rng) -> Cloud:
    """Something turned, which stands on a foot: wider above."""
    heights = np.linspace(0, 1, 200)
    foot, belly, neck = rng.uniform(0.15, 0.3), rng.uniform(0.3, 0.5), rng.uniform(0.08, 0.2)
    radius = np.interp(heights, [0, 0.04, 0.5, 0.85, 1], [foot, foot, belly, neck, neck * 1.3])
    weights = radius + 1e-3
    row = rng.choice(200, N, p=weights / weights.sum())
    angle = rng.random(N) * 2 * np.pi
    slope = np.gradient(radius, heights)[row]
    round_ = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    side = Cloud(
        np.column_stack([round_ * radius[row][:, None], heights[row]]), unit_rows(np.column_stack([round_, -slope]))
    )
    disc = np.sqrt(rng.random(N // 20)) * foot
    bottom = np.column_stack([disc * np.cos(angle[: N // 20]), disc * np.sin(angle[: N // 20]), np.zeros(N // 20)])
    return joined(side, Cloud(bottom, np.tile((0.0, 0.0, -1.0), (N // 20, 1))))


# ---------------------------------------------------------------------------------------------------------- sensors


def visible(cloud: Cloud, eye: np.ndarray, rng: Rng, across: int = 120, down: float = -1.0) -> Cloud:
    """The nearest point in each of the directions of a scanner, which does not see below an elevation (radians)."""
    away = cloud.positions - eye
    far = np.linalg.norm(away, axis=1)
    azimuth, elevation = np.arctan2(away[:, 1], away[:, 0]), np.arcsin(away[:, 2] / far)
    keys = np.floor(np.stack([azimuth, elevation]) / (2 * np.pi) * across).astype(int)
    order = np.argsort(far)
    _, first = np.unique(keys[0][order] * 1000 + keys[1][order], return_index=True)
    rows = order[first]
    chosen = cloud.select(rows[elevation[rows] > down])
    return facing(chosen, eye)


def facing(cloud: Cloud, eye: np.ndarray) -> Cloud:
    """The same, with normals towards a point."""
    away = ((cloud.positions - eye) * cloud.normals).sum(axis=1) > 0
    return cloud._replace(normals=np.where(away[:, None], -cloud.normals, cloud.normals))


def sweep(rng: Rng) -> Cloud:
    """A turn of a scanner on a car, about the scanner."""
    scene = street(rng, 3 * N)
    scene = joined(scene, ground(80, 60, 3 * N, rng, 0.02))
    eye = np.array([rng.uniform(-5, 5), 0.0, rng.uniform(1.5, 2.2)])
    seen = visible(scene, eye, rng, 360, -0.45)
    return seen._replace(positions=seen.positions - eye)


def frame(rng: Rng, make: Callable[..., Cloud] = room) -> Cloud:
    """Return the visible points of a room or street in camera coordinates: x right, y down, z forward."""
    dense = make(rng, n=30 * N)
    low, high = dense.positions.min(axis=0), dense.positions.max(axis=0)
    eye = np.array([*(low + (0.5 + rng.uniform(-0.2, 0.2)) * (high - low))[:2], 1.4])
    turn, tilt = rng.random() * 2 * np.pi, rng.uniform(0.0, 0.5)
    ahead = np.array([np.cos(turn) * np.cos(tilt), np.sin(turn) * np.cos(tilt), -np.sin(tilt)])
    right = np.array([np.sin(turn), -np.cos(turn), 0.0])
    axes = np.stack([right, np.cross(ahead, right), ahead])
    rows = (dense.positions - eye) @ axes.T
    x, y, z = rows.T
    focal, half = 60.0, (40, 30)
    ahead_of = np.flatnonzero(z > 0.3)
    u, v = (np.floor(side[ahead_of] / z[ahead_of] * focal) for side in (x, y))
    inside = (np.abs(u) < half[0]) & (np.abs(v) < half[1])
    order = np.flatnonzero(inside)[np.argsort(z[ahead_of][inside])]
    _, first = np.unique(u[order] * 1000 + v[order], return_index=True)
    kept = order[first]
    depth = z[ahead_of][kept]
    pixels = np.column_stack([(u[kept] + 0.5) / focal, (v[kept] + 0.5) / focal, np.ones(len(kept))])
    return facing(Cloud(pixels * depth[:, None], dense.normals[ahead_of][kept] @ axes.T), np.zeros(3))


def turned(cloud: Cloud, axis: str, rng: Rng) -> Cloud:
    """Return a cloud with another up axis, rotated about it by a random angle."""
    up = np.array(axis_direction(axis))
    side = np.cross(up, rng.normal(size=3))
    side /= np.linalg.norm(side)
    matrix = np.stack([side, np.cross(up, side), up])  # rows: where x, y and z go
    return Cloud(cloud.positions @ matrix, cloud.normals @ matrix)
