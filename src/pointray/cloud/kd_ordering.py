"""Kd ordering of a cloud: its distinct positions in an order that keeps neighbours together in memory."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.arrays import Floats
from .neighbors import distinct, kd_order, take
from .points import Points


class KdOrdering(NamedTuple):
    """Kd order of points: the distinct positions of their finite rows in that order, and where each row is in it.

    Attributes
    ----------
    positions : (m, 3) float32
    ids : (k,) int32
        Index into `positions` for each finite row.
    rows : (m,) int32
        The first row of the points at each position.
    """

    positions: Floats
    ids: NDArray[np.int32]
    rows: NDArray[np.int32]

    def order(self) -> NDArray[np.integer[Any]]:
        """Return the rows of points, (n,), in kd order, equal positions together. All rows must be finite."""
        return self.rows if len(self.rows) == len(self.ids) else np.argsort(self.ids, kind="stable")

    def moved(self, points: Points) -> KdOrdering:
        """Return the ordering of the same points at other positions, (n, 3), which keep their places in the kd order.

        They are not sorted again, so the order is exact only where points hardly moved.

        points : the same rows, all finite, with the new positions
        """
        finite, order = np.flatnonzero(points.finite), self.order()
        positions = take(points.positions, finite[order])
        rows, ids = distinct(positions)
        ids_of = np.empty_like(ids)
        ids_of[order] = ids
        return KdOrdering(take(positions, rows), ids_of, finite[order[rows]].astype(np.int32))

    def spread(self, values: NDArray[Any], points: Points) -> NDArray[Any]:
        """Copy values of distinct positions, (m, ...), to all rows of points, (n, ...); rows not finite get 0."""
        found = take(values, self.ids)
        if len(found) == len(points):
            return found
        out = np.zeros((len(points), *values.shape[1:]), values.dtype)
        out[points.finite] = found
        return out


def compute_kd_ordering(points: Points) -> KdOrdering:
    """Return the distinct positions of points in kd order, where neighbours are close in memory, and their rows."""
    finite = points.finite
    whole = bool(finite.all())
    positions = points.positions if whole else points.positions[finite]
    rows, ids = distinct(positions)
    order = kd_order(positions if len(rows) == len(positions) else take(positions, rows))
    rank = np.empty(len(order), np.int32)
    rank[order] = np.arange(len(order), dtype=np.int32)
    if len(rows) < len(positions):
        ids, order = take(rank, ids), take(rows, order)
    else:
        ids = rank
    rows = order if whole else take(np.flatnonzero(finite).astype(np.int32), order)
    return KdOrdering(take(positions, order), ids, rows)
