"""Scenes for baked light, those whose light is known by formula among them."""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

import pointray as pr

Floats = NDArray[np.float64]

ALBEDO = 0.8  # inside of the sphere
HALF = 4.0  # half the edge of the floor below the ball, whose radius is 1
LONG = 12.0  # half the length of the wall, whose height is 1: the missing part hides at most 2e-4 of the sky
FAR = 3.0  # width of the floor before the wall
SUNK = 0.01  # how deep the statue stands in its floor
BRIGHT = 6.0  # half the edge of the room around the dark box
WALLS = 4.0  # radii: thickness of the dark box's walls


class Known(NamedTuple):
    """A scene, one of its instances, the known light at its points, and the distance of neighbours.

    at : (n,) float64, the distance of each point from the ball's contact or from the wall; NaN where unknown
    """

    scene: pr.Scene
    id: int
    at: Floats
    spacing: float


def sheet(corner: ArrayLike, u: ArrayLike, v: ArrayLike, spacing: float) -> tuple[Floats, Floats]:
    """Points in the middles of square cells of the parallelogram corner + u, v; their normals are along u x v."""
    u, v = np.asarray(u, float), np.asarray(v, float)
    counts = [max(round(float(np.linalg.norm(edge)) / spacing), 1) for edge in (u, v)]
    a, b = (((np.arange(n) + 0.5) / n) for n in counts)
    positions = np.asarray(corner, float) + a[:, None, None] * u + b[None, :, None] * v
    normal = np.cross(u, v)
    positions = positions.reshape(-1, 3)
    return positions, np.broadcast_to(normal / np.linalg.norm(normal), positions.shape)


@cache
def solid(name: str, points: int) -> pr.Model:
    """Return a cached generated model."""
    return pr.Model(pr.procedural(name, points))


def lit_sphere(points: int) -> Known:
    """The inside of a sphere around a point light: each point sees all others alike, light is 1 / (1 - ALBEDO) fold.

    The direct light is 1.
    """
    scene = pr.Scene()
    id = scene.add(solid("sphere", points), material=pr.Diffuse(ALBEDO))
    scene.add_light(pr.PointLight((0, 0, 0), 1.0))
    return Known(scene, id, np.zeros(points), float(np.sqrt(4 * np.pi / points)))


def ball_on_sheet(points: int) -> Known:
    """A ball of radius 1 that rests on a square sheet of points, both black, under an even sky; see `ball_shade`."""
    spacing = 2 * HALF / np.sqrt(points / 2)
    positions, normals = sheet((-HALF, -HALF, 0), (2 * HALF, 0, 0), (0, 2 * HALF, 0), spacing)
    scene = pr.Scene()
    scene.add(solid("sphere", points // 2), pr.transform(translate=(0, 0, 1)), material=pr.Diffuse(0.0))
    id = scene.add(pr.Model(pr.Points(positions, normals)), material=pr.Diffuse(0.0))
    scene.add_light(pr.EnvironmentLight())
    inside = np.abs(positions[:, :2]).max(axis=1) < HALF - 3 * spacing
    return Known(scene, id, np.where(inside, np.linalg.norm(positions[:, :2], axis=1), np.nan), spacing)


def ball_shade(d: Floats) -> Floats:
    """The share of the sky that a floor point sees at the distance d from where a ball of radius 1 touches it."""
    return np.asarray(1.0 - (1.0 + d**2) ** -1.5)


def before_wall(points: int) -> Known:
    """A floor of points before a long wall of height 1, both black, under an even sky; see `wall_shade`."""
    spacing = np.sqrt(2 * LONG * (1 + FAR) / points)
    floor = sheet((-LONG, 0, 0), (2 * LONG, 0, 0), (0, FAR, 0), spacing)
    wall = sheet((LONG, 0, 0), (-2 * LONG, 0, 0), (0, 0, 1), spacing)
    scene = pr.Scene()
    scene.add(pr.Model(pr.Points(*wall)), material=pr.Diffuse(0.0))
    id = scene.add(pr.Model(pr.Points(*floor)), material=pr.Diffuse(0.0))
    scene.add_light(pr.EnvironmentLight())
    x, y = floor[0][:, 0], floor[0][:, 1]
    middle = (np.abs(x) < LONG / 4) & (y < FAR - 3 * spacing)
    return Known(scene, id, np.where(middle, y, np.nan), float(spacing))


def wall_shade(d: Floats, height: float = 1.0) -> Floats:
    """The share of the sky that a floor point sees at the distance d from an endless wall."""
    return np.asarray(1.0 - (1.0 - 1.0 / np.sqrt(1.0 + (height / d) ** 2)) / 2.0)


def _cube(half: float, spacing: float, sign: int) -> tuple[Floats, Floats]:
    """The six faces of a cube about zero; normals point outwards, or for the sign -1 inwards."""
    positions, normals = [], []
    for axis in range(3):
        e = np.roll(np.eye(3), -axis, axis=0)
        for s in (1.0, -1.0):
            x, n = sheet(half * (s * e[0] - e[1] - s * e[2]), 2 * half * e[1], 2 * half * s * e[2], spacing)
            positions.append(x)
            normals.append(sign * n)
    return np.concatenate(positions), np.concatenate(normals)


def dark_box(points: int, color: float = 0.8) -> Known:
    """A closed box of points in a bright room of planes. Its walls are two layers, WALLS radii apart.

    at : 1 for points of the outer layer, -1 for those of the inner one, NaN within 3 spacings of an edge
    """
    spacing = float(np.sqrt(48.0 / points))
    probe = pr.Model(pr.Points(*sheet((0, 0, 0), (1, 0, 0), (0, 1, 0), spacing)))
    thick = WALLS * float(np.median(probe.radii))
    outer, inner = _cube(1.0, spacing, 1), _cube(1.0 - thick, spacing, -1)
    positions, normals = (np.concatenate(both) for both in zip(outer, inner, strict=True))
    layer = np.repeat([1.0, -1.0], [len(outer[0]), len(inner[0])])
    half = np.where(layer > 0, 1.0, 1.0 - thick)
    near_edge = np.sort(np.abs(positions), axis=1)[:, 1] > half - 3 * spacing
    scene = pr.Scene()
    id = scene.add(pr.Model(pr.Points(positions, normals)), material=pr.Diffuse(0.5))
    for axis in range(3):
        for s in (1.0, -1.0):
            scene.add(pr.Plane(s * BRIGHT * np.eye(3)[axis], -s * np.eye(3)[axis], color))
    scene.add_light(pr.PointLight((3.0, -4.0, 4.5), 100.0))
    return Known(scene, id, np.where(near_edge, np.nan, layer), spacing)


def single_sheet(points: int) -> Known:
    """A sheet of points, 2 wide, alone under a sun. at : 1, or NaN within 3 spacings of the rim"""
    spacing = 2.0 / np.sqrt(points)
    positions, normals = sheet((-1, -1, 0), (2, 0, 0), (0, 2, 0), spacing)
    scene = pr.Scene()
    id = scene.add(pr.Model(pr.Points(positions, normals)), material=pr.Diffuse(0.7))
    scene.add_light(pr.SunLight((-0.3, 0.2, -1.0), np.pi))
    inside = np.abs(positions[:, :2]).max(axis=1) < 1.0 - 3 * spacing
    return Known(scene, id, np.where(inside, 1.0, np.nan), float(spacing))


def statue_room(
    points: int,
    lights: str = "sky lamp",
    matrix: Floats | None = None,
    material: Any = None,
    floor: str = "plane",
    wall: bool = False,
) -> pr.Scene:
    """The statue, instance 0, on a floor under some of: sky, lamp (a rectangle), sun. None shadows another.

    Its base is a hundredth below the floor: two surfaces in one plane have no light of their own.

    matrix : where the whole scene stands, a rotation, one scale for all axes, and a shift
    floor : "plane", or "points": a square sheet around the statue; wall : whether a red plane stands beside it
    """
    matrix = np.eye(4) if matrix is None else matrix
    linear, shift = matrix[:3, :3], matrix[:3, 3]
    turned = linear / np.cbrt(np.linalg.det(linear))
    scene, model = pr.Scene(), solid("statue", points)
    scene.add(model, matrix, material=material or pr.Diffuse((0.7, 0.6, 0.5)))
    low = model.bounds[0]
    if floor == "plane":
        scene.add(pr.Plane(linear @ (0, 0, low[2] + SUNK) + shift, turned[:, 2], 0.5))
    else:
        scene.add(pr.Model(pr.Points(*_floor(points, low[2] + SUNK))), matrix, material=pr.Diffuse(0.5))
    if wall:
        scene.add(pr.Plane(linear @ (low[0] - 0.3, 0, 0) + shift, turned[:, 0], (0.8, 0.1, 0.1)))
    made = {
        "sky": lambda: pr.EnvironmentLight((0.8, 0.9, 1.0), horizon=0.9, ground=0.0, up=turned[:, 2]),
        "lamp": lambda: pr.RectLight(
            linear @ (1.6, -1.6, 2.4) + shift, linear @ (0.35, 0.35, 0), linear @ (0.2, -0.2, -0.35), 14.0
        ),
        "sun": lambda: pr.SunLight(turned @ (0.9, 0.8, -1.0), (2.2, 2.0, 1.8)),
    }
    for name in lights.split():
        scene.add_light(made[name]())
    return scene


def _floor(points: int, height: float) -> tuple[Floats, Floats]:
    """A square sheet below the statue, 6 wide, with a quarter as many points."""
    return sheet((-3, -3, height), (6, 0, 0), (0, 6, 0), 6.0 / np.sqrt(points / 4))


def above_floor(points: int) -> NDArray[np.bool_]:
    """Return which points of the statue are above its floor."""
    model = solid("statue", points)
    return np.asarray(model.points.positions[:, 2] > model.bounds[0, 2] + 2 * SUNK)
