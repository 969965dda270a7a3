"""The path through a cloud: its places in an order that keeps neighbours together."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..data import Points
from ..neighbors import distinct, kd_order, take


class Path(NamedTuple):
    """The distinct positions of the finite rows of some points, in the order of `kd_order`, or about that.

    Attributes
    ----------
    positions : (m, 3) float32
    ids : (k,) int32
        For each finite row, the number of its position.
    rows : (m,) int32
        The first row at each position.
    order : (k,) int32
        The finite rows, counted among themselves, in the order of their positions.
    """

    positions: NDArray[np.float32]
    ids: NDArray[np.int32]
    rows: NDArray[np.int32]
    order: NDArray[np.int32]

    def spread(self, values: NDArray[Any], points: Points) -> NDArray[Any]:
        """What is known of each position, (m, ...), for each row of the points; 0 for rows that are not finite."""
        found = take(values, self.ids)
        if len(found) == len(points):
            return found
        out = np.zeros((len(points), *values.shape[1:]), values.dtype)
        out[points.finite] = found
        return out

    def moved(self, points: Points) -> Path:
        """The path through the same rows in the same order, where they are now."""
        return path_in(points, self.order)


def along_path(points: Points) -> Path:
    """The path through points."""
    finite = points.finite
    return path_in(points, kd_order(points.positions if finite.all() else points.positions[finite]))


def path_in(points: Points, order: NDArray[np.int32]) -> Path:
    """The path through points in an order of their finite rows, counted among themselves.

    Where points lie at one place the first of them counts, so the path of a part of the order is a part of the path.
    """
    finite = points.finite
    whole = bool(finite.all())
    positions = take(points.positions if whole else points.positions[finite], order)
    first, ids = distinct(positions)
    place, rows = np.empty(len(order), np.int32), order
    place[order] = ids
    if len(first) < len(positions):
        positions, rows = take(positions, first), take(order, first)
    return Path(positions, place, rows if whole else take(np.flatnonzero(finite).astype(np.int32), rows), order)
