"""Ambient occlusion: how much of the sky each surface point sees, if what blocks it is no farther than a distance."""

from __future__ import annotations

import numpy as np

from ..jit import inline
from ..kernels.sampling import DIRECTION_OF, ON_PATH, sample_pair
from ..kernels.scratch import KEY, SKY_SEEN, SPOT, SPOT_NORMAL, SPOT_SIDE, TILE, load3
from ..trace.world import NO_RAY, is_blocked, occlude_tile, set_ray, set_ray_from
from .phong import sample_diffuse
from .spots import add_radiance, is_spot, place_of


@inline
def _look_up(sample, reach, scratch):  # type: ignore[no-untyped-def]
    """The tile's rays leave its surface points, each in a direction chosen by the cosine; returns which do (bits)."""
    spots, asked = scratch.spots, np.int64(0)
    for i in range(TILE):
        if is_spot(scratch, i):
            u, v = sample_pair(int(spots[KEY + i]), sample, ON_PATH + DIRECTION_OF)
            d = sample_diffuse(load3(spots, SPOT_NORMAL + i), u, v)
            set_ray_from(scratch, i, (load3(spots, SPOT + i), d, 0.0, reach), spots[SPOT_SIDE + i])
            asked |= np.int64(1) << i
        else:
            set_ray(scratch, i, NO_RAY)
    return asked


@inline
def see_sky(world, sample, reach, scratch):  # type: ignore[no-untyped-def]
    """Add the surface's colour where one direction, chosen by the cosine, is free up to the reach (Landis 2002)."""
    asked = _look_up(sample, reach, scratch)
    if asked == 0:
        return
    occlude_tile(world, scratch)
    for i in range(TILE):
        if (asked >> i) & 1 != 0 and not is_blocked(scratch, i):
            add_radiance(scratch, i, place_of(world, scratch, i)[1].color)


@inline
def find_sky_seen(world, look, scratch):  # type: ignore[no-untyped-def]
    """Put down in SKY_SEEN what share of the sky the tile's surface points see. Uses the tile's rays.

    look : the number of the sample, how many rays it casts from each point (0: all of the sky is seen), their reach
    """
    sample, rays, reach = look
    spots = scratch.spots
    for i in range(TILE):
        spots[SKY_SEEN + i] = 1.0 if rays == 0 else 0.0
    for k in range(rays):
        asked = _look_up(sample * rays + k, reach, scratch)
        if asked == 0:
            return
        occlude_tile(world, scratch)
        for i in range(TILE):
            if (asked >> i) & 1 != 0 and not is_blocked(scratch, i):
                spots[SKY_SEEN + i] += 1.0 / rays
