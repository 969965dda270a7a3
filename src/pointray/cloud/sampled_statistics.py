"""Statistics of a cloud, computed from a sample in which some points may coincide: see `CloudStatistics`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .statistics import CloudStatistics, Rows


class SampledStatistics(CloudStatistics):
    """Statistics computed from a sample of the points in memory.

    Parameters
    ----------
    rows : (m,) int64
        The sample.
    known : dict of str to float, optional
        Where the numbers are stored.
    """

    def __init__(self, rows: Rows, known: dict[str, float] | None = None) -> None:
        super().__init__(rows, known)
        self.sample = rows


def of_distinct_positions(statistics: CloudStatistics, ids: NDArray[np.integer] | None) -> CloudStatistics:
    """Return statistics that count each position once. ids : (n,) number of each point's position; None: all differ"""
    if ids is None or not isinstance(statistics, SampledStatistics):
        return statistics
    return CloudStatistics(np.unique(ids[statistics.sample]).astype(np.int64), statistics.known)
