"""Ambient occlusion: how much of an even sky each surface point sees, no farther than a distance."""

from __future__ import annotations

import numpy as np

from ..jit import inline
from ..sampling import DIRECTION_OF, ON_PATH, sample_pair
from ..scratch import KEY, SPOT, SPOT_SIDE, TILE, row
from ..trace.world import NOWHERE, aim, aim_from, is_blocked, occlude_tile
from .phong import sample_diffuse
from .spots import add_radiance, is_spot, place_of


@inline
def see_sky(world, sample, reach, scratch):  # type: ignore[no-untyped-def]
    """Add the surface's colour where one direction, chosen by the cosine, is free up to the reach (Landis 2002)."""
    spots, asked = scratch.spots, np.int64(0)
    for i in range(TILE):
        if is_spot(scratch, i):
            u, v = sample_pair(int(spots[KEY + i]), sample, ON_PATH + DIRECTION_OF)
            d = sample_diffuse(place_of(world, scratch, i)[1].normal, u, v)
            aim_from(scratch, i, (row(spots, SPOT + i), d, 0.0, reach), spots[SPOT_SIDE + i])
            asked |= np.int64(1) << i
        else:
            aim(scratch, i, NOWHERE)
    if asked == 0:
        return
    occlude_tile(world, scratch)
    for i in range(TILE):
        if (asked >> i) & 1 != 0 and not is_blocked(scratch, i):
            add_radiance(scratch, i, place_of(world, scratch, i)[1].color)
