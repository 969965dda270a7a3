"""Connected components of a neighbour graph."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...base.arrays import Flags


def connected_components(near: NDArray[np.integer[Any]], is_linked: Flags) -> NDArray[np.int32]:
    """Return the connected component of each of n points, (n,) int32 numbers, in a graph of neighbours.

    near : (n, k) rows of each point's neighbours
    is_linked : (n, k) whether an edge, in both directions, connects the point with each of them
    """
    from scipy.sparse import csr_array  # deferred: takes 0.1 s, and most commands do not need it
    from scipy.sparse.csgraph import connected_components

    n = len(near)
    ends = np.concatenate([[0], is_linked.sum(axis=1, dtype=np.int32).cumsum(dtype=np.int32)])
    graph = csr_array((np.ones(ends[-1], np.int8), near[is_linked], ends), shape=(n, n))
    return np.asarray(connected_components(graph, directed=False)[1])
