"""Colours of the solids, computed from the position on the surface."""

from __future__ import annotations

from math import floor, sin, sqrt

from ..engine.jit import Array, inline, routine
from ..engine.kernels.vec import Vec3
from . import clay
from .clay import Solid
from .smooth import blend
from .solids import CLAY, LATTICE, LATTICE_PITCH, TORUS

EDGE = 0.004  # width of the transition between two colours


@inline
def _lattice_noise(i: int, j: int, k: int) -> float:
    h = (i * 73856093) ^ (j * 19349663) ^ (k * 83492791)
    h = ((h ^ (h >> 13)) * 1274126177) & 0x7FFFFFFF
    return ((h ^ (h >> 16)) & 0xFFFF) / 32767.5 - 1.0


@routine
def noise(x: float, y: float, z: float) -> float:
    """Return value noise at a position: random numbers at integer coordinates, smoothly interpolated, -1 to 1."""
    i, j, k = int(floor(x)), int(floor(y)), int(floor(z))
    u, v, w = x - i, y - j, z - k
    u, v, w = u * u * (3.0 - 2.0 * u), v * v * (3.0 - 2.0 * v), w * w * (3.0 - 2.0 * w)
    total = 0.0
    for c in range(8):
        a, b, d = c & 1, (c >> 1) & 1, c >> 2
        weight = (u if a else 1.0 - u) * (v if b else 1.0 - v) * (w if d else 1.0 - w)
        total += weight * _lattice_noise(i + a, j + b, k + d)
    return total


@inline
def _cloud(x: float, y: float, z: float, scale: float) -> float:
    """Return noise at three scales added up (fractal noise), about -1.75 to 1.75.

    scale : frequency of the coarsest one, in features per unit of length
    """
    n = noise(x * scale, y * scale, z * scale)
    n += 0.5 * noise(2.03 * x * scale + 7.0, 2.03 * y * scale, 2.03 * z * scale)
    return n + 0.25 * noise(4.1 * x * scale, 4.1 * y * scale + 3.0, 4.1 * z * scale)


@inline
def _veins(x: float, y: float, z: float) -> float:
    """Return how much a position lies on the thin winding veins of marble: up to 1 on a vein, 0 away from it."""
    bend = _cloud(x, y, z, 3.0) + 0.30 * _cloud(x, y, z, 14.0)
    line = abs(sin(5.0 * x + 3.0 * y + 9.0 * z + 4.2 * bend))
    strong = 0.5 + 0.5 * noise(4.0 * x + 9.0, 4.0 * y, 4.0 * z)
    return max(1.0 - 2.6 * sqrt(line), 0.0) * max(strong, 0.08)


@inline
def _over(red: float, green: float, blue: float, table: Array, i: int, share: float) -> Vec3:
    """Blend the colour of row i of a table of shapes over a colour; return the new colour.

    table : (strokes, COLUMNS), one row per shape of a sculpture; share : opacity of the new colour, 0 to 1
    """
    red += share * (table[i, clay.COLOR] - red)
    green += share * (table[i, clay.COLOR + 1] - green)
    blue += share * (table[i, clay.COLOR + 2] - blue)
    return red, green, blue


@routine
def _clay_color(solid: Solid, x: float, y: float, z: float) -> Vec3:
    """Return the sRGB colour of a solid made of clay at a surface point: that of the outermost shape (stroke) there.

    It is modified by strokes that only paint, by reliefs (darker in their depths) and by veins of marble.
    """
    table = solid.table
    which = clay.list_of(solid, x, y, z)
    f, red, green, blue, vein, shade = clay.FAR, 0.5, 0.5, 0.5, 0.0, 0.0
    for j in range(solid.starts[which], solid.starts[which + 1]):
        i = solid.items[j]
        op = int(table[i, clay.OP])
        if op == clay.ADD:
            d = clay.shape(table, i, x, y, z)
            share = min(max(0.5 + (f - d) / (2.0 * EDGE), 0.0), 1.0)
            red, green, blue = _over(red, green, blue, table, i, share)
            vein += share * (table[i, clay.VEIN] - vein)
            shade *= 1.0 - share
            f = blend(f, d, table[i, clay.WIDTH])
        elif op == clay.CARVE:
            f = -blend(-f, clay.shape(table, i, x, y, z), table[i, clay.WIDTH])
        elif op == clay.CUT:
            f = -blend(-f, -clay.shape(table, i, x, y, z), table[i, clay.WIDTH])
        elif op == clay.PAINT:
            share = clay.fade(clay.shape(table, i, x, y, z), table[i, clay.WIDTH]) * table[i, clay.ROUND]
            red, green, blue = _over(red, green, blue, table, i, share)
            vein += share * (table[i, clay.VEIN] - vein)
        elif op == clay.RELIEF:
            h = clay.height(table, i, x, y, z)
            f -= h
            # gold, or dirt and light, on raised places
            share = min(max(h / table[i, clay.ROUND], -1.0), 1.0)
            if table[i, clay.COLOR] >= 0.0:
                red, green, blue = _over(red, green, blue, table, i, max(share, 0.0) ** 2)
            else:
                shade += 0.16 * share
    streak = _veins(x, y, z)
    light = 1.0 + shade + 0.045 * _cloud(x, y, z, 6.0) + 0.03 * noise(60.0 * x, 60.0 * y, 60.0 * z)
    if vein >= 0.0:
        light *= 1.0 - vein * streak
        return red * light, green * light, blue * light
    return red * light - vein * streak, green * light - vein * streak, blue * light - 0.8 * vein * streak


@routine
def color(solid: Solid, x: float, y: float, z: float) -> Vec3:
    """Return the sRGB colour of a solid at a surface point, about 0 to 1."""
    if solid.kind == CLAY:
        return _clay_color(solid, x, y, z)
    tint = _cloud(x, y, z, 2.5)
    if solid.kind == TORUS:
        return 0.80 + 0.10 * tint, 0.52 + 0.12 * tint, 0.30 + 0.08 * tint
    if solid.kind == LATTICE:
        s = 0.5 + 0.5 * sin(z * 6.2831853 / LATTICE_PITCH)
        return 0.35 + 0.45 * s + 0.05 * tint, 0.55 + 0.05 * tint, 0.70 - 0.35 * s + 0.05 * tint
    return 0.36 + 0.12 * tint, 0.55 + 0.12 * tint, 0.72 + 0.10 * tint
