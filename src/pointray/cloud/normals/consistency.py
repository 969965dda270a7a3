"""Consistency of a file's normals: the share of neighbours that face opposite sides."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...base.arrays import Floats, Rows
from ...engine.jit import Array, kernel
from ..neighbors import distinct, kd_order, neighbors

ACROSS = 0.1  # sine of the angle at which a point lies off another's tangent plane
OPPOSITE = -0.5  # cosine below which two normals face opposite sides
RUNS, RUN = 64, 2048  # ranges of the kd order that represent a large cloud, and their points


@kernel
def _count_disagreements(positions: Array, normals: Array, rows: Array, near: Array) -> int:
    """Count pairs of neighbours whose normals face opposite sides, though they should not; return their number.

    Pairs on one tangent plane count. Other pairs may be the two faces of a thin wall, each behind the other, or of a
    slit, each in front of the other. Wrong signs make both cases equally frequent: twice the rarer one counts.

    positions, normals : (n, 3)
    rows, near : (m,) examined points, and (m, k) their neighbours
    """
    level = before = behind = 0
    for t in range(len(rows)):
        for j in near[t]:
            nm = height = square = 0.0
            for c in range(3):
                d = positions[j, c] - positions[rows[t], c]
                nm += normals[rows[t], c] * normals[j, c]
                height += normals[rows[t], c] * d
                square += d * d
            if nm < OPPOSITE:
                across = height * height > ACROSS * ACROSS * square
                level += not across
                before += across and height > 0.0
                behind += across and height < 0.0
    return level + 2 * min(before, behind)


def sample_rows(count: int) -> Rows:
    """Return places in a kd order that represent all `count` points: evenly spaced ranges, or all if there are few."""
    if count <= RUNS * RUN:
        return np.arange(count)
    starts = np.linspace(0, count - RUN, RUNS).astype(np.int64)
    return (starts[:, None] + np.arange(RUN)).ravel()


def disagreement_share(positions: Floats, normals: Floats, order: NDArray[np.int32] | None = None) -> float:
    """Return the share of pairs of neighbours, 0 to 1, whose normals face opposite sides, by a sample of the points.

    positions, normals : (n, 3)
    order : rows of the positions in kd order, if known
    """
    order = kd_order(positions) if order is None else order
    order = order[sample_rows(len(order))]
    order = order[distinct(positions[order])[0]]
    ordered, unit = positions[order], normals[order]
    if len(ordered) < 2:
        return 0.0
    rows = np.arange(0, len(ordered), 4)
    near = neighbors(ordered, 4, ordered[rows])[1][:, 1:]
    return float(_count_disagreements(ordered, unit, rows, np.ascontiguousarray(near)) / near.size)
