"""Reflection of baked light by a wide lobe about the mirrored direction, from the table of `lobe_tables.py`."""

from __future__ import annotations

from typing import TypeAlias

from ..engine.jit import f32, inline
from ..engine.kernels.records import MATERIAL_KIND, PHONG, World
from ..engine.kernels.scratch import ARRIVING, ARRIVING_COLORS, ARRIVING_MOMENTS, TILE, Scratch, load3
from ..engine.kernels.vec import BLACK, LUMINANCE, Vec3, add, dot, luminance, scale
from ..engine.simd import F8, lane, load8
from .bsdf import lobe_exponent
from .harmonics import Five, as_vector, times_matrix
from .lobe_tables import COLUMNS, FACETS, HALFWAY, LAST, LOBES, NUMBERS, PHONG_LOBES, ROWS

Lobe: TypeAlias = tuple[float, float]  # kind of its material, exponent

# Largest exponents of lobes evaluated from baked moments (docs/decisions/baked-light.md): of Phong, and of facets,
# whose tails are longer.
WIDE, WIDE_FACETS = 8.0, 3.0


@inline
def is_wide(lobe: Lobe) -> bool:
    """Return whether a glossy lobe is so wide that the spherical harmonics of baked light suffice to evaluate it.

    lobe : (kind of its material, exponent), from `lobe_of`
    """
    return 0.0 <= lobe[1] <= (WIDE if lobe[0] == PHONG else WIDE_FACETS)


@inline
def lobe_of(world: World, material: int) -> Lobe:
    """Return the glossy lobe of a material: (kind of the material, exponent); the exponent is -1.0 without such a lobe.

    material : offset of its record in `world.materials`
    """
    return world.materials[material + MATERIAL_KIND], lobe_exponent(world, material)


@inline
def lobe_numbers(lobe: Lobe, cosine: float) -> F8:
    """Interpolate the 8 coefficients by which a glossy lobe reflects harmonics of light, see `lobe_tables.py`.

    lobe : (kind of its material, exponent); cosine : of the normal and the mirrored direction
    """
    x = min(max(cosine, 0.0), 1.0) * (COLUMNS - 1)
    y = min(lobe[1] / (lobe[1] + HALFWAY) * ((ROWS - 1) / LAST), ROWS - 1.0)
    column, row = min(int(x), COLUMNS - 2), min(int(y), ROWS - 2)
    right, below = f32(x - column), f32(y - row)
    at = (((PHONG_LOBES if lobe[0] == PHONG else FACETS) * ROWS + row) * COLUMNS + column) * NUMBERS
    upper, lower = load8(LOBES, at), load8(LOBES, at + COLUMNS * NUMBERS)
    upper = upper + (load8(LOBES, at + NUMBERS) - upper) * right
    lower = lower + (load8(LOBES, at + (COLUMNS + 1) * NUMBERS) - lower) * right
    return upper + (lower - upper) * below


@inline
def _moments(scratch: Scratch, i: int) -> tuple[Vec3, Five]:
    """Return the spherical harmonics (band 1, band 2) of the luminance that arrives at surface point i of the tile.

    The harmonics of uniform light of the same irradiance are subtracted.
    """
    points, at = scratch.shading_points, ARRIVING_MOMENTS + i
    second = at + 3 * TILE
    return load3(points, at), (
        points[second],
        points[second + TILE],
        points[second + 2 * TILE],
        points[second + 3 * TILE],
        points[second + 4 * TILE],
    )


@inline
def reflect_baked(scratch: Scratch, i: int, lobe: Lobe, normal: Vec3, r: Vec3) -> Vec3:
    """Return the radiance that a glossy lobe of weight 1 reflects of the baked light at surface point i of the tile.

    Phong's lobe is (exponent + 2) / (2 pi) max(0, w.r)^exponent for light from w; the facet lobe has albedo 1.

    lobe : (kind of its material, exponent); r : unit mirrored direction, about which the lobe lies
    """
    light = load3(scratch.shading_points, ARRIVING + i)
    gray = luminance(light)
    if gray <= 0.0:
        return BLACK
    numbers = lobe_numbers(lobe, dot(normal, r))
    first, second = _moments(scratch, i)
    along = add(scale(normal, lane(numbers, 1)), scale(r, lane(numbers, 2)))
    cross = add(scale(normal, lane(numbers, 3)), scale(r, lane(numbers, 4)))
    more = dot(as_vector(first), along) + dot(times_matrix(second, normal), cross)
    more += lane(numbers, 5) * dot(times_matrix(second, r), r)
    share = lane(numbers, 0) + more / gray
    along = add(scale(normal, lane(numbers, 6)), scale(r, lane(numbers, 7)))
    red = dot(as_vector(load3(scratch.shading_points, ARRIVING_COLORS + i)), along)
    blue = dot(as_vector(load3(scratch.shading_points, ARRIVING_COLORS + 3 * TILE + i)), along)
    green = -(LUMINANCE[0] * red + LUMINANCE[2] * blue) / LUMINANCE[1]
    return (max(light[0] * share + red, 0.0), max(light[1] * share + green, 0.0), max(light[2] * share + blue, 0.0))
