"""The records of a scene, in the world: instances, lights, materials, cameras, and the hits of rays.

What each array holds, and in which unit, is said once, here. All arrays are flat and C-contiguous. A model's own
arrays are those of `engine/kernels/tree.py`.
"""

from __future__ import annotations

from typing import NamedTuple

from ...base.choices import PROJECTIONS, number_of
from ..jit import Array
from .vec import Vec3

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

# A material: 10 float64; what its last five numbers hold depends on the kind.
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

# What is baked of an instance's light: 5 int64 in `World.baked`, addresses of records and how many there are.
BAKED = 5
BAKED_FRONT, BAKED_BACK = 0, 1  # the records of the side to which normals point, and of the other; 0: it is dark
# Records of a side: one of each splat, in the tree's order, or one of each cell of a plane's grid; a multiple of 4.
BAKED_COUNT = 2
BAKED_SPREAD, BAKED_SPREAD_COUNT = 3, 4  # int32, SPREAD for each block; 0: each splat has its own record
# And 5 float64 in `World.baked_frames`.
BAKED_FRAME = 5
GRID_MIDDLE, GRID_HALF, GRID_EDGE = 0, 2, 3  # of a plane, see `shade/grid.py`: u and v, half width, cells a side
BAKED_UNIT = 4  # W/m2 of the records' 1.0
# A spread, how the light of a block's four splats is blended from records that lie farther apart: 8 int32.
SPREAD = 8
SPREAD_RECORDS = 0  # 0..3: which records
SPREAD_SHARES = 4  # 4..7: of each splat, the shares of these four in 255ths, a byte each
# A record: 4 int32.
RECORD = 4
INDIRECT, DIRECT = 0, 1  # RGB9E5, irradiance of the sky and of light from other surfaces; of lights
MOMENTS = 2  # 2 words, 8 bytes: see `shade/baked_code.py`

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
    baked : (instances * BAKED,) int64, baked_frames : (instances * BAKED_FRAME,) float64; or length 0: nothing is baked
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
    baked: Array
    baked_frames: Array

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
