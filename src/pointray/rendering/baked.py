"""The integrator "baked": direct light with sharp shadows, indirect light from the bake, mirrors and glass.

See `shade/baked_light.py`.
"""

from __future__ import annotations

from ..engine.jit import Array, i64, inline, kernel
from ..engine.kernels.records import World
from ..engine.kernels.scratch import DIRECTION, TILE, Scratch, load3
from ..engine.simd import Bits
from ..shade.backfaces import mute_back_faces
from ..shade.baked_light import add_baked, add_live, meet_lamps
from ..shade.shading_points import add_radiance, begin_radiance, is_shaded, store_shading_points
from ..shade.sky import sky_radiance
from ..shade.specular_rays import begin_specular, set_specular_rays, spawn_specular
from ..surface.trace.hits import describe_tile
from ..surface.trace.world import meets_nothing, trace_tile
from .film import add_sample
from .integrate import Pass, render_tiles


@inline
def _receive(world: World, job: Pass, first: bool, scratch: Scratch) -> Bits:
    """Add the light of area lights and sky that the tile's rays hit to the rays' radiance in scratch memory.

    Returns the rays that hit a surface, a light or the sky (bits).

    job : settings of the pass; first : whether these are camera rays, which see the sky only if it is the background
    """
    met = meet_lamps(world, scratch)
    for i in range(TILE):
        if is_shaded(scratch, i):
            met |= i64(1) << i
        elif (met >> i) & 1 == 0 and (job.sky_shows or not first):
            add_radiance(scratch, i, sky_radiance(world, load3(scratch.world, DIRECTION + i)))
            met |= i64(1) << i
    return met


@inline
def _sees_nothing(world: World, job: Pass, scratch: Scratch) -> bool:
    """Return whether a tile's sample is only background, and can be skipped: empty frames then take 0.6 of the time."""
    return meets_nothing(scratch) and not job.sky_shows and world.lamps.lights.size == 0


@inline
def _integrate_baked(world: World, camera: Array, job: Pass, sample: int, scratch: Scratch) -> None:
    """Integrator "baked": add one sample of a tile to the pixel sums: direct and baked light, mirrors and glass.

    job : settings of the pass; sample : index of the sample, for random numbers; camera : not used
    """
    draw = sample if job.draws else -1
    begin_radiance(scratch)
    begin_specular(scratch)
    met, first = i64(0), True
    while True:
        trace_tile(world, scratch)
        if first and _sees_nothing(world, job, scratch):
            return
        describe_tile(world, True, scratch)
        store_shading_points(world, scratch)
        found = _receive(world, job, first, scratch)
        spawn_specular(world, job.max_depth, scratch)
        add_baked(world, first, draw, scratch)
        if first:
            met = found
            add_live(world, job.shadows, draw, scratch)
            if job.muted:
                mute_back_faces(world, scratch)
        if not set_specular_rays(scratch):
            break
        first = False
    add_sample(met, scratch)


@kernel
def baked_frame(work: Array, world: World, camera: Array, job: Pass, film: Array, image: Array) -> None:
    """Render blocks of an image with the integrator "baked": direct light, and indirect light baked in advance.

    work : counter from which threads take blocks; camera : (16,), eye, axes, projection and lens
    job : settings and range of samples; image : (h, w, 4), the result, mean RGB over the background and alpha
    film : (h, w, k), updated, k sums over the samples of each pixel (RGB, hits and so on), or empty to keep none
    """
    render_tiles(_integrate_baked, work, world, camera, job, film, image)
