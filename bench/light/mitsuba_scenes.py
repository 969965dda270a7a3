"""The scenes in which pointray is compared with Mitsuba 3.

Meshes are scaled to a diagonal of 10 about the origin, because Mitsuba starts its rays 1e-4 (1 + |x|) away from a
surface. z is up.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import pointray as pr
from bench.helpers.truth import FOLDER
from bench.light.mitsuba_pairs import LIGHTS, MATERIALS, Floats, diffuse, placed
from pointray.procedural_models import mesh
from pointray.procedural_models.creases import edges_of, quarter

DIAGONAL = 10.0
# The radius of a disk that stands for an endless plane. With a radius of 1000, a corner lets in 1.6% more of the sky.
# Mitsuba's disks are exact at any size, whereas its rectangles are triangles.
ENDLESS = 1e4 * DIAGONAL
GAP = 0.01 * DIAGONAL  # below the model
FAR_CLIP = 1e12  # nothing is too far away to be seen
FLOOR = (0.5, 0.55, 0.6)
RED, GREEN = (0.7, 0.2, 0.15), (0.2, 0.6, 0.2)


class Body(NamedTuple):
    """A mesh whose vertices are the points. faces : (m, 3) int"""

    name: str
    vertices: NDArray[np.float32]
    normals: NDArray[np.float32]
    faces: NDArray[np.uint32]

    @property
    def floor(self) -> float:
        """The height of the floor, a little below the model, so that rays between the two can start from either."""
        return float(self.vertices[:, 2].min()) - GAP


def body(name: str, folder: Path = FOLDER) -> Body:
    """A mesh from `folder` (bunny, dragon), or of a procedural shape (torus, statue)."""
    import trimesh

    path = folder / f"stanford_{name}_mesh.ply"
    if path.exists():
        loaded = trimesh.load(path, process=False)
        loaded.vertices = np.asarray(loaded.vertices)[:, [0, 2, 1]] * (1, -1, 1)  # y is up in these files
    elif name in ("torus", "statue"):
        loaded = trimesh.Trimesh(*mesh(name), process=False)
    else:
        raise ValueError(f"mesh {path.name} not found in {folder}")
    low, high = loaded.bounds
    vertices = (loaded.vertices - (low + high) / 2) * (DIAGONAL / np.linalg.norm(high - low))
    faces, normals = np.asarray(loaded.faces, np.uint32), np.asarray(loaded.vertex_normals, np.float32)
    return Body(name, np.asarray(vertices, np.float32), normals, faces)


def halved(body: Body) -> Body:
    """The same flat triangles, each cut into four: more vertices of the same surface, with its interpolated normals."""
    faces = body.faces.astype(np.int32)
    edges, sides = edges_of(faces, len(body.vertices))
    normals = body.normals[edges].mean(axis=1)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    return Body(
        body.name,
        np.concatenate([body.vertices, body.vertices[edges].mean(axis=1)]),
        np.concatenate([body.normals, normals]),
        quarter(faces, sides + len(body.vertices)).astype(np.uint32),
    )


class Case(NamedTuple):
    """What is rendered. around : "floor", or "corner" of three planes; bounces : their maximum"""

    light: str
    material: str
    around: str = "floor"
    bounces: int = 1

    @property
    def name(self) -> str:
        return f"{self.light}, {self.material}, {self.around}, {self.bounces}"


def _planes(case: Case, floor: float) -> list[tuple[Floats, Floats, Any]]:
    """(point, normal, colour) of the planes around the model."""
    ground = np.array([0.0, 0.0, floor]), np.array([0.0, 0.0, 1.0]), FLOOR
    if case.around == "floor":
        return [ground]
    back = np.array([0.0, 5.5, 0.0]), np.array([0.0, -1.0, 0.0]), RED
    side = np.array([-5.5, 0.0, 0.0]), np.array([1.0, 0.0, 0.0]), GREEN
    return [ground, back, side]


def our_scene(case: Case, model: pr.Model, floor: float) -> pr.Scene:
    """The model between its planes, lit."""
    scene = pr.Scene()
    scene.add(model, material=MATERIALS[case.material]().ours)
    for point, normal, color in _planes(case, floor):
        scene.add(pr.Plane(point, normal), material=pr.Diffuse(color))
    scene.add_light(LIGHTS[case.light]().ours)
    return scene


def _their_mesh(body: Body, bsdf: dict[str, Any]) -> Any:
    """The mesh with interpolated normals."""
    import mitsuba as mi

    properties = mi.Properties()
    properties["mesh_bsdf"] = mi.load_dict(bsdf)
    out = mi.Mesh("model", len(body.vertices), len(body.faces), has_vertex_normals=True, props=properties)
    values = mi.traverse(out)
    values["vertex_positions"], values["vertex_normals"] = body.vertices.ravel(), body.normals.ravel()
    values["faces"] = body.faces.ravel()
    values.update()
    return out


def their_scene(case: Case, body: Body) -> Any:
    """The mesh between its planes, lit."""
    import mitsuba as mi

    parts: dict[str, Any] = {"type": "scene", "light": LIGHTS[case.light]().theirs}
    parts["model"] = _their_mesh(body, MATERIALS[case.material]().theirs)
    for k, (point, normal, color) in enumerate(_planes(case, body.floor)):
        u = np.roll(normal, 1)
        to_world = placed(ENDLESS * u, ENDLESS * np.cross(normal, u), normal, point)
        parts[f"plane{k}"] = {"type": "disk", "to_world": to_world, "bsdf": diffuse(color)}
    return mi.load_dict(parts)


def camera(size: int) -> pr.Camera:
    """A camera in front of the model and above it."""
    return pr.Camera.look_at((5.0, -15.0, 8.0), (0.0, 0.0, -0.3), fov=28, size=(size, size))


def their_camera(ours: pr.Camera, samples: int, finer: int = 1) -> Any:
    """The camera for Mitsuba, with `finer` times as many pixels a side."""
    import mitsuba as mi

    width, height = ours.size
    look = mi.ScalarTransform4f().look_at(*(np.asarray(v, float).tolist() for v in (ours.eye, ours.target, ours.up)))
    film = {
        "type": "hdrfilm",
        "width": finer * width,
        "height": finer * height,
        "pixel_format": "rgb",
        "component_format": "float32",
        "rfilter": {"type": "box"},
    }
    sampler = {"type": "multijitter" if samples > 1 else "independent", "sample_count": samples}
    view = {"type": "perspective", "fov": ours.fov, "fov_axis": "y", "to_world": look, "far_clip": FAR_CLIP}
    return mi.load_dict({**view, "film": film, "sampler": sampler})
