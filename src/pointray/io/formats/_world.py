"""World coordinates of points for writing."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...cloud.geographic import in_file
from ...cloud.georeference import RESIDUAL, numbers_of
from ...cloud.points import Points, are_finite


def is_float64(points: Points) -> bool:
    """Whether world coordinates must be written as float64.

    They must if the points have an origin, a local projection, or rounding errors that restore a file's integers.
    """
    return bool(points.origin.any()) or points.georeference.projection is not None or _has_grid(points)


def world_rows(points: Points, part: slice | NDArray[np.integer[Any]]) -> NDArray[Any]:
    """Return the world coordinates of some rows, (m, 3) float64, or float32 if nothing is lost.

    Points of files with integer coordinates keep the rounding errors of float32 in an attribute, in integer steps. They
    are added, which restores the coordinates of the original file exactly.
    """
    if not is_float64(points):
        return points.positions[part]
    world = in_file(points.georeference, points.positions[part] + points.origin)
    if _has_grid(points):
        georeference, finite = points.georeference, are_finite(points.positions[part])
        numbers = numbers_of(georeference, world) + points.attributes[RESIDUAL][part]
        world[finite] = (np.array(georeference.offset) + np.array(georeference.scale) * numbers)[finite]
    return world


def _has_grid(points: Points) -> bool:
    residual = points.attributes.get(RESIDUAL)
    return points.georeference.scale is not None and residual is not None and residual.shape == points.positions.shape
