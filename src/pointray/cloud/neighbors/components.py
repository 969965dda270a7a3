"""Which points hang together by links to their neighbours."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def connected_components(near: NDArray[np.integer[Any]], is_linked: NDArray[np.bool_]) -> NDArray[np.int32]:
    """The part of each of n points, (n,): points that links join, in whichever direction, are of the same part.

    near : (n, k) rows; is_linked : (n, k), which of them are linked
    """
    from scipy.sparse import csr_array  # a tenth of a second, which most commands need not wait for
    from scipy.sparse.csgraph import connected_components

    n = len(near)
    ends = np.concatenate([[0], is_linked.sum(axis=1, dtype=np.int32).cumsum(dtype=np.int32)])
    graph = csr_array((np.ones(ends[-1], np.int8), near[is_linked], ends), shape=(n, n))
    return np.asarray(connected_components(graph, directed=False)[1])
