"""Point clouds of Open3D: tensor-based ones, which hold all attributes, and older ones with three arrays."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...base.warning_log import warn
from ...cloud.points import Points
from ..formats._source import Chunk
from .columns import points_of_chunk
from .losses import free_name, lost_georeference, package, warn_lost

ROLES = ("positions", "normals", "colors")
OTHER_RANGE = 16.0  # floats above it are colours from 0 to 255


def points_of_tensors(cloud: Any) -> Points:
    """Return an `open3d.t.geometry.PointCloud` as points; float32 positions near zero share its memory."""
    columns = {name: cloud.point[name].cpu().numpy() for name in cloud.point}
    if "positions" not in columns:
        raise ValueError("Open3D point cloud: contains no points")
    positions, normals, colors = (columns.pop(name, None) for name in ROLES)
    # Open3D has no (n,) attributes.
    attributes = {name: values[:, 0] if values.shape[1:] == (1,) else values for name, values in columns.items()}
    return points_of_chunk(Chunk(positions, normals, _clipped(colors), attributes), "Open3D point cloud")


def points_of_legacy(cloud: Any) -> Points:
    """Return an `open3d.geometry.PointCloud` as points: positions, normals and colours."""
    normals = np.asarray(cloud.normals) if cloud.has_normals() else None
    colors = np.asarray(cloud.colors) if cloud.has_colors() else None
    return points_of_chunk(Chunk(np.asarray(cloud.points), normals, _clipped(colors)), "Open3D point cloud")


def _clipped(colors: NDArray[Any] | None) -> NDArray[Any] | None:
    """Return colours with floats clipped to 0 to 1, their range in Open3D; unchanged if some are far above."""
    if colors is None or colors.dtype.kind != "f" or not colors.size:
        return colors
    low, high = np.nanmin(colors), np.nanmax(colors)
    if high > OTHER_RANGE or (low >= 0 and high <= 1):
        return colors
    warn("Open3D point cloud: colours outside 0 to 1 are clipped", stacklevel=2)
    return np.clip(colors, 0, 1)


def to_open3d(points: Points, legacy: bool) -> Any:
    """Return points as a point cloud of Open3D; see `Points.to_open3d`."""
    open3d = package("open3d", "to_open3d")
    lost = lost_georeference(points.georeference)
    if legacy:
        made = _legacy(open3d, points)
        lost += [f"cannot store the attributes {', '.join(points.attributes)}; legacy=False keeps them"] * bool(
            points.attributes
        )
    else:
        made = _tensors(open3d, points, lost)
    warn_lost("to_open3d", lost)
    return made


def _legacy(open3d: Any, points: Points) -> Any:
    made, vectors = open3d.geometry.PointCloud(), open3d.utility.Vector3dVector
    made.points = vectors(points.world)
    if points.normals is not None:
        made.normals = vectors(points.normals.astype(np.float64))
    if points.colors is not None:
        made.colors = vectors(points.colors / 255.0)
    return made


def _tensors(open3d: Any, points: Points, lost: list[str]) -> Any:
    """Return a tensor-based point cloud, whose arrays share the memory of the points' where dtypes allow.

    lost : receives descriptions of what it cannot store
    """
    made, tensor = open3d.t.geometry.PointCloud(), open3d.core.Tensor.from_numpy
    positions: NDArray[Any] = points.world if points.origin.any() else points.positions
    made.point["positions"] = tensor(positions)
    if points.normals is not None:
        made.point["normals"] = tensor(points.normals)
    if points.colors is not None:
        made.point["colors"] = tensor(points.colors)
    for name, values in points.attributes.items():
        made.point[free_name(name, ROLES, lost)] = tensor(values if values.ndim == 2 else values[:, None])
    return made
