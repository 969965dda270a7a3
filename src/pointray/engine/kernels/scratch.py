"""One thread's working memory: the state of a ray or of a tile of rays between the functions that handle it.

A tile is 64 rays that are traced together, in vectors of 16. A row holds one number for each ray. Rows are declared
below, part by part: each name is the offset of its rows in the part's array.

| part | written by | read by | valid for |
|---|---|---|---|
| DIRECTION, ORIGIN, T_MIN, SIDE_OF | `set_ray`, `film`, `trace/world.py` | `trace/`, `shade/` | until set anew |
| NEAREST | `set_ray`; `trace_tile`, `occlude_tile` | `trace/`, `tile_hit`, `shade/` | until rays are set anew |
| NORMAL, LOCAL, INSTANCE_OF, LEAF_OF | `trace_tile`, `occlude_tile` | `tile_hit`, `shade/` | until the next of these |
| COLOR, SLOT_OF | `describe_tile`; a plane's COLOR `trace_tile` | `tile_hit`, `shade/` | until rays are traced again |
| START, HEADING, SPEED, LOW | `instance` | `instance` | while the tile is in one model |
| TOP_*, top_what, top_rays, top_near | `instance_bvh` | `world`, `instance_bvh` | one `trace_tile` |
| OX to BEGIN but TOP_*, FOUND | `instance`, `tile`, `leaf` | the same | while the tile is in one model |
| SCATTER_* | `scattered` | `scattered`, `tile` | one traversal of a model |
| CUT | `surface/trace/world.py` | `plane`, `instance` | one `trace_tile` |
| SAVED_ROWS, FOUND_SAVED | `group` | `group` | while a group of the rays is in one model |
| stack, stack_near | `traverse`, `tile` | the same | one traversal of a model |
| part | `leaf`; later `hits`, `paint`, `baked` | `leaf`, `gather`; the same | one leaf; four hits |
| near, COUNT_NEAR | `gather`, `baked` | `disc`, `hits`, `paint`, `cast`, `baked` | one leaf, or four hits |
| splats, listed, COUNT_SPLATS | `gather`, `baked` | `surface`, `march`, `leaf`, `baked` | one leaf, or four hits |
| offsets | `new_scratch` | `gather` | always |
| COUNT_NODES, COUNT_LEAVES | `traverse`, `tile` | `integrate` | until the reader resets them |
| SHADING_* | `store_shading_points`, `path`, `catcher` | `shade/` | until the tile's next points |
| KEY | `film` | `film`, `shade/` | one tile of the image |
| RADIANCE, THROUGHPUT, PDF, SHADING_DEPTH | `shade/` | `shade/`, `film` | one sample of the tile |
| GAIN, SKY_SEEN, NEXT* | `shade/` | `shade/` | one light, sky lookup, or scattering |
| ARRIVING* | `baked` | `baked_light`, `lobes` | one lookup of the tile |
| CAUGHT, UNLIT, LIT | `catcher` | `catcher`, `film` | one sample of the tile |
| waiting, WAITING_COUNT | `specular_rays` | `specular_rays` | one sample of the tile |
| sums | `film` | `film` | one tile of the image |

Two parts are shared by uses that exclude each other: IMAGE_X and IMAGE_Y are the direction's rows until rays are
generated; COST_ORIGIN and COST_DIRECTION are rows of shading points while these are unused.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..jit import Array, i64, inline
from .vec import Vec3

LANES, TILE = 16, 64


class Rows:
    """Allocator of consecutive rows in an array of scratch memory; a row has one number for each ray of a tile.

    width : numbers per row; size : total length of the rows allocated so far
    """

    def __init__(self, width: int) -> None:
        self._width, self.size = width, 0

    def __call__(self, count: int = 1) -> int:
        """Allocate `count` rows behind the previous ones and return the offset of the first in the array."""
        begin = self.size
        self.size += count * self._width
        return begin


# world, float64: the rays in world space. Kernels call it `wide`, as `world` is the scene's `World`.
_rows = Rows(TILE)
DIRECTION, ORIGIN = _rows(3), _rows(3)  # the ray as given by the caller
T_MIN, NEAREST = _rows(), _rows()  # where the ray begins; its nearest hit so far, initially its end
NORMAL, COLOR, LOCAL = _rows(3), _rows(3), _rows(3)  # of the nearest hit
# The ray in the current model: origin, unit direction, the direction's original length, where it enters the bounds.
START, HEADING, SPEED, LOW = _rows(3), _rows(3), _rows(), _rows()
ANYWHERE = 1.0 + 2.0**-40  # a side: +1 as float32; marks a ray of a camera or a caller, which may start anywhere
SIDE_OF = _rows()  # +1 if a ray that starts on a surface is outside of it, -1 if it is inside; or ANYWHERE
TOP_LOW, TOP_SPEED = _rows(), _rows()  # LOW and SPEED of the ray in the BVH over the instances
WORLD_SIZE = _rows.size
IMAGE_X, IMAGE_Y = DIRECTION, DIRECTION + TILE  # image position of each ray, until rays are generated

# numbers, int64.
_rows = Rows(TILE)
INSTANCE_OF, LEAF_OF, SLOT_OF = _rows(), _rows(), _rows()  # of the nearest hit, -1 for none
FOUND = _rows()  # leaf of the hit in the current model, -1 for none
WAITING_COUNT = _rows()  # number of pending rays at each shading point
FOUND_SAVED = _rows()  # FOUND of all the tile's rays, while a group of them uses the rows above
SCATTER_SLOT = _rows()  # slot of the nearest scattered point hit in the current model, -1 for none
NUMBERS_SIZE = _rows.size

# model, float32: the rays in the current model, see `engine.kernels.tree.Ray`, and values computed of them at a leaf.
_rows = Rows(TILE)
OX, OY, OZ, DX, DY, DZ, IX, IY, IZ = (_rows() for _ in range(9))
# How far the ray is followed: initially one step beyond its end, see `intersect/march.py`, then to where it enters the
# voxel of its hit; below 0 if it misses the bounds. Two voxels that share a face can find the same root, with different
# rounding. The first voxel along the ray decides, not the least t, so that the result does not depend on the order in
# which a tile visits them.
LENGTH = _rows()
HIT_T, NX, NY, NZ = _rows(), _rows(), _rows(), _rows()  # t and unit normal of the ray's hit in this model
ENTER, LEAVE, FIRST, LAST = _rows(), _rows(), _rows(), _rows()  # of the leaf: its voxel, and the part that is searched
END = _rows()  # the initial LENGTH, whatever the ray hits
SIDE = _rows()  # see SIDE_OF
TOP_OX, TOP_IX, TOP_LENGTH = _rows(3), _rows(3), _rows()  # in the BVH over the instances
# Where the ray begins, measured from where it enters the bounds: no hit before it counts. Negative if a clip plane has
# cut the ray, so that it starts on no surface; then never 0.
BEGIN = _rows()
SCATTER_T = _rows()  # t of the nearest hit of a scattered point in this model; inf: none
SCATTER_END = _rows()  # how far scattered points are searched: to the nearest hit of any kind; below 0: not at all
CUT = _rows()  # 1 if a clip plane has cut the ray, in any model; else 0
SAVED_ROWS = _rows(_rows.size // TILE)  # the same rows of all the tile's rays, while a group uses the rows above
MODEL_SIZE = _rows.size

# part, float32: the rays that search a leaf, packed, see `intersect/leaf.py`. A row is longer by 16, because stores
# overwrite the lanes behind the last ray.
PART = TILE + LANES
_rows = Rows(PART)
AT_X, AT_Y, AT_Z, AT_DX, AT_DY, AT_DZ = (_rows() for _ in range(6))  # centre of the searched part; direction
AT_OX, AT_OY, AT_OZ = (_rows() for _ in range(3))  # origin
AT_HALF, AT_FIRST, AT_LAST = _rows(), _rows(), _rows()  # half the length; indices of the first and the last sample
AT_BEGIN, AT_T, AT_SIDE = _rows(), _rows(), _rows()  # see `lattice.SampleRange`; nearest hit in the leaf; side
PART_SIZE = _rows.size

# shading_points, float64: where the tile's rays have hit a surface.
_rows = Rows(TILE)
SHADING_POINT, SHADING_NORMAL, SHADING_WO = _rows(3), _rows(3), _rows(3)  # the normal is turned to the viewer
SHADING_COLOR, SHADING_INSTANCE, SHADING_SIDE = _rows(3), _rows(), _rows()  # instance: -1 for none; side of the viewer
SHADING_MARGIN = _rows()  # offset of secondary rays from the surface, in world space
RADIANCE, GAIN = _rows(3), _rows(3)  # toward the viewer so far; contribution of the current light if unoccluded
THROUGHPUT, SHADING_DEPTH = _rows(3), _rows()  # weight of radiance in the pixel; scatterings so far
KEY = _rows()  # key of the pixel's random numbers
PDF = _rows()  # density with which a path's ray was sampled; 0: no other technique samples its direction
NEXT, NEXT_SIDE, NEXT_THROUGHPUT, NEXT_PDF = _rows(3), _rows(), _rows(3), _rows()  # a path's next ray
UNLIT, LIT = _rows(), _rows()  # of a shadow catcher: light without and with occlusion
SKY_SEEN = _rows()  # cosine-weighted share of the sky visible from a surface point
# Baked light, see `shade/baked.py`: irradiance; its moments minus those of uniform light (luminance, red, blue).
ARRIVING, ARRIVING_MOMENTS, ARRIVING_COLORS = _rows(3), _rows(8), _rows(6)
SHADING_SIZE = _rows.size
COST_ORIGIN, COST_DIRECTION = SHADING_POINT, SHADING_WO  # of rays whose cost is counted one by one

# sums, float64, over a tile's pixels, see `rendering/film.py`. A film keeps the first of them, in this order.
_rows = Rows(TILE)
TOTAL, TOTAL_MET, TOTAL_SQUARE = _rows(3), _rows(), _rows()  # light; samples that hit something; squared luminance
TOTAL_CAUGHT, TOTAL_UNLIT, TOTAL_LIT = _rows(), _rows(), _rows()  # samples that hit a shadow catcher; UNLIT, LIT there
SUMS_SIZE = _rows.size

# waiting, float64, see `shade/specular_rays.py`: a stack of pending specular rays for each shading point.
_rows = Rows(1)
WAIT_ORIGIN, WAIT_DIRECTION, WAIT_THROUGHPUT = _rows(3), _rows(3), _rows(3)
WAIT_SIDE, WAIT_DEPTH = _rows(), _rows()
WAITING = _rows.size
MOST_WAITING = 33

# counts, int64.
_rows = Rows(1)
COUNT_NEAR = _rows()  # number of blocks near the current rays
COUNT_NODES, COUNT_LEAVES = _rows(), _rows()  # number visited
COUNT_SPLATS = _rows()  # number of splats near the current rays
CAUGHT = _rows()  # camera rays of the tile that have hit a shadow catcher, as bits
COUNTS_SIZE = _rows.size

# splats, float32: the splats of the listed blocks in groups of 16: 7 rows of 16, in the order of a block's rows.
GATHERED = 7 * LANES
STACK, TOP_STACK = 512, 128  # children still to visit, in a model and over the instances


@inline
def load3(rows: Array, i: int) -> Vec3:
    """Load three numbers of one ray from three consecutive rows of a tile.

    i : offset of the first row in the array, plus the index of the ray in the tile, 0 to 63
    """
    return rows[i], rows[i + TILE], rows[i + 2 * TILE]


@inline
def store3(rows: Array, i: int, a: Vec3) -> None:
    """Store three numbers of one ray in three consecutive rows of a tile.

    i : offset of the first row in the array, plus the index of the ray in the tile, 0 to 63
    """
    rows[i], rows[i + TILE], rows[i + 2 * TILE] = a


class Scratch(NamedTuple):
    """One thread's working memory. Constants name the rows of its arrays; a row has one number for each ray.

    stack : (512,) int32, nodes of a model still to visit
    stack_near : (512,) float32, t where the ray enters each of these nodes
    near : (n,) int32, numbers of the blocks near the rays in the current leaf
    counts : int64, counters, see COUNT_*
    splats : (m,) float32, the splats of the blocks in `near`, in groups of 16: 7 rows of 16, as in a block
    offsets : (4 n,) int32, offset of each of these splats in `splats`
    listed : (4 n,) int32, offsets in `splats` of the splats near the rays that are evaluated
    world : float64, the tile's rays in world space, with their nearest hits
    model : float32, the rays in the space of the current model
    numbers : int64, indices of the rays' nearest hits: instance, leaf and slot
    part : float32, the rays that search a leaf, packed
    shading_points : float64, surface points hit by the tile's rays, and the light there
    sums : float64, sums over the samples of a tile's pixels
    waiting : float64, for each shading point a stack of specular rays still to trace
    top_what : (128,) int32, nodes and instances (~instance) of the BVH over the instances still to visit
    top_rays : (128,) int64, the rays that enter each of these, as bits
    top_near : (128,) float32, least t at which one of these rays enters
    """

    stack: Array
    stack_near: Array
    near: Array
    counts: Array
    splats: Array
    offsets: Array
    listed: Array
    world: Array
    model: Array
    numbers: Array
    part: Array
    shading_points: Array
    sums: Array
    waiting: Array
    top_what: Array
    top_rays: Array
    top_near: Array


@inline
def new_scratch(longest: int) -> Scratch:
    """Allocate working memory for models whose leaves list at most `longest` blocks."""
    groups = longest // 4 + 1
    offsets = np.empty(groups * LANES, np.int32)
    for k in range(offsets.size):
        offsets[k] = k // LANES * GATHERED + k % LANES
    return Scratch(
        np.empty(STACK, np.int32),
        np.empty(STACK, np.float32),
        np.empty(4 * longest + 16, np.int32),  # `shade/baked_sums.py` lists four records for each block
        np.zeros(COUNTS_SIZE, np.int64),
        np.empty(max(groups * GATHERED, 5 * LANES * (longest + 16)), np.float32),  # there also: their weights
        offsets,
        np.empty(offsets.size + LANES, np.int32),
        np.zeros(WORLD_SIZE, np.float64),
        np.zeros(MODEL_SIZE, np.float32),
        np.zeros(NUMBERS_SIZE, np.int64),
        np.zeros(PART_SIZE, np.float32),
        np.zeros(SHADING_SIZE, np.float64),
        np.zeros(SUMS_SIZE, np.float64),
        np.empty(TILE * MOST_WAITING * WAITING, np.float64),
        np.empty(TOP_STACK, np.int32),
        np.empty(TOP_STACK, np.int64),
        np.empty(TOP_STACK, np.float32),
    )


@inline
def slot_of(scratch: Scratch, offset: int) -> int:
    """Return the index in `Tree.order` of the splat at an offset of `Scratch.splats`, the splats gathered in a leaf."""
    k = offset // GATHERED * LANES + offset % GATHERED
    return i64(scratch.near[k // 4]) * 4 + k % 4
