"""The surface points of a tile that are shaded: what is kept of each, and as a material sees it."""

from __future__ import annotations

from ..jit import inline
from ..scratch import (
    RADIANCE,
    SPOT,
    SPOT_COLOR,
    SPOT_EYE,
    SPOT_INSTANCE,
    SPOT_NORMAL,
    SPOT_SIDE,
    SPOT_WEIGHT,
    TILE,
    put,
    row,
)
from ..trace.hits import material_at
from ..vec import BLACK, WHITE, add, dot, multiply, scale, unit
from .bsdf import Place, base_color


@inline
def begin_radiance(scratch):  # type: ignore[no-untyped-def]
    """The tile's rays are the camera's: nothing has come along them yet, and all that will counts."""
    for i in range(TILE):
        put(scratch.spots, RADIANCE + i, BLACK)
        put(scratch.spots, SPOT_WEIGHT + i, WHITE)


@inline
def add_radiance(scratch, i, light):  # type: ignore[no-untyped-def]
    """Radiance along ray i, by how much it counts in the pixel."""
    spots = scratch.spots
    put(spots, RADIANCE + i, add(row(spots, RADIANCE + i), multiply(row(spots, SPOT_WEIGHT + i), light)))


@inline
def keep_spot(scratch, i, hit, ray):  # type: ignore[no-untyped-def]
    """Put down what ray i of the tile, (o, d), has hit: surfaces shade both sides."""
    spots = scratch.spots
    spots[SPOT_INSTANCE + i] = hit.instance
    if hit.instance < 0:
        return
    to_eye = scale(unit(ray[1]), -1.0)
    # The side the eye is on: where the start rule puts shadow rays, and where the normal is turned.
    side = 1.0 if dot(hit.normal, to_eye) >= 0.0 else -1.0
    put(spots, SPOT + i, add(ray[0], scale(ray[1], hit.t)))
    put(spots, SPOT_NORMAL + i, scale(hit.normal, side))
    put(spots, SPOT_EYE + i, to_eye)
    put(spots, SPOT_COLOR + i, hit.color)
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
    color = base_color(world, at, row(spots, SPOT_COLOR + i))
    return at, Place(row(spots, SPOT_NORMAL + i), row(spots, SPOT_EYE + i), color, spots[SPOT_SIDE + i])
