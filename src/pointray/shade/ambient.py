"""Ambient occlusion: the visible fraction of the sky, where only surfaces within a distance occlude."""

from __future__ import annotations

from ..engine.jit import i64, inline
from ..engine.kernels.records import World
from ..engine.kernels.sampling import DIRECTION_OF, ON_PATH, sample_pair
from ..engine.kernels.scratch import KEY, SHADING_NORMAL, SHADING_SIDE, SKY_SEEN, TILE, Scratch, load3
from ..engine.simd import Bits
from ..surface.trace.world import NO_RAY, is_blocked, occlude_tile, set_ray, set_ray_from
from .materials.diffuse import sample_diffuse
from .shading_points import add_radiance, is_shaded, shading_point, start_of


@inline
def _look_up(sample: int, distance: float, scratch: Scratch) -> Bits:
    """Set one cosine-distributed ray from each of the tile's surface points; return the points that got one (bits).

    sample : index of the sample, which selects the directions; distance : length of the rays
    """
    points, asked = scratch.shading_points, i64(0)
    for i in range(TILE):
        if is_shaded(scratch, i):
            u, v = sample_pair(int(points[KEY + i]), sample, ON_PATH + DIRECTION_OF)
            d = sample_diffuse(load3(points, SHADING_NORMAL + i), u, v)
            side = points[SHADING_SIDE + i]
            set_ray_from(scratch, i, (start_of(scratch, i, side), d, 0.0, distance), side)
            asked |= i64(1) << i
        else:
            set_ray(scratch, i, NO_RAY)
    return asked


@inline
def see_sky(world: World, sample: int, distance: float, scratch: Scratch) -> None:
    """Add a sample of ambient occlusion: the surface colour where a cosine-distributed ray is unoccluded (Landis 2002).

    sample : index of the sample; distance : only surfaces up to this distance occlude, in world units
    """
    asked = _look_up(sample, distance, scratch)
    if asked == 0:
        return
    occlude_tile(world, scratch)
    for i in range(TILE):
        if (asked >> i) & 1 != 0 and not is_blocked(scratch, i):
            add_radiance(scratch, i, shading_point(world, scratch, i)[1].color)


@inline
def find_sky_seen(world: World, look: tuple[int, int, float], scratch: Scratch) -> None:
    """Estimate the visible fraction of the sky at the tile's surface points. Overwrites the tile's rays.

    The result is in row SKY_SEEN of the scratch.

    look : (sample index, rays per point, ray length); with 0 rays the whole sky is visible
    """
    sample, rays, distance = look
    points = scratch.shading_points
    for i in range(TILE):
        points[SKY_SEEN + i] = 1.0 if rays == 0 else 0.0
    for k in range(rays):
        asked = _look_up(sample * rays + k, distance, scratch)
        if asked == 0:
            return
        occlude_tile(world, scratch)
        for i in range(TILE):
            if (asked >> i) & 1 != 0 and not is_blocked(scratch, i):
                points[SKY_SEEN + i] += 1.0 / rays
