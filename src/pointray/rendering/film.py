"""Tiles of 8 x 8 pixels: camera rays of one sample a pixel, and the pixel sums.

Pixels follow a Morton curve, so that four consecutive rays are neighbours. Branches on the camera are outside the loops
over rays, which are vectorized. Branches inside would compute both sides, including the sines of panoramas and the
logarithms of filters: 75 ns a pixel, two thirds of an empty frame.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np

from ..engine.jit import Array, f32, inline
from ..engine.kernels import records as rec, scratch as sc
from ..engine.kernels.sampling import ON_LENS, on_disc, pixel_key, sample_pair
from ..engine.kernels.scratch import Scratch, load3, store3
from ..engine.kernels.vec import Vec3, add, along_curve, luminance, scale, unit
from ..engine.simd import Bits, count_trailing_zeros
from ..surface.trace.world import set_ray
from .lens import BLACKMAN_HARRIS, BOX, GAUSSIAN, TENT, on_screen, position_in_pixel, project, through_lens

Corner: TypeAlias = tuple[int, int]  # column and row of a tile's first pixel
Size: TypeAlias = tuple[int, int]  # width and height of the image
Window: TypeAlias = tuple[float, float, float, float]  # left, top, right, bottom, in pixels
Background: TypeAlias = tuple[float, float, float, float]  # RGB and alpha

EDGE = 8  # pixels a side of a tile
LONGEST_PASS = 64  # samples
# Sums a pixel: RGB and number of hits; also squares, if noise is measured; all of them with shadow catchers.
LIGHT_SUMS, NOISE_SUMS, ALL_SUMS = 4, 5, 8


@inline
def pixel_of(corner: Corner, i: int) -> Corner:
    """Return (column, row) of pixel i of a tile, 0 <= i < 64, in Morton order.

    corner : column and row of the tile's first pixel
    """
    x, y = along_curve(i)
    return corner[0] + x, corner[1] + y


@inline
def begin_tile(corner: Corner, size: Size, seed: int, scratch: Scratch) -> None:
    """Store a number for each pixel of a tile in scratch memory, from which the pixel's random numbers are computed.

    Pixels of the tile beyond the edge of the image get the numbers of the nearest pixels inside.

    corner : column and row of the tile's first pixel; size : (width, height) of the image
    seed : seed of the image's random numbers
    """
    for i in range(sc.TILE):
        x, y = pixel_of(corner, i)
        scratch.shading_points[sc.KEY + i] = pixel_key(min(x, size[0] - 1), min(y, size[1] - 1), seed)


@inline
def _middles(corner: Corner, size: Size, wide: Array) -> None:
    for i in range(sc.TILE):
        x, y = pixel_of(corner, i)
        wide[sc.IMAGE_X + i], wide[sc.IMAGE_Y + i] = min(x, size[0] - 1) + 0.5, min(y, size[1] - 1) + 0.5


@inline
def _move(sample: int, shape: int, scratch: Scratch) -> None:
    """Move the image positions of the tile's samples, in scratch memory, from the pixel centres to random places.

    sample : index of the sample; shape : number of the pixel filter, which is the distribution of the places
    """
    for i in range(sc.TILE):
        right, down = position_in_pixel(int(scratch.shading_points[sc.KEY + i]), sample, shape)
        scratch.world[sc.IMAGE_X + i] += right
        scratch.world[sc.IMAGE_Y + i] += down


@inline
def _project(camera: Array, size: Size, projection: int, scratch: Scratch) -> None:
    """Set the tile's rays from the image positions of its samples in scratch memory; directions are not normalized.

    camera : (16,), eye, axes, projection and lens; size : (width, height) of the image
    projection : number of a projection, a constant
    """
    wide = scratch.world
    for i in range(sc.TILE):
        u, v = on_screen(size, wide[sc.IMAGE_X + i], wide[sc.IMAGE_Y + i])
        o, d = project(camera, projection, u, v)
        set_ray(scratch, i, (o, d, 0.0, np.inf))


@inline
def _blur(camera: Array, sample: int, scratch: Scratch) -> None:
    """Move the tile's rays to random points of the lens, so that only the plane in focus stays sharp.

    camera : (16,), eye, axes, projection and lens; sample : index of the sample
    """
    wide = scratch.world
    for i in range(sc.TILE):
        u, v = sample_pair(int(scratch.shading_points[sc.KEY + i]), sample, ON_LENS)
        o, d = through_lens(camera, (load3(wide, sc.ORIGIN + i), load3(wide, sc.DIRECTION + i)), on_disc(u, v))
        store3(wide, sc.ORIGIN + i, o)
        store3(wide, sc.DIRECTION + i, d)


@inline
def set_pixel_rays(
    camera: Array, size: Size, corner: Corner, sample: int, drawn: tuple[int, int], scratch: Scratch
) -> None:
    """Set the tile's rays in scratch memory to one sample of each pixel.

    If a pixel has a single sample, the ray goes through the centres of the pixel and of the lens.

    camera : (16,), eye, axes, projection and lens; size : (width, height) of the image
    corner : column and row of the tile's first pixel; sample : index of the sample
    drawn : (samples a pixel in all, number of the pixel filter)
    """
    spp, shape = drawn
    _middles(corner, size, scratch.world)
    if spp > 1:
        if shape == BOX:
            _move(sample, BOX, scratch)
        elif shape == TENT:
            _move(sample, TENT, scratch)
        elif shape == GAUSSIAN:
            _move(sample, GAUSSIAN, scratch)
        else:
            _move(sample, BLACKMAN_HARRIS, scratch)
    if camera[rec.PROJECTION] == rec.PERSPECTIVE:
        _project(camera, size, rec.PERSPECTIVE, scratch)
    elif camera[rec.PROJECTION] == rec.ORTHOGRAPHIC:
        _project(camera, size, rec.ORTHOGRAPHIC, scratch)
    else:
        _project(camera, size, rec.PANORAMA, scratch)
    if camera[rec.LENS_RADIUS] > 0.0 and spp > 1:
        _blur(camera, sample, scratch)
    for i in range(sc.TILE):
        store3(scratch.world, sc.DIRECTION + i, unit(load3(scratch.world, sc.DIRECTION + i)))


@inline
def begin_sums(corner: Corner, first: int, film: Array, scratch: Scratch) -> None:
    """Load the sums of a tile's pixels over their first samples into scratch memory, to add more samples.

    All sums are set to 0 if there are no samples yet. Sums that `film` does not keep are always set to 0.

    corner : column and row of the tile's first pixel; first : number of samples so far
    film : (h, w, k) float32, the k sums kept of each pixel: RGB, number of hits and so on
    """
    sums = scratch.sums
    sums[:] = 0.0
    if first == 0:
        return
    for i in range(sc.TILE):
        x, y = pixel_of(corner, i)
        if x < film.shape[1] and y < film.shape[0]:
            for c in range(film.shape[2]):
                sums[c * sc.TILE + i] = film[y, x, c]


@inline
def round_sums(sample: int, first: int, scratch: Scratch) -> None:
    """Round a tile's sums to float32 where a pass of samples may begin: between passes they are stored so.

    The image is then the same in one pass and in passes of 1, 1, 2, 4 and so on samples.

    sample : index of the next sample; first : index of the first one in this pass
    """
    if sample > first and (sample % LONGEST_PASS == 0 or (sample < LONGEST_PASS and sample & (sample - 1) == 0)):
        for k in range(scratch.sums.size):
            scratch.sums[k] = f32(scratch.sums[k])


@inline
def add_color(scratch: Scratch, i: int, color: Vec3) -> None:
    """Add a sample that hits something to the sums of pixel i of the tile. color : linear radiance"""
    _add(scratch.sums, i, color, 1.0)


@inline
def _add(sums: Array, i: int, color: Vec3, met: float) -> None:
    light = luminance(color)
    red, green, blue = load3(sums, sc.TOTAL + i)
    store3(sums, sc.TOTAL + i, (red + color[0], green + color[1], blue + color[2]))
    sums[sc.TOTAL_MET + i] += met
    sums[sc.TOTAL_SQUARE + i] += light * light


@inline
def add_sample(met: Bits, scratch: Scratch) -> None:
    """Add one sample of the tile, its rays' radiance in scratch memory, to the sums of its pixels.

    met : rays that have hit anything (bits), which make their pixels opaque
    """
    points, sums, caught = scratch.shading_points, scratch.sums, scratch.counts[sc.CAUGHT]
    met &= ~caught
    for i in range(sc.TILE):
        _add(sums, i, load3(points, sc.RADIANCE + i), float((met >> i) & 1))
    while caught != 0:
        i = count_trailing_zeros(caught)
        caught &= caught - 1
        sums[sc.TOTAL_CAUGHT + i] += 1.0
        sums[sc.TOTAL_UNLIT + i] += points[sc.UNLIT + i]
        sums[sc.TOTAL_LIT + i] += points[sc.LIT + i]


@inline
def _average(done: int, background: Background, sums: Array) -> None:
    """Replace the first four rows of a tile's sums, for its 64 pixels, by mean RGB over the background, and alpha.

    Shadow catchers cover a pixel by the blocked fraction of their light.

    done : number of samples; background : RGB and alpha
    """
    share = 1.0 / done
    for i in range(sc.TILE):
        unlit = sums[sc.TOTAL_UNLIT + i]
        dark = 1.0 - sums[sc.TOTAL_LIT + i] / unlit if unlit > 0.0 else 0.0
        covered = (sums[sc.TOTAL_MET + i] + sums[sc.TOTAL_CAUGHT + i] * dark) * share
        store3(sums, sc.TOTAL + i, add(scale(load3(sums, sc.TOTAL + i), share), scale(background[:3], 1.0 - covered)))
        sums[sc.TOTAL_MET + i] = covered + (1.0 - covered) * background[3]


@inline
def fill_tile(corner: Corner, background: Background, image: Array) -> None:
    """Fill a tile without hits with the background. The sums over samples of its pixels stay 0.

    corner : column and row of the tile's first pixel; background : RGB and alpha; image : (h, w, 4), RGB and alpha
    """
    for y in range(corner[1], min(corner[1] + EDGE, image.shape[0])):
        for x in range(corner[0], min(corner[0] + EDGE, image.shape[1])):
            for c in range(4):
                image[y, x, c] = background[c]


@inline
def finish_sums(corner: Corner, done: int, background: Background, film: Array, image: Array, scratch: Scratch) -> None:
    """Store a tile's sums over samples in `film`, if any, and its pixels' means over the background in the image.

    corner : column and row of the tile's first pixel; done : number of samples in the sums
    film : (h, w, k), the k sums kept of each pixel (RGB, number of hits and so on), or empty
    image : (h, w, 4), mean RGB and alpha; background : RGB and alpha
    """
    sums, height, width = scratch.sums, image.shape[0], image.shape[1]
    if film.size > 0:
        for i in range(sc.TILE):
            x, y = pixel_of(corner, i)
            if x < width and y < height:
                for c in range(film.shape[2]):
                    film[y, x, c] = sums[c * sc.TILE + i]
    _average(done, background, sums)
    for i in range(sc.TILE):
        x, y = pixel_of(corner, i)
        if x < width and y < height:
            for c in range(4):
                image[y, x, c] = sums[c * sc.TILE + i]
