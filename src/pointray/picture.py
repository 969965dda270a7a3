"""From a scene to a picture: rays through the pixels, the first hit of each, its light, the mean of the samples."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .camera import Camera
from .jit import borrow, cancelled, inline, keep, kernel, run, take
from .lens import FILTERS, camera_ray, depth_of
from .records import World, lend_world
from .scene import Scene
from .scratch import COUNT_LEAVES, COUNT_NODES, DIRECTION, ORIGIN, RADIANCE, TILE, lend_scratch, new_scratch, row
from .shade.direct import keep_spot, light_tile
from .trace.hits import describe_tile, tile_hit
from .trace.world import NOWHERE, aim, trace_tile
from .vec import add, along_curve, scale

INTEGRATORS = ("phong", "normal", "depth", "color", "cost")
PHONG, NORMAL, DEPTH, COLOR, COST = range(5)
BLOCK = 16  # pixels a side of what a thread takes at a time: 4 tiles of 8 x 8
MOST_SAMPLES = 65536


@dataclass(frozen=True)
class Settings:
    """How a picture is made.

    Parameters
    ----------
    integrator : str
        "phong" (direct light, hard shadows), or what is at the first hit: "normal" (world, -1 to 1 shown as 0 to 1),
        "depth" (distance along the view, in a panorama from the eye), "color" (unlit), "cost" (red: nodes, green:
        leaves visited, blue: both / 64).
    spp : int
        Samples a pixel; 1 goes through the middle of the pixel and of the lens.
    shadows : bool
    seed : int
        Of the places of the samples in the pixel and on the lens.
    threads : int, optional
        None: `POINTRAY_THREADS`, else all. The picture does not depend on it.
    filter : str
        How pixels are made of their samples, if there are several: "box" (the pixel itself), "tent" (2 pixels wide),
        "gaussian" (standard deviation 0.5 pixels, ends 1.5 from the middle), "blackman-harris" (3 pixels wide). On a
        checkerboard too fine for the pixels the last leaves a third of the box's moire (tent the same, gaussian a
        seventh), and edges are smooth where the box leaves steps; 4 samples have 20% more noise than in a box
        (gaussian 39%, and blurred detail).
    """

    integrator: str = "phong"
    spp: int = 1
    shadows: bool = True
    seed: int = 0
    threads: int | None = None
    filter: str = "blackman-harris"

    def __post_init__(self) -> None:
        if self.integrator not in INTEGRATORS:
            raise ValueError(f"unknown integrator {self.integrator!r}: one of {', '.join(INTEGRATORS)}")
        if not isinstance(self.spp, int) or not 1 <= self.spp <= MOST_SAMPLES:
            raise ValueError(f"spp must be a whole number from 1 to {MOST_SAMPLES}, not {self.spp!r}")
        if self.threads is not None and (not isinstance(self.threads, int) or self.threads < 1):
            raise ValueError(f"threads must be a whole number from 1, or None, not {self.threads!r}")
        if not isinstance(self.seed, int) or not 0 <= self.seed < 2**31:
            raise ValueError(f"seed must be a whole number from 0 to 2**31 - 1, not {self.seed!r}")
        if self.filter not in FILTERS:
            raise ValueError(f"unknown filter {self.filter!r}: one of {', '.join(FILTERS)}")


@inline
def look(world, hit, ray, camera, integrator):  # type: ignore[no-untyped-def]
    """Colour of what a camera ray (o, d) has hit, by an integrator that needs no light."""
    if integrator == NORMAL:
        return add(scale(hit.normal, 0.5), (0.5, 0.5, 0.5))
    if integrator == DEPTH:
        depth = depth_of(camera, ray, hit.t)
        return depth, depth, depth
    return hit.color


@inline
def cost(world, ray, scratch):  # type: ignore[no-untyped-def]
    """Nodes and leaves that a ray (o, d) visits when it is traced alone, as a colour."""
    scratch.counts[COUNT_NODES], scratch.counts[COUNT_LEAVES] = 0, 0
    aim(scratch, 0, (ray[0], ray[1], 0.0, np.inf))
    for k in range(1, TILE):
        aim(scratch, k, NOWHERE)
    trace_tile(world, scratch)
    nodes, leaves = float(scratch.counts[COUNT_NODES]), float(scratch.counts[COUNT_LEAVES])
    return nodes, leaves, (nodes + leaves) / 64.0


@inline
def _add(total, i, color):  # type: ignore[no-untyped-def]
    """Add a sample's colour to a pixel's."""
    total[i, 0] += color[0]
    total[i, 1] += color[1]
    total[i, 2] += color[2]


@inline
def _trace_pixels(world, camera, image, corner, sample, how, scratch):  # type: ignore[no-untyped-def]
    """Trace one sample of 8 x 8 pixels; those beyond the image's edge repeat its last ones.

    The pixels follow a Morton curve: four rays in a row are neighbours.
    """
    height, width = image.shape[:2]
    for i in range(TILE):
        x, y = along_curve(i)
        pixel = min(corner[0] + x, width - 1), min(corner[1] + y, height - 1)
        o, d = camera_ray(camera, (width, height), pixel, sample, how)
        aim(scratch, i, (o, d, 0.0, np.inf))
    trace_tile(world, scratch)


@inline
def _costs(world, camera, image, corner, sample, how, out):  # type: ignore[no-untyped-def]
    """Add the cost of one sample of 8 x 8 pixels, each ray traced alone. out : total, scratch."""
    height, width = image.shape[:2]
    for i in range(TILE):
        x, y = along_curve(i)
        ray = camera_ray(camera, (width, height), (corner[0] + x, corner[1] + y), sample, how)
        _add(out[0], i, cost(world, ray, out[1]))
        out[0][i, 3] += 1.0


@inline
def _finish(total, corner, spp, background, image):  # type: ignore[no-untyped-def]
    """Write the means of 8 x 8 pixels, over the background."""
    height, width = image.shape[:2]
    for i in range(TILE):
        x, y = along_curve(i)
        x, y = corner[0] + x, corner[1] + y
        if x < width and y < height:
            uncovered = spp - total[i, 3]
            for c in range(3):
                image[y, x, c] = (total[i, c] + uncovered * background[c]) / spp
            image[y, x, 3] = (total[i, 3] + uncovered * background[3]) / spp


@kernel
def _frame(work, world, camera, how, image):  # type: ignore[no-untyped-def]
    """Render blocks of an image (h, w, 4).

    how : integrator, shadows, samples (seed, samples a pixel, filter), background (4 with alpha)
    """
    height, width = image.shape[:2]
    memory = new_scratch(world.longest)
    scratch, world = lend_scratch(memory), lend_world(world)
    integrator, shadows, samples, background = how
    camera, spp = borrow(camera), samples[1]
    across = (width + BLOCK - 1) // BLOCK
    total = np.empty((TILE, 4), np.float64)
    block = take(work)
    while block >= 0:
        top, left = block // across * BLOCK, block % across * BLOCK
        for tile in range(BLOCK * BLOCK // TILE):
            corner = left + tile % 2 * 8, top + tile // 2 * 8
            if corner[0] >= width or corner[1] >= height:
                continue
            total[:] = 0.0
            for sample in range(spp):
                if cancelled(work):  # a block of many samples takes long
                    break
                if integrator == COST:
                    _costs(world, camera, image, corner, sample, samples, (total, scratch))
                    continue
                _trace_pixels(world, camera, image, corner, sample, samples, scratch)
                if integrator in (PHONG, COLOR):
                    describe_tile(world, scratch)
                for i in range(TILE):
                    ray = row(scratch.world, ORIGIN + i), row(scratch.world, DIRECTION + i)
                    hit = tile_hit(scratch, i)
                    if integrator == PHONG:
                        keep_spot(scratch, i, hit, ray)
                    if hit.instance >= 0:
                        total[i, 3] += 1.0
                        if integrator != PHONG:
                            _add(total, i, look(world, hit, ray, camera, integrator))
                if integrator == PHONG:
                    light_tile(world, shadows != 0, scratch)
                    for i in range(TILE):
                        _add(total, i, row(scratch.spots, RADIANCE + i))
            _finish(total, corner, spp, background, image)
        block = take(work)
    keep(memory)
    keep(total)
    return 0


def render(
    scene: Scene,
    camera: Camera,
    settings: Settings | None = None,
    progress: Callable[[float], None] | None = None,
) -> NDArray[np.float32]:
    """Render a scene.

    Parameters
    ----------
    progress : callable, optional
        Called with the share done, some ten times a second.

    Returns
    -------
    (h, w, 4) float32
        Linear RGB, premultiplied, and alpha: the share of the pixel that is covered (1 with a background).

    Notes
    -----
    A scene without lights is lit by a headlight at the camera.
    """
    settings = settings or Settings()
    width, height = camera.size
    image = np.empty((height, width, 4), np.float32)
    world: World = scene._world()[0]
    color = scene.background
    background = (0.0, 0.0, 0.0, 0.0) if color is None else (*map(float, color), 1.0)
    integrator = INTEGRATORS.index(settings.integrator)
    samples = (settings.seed, settings.spp, FILTERS.index(settings.filter))
    how = (integrator, int(settings.shadows), samples, background)
    blocks = -(-width // BLOCK) * -(-height // BLOCK)
    run(_frame, blocks, world, camera.record(), how, image, threads=settings.threads, progress=progress)
    return image
