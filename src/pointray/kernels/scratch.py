"""One thread's working memory: where a ray or a tile of rays keeps what it knows on its way."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..jit import Array, borrow, i64, inline
from .vec import Vec3

# A tile: 64 rays that are traced together, in vectors of 16. Its rows hold one number of each ray.
LANES, TILE = 16, 64
DIRECTION, ORIGIN = 0, 3 * TILE  # world, float64, 3 rows each: the ray as asked for
T_MIN, NEAREST = 6 * TILE, 7 * TILE  # where it begins; the nearest hit so far, at first where it ends
NORMAL, COLOR, LOCAL = 8 * TILE, 11 * TILE, 14 * TILE  # of that hit, 3 rows each
# The ray in the current model: where it begins and its unit direction, 3 rows each; the length that the direction had
# before; where it enters the bounds.
START, HEADING, SPEED, LOW = 17 * TILE, 20 * TILE, 23 * TILE, 24 * TILE
ANYWHERE = 1.0 + 2.0**-40  # a side: +1 as float32, of a ray that a camera or a caller sends, from wherever it is
SIDE_OF = 25 * TILE  # +1 where a ray that starts on a surface is outside of it, -1 where it is inside; or ANYWHERE
TOP_LOW, TOP_SPEED = 26 * TILE, 27 * TILE  # the ray in the tree over the instances, as LOW and SPEED
WORLD_ROWS = 28
INSTANCE_OF, LEAF_OF, SLOT_OF = 0, TILE, 2 * TILE  # int64: of the nearest hit, -1 for none
FOUND = 3 * TILE  # leaf of the hit in the current model, -1 for none
WAITING_COUNT = 4 * TILE  # rays that wait at each place
NUMBER_ROWS = 6
# float32: the rays in the current model, see `Ray`, and what is computed of them at a leaf.
OX, OY, OZ, DX, DY, DZ, IX, IY, IZ = (k * TILE for k in range(9))
# Where its nearest hit in this model is, at first a step behind where it ends: see `intersect/march.py`; below 0 where
# it misses the bounds.
LENGTH = 9 * TILE
NX, NY, NZ = 10 * TILE, 11 * TILE, 12 * TILE  # unit normal of that hit
ENTER, LEAVE, FIRST, LAST = 13 * TILE, 14 * TILE, 15 * TILE, 16 * TILE
END = 17 * TILE  # LENGTH as it was at first, whatever the ray hits
SIDE = 18 * TILE  # see SIDE_OF
TOP_OX, TOP_IX, TOP_LENGTH = 19 * TILE, 22 * TILE, 25 * TILE  # in the tree over the instances, 3, 3 and 1
# Where the ray begins, from where it enters the bounds on: nothing before counts. Negative where a clip plane has cut
# it, so that it begins on no surface; then never 0.
BEGIN = 26 * TILE
CUT = 27 * TILE  # 1 where a clip plane has cut the ray, in any model; else 0
MODEL_ROWS = 28
# The same rows of all the tile's rays, while a group of them stands in the rows above; FOUND of these.
ASIDE, FOUND_ASIDE = MODEL_ROWS * TILE, 5 * TILE
# float32: of the rays that search a leaf, one after the other, see `intersect/leaf.py`: the middle of the part that is
# looked at, the direction, where its first sample is, 3 rows each; half the part's length; the first and the last
# sample, and where the ray begins, see `leaf.Reach`; the nearest hit; the side.
PART = TILE + LANES  # the length of such a row: what follows the last ray is written over
AT_X, AT_Y, AT_Z, AT_DX, AT_DY, AT_DZ, AT_FIRST_X, AT_FIRST_Y, AT_FIRST_Z = (k * PART for k in range(9))
AT_HALF, AT_FIRST, AT_LAST, AT_BEGIN, AT_LENGTH, AT_SIDE = (k * PART for k in range(9, 15))
PART_ROWS = 15

# float64: of the surface points of a tile that are shaded, see `shade/direct.py`: where they are, the normal turned to
# the eye, the direction to the eye, the colour, 3 rows each; the instance, -1 for none; the side of the surface the eye
# is on; the radiance to the eye so far, and what the current light adds where nothing is in its way, 3 rows each.
SHADING_POINT, SHADING_NORMAL, SHADING_WO, SHADING_COLOR = 0, 3 * TILE, 6 * TILE, 9 * TILE
SHADING_INSTANCE, SHADING_SIDE, RADIANCE, GAIN = 12 * TILE, 13 * TILE, 14 * TILE, 17 * TILE
# How much radiance along the ray counts in the pixel, RGB; how many scatterings lie behind. Of a path: the key of its
# numbers, the pdf with which its ray's direction was chosen (0: no other way finds it); the same of the next ray.
THROUGHPUT, SHADING_DEPTH, KEY, PDF = 20 * TILE, 23 * TILE, 24 * TILE, 25 * TILE
NEXT, NEXT_SIDE, NEXT_THROUGHPUT, NEXT_PDF = 26 * TILE, 29 * TILE, 30 * TILE, 33 * TILE
UNLIT, LIT = 34 * TILE, 35 * TILE  # of a shadow catcher: light that would arrive, that does
SKY_SEEN = 36 * TILE  # share of the sky that a surface point sees, by the cosine
SHADING_ROWS = 37
# float64: the sums of a tile's pixels, see `rendering/film.py`: RGB; samples that met something; squares of the
# luminance; samples that met a shadow catcher, what UNLIT and LIT were there.
TOTAL, TOTAL_MET, TOTAL_SQUARE = 0, 3 * TILE, 4 * TILE
TOTAL_CAUGHT, TOTAL_UNLIT, TOTAL_LIT, SUM_ROWS = 5 * TILE, 6 * TILE, 7 * TILE, 8
# Rays that wait, see `shade/specular_rays.py`: origin, direction, how much each counts, 3 each, side, depth.
WAITING, MOST_WAITING = 11, 33

COUNT_NEAR = 0  # blocks listed near the current rays
COUNT_NODES, COUNT_LEAVES = 1, 2  # visited
COUNT_SPLATS = 3  # splats listed near the current rays
CAUGHT = 4  # the camera's rays of the tile that have met a shadow catcher, as bits
ANY_HIT = 5  # 1 while it matters only whether the tile's rays meet anything
SEEN_ONLY = 6  # 1 where of hits only the colours matter, and only those that materials show

# Splats gathered from the listed blocks, 16 together: 7 rows of 16 float32, in the order of a block's.
GATHERED = 7 * LANES


@inline
def load3(rows: Array, i: int) -> Vec3:
    """Three numbers of one ray in three neighbouring rows of a tile."""
    return rows[i], rows[i + TILE], rows[i + 2 * TILE]


@inline
def store3(rows: Array, i: int, a: Vec3) -> None:
    """Write three numbers of one ray to three neighbouring rows of a tile."""
    rows[i], rows[i + TILE], rows[i + 2 * TILE] = a


class Scratch(NamedTuple):
    """One thread's working memory.

    stack : (512,) int32, children still to visit; stack_near : (512,) float32, where the ray enters them
    near : (n,) int32, blocks near the rays in the current leaf; counts : (8,) int64, see COUNT_*
    lift : (1,) float32, the start rule's state, see `intersect/march.py`
    splats : (m,) float32, the splats of these blocks, see GATHERED
    places : (4 n,) int32, where in `splats` each of them is
    listed : (4 n,) int32, the places of those near the rays that are evaluated
    world, model, numbers : the rows of a tile, float64, float32 and int64; part : float32, of those that search a leaf
    shading_points : float64, rows of the shading points; sums : float64, rows of the sums of a tile's pixels
    waiting : float64, rays that mirrors and glass send on
    top_what : (128,) int32, entries of the tree over the instances still to visit; top_rays : (128,)
    int64, the rays that enter them; top_near : (128,) float32, where the first of these does
    """

    stack: Array
    stack_near: Array
    near: Array
    counts: Array
    lift: Array
    splats: Array
    places: Array
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
    """Working memory for models whose longest leaf knows `longest` blocks."""
    groups = longest // 4 + 1
    places = np.empty(groups * LANES, np.int32)
    for k in range(places.size):
        places[k] = k // LANES * GATHERED + k % LANES
    return Scratch(
        np.empty(512, np.int32),
        np.empty(512, np.float32),
        np.empty(longest + 16, np.int32),
        np.zeros(8, np.int64),
        np.zeros(1, np.float32),
        np.empty(groups * GATHERED, np.float32),
        places,
        np.empty(places.size + LANES, np.int32),
        np.zeros(WORLD_ROWS * TILE, np.float64),
        np.zeros(2 * MODEL_ROWS * TILE, np.float32),
        np.zeros(NUMBER_ROWS * TILE, np.int64),
        np.zeros(PART_ROWS * PART, np.float32),
        np.zeros(SHADING_ROWS * TILE, np.float64),
        np.zeros(SUM_ROWS * TILE, np.float64),
        np.empty(TILE * MOST_WAITING * WAITING, np.float64),
        np.empty(128, np.int32),
        np.empty(128, np.int64),
        np.empty(128, np.float32),
    )


@inline
def borrow_scratch(s: Scratch) -> Scratch:
    """The working memory without references to it (see `jit.borrow`): the kernel must `keep` the original."""
    return Scratch(
        borrow(s.stack),
        borrow(s.stack_near),
        borrow(s.near),
        borrow(s.counts),
        borrow(s.lift),
        borrow(s.splats),
        borrow(s.places),
        borrow(s.listed),
        borrow(s.world),
        borrow(s.model),
        borrow(s.numbers),
        borrow(s.part),
        borrow(s.shading_points),
        borrow(s.sums),
        borrow(s.waiting),
        borrow(s.top_what),
        borrow(s.top_rays),
        borrow(s.top_near),
    )


@inline
def slot_of(scratch: Scratch, place: int) -> int:
    """Which splat of the tree lies at a place of the gathered ones."""
    k = place // GATHERED * LANES + place % GATHERED
    return i64(scratch.near[k // 4]) * 4 + k % 4
