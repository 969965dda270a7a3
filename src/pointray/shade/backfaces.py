"""Muted back faces: desaturated colour, lit by the sky or the headlight without shadows.

Through holes of a scan the back of the surface is visible. Little light arrives there, so it would be black.
"""

from __future__ import annotations

import math

from ..engine.jit import inline
from ..engine.kernels.records import INSTANCE, KIND, MODEL, World
from ..engine.kernels.scratch import RADIANCE, SHADING_INSTANCE, SHADING_SIDE, TILE, Scratch, store3
from ..engine.kernels.vec import add, dot, luminance, scale
from .bsdf import emitted, is_specular
from .shading_points import is_shaded, shading_point
from .sky import has_sky, sky_irradiance

SATURATION = 0.75  # weight of the surface colour; the rest is grey of the same luminance
LEVEL = 0.8  # fraction of the light of the sky or headlight on a surface that faces the camera
EDGE_LEVEL = 0.6  # the same at grazing view


@inline
def mute_back_faces(world: World, scratch: Scratch) -> None:
    """Replace the radiance where camera rays hit back faces of models by a desaturated, unshadowed surface colour.

    Back faces are seen through holes of a scan, and would be nearly black. Mirrors and glass are unchanged. In scenes
    with lights but without sky nothing changes.
    """
    points = scratch.shading_points
    for i in range(TILE):
        if not is_shaded(scratch, i) or points[SHADING_SIDE + i] > 0.0:
            continue
        instance = int(points[SHADING_INSTANCE + i])
        material, point = shading_point(world, scratch, i)
        if world.instances[instance * INSTANCE + KIND] != MODEL or is_specular(world, material):
            continue
        if not has_sky(world) and world.lights.size > 0:  # lamps only: no level for uniform light
            continue
        light = 1.0
        if has_sky(world):
            light = luminance(sky_irradiance(world, point.normal)) / math.pi
        cosine = dot(point.normal, point.wo)
        light *= EDGE_LEVEL + (LEVEL - EDGE_LEVEL) * cosine
        grey = luminance(point.color) * (1.0 - SATURATION)
        tone = add(scale(point.color, SATURATION), (grey, grey, grey))
        store3(points, RADIANCE + i, add(emitted(world, material), scale(tone, light)))
