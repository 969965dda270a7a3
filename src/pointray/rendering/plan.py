"""Preparation of kernel arguments from a scene and settings."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..base.choices import EXPOSED, FILTERS, INTEGRATORS, MUTED, NOISY, number_of
from ..engine.kernels import records as rec
from ..engine.kernels.records import World
from ..scene.world import Snapshot
from ..shade.environment import EnvironmentLight
from .camera import Camera
from .film import Window
from .integrate import Pass
from .lod import Fetch, at_distance
from .settings import AO, BAKED, COST, PATH, PHONG, Settings
from .window import EVERYWHERE, window_of

AO_SHARE = 0.2  # default length of ambient occlusion rays, relative to the scene's diagonal
MOST_SPECULAR = 32  # maximum number of successive mirrors and glass surfaces
SIZED_LIGHTS = (rec.RECT_LIGHT, rec.DISK_LIGHT, rec.SPHERE_LIGHT)  # lights visible to paths


def plan(
    scene: Snapshot,
    camera: Camera,
    settings: Settings,
    fetch: Fetch | None = None,
    held: NDArray[np.int64] | None = None,
) -> tuple[World, Pass]:
    """Return the arguments of a rendering kernel: the world, and the parameters of a pass of all samples.

    The world has levels of detail, baked light and a default sky as the settings require.

    fetch : opens models on disk in the background, while other levels of detail are shown; None: open them now
    held : rows of the instances to open; rays miss other instances whose models are on disk. None: open all
    """
    if settings.levels or fetch is not None:
        world, levels = at_distance(scene, camera, settings.most if settings.levels else None, fetch, held)
    else:
        world, levels = scene.opened(held).world, np.zeros(scene.world.instances.size // rec.INSTANCE, np.int64)
    color = scene.background
    integrator = number_of(INTEGRATORS, settings.integrator)
    lit = integrator == PATH or (integrator == AO and scene.shows_sky)
    world = _lit(world) if lit else world
    if integrator == BAKED:
        if scene.baked is None:
            raise ValueError("the scene has no baked light: set scene.baked = pr.bake(scene)")
        baked, frames = scene.baked.tables(scene, levels)
        world = world._replace(baked=baked, baked_frames=frames)
    looks_up = integrator == PHONG and settings.sky_rays > 0 and world.sky[rec.SKY_KIND] != rec.NO_SKY
    job = Pass(
        integrator=integrator,
        shadows=settings.shadows,
        muted=settings.backfaces == MUTED and integrator in (PHONG, BAKED),
        max_depth=min(settings.depth, MOST_SPECULAR) if integrator in (PHONG, BAKED) else settings.depth,
        sky_shows=scene.shows_sky and settings.integrator in EXPOSED,
        sky_rays=settings.sky_rays if looks_up else 0,
        ao_distance=_ao_distance(scene, settings) if looks_up or integrator == AO else 0.0,
        seed=settings.seed,
        spp=settings.most,
        filter=number_of(FILTERS, settings.filter),
        draws=settings.most > 1 or looks_up or settings.integrator in NOISY,
        first=0,
        end=settings.most,
        window=EVERYWHERE,
        background=(0.0, 0.0, 0.0, 0.0) if color is None else (float(color[0]), float(color[1]), float(color[2]), 1.0),
    )
    return world, job._replace(window=_window(camera, world, job))


def _ao_distance(scene: Snapshot, settings: Settings) -> float:
    """Return the length of ambient occlusion rays in world units; by default a fifth of the scene's diagonal."""
    return float(settings.ao_distance or AO_SHARE * np.linalg.norm(np.diff(scene.bounds, axis=0)))


def _window(camera: Camera, world: World, job: Pass) -> Window:
    """Return the part of the image in which rays may hit anything: left, top, right, bottom in pixels.

    It is the whole image unless only models can be hit.
    """
    lights = job.integrator == PATH and np.isin(world.lights[rec.LIGHT_KIND :: rec.LIGHT], SIZED_LIGHTS).any()
    if job.integrator == COST or job.sky_shows or lights or world.planes.size > 0 or world.table.size == 0:
        return EVERYWHERE
    return window_of(camera, world.top)


def _lit(world: World) -> World:
    """Return the world; if nothing in it emits light, with a uniform white sky."""
    if world.lights.size > 0 or world.sky[rec.SKY_KIND] != rec.NO_SKY:
        return world
    if (world.materials[rec.MATERIAL_KIND :: rec.MATERIAL_SIZE] == rec.EMISSIVE).any():
        return world
    sky, colors, rows, columns, mean = EnvironmentLight().tables()
    return world._replace(sky=sky, sky_colors=colors, sky_rows=rows, sky_columns=columns, sky_mean=mean)
