"""Share of the image that points cover."""

from __future__ import annotations

import numpy as np

from ..base.arrays import Doubles
from ..engine.kernels.records import ACROSS, EYE, FORWARD, ORTHOGRAPHIC, PANORAMA, PROJECTION, UPWARD
from ..rendering.camera import Camera
from .clusters import largest_cluster
from .sample import Sample

LEAST = 0.005  # image coverage below which the view is considered empty
COUNTED = 0.75  # share of the points whose cells count
CELLS = 160  # largest number of cells across the image; fewer for few points, whose splats are larger


def coverage(positions: Doubles, camera: Camera) -> float:
    """Return the share of an image that points cover: the share of cells of a grid that contain visible points.

    Only the fullest cells, with 75% of the points, count, so isolated points do not raise the coverage.

    Parameters
    ----------
    positions : (n, 3) float64
        World.
    """
    record = camera.record()
    if record[PROJECTION] == PANORAMA:
        return 1.0
    forward, right, up = (record[k : k + 3] for k in (FORWARD, ACROSS, UPWARD))
    offset = positions - record[EYE : EYE + 3]
    depth = offset @ forward
    scale = np.where(depth > 0, 1.0 if record[PROJECTION] == ORTHOGRAPHIC else depth, np.nan)
    across = int(np.clip(2.0 * np.sqrt(len(positions)), 1, CELLS))
    cells = np.array([across, max(round(across * camera.size[1] / camera.size[0]), 1)])
    u, v = (offset @ axis / (axis @ axis) / scale for axis in (right, up))
    at = (np.stack([u, v]) + 1.0) / 2.0 * cells[:, None]
    inside = ((at >= 0) & (at < cells[:, None])).all(axis=0)
    column = at[:, inside].astype(int)
    counts = np.sort(np.bincount(column[0] * cells[1] + column[1]))[::-1]
    most = np.searchsorted(np.cumsum(counts), COUNTED * len(positions)) + 1 if len(counts) else 0
    return min(int(most), int(np.count_nonzero(counts))) / COUNTED / int(cells.prod())


def of_largest_cluster(sample: Sample) -> Sample:
    """Return the sample reduced to its largest cluster, which is framed if all points would cover almost no pixels."""
    rows = largest_cluster(sample.positions)
    return sample._replace(positions=sample.positions[rows], normals=sample.normals[rows])
