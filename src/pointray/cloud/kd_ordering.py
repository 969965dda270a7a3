"""Kd ordering of a cloud: its distinct positions in an order that keeps neighbours together in memory."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .neighbors import distinct, kd_order, take
from .points import Points


class KdOrdering(NamedTuple):
    """Distinct positions of the finite rows of some points, in the order of `kd_order`.

    Attributes
    ----------
    positions : (m, 3) float32
    ids : (k,) int32
        Index into `positions` for each finite row.
    rows : (m,) int32
        The first row at each position.
    """

    positions: NDArray[np.float32]
    ids: NDArray[np.int32]
    rows: NDArray[np.int32]

    def order(self) -> NDArray[np.integer[Any]]:
        """Return the finite rows, numbered among themselves, in the order of their positions."""
        return self.rows if len(self.rows) == len(self.ids) else np.argsort(self.ids, kind="stable")

    def moved(self, points: Points) -> KdOrdering:
        """Return the ordering of the same points at other positions, without sorting them again."""
        finite, order = np.flatnonzero(points.finite), self.order()
        positions = take(points.positions, finite[order])
        rows, ids = distinct(positions)
        ids_of = np.empty_like(ids)
        ids_of[order] = ids
        return KdOrdering(take(positions, rows), ids_of, finite[order[rows]].astype(np.int32))

    def spread(self, values: NDArray[Any], points: Points) -> NDArray[Any]:
        """Copy values of positions, (m, ...), to all rows of the points; rows that are not finite get 0."""
        found = take(values, self.ids)
        if len(found) == len(points):
            return found
        out = np.zeros((len(points), *values.shape[1:]), values.dtype)
        out[points.finite] = found
        return out


def compute_kd_ordering(points: Points) -> KdOrdering:
    """Return the kd ordering of points."""
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
