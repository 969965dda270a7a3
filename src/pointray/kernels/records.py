"""The records that kernels share: what each array holds, in which unit, and what stands for 'none'. Said once, here.

All arrays are flat and C-contiguous, so that a model can travel as a table of addresses (`model_table`) and every
kernel has one signature whatever the number of models. Lengths are in model space, about the points' origin.

What 'none' means
-----------------
- A ray that misses has t = inf; a degenerate ray (a direction that is zero or not finite) misses.
- An empty box is lo = +inf, hi = -inf: no ray enters it. Every box test must get this right without a special case.
- A column of a leaf that no support reaches has PATCH_LOW = PATCH_HIGH = NO_SURFACE (1e30): no ray is in its slab.
- An empty slot of a block is a splat at EMPTY (1e15) with radius 1: its weight is 0 everywhere. No other is beyond FAR.
- An empty slot of a group of spheres has the radius NaN: no ray is near it.
- The surface function is NaN where no support reaches; a comparison with it is false, so that no sign change counts.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..choices import PROJECTIONS, SURFACES, number_of
from ..jit import Array, array_at, f32, i32, inline
from .vec import Vec3

EMPTY, FAR = f32(1e15), f32(1e14)

# A block: 4 splats in structure-of-arrays order, 7 rows of 4 float32 (28 bytes a splat).
BLOCK = 28
PX, PY, PZ, NX, NY, NZ, INV_R2 = 0, 4, 8, 12, 16, 20, 24

# A leaf: 16 float32.
LEAF = 16
CELL = 0  # 0..5: the kd-tree's voxel, lo x y z, hi x y z
SLAB = 6  # 6..8: unit normal m of the slab; all surface in the voxel has SLAB_LO <= m.x <= SLAB_HI
SLAB_LO, SLAB_HI = 9, 10
STEP = 11  # distance of the samples along a ray
RADIUS = 12  # mean support radius of the splats over the voxel
LEAST = 13  # least support radius over the voxel and around it, see `tree/cells.py`
BORDERED = 14  # 1 where one of them lies on an open border
SHEETED = 15  # 1 where one of them belongs to two sheets that face away from each other

# A leaf's patches: 4 rows of 16 float32, one of each of its 4 x 4 columns, see `tree/columns.py`. Relative to the least
# corner of its voxel, u and v in columns, the surface is where PATCH_LOW <= w + PATCH_B u + PATCH_C v <= PATCH_HIGH.
COLUMNS = 4
PATCH = 4 * COLUMNS * COLUMNS
PATCH_B, PATCH_C, PATCH_LOW, PATCH_HIGH = 0, 16, 32, 48
NO_SURFACE = f32(1e30)

# A wide node: the boxes of 8 children, 6 rows (lo x y z, hi x y z) of 8 float32.
WIDTH = 8
NODE = 6 * WIDTH
NO_CHILD = -(2**31)  # else: a child >= 0 is a node, a child < 0 is leaf ~child

# A group: 16 bounding spheres of blocks, 4 rows (centre x y z, radius) of 16 float32.
GROUP = 64

# The head of a model: 16 float32.
HEAD = 16
BOUNDS = 0  # 0..5: lo x y z, hi x y z of all supports
SURFACE = 6  # which surface: one of the next four
PAPER, IMLS, APSS, DISC = (number_of(SURFACES, name) for name in ("paper", "imls", "apss", "disc"))
REFINE = 7  # secant steps after the bracket
TRIM = 8  # largest |x - P(x)| of a hit, in local radii; inf: no limit
OVERHANG = 9  # how far a hit may lie out of an open border, in local radii; inf: no limit
LONGEST = 10  # longest step of the samples in any leaf


class Tree(NamedTuple):
    """The acceleration structure of one model, with its splats.

    head : (16,) float32, see `HEAD`
    boxes : (nodes * 48,) float32, the children's tight boxes
    children : (nodes * 8,) int32
    leaves : (leaves * 16,) float32, see `LEAF`
    patches : (leaves * 64,) float32, see `PATCH`
    spans : (leaves * 2,) int32, first group and number of groups
    spheres : (groups * 64,) float32, bounding spheres of the blocks that a leaf knows
    refs : (groups * 16,) int32, their numbers; 0 in an empty slot
    blocks : (blocks * 28,) float32
    order : (blocks * 4,) int32, the caller's row of each splat; -1 in an empty slot
    borders : (blocks * 4 * 3,) int8, for a splat on an open border the direction out of the surface (unit, in 127ths),
        else zero; or length 0: none is
    facing : (blocks * 4 * 3,) int8, for a splat with another sheet close by its normal (unit, in 127ths),
        else zero; or length 0: there is none
    colors : (blocks * 4,) int32, sRGB as r + 256 g + 65536 b; or length 0: the points have none
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


_F32, _I32, _I8 = f32(0), i32(0), np.int8(0)
ROW = 2 * len(Tree._fields)  # a model in the table: the address and the length of each array


class _Addresses(bytearray):
    """The memory of a table of addresses, with what they point to: as long as the one is there, so is the other."""

    trees: list[Tree]


def model_table(trees: list[Tree]) -> Array:
    """(models * ROW,) int64: where each model's arrays lie. The table keeps the trees alive; a copy of it does not."""
    rows = [[value for array in tree for value in (array.ctypes.data, array.size)] for tree in trees]
    memory = _Addresses(np.array(rows, np.int64).tobytes())
    memory.trees = list(trees)
    return np.frombuffer(memory, np.int64) if rows else np.zeros(0, np.int64)


@inline
def tree_at(table: Array, model: int) -> Tree:
    """The tree of one model of the table."""
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
    )


class Ray(NamedTuple):
    """A ray in model space: origin, unit direction, the inverse of each component, the interval, the side it starts on.

    t_min : see `scratch.BEGIN`; t_max : see `scratch.LENGTH`
    side : +1 where a ray that starts on the surface is outside (where normals point), -1 where it is inside
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
    """Where a ray meets a model, in model space: t = inf and leaf = -1 for a miss; the normal has unit length."""

    t: float
    nx: float
    ny: float
    nz: float
    leaf: int


# An instance: 16 float64.
INSTANCE = 16
KIND = 0  # MODEL, PLANE, or CATCHER: a plane of which the camera sees the shadows only
MODEL, PLANE, CATCHER = 0, 1, 2
SHAPE_ROW = 1  # which model of the table, or which plane
MATERIAL = 2  # which material
PAINT = 3  # which paint, -1: the points' own colours
TO_MODEL = 4  # 4..15: of a model world to model space, row-major 3x4

# A plane: 20 float64, in the world.
PLANE_SIZE = 20
PLANE_POINT, PLANE_NORMAL, PLANE_COLOR = 0, 3, 6  # 3 each
PLANE_CHECKER = 9  # edge of a checker's square, 0: plain
PLANE_U, PLANE_V = 10, 13  # the checker's axes, 3 each
PLANE_INSTANCE = 16  # which instance it is

# The tree over the instances that are models: binary, the boxes of both children (lo x y z, hi x y z) in a node.
TOP_NODE = 12
# Where it is, 9 float64: the position that its boxes are about, and the bounds of all of them (lo x y z, hi x y z).
TOP_CENTER, TOP_BOUNDS = 0, 3
TOP_SIZE = 9

# A clip plane: 4 float64, in the world: its unit normal n, and o; what has n.x > o is cut away.
CLIP = 4
CLIP_OFFSET = 3

# A light: 18 float64.
LIGHT = 18
LIGHT_KIND = 0
POINT_LIGHT, SUN_LIGHT, RECT_LIGHT, DISK_LIGHT, SPHERE_LIGHT = range(5)
LIGHT_POSITION = 1  # 1..3: position or middle, or direction of travel
LIGHT_POWER = 4  # RGB: intensity in W/sr, of the sun irradiance in W/m2, of what has a size radiance in W/(m2 sr)
LIGHT_U, LIGHT_V = 7, 10  # 3 each, of a rectangle and a disk: from the middle to the edge
LIGHT_FACING = 13  # 13..15, of these two: unit, the side that shines
LIGHT_RADIUS = 16  # of a sphere; of the sun 1 - cosine of half the angle it fills
LIGHT_AREA = 17

# The light from all around, if there is any: 20 float64, and the tables of a picture.
SKY = 20
SKY_KIND = 0
NO_SKY, GRADIENT_SKY, PICTURE_SKY = range(3)
SKY_X, SKY_Y, SKY_Z = 1, 4, 7  # its axes in the world, 3 each, unit: to the right of the picture's middle, it, and up
SKY_ZENITH, SKY_HORIZON, SKY_GROUND = 10, 13, 16  # RGB radiance of a gradient
SKY_WIDTH = 19  # of the picture, in pixels

# A material: 10 float64; what its last five places hold depends on the kind.
MATERIAL_SIZE = 10
MATERIAL_KIND = 0
DIFFUSE, PHONG, MIRROR, DIELECTRIC, PRINCIPLED, EMISSIVE = range(6)
OWN_COLOR = 1  # 1: the points' own colour
BASE_COLOR = 2  # 2..4: else this, linear
SPECULAR, EXPONENT = 5, 6  # of Phong
IOR = 5  # of Dielectric: index of refraction of the inside over that of the outside
ALPHA, METALLIC = 5, 6  # of Principled: width of the facets' distribution, share of metal
COAT = 7  # 7..9: what its facets reflect if dielectric, at normal incidence, how much more at 90 degrees, the power
EMITTED = 5  # 5..7, of Emissive: radiance, linear RGB

# A paint, what colours an instance by an attribute: 8 float64.
PAINT_SIZE = 8
PAINT_KIND = 0
# The map is looked up by the splats' values, blended; by that of the splat of most weight; by a coordinate of the hit.
BLENDED, CLASSES, BY_COORDINATE = range(3)
PAINT_COLORS, PAINT_COUNT = 1, 2  # where its map begins in World.map_colors, how many colours it has
PAINT_POSITIONS = 3  # where the splats of its model begin in World.map_positions
PAINT_ALONG, PAINT_START = 3, 6  # BY_COORDINATE: a point x in the world has the map position along (3).x + start
PAINT_COARSER = 7  # BLENDED: how many paints follow that are the same for the levels of detail of its model

# A camera: 16 float64.
CAMERA = 16
EYE = 0  # 0..2: world
FORWARD = 3  # 3..5: unit
# 6..8 and 9..11, half the picture's width to the right, half its height up: of a perspective at distance 1; of a
# panorama, whose picture has no size in the world, unit vectors.
ACROSS, UPWARD = 6, 9
PROJECTION = 12  # one of the next three
PERSPECTIVE, ORTHOGRAPHIC, PANORAMA = (
    number_of(PROJECTIONS, name) for name in ("perspective", "orthographic", "panorama")
)
LENS_RADIUS = 13  # world; 0: a pinhole
NEARNESS = 14  # 1 / distance along the view of the plane that is sharp


class LightTree(NamedTuple):
    """Lights that rays meet, in a binary tree: its entries are visited one after the other, or skipped.

    lights : (entries,) int32, which light (of `World.lights`); -1 for a box around those that follow
    skips : (entries,) int32, of a box the entry that follows on all within it; few lights stand in no box
    boxes : (entries * 6,) float64, lo x y z, hi x y z of a box
    """

    lights: Array
    skips: Array
    boxes: Array


class World(NamedTuple):
    """All that a scene's rays can meet, for kernels.

    table : (models * ROW,) int64, see `model_table`; instances, planes, lights, materials : float64, see above
    top : (9,) float64, where the tree over the instances is; top_boxes : (nodes * 12,) float32
    top_children : (nodes * 2,) int32, a child >= 0 is a node, a child < 0 is instance ~child; a tree of no nodes: there
        are so few models that each is tried
    light_shares : float64, the table by which a light is chosen, see `shade/tables.py`; lamps : the tree of lights that
        have a size; suns : the tree of suns that are a disk, its boxes are those of unit directions
    sky : (20,) float64, see `SKY`; sky_colors : (h * w * 3,) float32, its picture's radiance, row 0 on top
    sky_rows : (h + 1,) float64, share of the light above each row; sky_columns : (h * (w + 1),) float64, of each row's
        light that to the left of each pixel
    sky_mean : (27,) float64, its irradiance as spherical harmonics, 9 times RGB
    paints : (paints * 8,) float64, see above; map_positions : (n,) float32, in the order of a model's splats where the
        value of each lies in the map, from 0 to its number of colours, or NaN
    map_colors : (m * 3,) float32, linear: the colours of maps, behind each map's that of what has no value
    tone : (256,) float32, linear value of each sRGB level; longest : blocks of the longest leaf
    catchers : number of shadow catchers; clips : float64, see above
    """

    table: Array
    instances: Array
    planes: Array
    top: Array
    top_boxes: Array
    top_children: Array
    lights: Array
    light_shares: Array
    lamps: LightTree
    suns: LightTree
    materials: Array
    sky: Array
    sky_colors: Array
    sky_rows: Array
    sky_columns: Array
    sky_mean: Array
    paints: Array
    map_positions: Array
    map_colors: Array
    tone: Array
    longest: int
    catchers: int
    clips: Array

    def __reduce__(self) -> str:
        """A copy or a pickle would hold addresses without what lies there."""
        raise TypeError("what kernels read of a scene cannot be copied: copy or pickle the scene itself")


class WorldHit(NamedTuple):
    """Where a ray meets the scene, in world space: t in lengths of the direction, inf for a miss; instance -1.

    normal : unit; color : linear; slot : number of the splat of most weight in the model's order, -1 for a plane
    leaf, and local : position in model space, for what is blended later
    """

    t: float
    normal: Vec3
    color: Vec3
    instance: int
    slot: int
    leaf: int
    local: Vec3


class ShadingPoint(NamedTuple):
    """A surface point as a material sees it.

    normal : unit, turned to the side the eye is on; wo : unit
    color : linear RGB of the surface there, see `base_color`
    side : +1.0 where the eye is on the outer side, to which normals point, else -1.0
    """

    normal: Vec3
    wo: Vec3
    color: Vec3
    side: float
