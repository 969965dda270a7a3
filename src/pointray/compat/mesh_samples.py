"""Points sampled on triangle meshes, and the triangles that they stand for."""

from __future__ import annotations

import warnings
from typing import Any, NamedTuple

import numpy as np

from ..base.arguments import wrong_type
from ..base.arrays import Doubles, Floats, Rows
from ..cloud.points import Points
from .tensors import as_array, as_rows

MIXED = 0.01  # share of edges that both triangles traverse in the same direction, from which normals are estimated
FIRST, SECOND = 0.7548776662466927, 0.5698402909980532  # steps of the R2 sequence: even samples of a triangle

NO_TRIANGLES = "triangle_indices: the mesh has no triangles; to add its vertices, use add_points"


class Triangles(NamedTuple):
    """A mesh, and the triangle on which each sampled point lies.

    corners : (m, 3, 3) float64; normals : (m, 3) float32, unit; of_point : (n,) int64, triangle of each point
    """

    corners: Doubles
    normals: Floats
    of_point: Rows

    def coordinates(self, triangles: Rows, positions: Doubles) -> Floats:
        """Return barycentric coordinates (u, v) of positions near triangles, (k, 2), clipped to the triangle.

        u belongs to the second corner, v to the third. triangles : (k,)
        """
        a, b, c = (self.corners[triangles, k] for k in range(3))
        e, f, p = b - a, c - a, positions - a
        ee, ef, ff = ((one * other).sum(axis=1) for one, other in ((e, e), (e, f), (f, f)))
        pe, pf = (p * e).sum(axis=1), (p * f).sum(axis=1)
        area = np.maximum(ee * ff - ef * ef, 1e-300)
        u = np.clip((ff * pe - ef * pf) / area, 0, 1)
        v = np.clip((ee * pf - ef * pe) / area, 0, 1 - u)
        return np.stack([u, v], axis=1).astype(np.float32)


def mesh_arrays(vertices: Any, triangles: Any, mesh: Any) -> tuple[Doubles, Rows]:
    """Return vertices, (v, 3), and triangles, (m, 3), of the arguments of `RaycastingScene.add_triangles`."""
    if triangles is None and mesh is None:
        vertices, mesh = None, vertices
    if mesh is not None:
        if vertices is not None or triangles is not None:
            raise wrong_type("mesh", "None if vertices and triangles are given", mesh)
        vertices, triangles = _parts_of(mesh)
    positions = as_rows(vertices, "vertex_positions", 3, 2)
    corners = as_array(triangles, "triangle_indices")
    if positions.ndim != 2 or not np.isfinite(positions).all():
        raise ValueError("vertex_positions must be finite, with the shape (v, 3)")
    if corners.ndim != 2 or corners.shape[1] != 3 or corners.dtype.kind not in "iu":
        raise ValueError(
            f"triangle_indices must be integers of shape (m, 3), got {corners.dtype} of shape {corners.shape}"
        )
    if not len(corners):
        raise ValueError(NO_TRIANGLES)
    if corners.min() < 0 or corners.max() >= len(positions):
        odd = corners.min() if corners.min() < 0 else corners.max()
        raise ValueError(f"triangle_indices must be from 0 to {len(positions) - 1}, found {odd}")
    return positions, corners.astype(np.int64)


def _parts_of(mesh: Any) -> tuple[Any, Any]:
    """Return vertices and triangles of a mesh of Open3D (tensors or legacy) or trimesh."""
    if hasattr(mesh, "vertex") and hasattr(mesh, "triangle"):
        if "positions" not in mesh.vertex or "indices" not in mesh.triangle:
            raise ValueError(
                NO_TRIANGLES if "positions" in mesh.vertex else "vertex_positions: the mesh has no vertices"
            )
        return mesh.vertex["positions"], mesh.triangle["indices"]
    for name in ("faces", "triangles"):  # trimesh has both, of which `triangles` are coordinates
        if hasattr(mesh, "vertices") and hasattr(mesh, name):
            return np.asarray(mesh.vertices), np.asarray(getattr(mesh, name))
    raise wrong_type("mesh", "a triangle mesh of Open3D or trimesh, or vertex_positions with triangle_indices", mesh)


def sample_triangles(vertices: Doubles, faces: Rows, count: int) -> tuple[Points, Triangles]:
    """Return `count` points spread evenly over a mesh, with the normals of the triangles, and their triangles.

    If neighbouring triangles are oriented differently, a warning says so, and the points have no normals. Triangles are
    neighbours if they share two positions, also as different vertices.

    vertices : (v, 3); faces : (m, 3), indices of vertices
    """
    corners = vertices[faces]
    with np.errstate(over="ignore", invalid="ignore"):
        crosses = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        areas = np.linalg.norm(crosses, axis=1)
    ends = np.cumsum(areas)
    if not 0 < ends[-1] < np.inf:
        raise ValueError(f"the mesh has no area: its {len(faces):,} triangles cannot be sampled")
    normals = (crosses / np.maximum(areas, 1e-300)[:, None]).astype(np.float32)
    k = np.arange(count)
    triangle = np.minimum(np.searchsorted(ends, (k + 0.5) / count * ends[-1], "right"), int(np.argmax(ends)))
    u, v = (k * FIRST) % 1.0, (k * SECOND) % 1.0
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    weights = np.stack([1 - u - v, u, v], axis=1)
    positions = np.einsum("nk,nkc->nc", weights, corners[triangle])
    mixed = _are_mixed(vertices, faces)
    if mixed:
        warnings.warn(
            "the triangles of the mesh are oriented differently: normals are estimated from the sampled points",
            stacklevel=3,
        )
    points = Points(positions, normals=None if mixed else normals[triangle])
    return points, Triangles(corners, normals, triangle)


def _are_mixed(vertices: Doubles, faces: Rows) -> bool:
    """Return whether neighbouring triangles are oriented differently. vertices : (v, 3); faces : (m, 3)"""
    place = np.unique(vertices + 0.0, axis=0, return_inverse=True)[1].reshape(-1)  # -0.0 and 0.0 are the same
    ends = place[faces]
    keys = (ends * len(vertices) + np.roll(ends, -1, axis=1)).reshape(-1)
    return bool(len(np.unique(keys)) < (1 - MIXED) * len(keys))
