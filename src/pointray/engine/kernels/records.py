"""Records of a scene in world space: instances, lights, materials, cameras, and the hits of rays.

This is the only description of each array's content and units. All arrays are flat and C-contiguous. The arrays of a
model are described in `engine/kernels/tree.py`.
"""

from __future__ import annotations

from typing import NamedTuple

from ...base.choices import PROJECTIONS, number_of
from ..jit import Array
from .vec import Vec3

# An instance: 16 float64.
INSTANCE = 16
KIND = 0  # MODEL, PLANE, or CATCHER: a plane of which only its shadows are visible to the camera
MODEL, PLANE, CATCHER = 0, 1, 2
SHAPE_ROW = 1  # index of its model in the table, or of its plane
MATERIAL = 2  # index of its material
PAINT = 3  # index of its paint; -1: the points' own colours
TO_MODEL = 4  # 4..15: transform from world to model space, row-major 3x4

# A plane: 20 float64, in world space.
PLANE_SIZE = 20
PLANE_POINT, PLANE_NORMAL, PLANE_COLOR = 0, 3, 6  # 3 each
PLANE_CHECKER = 9  # edge length of the checker's squares; 0: plain
PLANE_U, PLANE_V = 10, 13  # the checker's axes, 3 each
PLANE_INSTANCE = 16  # index of its instance

# The BVH over the model instances: binary; a node holds the boxes of both children (lo x y z, hi x y z).
TOP_NODE = 12
# Its frame, 9 float64: the position that boxes are relative to, and the bounds of all of them (lo x y z, hi x y z).
TOP_CENTER, TOP_BOUNDS = 0, 3
TOP_SIZE = 9

# A clip plane: 4 float64, in world space: its unit normal n and offset o; everything with n.x > o is cut away.
CLIP = 4
CLIP_OFFSET = 3

# A light: 18 float64.
LIGHT = 18
LIGHT_KIND = 0
POINT_LIGHT, SUN_LIGHT, RECT_LIGHT, DISK_LIGHT, SPHERE_LIGHT = range(5)
LIGHT_POSITION = 1  # 1..3: position or centre; of a sun the direction in which its light travels
LIGHT_POWER = 4  # RGB: intensity (W/sr) of a point, irradiance (W/m2) of a sun, radiance (W/(m2 sr)) of an area light
LIGHT_U, LIGHT_V = 7, 10  # 3 each, of a rectangle or a disk: from the centre to the edge
LIGHT_FACING = 13  # 13..15, of a rectangle or a disk: unit normal of the emitting side
LIGHT_RADIUS = 16  # of a sphere; of a sun 1 - cosine of its angular radius
LIGHT_AREA = 17

# The environment light, if any: 20 float64, and the tables of an environment map.
SKY = 20
SKY_KIND = 0
NO_SKY, GRADIENT_SKY, PICTURE_SKY = range(3)
SKY_X, SKY_Y, SKY_Z = 1, 4, 7  # axes in world space, unit, 3 each: right of the map's centre, that centre, up
SKY_ZENITH, SKY_HORIZON, SKY_GROUND = 10, 13, 16  # RGB radiance of a gradient
SKY_WIDTH = 19  # of the map, in pixels

# A material: 10 float64; the last five numbers depend on its kind.
MATERIAL_SIZE = 10
MATERIAL_KIND = 0
DIFFUSE, PHONG, MIRROR, DIELECTRIC, PRINCIPLED, EMISSIVE = range(6)
OWN_COLOR = 1  # 1: the points' own colour
BASE_COLOR = 2  # 2..4: otherwise this one, linear
SPECULAR, EXPONENT = 5, 6  # of Phong
IOR = 5  # of Dielectric: index of refraction inside over that outside
ALPHA, METALLIC = 5, 6  # of Principled: roughness alpha of the microfacet distribution, metallic share
COAT = 7  # 7..9: reflectance of dielectric facets at normal incidence, its increase at 90 degrees, the exponent
EMITTED = 5  # 5..7, of Emissive: radiance, linear RGB

# A paint, which colours an instance by an attribute: 8 float64.
PAINT_SIZE = 8
PAINT_KIND = 0
# The colour map is looked up at the splats' values, blended; at the value of the splat of most weight; or at a
# coordinate of the hit.
BLENDED, CLASSES, BY_COORDINATE = range(3)
PAINT_COLORS, PAINT_COUNT = 1, 2  # first colour of its map in World.map_colors, number of colours
PAINT_POSITIONS = 3  # first entry of its model's splats in World.map_positions
PAINT_ALONG, PAINT_START = 3, 6  # BY_COORDINATE: a world-space point x has the map position along (3).x + start
PAINT_COARSER = 7  # BLENDED: number of paints that follow: the same, for the levels of detail of its model

# Baked light of an instance: 5 int64 in `World.baked`, addresses and numbers of its records.
BAKED = 5
BAKED_FRONT, BAKED_BACK = 0, 1  # records of the side to which normals point, and of the other side; 0: no light
# Records of a side, a multiple of 4: one for each splat, in the tree's order, or for each cell of a plane's grid.
BAKED_COUNT = 2
BAKED_SPREAD, BAKED_SPREAD_COUNT = 3, 4  # int32, SPREAD for each block; 0: each splat has its own record
# And 5 float64 in `World.baked_frames`.
BAKED_FRAME = 5
GRID_MIDDLE, GRID_HALF, GRID_EDGE = 0, 2, 3  # of a plane, see `shade/grid.py`: centre (u, v), half width, cells a side
BAKED_UNIT = 4  # irradiance of a record's 1.0, in W/m2
# A spread, which blends the light of a block's four splats from more widely spaced records: 8 int32.
SPREAD = 8
SPREAD_RECORDS = 0  # 0..3: indices of the records
SPREAD_SHARES = 4  # 4..7: for each splat the weights of these four in 255ths, a byte each
# A record: 4 int32.
RECORD = 4
INDIRECT, DIRECT = 0, 1  # RGB9E5: irradiance from the sky and other surfaces; from lights
MOMENTS = 2  # 2 words, 8 bytes: see `shade/baked_code.py`

# A camera: 16 float64.
CAMERA = 16
EYE = 0  # 0..2: world space
FORWARD = 3  # 3..5: unit
# 6..8 and 9..11: half the image's width to the right and half its height up; of a perspective camera at distance 1, of
# a panorama unit vectors.
ACROSS, UPWARD = 6, 9
PROJECTION = 12  # one of the next three
PERSPECTIVE, ORTHOGRAPHIC, PANORAMA = (
    number_of(PROJECTIONS, name) for name in ("perspective", "orthographic", "panorama")
)
LENS_RADIUS = 13  # world space; 0: a pinhole
NEARNESS = 14  # 1 / distance of the focal plane along the view direction


class LightTree(NamedTuple):
    """Tree of the lights that rays can hit: a list of entries in depth-first order, boxes and the lights within.

    A ray that misses a box goes on behind the entries within it. A few lights are stored without boxes.

    lights : (entries,) int32, index in `World.lights`; -1 for a box around the entries that follow
    skips : (entries,) int32, for a box the index of the first entry that is not within it
    boxes : (entries * 6,) float64, lo x y z, hi x y z of a box
    """

    lights: Array
    skips: Array
    boxes: Array


class World(NamedTuple):
    """Everything in a scene that rays can hit, and its lights, as kernels read it: flat arrays of records.

    A name in capitals is a constant of this module, the length of a record; the constants behind it are the fields.

    table : (models * ROW,) int64, addresses and lengths of the arrays of each model's `Tree`
    instances : (instances * 16,) float64, records of the models and planes that are placed in the scene (INSTANCE)
    planes : (planes * 20,) float64, records of the planes (PLANE_SIZE)
    top : (9,) float64, centre of the BVH over the instances of models, and its bounds (lo, hi) relative to that
    top_boxes : (nodes * 12,) float32, boxes (lo, hi) of a node's two children, relative to the centre
    top_children : (nodes * 2,) int32, a child >= 0 is a node, a child < 0 is instance ~child; without nodes, rays are
        tested against each of the few models
    lights : (lights * 18,) float64, records of all lights but the environment light (LIGHT)
    light_shares : float64, cumulative distribution for choosing a light
    lamps : tree of the area lights
    suns : tree of the suns with a disk, whose boxes bound unit directions
    materials : (materials * 10,) float64, records of the materials (MATERIAL_SIZE)
    sky : (20,) float64, record of the environment light (SKY)
    sky_colors : (h * w * 3,) float32, radiance of the environment map, top row first
    sky_rows : (h + 1,) float64, share of the map's light above each row
    sky_columns : (h * (w + 1),) float64, share of each row's light to the left of each pixel
    sky_mean : (27,) float64, irradiance of the environment light as spherical harmonics, 9 times RGB
    paints : (paints * 8,) float64, records of the attributes that colour instances (PAINT_SIZE)
    map_positions : (n,) float32, in the order of a model's splats the position of each value in the colour map, from 0
        to the map's number of colours, or NaN
    map_colors : (m * 3,) float32, linear: the colours of all maps, each followed by its colour for missing values
    tone : (256,) float32, linear value of each sRGB level
    longest : number of blocks of the leaf that lists most
    catchers : number of shadow catchers
    clips : (clips * 4,) float64, records of the clip planes (CLIP)
    baked : (instances * 5,) int64, addresses of the instances' baked light (BAKED); length 0 without baked light
    baked_frames : (instances * 5,) float64, units of the baked light and grids of planes (BAKED_FRAME)
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
        """Refuse to copy or pickle: the addresses would outlive the arrays they point to."""
        raise TypeError("World holds addresses and cannot be copied: copy or pickle the scene instead")


class WorldHit(NamedTuple):
    """A ray's hit in world space. For a miss, t is inf and instance is -1.

    t : in lengths of the ray's direction
    normal : unit; color : linear RGB
    instance : index of the instance that was hit
    slot : index in `Tree.order` of the splat of most weight, -1 for a plane
    leaf : index of the leaf; local : position in model space; both for values that are blended later
    """

    t: float
    normal: Vec3
    color: Vec3
    instance: int
    slot: int
    leaf: int
    local: Vec3


class ShadingPoint(NamedTuple):
    """A surface point as a material's BSDF takes it.

    normal : unit, turned to the side of the viewer; wo : unit direction to the viewer
    color : linear RGB of the surface there: the material's, or the points' own
    side : +1.0 if the viewer is on the outer side, to which normals point, else -1.0
    """

    normal: Vec3
    wo: Vec3
    color: Vec3
    side: float
