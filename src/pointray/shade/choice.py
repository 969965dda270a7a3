"""Selection of lights by paths, from a table, and intersection of rays with lights, in a tree.

No loop visits all lights: with 5,000 lamps a path tests about a dozen. See `shade/tables.py`.
"""

from __future__ import annotations

from ..engine.jit import Array, inline
from ..engine.kernels.records import LIGHT, World
from ..engine.kernels.sampling import find_share
from ..engine.kernels.vec import BLACK, Vec3
from .emitters import intersect_light, sun_in

FLAT = 1e-200  # smallest component of a direction, so that box tests do not divide by zero


@inline
def choose_light(world: World, u: float) -> tuple[int, float]:
    """Return (index of a light chosen by a random number u in [0, 1), its probability); (-1, 0) if no light shines.

    An environment image has the index after the last light.
    """
    count = world.light_shares.size - 1
    if count < 1:
        return -1, 0.0
    which = find_share(world.light_shares, 0, count, u)
    return which, light_probability(world, which)


@inline
def light_probability(world: World, which: int) -> float:
    """Return the probability with which `choose_light` chooses a light; 0 for a black light.

    which : index of the light; an environment image follows the last light
    """
    if which + 1 >= world.light_shares.size:
        return 0.0
    return world.light_shares[which + 1] - world.light_shares[which]


@inline
def sky_probability(world: World) -> float:
    """Return the probability with which `choose_light` chooses the environment image."""
    return light_probability(world, world.lights.size // LIGHT)


@inline
def _nonzero(x: float) -> float:
    """Return a component of a direction, replaced by FLAT if its magnitude is smaller, so that it can be a divisor."""
    return x if abs(x) >= FLAT else FLAT


@inline
def _enters(boxes: Array, offset: int, o: Vec3, inverse: Vec3, nearest: float) -> bool:
    """Return whether a ray enters a box before `nearest`, a distance in lengths of its direction.

    boxes : flat, the box's lower and upper corner (six numbers) from index `offset`
    o : origin of the ray; inverse : 1 / direction, by component
    """
    ax, bx = (boxes[offset] - o[0]) * inverse[0], (boxes[offset + 3] - o[0]) * inverse[0]
    ay, by = (boxes[offset + 1] - o[1]) * inverse[1], (boxes[offset + 4] - o[1]) * inverse[1]
    az, bz = (boxes[offset + 2] - o[2]) * inverse[2], (boxes[offset + 5] - o[2]) * inverse[2]
    enter = max(max(min(ax, bx), min(ay, by)), max(min(az, bz), 0.0))
    leave = min(min(max(ax, bx), max(ay, by)), min(max(az, bz), nearest))
    return enter <= leave


@inline
def nearest_lamp(world: World, ray: tuple[Vec3, Vec3], nearest: float) -> tuple[float, int]:
    """Find the nearest area light that a ray (o, d), d unit, hits before a distance `nearest`.

    Returns (distance, offset of the light's record in `world.lights`), or (nearest, -1) for a miss.
    """
    lamps, found, k = world.lamps, -1, 0
    d = ray[1]
    inverse = 1.0 / _nonzero(d[0]), 1.0 / _nonzero(d[1]), 1.0 / _nonzero(d[2])
    while k < lamps.lights.size:
        light = lamps.lights[k]
        if light >= 0:
            t = intersect_light(world, light * LIGHT, ray[0], d)
            if t < nearest:
                nearest, found = t, light * LIGHT
        elif not _enters(lamps.boxes, 6 * k, ray[0], inverse, nearest):
            k = lamps.skips[k]
            continue
        k += 1
    return nearest, found


@inline
def meets_lamp(world: World, ray: tuple[Vec3, Vec3], end: float) -> bool:
    """Return whether a ray (o, d), d unit, hits the front of an area light before a distance `end`."""
    return nearest_lamp(world, ray, end)[1] >= 0


@inline
def _is_within(boxes: Array, offset: int, d: Vec3) -> bool:
    """Return whether a unit direction, as a point of the unit sphere, is inside a box of the tree over the suns' disks.

    boxes : flat, the box's lower and upper corner (six numbers) from index `offset`
    """
    x = (boxes[offset] <= d[0]) & (d[0] <= boxes[offset + 3])
    y = (boxes[offset + 1] <= d[1]) & (d[1] <= boxes[offset + 4])
    return x & y & (boxes[offset + 2] <= d[2]) & (d[2] <= boxes[offset + 5])


@inline
def sun_after(world: World, k: int, d: Vec3) -> tuple[int, int, Vec3, float]:
    """Find the next sun whose disk contains a unit direction; called again with the returned k, it lists all such suns.

    k : entry of the tree `world.suns` to begin with, 0 at first

    Returns
    -------
    tuple
        (next entry, or 0 if none is found; index of the sun in `world.lights`; radiance; pdf per solid angle).
    """
    suns = world.suns
    while k < suns.lights.size:
        light = suns.lights[k]
        if light >= 0:
            radiance, pdf = sun_in(world, light * LIGHT, d)
            if pdf > 0.0:
                return k + 1, light, radiance, pdf
        elif not _is_within(suns.boxes, 6 * k, d):
            k = suns.skips[k]
            continue
        k += 1
    return 0, -1, BLACK, 0.0
