"""The records of one model, in its own space: layout of the tree's arrays, and the values that mean "none".

All arrays are flat and C-contiguous, so that a model can be passed as a table of addresses (`model_table`) and every
kernel has one signature for any number of models. Lengths are in model space, relative to the points' origin.

What "none" means
-----------------
- A ray that misses has t = inf; a degenerate ray (a direction that is zero or not finite) misses.
- An empty box is lo = +inf, hi = -inf: no ray enters it. Every box test must handle it without a special case.
- A column of a leaf that no support reaches has PATCH_LOW = PATCH_HIGH = NO_SURFACE (1e30): no ray enters its slab.
- An empty slot of a block is a splat at EMPTY (1e15) with radius 1: its weight is 0 everywhere. No other is beyond FAR.
- An empty slot of a group of bounding spheres has the radius NaN: no ray comes near it.
- The surface function is NaN where no support reaches; comparisons with NaN are false, so no sign change is found.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...base.choices import SURFACES, number_of
from ..jit import Array, array_at, f32, i32, inline

EMPTY, FAR = f32(1e15), f32(1e14)

# A block: 4 splats as a structure of arrays, 7 rows of 4 float32 (28 bytes a splat).
BLOCK = 28
PX, PY, PZ, NX, NY, NZ, INV_R2 = 0, 4, 8, 12, 16, 20, 24

# A leaf: 16 float32.
LEAF = 16
CELL = 0  # 0..5: the kd-tree's voxel, lo x y z, hi x y z
SLAB = 6  # 6..8: unit normal m of the slab; all surface in the voxel has SLAB_LO <= m.x <= SLAB_HI
SLAB_LO, SLAB_HI = 9, 10
STEP = 11  # distance of the samples along a ray
RADIUS = 12  # mean support radius of the splats over the voxel
LEAST = 13  # least support radius in and around the voxel, see `surface/tree/cells.py`
BORDERED = 14  # 1 if one of these splats lies on an open border
SHEETED = 15  # 1 if one of these splats belongs to one of two sheets that face away from each other

# A leaf's patches: 4 rows of 16 float32, one number for each of its 4 x 4 columns, see `tree/columns.py`. With u and v
# in columns, relative to the low corner of the voxel, the surface is where PATCH_LOW <= w + PATCH_B u + PATCH_C v <=
# PATCH_HIGH.
COLUMNS = 4
PATCH = 4 * COLUMNS * COLUMNS
PATCH_B, PATCH_C, PATCH_LOW, PATCH_HIGH = 0, 16, 32, 48
NO_SURFACE = f32(1e30)

# A wide node: the boxes of 8 children, 6 rows (lo x y z, hi x y z) of 8 float32.
WIDTH = 8
NODE = 6 * WIDTH
NO_CHILD = -(2**31)  # otherwise: a child >= 0 is a node, a child < 0 is leaf ~child
# Leaves from this number on hold scattered points: leaf SCATTERED + b has blocks b and b + 1. Their splats are drawn as
# spheres or single discs of their radius; their normals are the mean directions of their neighbourhoods. As the leaf of
# a hit, SCATTERED + s is slot s. These blocks follow those of the surface, and no group lists them.
SCATTERED = 1 << 30
LEAF_BLOCKS = 2  # with 1 block, bounces among a million spheres take 1.7 times as long, shadow rays 1.2

# A group: 16 bounding spheres of blocks, 4 rows (centre x y z, radius) of 16 float32.
GROUP = 64

# The head of a model: 16 float32.
HEAD = 16
BOUNDS = 0  # 0..5: lo x y z, hi x y z of all supports
SURFACE = 6  # the kind of surface: one of the next four
PAPER, IMLS, APSS, DISC = (number_of(SURFACES, name) for name in ("paper", "imls", "apss", "disc"))
REFINE = 7  # secant steps after a sign change is found
TRIM = 8  # largest |x - P(x)| of a hit, in local radii; inf: no limit
OVERHANG = 9  # largest distance of a hit beyond an open border, in local radii; inf: no limit
LONGEST = 10  # largest sample step of any leaf
SCATTER = 11  # how scattered points are drawn: SPHERES or DISCS; 0: the tree has none
SPHERES, DISCS = 1, 2
SCATTER_LEAVES = 12  # number of leaves of scattered points, rounded to float32


class Tree(NamedTuple):
    """The acceleration structure of one model, with its splats, as flat arrays of records.

    A name in capitals is a constant of this module, the length of a record; the constants behind it are the fields.

    head : (16,) float32, bounds, kind of surface, how far hits may be from splats, and so on (HEAD)
    boxes : (nodes * 48,) float32, tight boxes of a node's 8 children: 6 rows (lo x y z, hi x y z) of 8
    children : (nodes * 8,) int32, a child >= 0 is a node, a child < 0 is leaf ~child; NO_CHILD for none
    leaves : (leaves * 16,) float32, voxel, slab and sample step of each leaf (LEAF)
    patches : (leaves * 64,) float32, slabs of the leaf's 4 x 4 columns (PATCH)
    spans : (leaves * 2,) int32, first group and number of groups, each of 16 blocks, that a leaf lists
    spheres : (groups * 64,) float32, bounding spheres of a group's blocks: 4 rows (centre x y z, radius) of 16
    refs : (groups * 16,) int32, numbers of a group's blocks; 0 in an empty slot
    blocks : (blocks * 28,) float32, the splats: 7 rows (position, normal, 1 / radius^2) of 4
    order : (blocks * 4,) int32, the caller's row of each splat; -1 in an empty slot
    borders : (blocks * 4 * 3,) int8, for a splat on an open border the direction out of the surface (unit, in 127ths),
        else zero; length 0 if no splat is
    facing : (blocks * 4 * 3,) int8, for a splat with another sheet close by its normal (unit, in 127ths), else zero;
        length 0 if no splat has one
    colors : (blocks * 4,) int32, sRGB as r + 256 g + 65536 b; length 0 if the points have no colours
    noise : (blocks,) float32, standard deviation of the noise that was removed, of the noisiest of a block's splats;
        length 0 if the points were not denoised
    """

    head: Array
    boxes: Array
    children: Array
    leaves: Array
    patches: Array
    spans: Array
    spheres: Array
    refs: Array
    blocks: Array
    order: Array
    borders: Array
    facing: Array
    colors: Array
    noise: Array


def no_tree(bounds: Array) -> Tree:
    """Return a tree without splats, which no ray hits. bounds : (6,) float32, lo x y z, hi x y z"""
    head = np.zeros(HEAD, np.float32)
    head[BOUNDS : BOUNDS + 6], head[TRIM], head[OVERHANG] = bounds, np.inf, np.inf
    boxes = np.repeat(np.array([np.inf] * 3 + [-np.inf] * 3, np.float32), WIDTH)
    children = np.full(WIDTH, NO_CHILD, np.int32)
    real, whole, small = np.zeros(0, np.float32), np.zeros(0, np.int32), np.zeros(0, np.int8)
    return Tree(head, boxes, children, real, real, whole, real, whole, real, whole, small, small, whole, real)


def first_scattered(tree: Tree) -> int:
    """Return the index of the first block of scattered points, which follow the blocks of the surface.

    Scattered points lie on no surface and are drawn as spheres or discs. Without any it is the number of blocks.
    """
    leaf = ~tree.children[(tree.children < 0) & (tree.children != NO_CHILD)].astype(np.int64)
    scattered = leaf[leaf >= SCATTERED] - SCATTERED
    return int(scattered.min(initial=tree.blocks.size // BLOCK))


_F32, _I32, _I8 = f32(0), i32(0), np.int8(0)
ROW = 2 * len(Tree._fields)  # a model in the table: address and length of each array


class _Addresses(bytearray):
    """Memory of a table of addresses, which keeps alive the arrays to which they point: those of `trees`."""

    trees: list[Tree]


def model_table(trees: list[Tree]) -> Array:
    """Return a table of the models' trees for kernels, (models * ROW,) int64: address and length of each array.

    It keeps the trees alive; a copy does not.
    """
    rows = [[value for array in tree for value in (array.ctypes.data, array.size)] for tree in trees]
    memory = _Addresses(np.array(rows, np.int64).tobytes())
    memory.trees = list(trees)
    return np.frombuffer(memory, np.int64) if rows else np.zeros(0, np.int64)


@inline
def tree_at(table: Array, model: int) -> Tree:
    """Return the tree of one model, as arrays.

    table : addresses and lengths of the arrays of all models' trees; model : index of the model
    """
    i = model * ROW
    return Tree(
        array_at(table[i + 0], table[i + 1], _F32),
        array_at(table[i + 2], table[i + 3], _F32),
        array_at(table[i + 4], table[i + 5], _I32),
        array_at(table[i + 6], table[i + 7], _F32),
        array_at(table[i + 8], table[i + 9], _F32),
        array_at(table[i + 10], table[i + 11], _I32),
        array_at(table[i + 12], table[i + 13], _F32),
        array_at(table[i + 14], table[i + 15], _I32),
        array_at(table[i + 16], table[i + 17], _F32),
        array_at(table[i + 18], table[i + 19], _I32),
        array_at(table[i + 20], table[i + 21], _I8),
        array_at(table[i + 22], table[i + 23], _I8),
        array_at(table[i + 24], table[i + 25], _I32),
        array_at(table[i + 26], table[i + 27], _F32),
    )


class Ray(NamedTuple):
    """A ray in model space, as traced through one model.

    ox, oy, oz : origin, where the ray enters the model's bounds; dx, dy, dz : unit direction
    ix, iy, iz : inverse of each component of the direction
    t_min : t where the ray begins, or -t if it starts on no surface, as after a cut by a clip plane
    t_max : how far the ray is followed: one sample step beyond its end
    side : +1 if a ray that starts on the surface is outside (where normals point), -1 if it is inside
    """

    ox: float
    oy: float
    oz: float
    dx: float
    dy: float
    dz: float
    ix: float
    iy: float
    iz: float
    t_min: float
    t_max: float
    side: float


class Hit(NamedTuple):
    """A ray's hit with a model, in model space; t = inf and leaf = -1 for a miss.

    t : distance from the ray's origin; nx, ny, nz : unit normal; leaf : index of the leaf
    """

    t: float
    nx: float
    ny: float
    nz: float
    leaf: int
