"""The directions in which patches look for light, and the texels of the sky that links lead to.

A patch's directions are stratified: its hemisphere is cut into parts of equal flux, and each link takes one of them.
Within a part the patches in order take the points of an additive sequence (Roberts 2018: R2): the links of neighbours,
which smoothing averages, complement each other. No direction is kept: it follows from the numbers of patch and link.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from ..engine.jit import inline, uncompiled
from ..engine.kernels.sampling import hash32, on_disc
from ..engine.kernels.vec import Vec3, tangents, turned, unit

SKY_EDGE = 64  # texels a side of the octahedral map of the sky
SKY_TEXELS = SKY_EDGE * SKY_EDGE
CELLS, MOMENTS = 4, 9  # cells a side of a part of the hemisphere, and what is known of each
FINE = 2  # samples a side of a cell
PLASTIC = 0xC13FA9A9, 0x91E10DA5  # 2^32 times 1/p and 1/p^2, of p with p^3 = p + 1
WORD, TO_ONE = 0xFFFFFFFF, 2.0**-32


def strata(links: int) -> tuple[int, int]:
    """(rows, columns) of the parts of a hemisphere: as nearly square as their number allows."""
    rows = math.isqrt(links)
    while links % rows:
        rows -= 1
    return rows, links // rows


@cache
def cell_moments(parts: tuple[int, int]) -> NDArray[np.float64]:
    """Means of x, y, z, xx, xy, xz, yy, yz, zz over CELLS x CELLS cells of each part of the hemisphere about z.

    Returns
    -------
    (rows * columns, CELLS * CELLS, MOMENTS)
    """
    rows, columns = parts
    fine = CELLS * FINE
    u, v = ((np.arange(count * fine) + 0.5) / (count * fine) for count in parts)
    on = cast(Any, uncompiled(on_disc))
    x, y = np.moveaxis(np.array([[on(a, b) for b in v.tolist()] for a in u.tolist()]), 2, 0)
    z = np.sqrt(np.maximum(1.0 - x * x - y * y, 0.0))
    moments = np.stack([x, y, z, x * x, x * y, x * z, y * y, y * z, z * z], axis=2)
    cells = moments.reshape(rows, CELLS, FINE, columns, CELLS, FINE, MOMENTS).mean(axis=(2, 5))
    return cells.transpose(0, 2, 1, 3, 4).reshape(rows * columns, CELLS * CELLS, MOMENTS)


@inline
def _in_part(patch: int, link: int, seed: int) -> tuple[int, int]:
    """Where in its part a link lies, two words of 32 bits."""
    key = hash32((seed * 0x9E3779B9 + link * 0x85EBCA6B) & WORD)
    return (key + patch * PLASTIC[0]) & WORD, (hash32(key ^ 0x2C1B3C6D) + patch * PLASTIC[1]) & WORD


@inline
def link_cell(patch: int, link: int, seed: int) -> int:
    """The row in `cell_moments` of all cells for a patch's link."""
    u, v = _in_part(patch, link, seed)
    return link * CELLS * CELLS + (u * CELLS >> 32) * CELLS + (v * CELLS >> 32)


@inline
def link_direction(normal: Vec3, patch: int, link: int, parts: tuple[int, int], seed: int) -> Vec3:
    """The unit direction of a patch's link: cosine-distributed over all links.

    parts : see `strata`; link : below rows times columns
    """
    rows, columns = parts
    u, v = _in_part(patch, link, seed)
    x, y = on_disc((link // columns + u * TO_ONE) / rows, (link % columns + v * TO_ONE) / columns)
    first, second = tangents(normal)
    z = math.sqrt(max(1.0 - x * x - y * y, 0.0))
    return turned((x, y, z), (first, second, normal))


@inline
def _fold(a: float, b: float) -> float:
    """A coordinate of the lower half of an octahedron, turned outwards."""
    return (1.0 - abs(b)) * (1.0 if a >= 0.0 else -1.0)


@inline
def texel_of(d: Vec3) -> int:
    """The texel of a direction (Cigolle et al. 2014: the octahedral map)."""
    size = 1.0 / max(abs(d[0]) + abs(d[1]) + abs(d[2]), 1e-300)
    x, y = d[0] * size, d[1] * size
    if d[2] < 0.0:
        x, y = _fold(x, y), _fold(y, x)
    column = min(max(int((x * 0.5 + 0.5) * SKY_EDGE), 0), SKY_EDGE - 1)
    row = min(max(int((y * 0.5 + 0.5) * SKY_EDGE), 0), SKY_EDGE - 1)
    return row * SKY_EDGE + column


@inline
def in_texel(texel: int, u: float, v: float) -> Vec3:
    """The unit direction of a point of a texel, two numbers in 0..1."""
    x = 2.0 * (texel % SKY_EDGE + u) / SKY_EDGE - 1.0
    y = 2.0 * (texel // SKY_EDGE + v) / SKY_EDGE - 1.0
    z = 1.0 - abs(x) - abs(y)
    if z < 0.0:
        x, y = _fold(x, y), _fold(y, x)
    return unit((x, y, z))


@cache
def texel_size() -> NDArray[np.float64]:
    """The solid angle of each texel, (SKY_TEXELS,): its area on the octahedron, seen from the middle."""
    fine = 8  # points a side
    u = (np.arange(SKY_EDGE * fine) + 0.5) / (SKY_EDGE * fine) * 2.0 - 1.0
    x, y = np.meshgrid(u, u)
    z = 1.0 - np.abs(x) - np.abs(y)
    folded = np.maximum(-z, 0.0)  # the lower half is that of the mirrored point
    square = (np.abs(x) - folded) ** 2 + (np.abs(y) - folded) ** 2 + z * z
    size = square**-1.5 * (2.0 / (SKY_EDGE * fine)) ** 2
    cells = size.reshape(SKY_EDGE, fine, SKY_EDGE, fine).sum(axis=(1, 3)).reshape(-1)
    return np.asarray(cells * (4.0 * np.pi / cells.sum()))
