"""The surfaces that `compare.py` compares: pointray's, screened Poisson by Open3D, and RIMLS by MeshLab.

Open3D and pymeshlab are optional: `peers` reports missing ones. Both peers get Open3D's normals of 30 neighbours (its
default), with the signs of the exact normals; pointray gets positions only, and the scanner where there is one.
"""

from __future__ import annotations

import importlib
import inspect
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

import pointray as pr
from bench.helpers.truth import Floats
from bench.noise.clouds import Cloud

OURS, PLAIN, CLEARED, POISSON, RIMLS = "pointray", "smooth=0", "no strays", "Poisson", "RIMLS"
PEERS = {POISSON: ("open3d",), RIMLS: ("open3d", "pymeshlab")}
NEIGHBOURS = 30  # of Poisson's normals: 16 give 0.113 h where 30 give 0.105 (torus, 0.3 h)
FILTER, RESOLUTION = 4.0, 300  # of RIMLS: at 0.5 h its default of 2 gives 0.25 h, 4 gives 0.16

Cast = Callable[[Floats, Floats], tuple[Floats, Floats]]


@dataclass(frozen=True)
class Surface:
    """Something that rays can hit. cast : origins, directions -> t (inf: none), normals; seconds : to make it"""

    name: str
    cast: Cast
    seconds: float


def smooths() -> bool:
    """Whether `pr.Model` can smooth."""
    return "smooth" in inspect.signature(pr.Model).parameters


def model_of(points: pr.Points, smooth: str | float = "auto") -> pr.Model:
    """A model; `smooth` is passed where there is such a parameter."""
    return pr.Model(points, scatter="surface", **({"smooth": smooth} if smooths() else {}))


def points_of(cloud: Cloud) -> pr.Points:
    """The cloud's positions, with normals only if the scanner is known."""
    points = pr.Points(cloud.positions)
    return points if cloud.eye is None else pr.estimate_normals(points, viewpoint=cloud.eye)


def finds_strays() -> bool:
    """Whether pointray can find strays."""
    return "find_strays" in pr.__all__


def strays_of(cloud: Cloud) -> NDArray[np.bool_]:
    """Rows that pointray classifies as strays of any kind, given the scanner position."""
    known = {} if cloud.eye is None else {"viewpoint": cloud.eye}
    found: Any = pr.find_strays(pr.Points(cloud.positions), **known)
    masks = [np.asarray(part) != 0 for part in (found if isinstance(found, tuple) else (found,))]
    return np.any([mask for mask in masks if mask.shape == (len(cloud.positions),)], axis=0)


def ours(cloud: Cloud, smooth: str | float = "auto") -> Surface:
    """pointray's surface of the cloud."""
    start = time.perf_counter()
    model = model_of(points_of(cloud), smooth)
    return _traced(OURS if smooth != 0 else PLAIN, model, time.perf_counter() - start)


def warm_up(cloud: Cloud) -> None:
    """Compile the kernels of a model, so that compilation is not measured."""
    for smooth in ("auto", 0) if smooths() else ("auto",):
        ours(cloud, smooth)


def cleared(cloud: Cloud, drop: NDArray[np.bool_]) -> Surface:
    """pointray's surface of the cloud without its strays."""
    start = time.perf_counter()
    model = model_of(points_of(cloud).select(~drop))
    return _traced(CLEARED, model, time.perf_counter() - start)


def _traced(name: str, model: pr.Model, seconds: float) -> Surface:
    """Rays through a model."""
    scene = pr.Scene()
    scene.add(model)

    def cast(origins: Floats, directions: Floats) -> tuple[Floats, Floats]:
        hits = scene.intersect(origins, directions)
        return np.asarray(hits.t, np.float64), np.asarray(hits.normal, np.float64)

    return Surface(name, cast, seconds)


def signed_normals(cloud: Cloud, neighbours: int = NEIGHBOURS) -> Floats:
    """Open3D's normals with the exact normals' signs."""
    import open3d

    cloud_there = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(cloud.positions))
    cloud_there.estimate_normals(open3d.geometry.KDTreeSearchParamKNN(neighbours))
    normals = np.array(cloud_there.normals)
    return normals * np.where((normals * cloud.normals).sum(axis=1) < 0, -1.0, 1.0)[:, None]


def poisson(cloud: Cloud, depth: int = 9) -> Surface:
    """Screened Poisson by Open3D. Its normals are its own at the vertices: 4.3 degrees where its triangles' are 11."""
    import open3d

    start = time.perf_counter()
    there = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(cloud.positions))
    there.normals = open3d.utility.Vector3dVector(signed_normals(cloud))
    mesh, _ = open3d.geometry.TriangleMesh.create_from_point_cloud_poisson(there, depth=depth)
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.triangles)
    return _mesh(POISSON, (vertices, faces, np.asarray(mesh.vertex_normals)), time.perf_counter() - start)


def rimls(cloud: Cloud) -> Surface:
    """Marching cubes over MeshLab's robust implicit moving least squares (Oztireli, Guennebaud, Gross 2009)."""
    import pymeshlab

    start = time.perf_counter()
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(vertex_matrix=cloud.positions, v_normals_matrix=signed_normals(cloud)))
    meshes.generate_marching_cubes_rimls(resolution=RESOLUTION, filterscale=FILTER)
    mesh = meshes.current_mesh()
    vertices, faces = mesh.vertex_matrix(), mesh.face_matrix()
    return _mesh(RIMLS, (vertices, faces, _averaged(vertices, faces)), time.perf_counter() - start)


def _averaged(vertices: Floats, faces: Any) -> Floats:
    """Normals at vertices: the mean of the triangles' around, by area."""
    corners = vertices[faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros(vertices.shape)
    for k in range(3):
        np.add.at(normals, faces[:, k], across)
    return normals


def _mesh(name: str, mesh: tuple[Floats, Any, Floats], seconds: float) -> Surface:
    """Rays through triangles by Open3D, which asks Embree; normals are blended from those of the vertices."""
    import open3d

    vertices, faces, normals = mesh
    scene = open3d.t.geometry.RaycastingScene()
    scene.add_triangles(open3d.core.Tensor(vertices.astype(np.float32)), open3d.core.Tensor(faces.astype(np.uint32)))

    def cast(origins: Floats, directions: Floats) -> tuple[Floats, Floats]:
        rays = np.concatenate([origins, directions], axis=1).astype(np.float32)
        found = scene.cast_rays(open3d.core.Tensor(rays))
        t, uv = found["t_hit"].numpy().astype(np.float64), found["primitive_uvs"].numpy().astype(np.float64)
        rows = faces[np.where(np.isfinite(t), found["primitive_ids"].numpy(), 0).astype(np.int64)]
        u, v = uv[:, :1], uv[:, 1:]
        blended = (1 - u - v) * normals[rows[:, 0]] + u * normals[rows[:, 1]] + v * normals[rows[:, 2]]
        return t, blended / np.maximum(np.linalg.norm(blended, axis=1, keepdims=True), 1e-300)

    return Surface(name, cast, seconds)


def peers(wanted: list[str]) -> tuple[list[str], list[str]]:
    """Those of the wanted peers that can run here, and a message for each that cannot."""
    here, messages = [], []
    for name in wanted:
        try:
            for module in PEERS[name]:
                importlib.import_module(module)
            here.append(name)
        except (ImportError, OSError) as error:
            messages.append(f"{name} skipped: {error} (pip install {' '.join(PEERS[name])})")
    return here, messages


def surfaces(cloud: Cloud, others: list[str], depth: int = 9) -> list[Callable[[], Surface]]:
    """What makes each of the surfaces of a cloud, one after the other."""
    made: list[Callable[[], Surface]] = [lambda: ours(cloud)]
    if smooths():
        made.append(lambda: ours(cloud, 0))
    if POISSON in others:
        made.append(lambda: poisson(cloud, depth))
    if RIMLS in others:
        made.append(lambda: rimls(cloud))
    return made
