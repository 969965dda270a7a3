"""Light that arrives at random points of three scenes, without that of lamps; and lobes that reflect it.

The panoramas are path-traced and taken in the tangent frame, so that their pixels have the same directions there: W,
the upper half (n, 3), of solid angle SOLID (n,). The scenes are "sky" (the statue on a plane, gradient sky and sun),
"box" (in a closed box with a red and a green wall, point light), and "wall" ("sky" beside a red wall).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import pointray as pr

Floats = NDArray[np.float64]
SIZE = (128, 64)
NAMES = ("sky", "box", "wall")


def scenes() -> Iterator[pr.Scene]:
    """The scenes of NAMES. Lamps have no size, so that panoramas do not show them."""
    model = pr.Model(pr.procedural("statue", 50_000))
    sky = pr.EnvironmentLight((0.3, 0.5, 1.0), horizon=(0.9, 0.85, 0.8), ground=0.2)
    sun = pr.SunLight((-0.6, 0.7, -0.9), (3.2, 3.0, 2.6), angle=0)
    lamp = pr.PointLight((0.5, -0.9, 2.2), 6.0)
    floor = ((0, 0, 0), (0, 0, 1), 0.4)
    red, green = ((-1.2, 0, 0), (1, 0, 0), (0.7, 0.06, 0.05)), ((1.2, 0, 0), (-1, 0, 0), (0.1, 0.5, 0.08))
    white = [((0, y, 0), (0, -y, 0), 0.75) for y in (-1.5, 1.5)]
    box = [((0, 0, 0), (0, 0, 1), 0.75), ((0, 0, 2.6), (0, 0, -1), 0.75), red, green, *white]
    parts: tuple[tuple[list[Any], list[Any]], ...] = ([floor], [sky, sun]), (box, [lamp]), ([floor, red], [sky, sun])
    for planes, lights in parts:
        scene = pr.Scene()
        scene.add(model, material=pr.Diffuse((0.65, 0.6, 0.5)))
        for plane in planes:
            scene.add(pr.Plane(*plane))
        scene.lights = lights
        scene.background = "environment" if sky in lights else None
        yield scene


def surface_points(scene: pr.Scene, count: int) -> tuple[Floats, Floats]:
    """Positions of random hits, and their frames (count, 3, 3): tangent at random, bitangent and normal as rows."""
    rng = np.random.default_rng(7)
    eyes = rng.uniform((-1.1, -1.4, 0.1), (1.1, 1.4, 2.4), (20 * count, 3))
    targets = rng.uniform((-0.8, -0.6, -0.2), (0.8, 0.6, 2), eyes.shape)
    hits = scene.intersect(eyes, targets - eyes)
    seen = np.isfinite(hits.t) & (np.sum(hits.normal * (targets - eyes), axis=1) < 0)
    seen &= np.abs(hits.position).max(axis=1) < 4
    positions, normals = hits.position[seen][:count], hits.normal[seen][:count].astype(float)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    tangents = np.cross(normals, rng.normal(size=normals.shape))
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    return positions, np.stack([tangents, np.cross(normals, tangents), normals], axis=1)


def panorama(position: Floats, frame: Floats) -> pr.Camera:
    """A camera just off the surface: its forward is the tangent, its upper half the hemisphere."""
    eye = position + 2e-3 * frame[2]
    return pr.Camera.look_at(eye, eye + frame[0], up=frame[2], size=SIZE, projection="panorama")


def hemisphere() -> tuple[Floats, Floats]:
    """Directions (n, 3) of the pixels in the tangent frame, and solid angles (n,)."""
    directions = panorama(np.zeros(3), np.eye(3)).rays()[1][: SIZE[1] // 2].reshape(-1, 3)
    edges = np.sin(np.linspace(np.pi / 2, 0, SIZE[1] // 2 + 1))
    return directions, np.repeat(-np.diff(edges), SIZE[0]) * 2 * np.pi / SIZE[0]


def incident(scene: pr.Scene, position: Floats, frame: Floats, spp: int) -> Floats:
    """Two independent pictures of the radiance from the hemisphere, (2, n, 3)."""
    camera = panorama(position, frame)
    assert np.allclose(camera.rays()[1][: SIZE[1] // 2].reshape(-1, 3), hemisphere()[0] @ frame)
    settings = [pr.Settings("path", spp=spp // 2, max_depth=8, filter="box", seed=seed) for seed in (0, 1)]
    pictures = [pr.render(scene, camera, each)[: SIZE[1] // 2, :, :3] for each in settings]
    return np.array(pictures, float).reshape(2, -1, 3)


def light_maps(count: int, spp: int) -> dict[str, Floats]:
    """Frames (3 count, 3, 3), and two independent pictures of each point's radiance, (2, 3 count, n, 3), by scenes."""
    frames, pictures = [], []
    for scene in scenes():
        points = surface_points(scene, count)
        frames += list(points[1])
        pictures += [incident(scene, *point, spp) for point in zip(*points, strict=True)]
    return {"frames": np.array(frames), "pictures": np.stack(pictures, axis=1)}


def even_sky() -> float:
    """The irradiance that the pixels give under a sky of radiance 1 above a plane that is not level: pi."""
    scene, normal = pr.Scene(), np.array([0.48, -0.6, 0.64])
    scene.add(pr.Plane((0, 0, 0), normal, 0.2))
    scene.add_light(pr.EnvironmentLight(1.0))
    scene.background = "environment"
    frame = np.array([(0.8, 0, -0.6), np.cross(normal, (0.8, 0, -0.6)), normal])
    directions, solid = hemisphere()
    return float(incident(scene, np.zeros(3), frame, 4).mean(axis=(0, 2)) @ (directions[:, 2] * solid))


W, SOLID = hemisphere()
COSINE = W[:, 2] * SOLID


def spiral(count: int, lowest: float = 0.0) -> Floats:
    """Even directions above a height, (count, 3)."""
    z = lowest + (1 - lowest) * (np.arange(count) + 0.5) / count
    turn = np.arange(count) * np.pi * (3 - np.sqrt(5))
    return np.stack([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z], axis=1)


MIRRORED = spiral(32)  # the eyes, reflected at the normal


class Lobe(NamedTuple):
    """A lobe for each eye. table : (n, 32), BRDF times cosine and solid angle; exponent : of the nearest Phong lobe"""

    name: str
    exponent: float
    table: Floats


def phong(exponent: float) -> Lobe:
    """The lobe of `pr.Phong`."""
    lobe = (exponent + 2) / (2 * np.pi) * np.maximum(W @ MIRRORED.T, 0) ** exponent
    return Lobe(f"e {exponent:g}", exponent, lobe * COSINE[:, None])


def ggx(roughness: float) -> Lobe:
    """GGX with Smith's height-correlated masking; Phong's exponent is a quarter of Blinn's."""
    square, eyes = roughness**4, MIRRORED * (-1, -1, 1)
    half = W[:, None] + eyes
    cosine = half[..., 2] / np.linalg.norm(half, axis=-1)
    d = square / (np.pi * (1 + (square - 1) * cosine**2) ** 2)
    i, o = W[:, 2, None], eyes[:, 2]
    masking = 0.5 / (o * np.sqrt(square + (1 - square) * i * i) + i * np.sqrt(square + (1 - square) * o * o))
    return Lobe(f"ggx {roughness}", (2 / square - 2) / 4, d * masking * COSINE[:, None])
