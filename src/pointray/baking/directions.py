"""Directions of the link rays of patches, and the texels of the sky that links refer to.

Directions are stratified: the hemisphere of a patch is divided into parts of equal cosine-weighted size, with one link
each. Within a part, successive patches take the points of an additive sequence (R2, Roberts 2018), so that the links of
neighbours, which smoothing averages, complement each other. Directions are not stored: they follow from the numbers of
patch and link.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any, cast

import numpy as np

from ..base.arrays import Doubles
from ..engine.jit import inline, uncompiled
from ..engine.kernels.sampling import hash32, on_disc
from ..engine.kernels.vec import Vec3, tangents, turned, unit

SKY_EDGE = 64  # texels along each side of the octahedral map of the sky
SKY_TEXELS = SKY_EDGE * SKY_EDGE
CELLS, MOMENTS = 4, 9  # cells along each side of a hemisphere part, and moments of each
FINE = 2  # samples along each side of a cell
PLASTIC = 0xC13FA9A9, 0x91E10DA5  # 2^32 / p and 2^32 / p^2, where p^3 = p + 1
WORD, TO_ONE = 0xFFFFFFFF, 2.0**-32


def strata(links: int) -> tuple[int, int]:
    """Return (rows, columns) of the strata of a hemisphere for stratified sampling, as nearly square as possible.

    links : number of rays, one for each stratum
    """
    rows = math.isqrt(links)
    while links % rows:
        rows -= 1
    return rows, links // rows


@cache
def cell_moments(parts: tuple[int, int]) -> Doubles:
    """Tabulate means of products of direction components over small cells of a stratified hemisphere about z.

    A ray's products are looked up here instead of being computed from its direction. The products are x, y, z, xx, xy,
    xz, yy, yz, zz. Each stratum is divided into CELLS x CELLS cells.

    parts : (rows, columns) of the strata

    Returns
    -------
    (rows * columns, CELLS * CELLS, MOMENTS) float64
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
    """Return a ray's position within its stratum of the hemisphere: (u, v), two fractions times 2^32.

    patch, link : the patch that sends the ray, and index of the ray, which is also that of its stratum
    seed : of the random numbers
    """
    key = hash32((seed * 0x9E3779B9 + link * 0x85EBCA6B) & WORD)
    return (key + patch * PLASTIC[0]) & WORD, (hash32(key ^ 0x2C1B3C6D) + patch * PLASTIC[1]) & WORD


@inline
def link_cell(patch: int, link: int, seed: int) -> int:
    """Return the row of `cell_moments`, flattened over strata and cells, of the cell that a patch's ray falls into.

    link : index of the ray, which is also that of its stratum of the hemisphere; seed : of the random numbers
    """
    u, v = _in_part(patch, link, seed)
    return link * CELLS * CELLS + (u * CELLS >> 32) * CELLS + (v * CELLS >> 32)


@inline
def link_direction(normal: Vec3, patch: int, link: int, parts: tuple[int, int], seed: int) -> Vec3:
    """Return the unit direction of a ray that a patch sends to find where its light comes from.

    All rays of a patch together are stratified and cosine-distributed.

    normal : of the patch; link : index of the ray, below rows times columns
    parts : (rows, columns) of the strata of the hemisphere; seed : of the random numbers
    """
    rows, columns = parts
    u, v = _in_part(patch, link, seed)
    x, y = on_disc((link // columns + u * TO_ONE) / rows, (link % columns + v * TO_ONE) / columns)
    first, second = tangents(normal)
    z = math.sqrt(max(1.0 - x * x - y * y, 0.0))
    return turned((x, y, z), (first, second, normal))


@inline
def _fold(a: float, b: float) -> float:
    """Fold the lower half of an octahedral map outwards: return the new value of a coordinate.

    a : the coordinate, before folding; b : the other coordinate
    """
    return (1.0 - abs(b)) * (1.0 if a >= 0.0 else -1.0)


@inline
def texel_of(d: Vec3) -> int:
    """Return the index of the texel that contains a direction in the octahedral map of the sky (Cigolle et al. 2014).

    The map has SKY_EDGE x SKY_EDGE texels. d : of any length
    """
    size = 1.0 / max(abs(d[0]) + abs(d[1]) + abs(d[2]), 1e-300)
    x, y = d[0] * size, d[1] * size
    if d[2] < 0.0:
        x, y = _fold(x, y), _fold(y, x)
    column = min(max(int((x * 0.5 + 0.5) * SKY_EDGE), 0), SKY_EDGE - 1)
    row = min(max(int((y * 0.5 + 0.5) * SKY_EDGE), 0), SKY_EDGE - 1)
    return row * SKY_EDGE + column


@inline
def in_texel(texel: int, u: float, v: float) -> Vec3:
    """Return the unit direction of a position within a texel of the octahedral map of the sky.

    u, v : across and down the texel, each 0 to 1
    """
    x = 2.0 * (texel % SKY_EDGE + u) / SKY_EDGE - 1.0
    y = 2.0 * (texel // SKY_EDGE + v) / SKY_EDGE - 1.0
    z = 1.0 - abs(x) - abs(y)
    if z < 0.0:
        x, y = _fold(x, y), _fold(y, x)
    return unit((x, y, z))


@cache
def texel_size() -> Doubles:
    """Return the solid angle in steradians of each texel of the octahedral map of the sky, (SKY_TEXELS,) float64."""
    fine = 8  # sample points along each side
    u = (np.arange(SKY_EDGE * fine) + 0.5) / (SKY_EDGE * fine) * 2.0 - 1.0
    x, y = np.meshgrid(u, u)
    z = 1.0 - np.abs(x) - np.abs(y)
    folded = np.maximum(-z, 0.0)  # points of the lower half are measured at their mirror image
    square = (np.abs(x) - folded) ** 2 + (np.abs(y) - folded) ** 2 + z * z
    size = square**-1.5 * (2.0 / (SKY_EDGE * fine)) ** 2
    cells = size.reshape(SKY_EDGE, fine, SKY_EDGE, fine).sum(axis=(1, 3)).reshape(-1)
    return np.asarray(cells * (4.0 * np.pi / cells.sum()))
