"""The surface points of a tile that are shaded: what is kept of each, and as a material sees it."""

from __future__ import annotations

from ..jit import inline
from ..kernels.scratch import (
    COLOR,
    DIRECTION,
    INSTANCE_OF,
    NEAREST,
    NORMAL,
    ORIGIN,
    RADIANCE,
    SPOT,
    SPOT_COLOR,
    SPOT_EYE,
    SPOT_INSTANCE,
    SPOT_NORMAL,
    SPOT_SIDE,
    SPOT_WEIGHT,
    TILE,
    load3,
    store3,
)
from ..kernels.vec import BLACK, WHITE, add, dot, multiply, scale, unit
from ..trace.hits import material_at
from .bsdf import Place, base_color


@inline
def begin_radiance(scratch):  # type: ignore[no-untyped-def]
    """The tile's rays are the camera's: nothing has come along them yet, and all that will counts."""
    for i in range(TILE):
        store3(scratch.spots, RADIANCE + i, BLACK)
        store3(scratch.spots, SPOT_WEIGHT + i, WHITE)


@inline
def add_radiance(scratch, i, light):  # type: ignore[no-untyped-def]
    """Radiance along ray i, by how much it counts in the pixel."""
    spots = scratch.spots
    store3(spots, RADIANCE + i, add(load3(spots, RADIANCE + i), multiply(load3(spots, SPOT_WEIGHT + i), light)))


@inline
def keep_spots(scratch):  # type: ignore[no-untyped-def]
    """Put down what the tile's rays have hit: surfaces shade both sides.

    No branches: rays as vectors, those that have hit nothing too, of which only that counts.
    """
    spots, wide = scratch.spots, scratch.world
    for i in range(TILE):
        spots[SPOT_INSTANCE + i] = scratch.numbers[INSTANCE_OF + i]
    for i in range(TILE):
        d, normal = load3(wide, DIRECTION + i), load3(wide, NORMAL + i)
        to_eye = scale(unit(d), -1.0)
        # The side the eye is on: where the start rule puts shadow rays, and where the normal is turned.
        side = 1.0 if dot(normal, to_eye) >= 0.0 else -1.0
        store3(spots, SPOT + i, add(load3(wide, ORIGIN + i), scale(d, wide[NEAREST + i])))
        store3(spots, SPOT_NORMAL + i, scale(normal, side))
        store3(spots, SPOT_EYE + i, to_eye)
        store3(spots, SPOT_COLOR + i, load3(wide, COLOR + i))
        spots[SPOT_SIDE + i] = side


@inline
def is_spot(scratch, i):  # type: ignore[no-untyped-def]
    """Whether ray i of the tile has hit a surface."""
    return scratch.spots[SPOT_INSTANCE + i] >= 0.0


@inline
def place_of(world, scratch, i):  # type: ignore[no-untyped-def]
    """(where its material begins in world.materials, the `Place`) of a surface point."""
    spots = scratch.spots
    at = material_at(world, int(spots[SPOT_INSTANCE + i]))
    color = base_color(world, at, load3(spots, SPOT_COLOR + i))
    return at, Place(load3(spots, SPOT_NORMAL + i), load3(spots, SPOT_EYE + i), color, spots[SPOT_SIDE + i])
