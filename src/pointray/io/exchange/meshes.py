"""Vertices of trimesh's and meshio's objects, with their normals and colours."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...cloud.points import Points
from .columns import named_points


def points_of_trimesh(thing: Any) -> Points:
    """Return the vertices of a `trimesh.PointCloud` or a `trimesh.Trimesh`, the latter with vertex normals."""
    columns = {name: np.asarray(values) for name, values in getattr(thing, "vertex_attributes", {}).items()}
    is_mesh = hasattr(thing, "faces")
    if is_mesh and len(thing.faces):
        columns["normals"] = np.asarray(thing.vertex_normals)
    visual = thing.visual
    if getattr(visual, "kind", None) == "vertex" and len(visual.vertex_colors) == len(thing.vertices):
        columns["colors"] = np.asarray(visual.vertex_colors)
    return named_points(np.array(thing.vertices), columns, type(thing).__name__)


def points_of_meshio(mesh: Any) -> Points:
    """Return the vertices of a `meshio.Mesh` with its point data; two coordinates get z = 0."""
    positions = np.asarray(mesh.points)
    if positions.ndim == 2 and positions.shape[1] == 2:
        positions = np.pad(positions, ((0, 0), (0, 1)))
    columns = {name: np.asarray(values) for name, values in mesh.point_data.items()}
    return named_points(positions, columns, "meshio.Mesh")
