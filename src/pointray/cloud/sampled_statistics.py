"""Statistics of a cloud, computed from a sample in which some points may coincide: see `CloudStatistics`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..base.arrays import Rows
from .statistics import CloudStatistics


class SampledStatistics(CloudStatistics):
    """Statistics of a cloud, computed from a sample of the points in memory; some of these may have equal positions.

    Parameters
    ----------
    rows : (m,) int64
        The sample, as rows of the points in memory.
    known : dict of str to float, optional
        Numbers computed before, by name; further ones are added.
    """

    def __init__(self, rows: Rows, known: dict[str, float] | None = None) -> None:
        super().__init__(rows, known)
        self.sample = rows


def of_distinct_positions(statistics: CloudStatistics, ids: NDArray[np.integer] | None) -> CloudStatistics:
    """Return statistics that count each distinct position once, where the given ones count points.

    ids : (n,) number of the position of each point in memory; None: all positions are distinct
    """
    if ids is None or not isinstance(statistics, SampledStatistics):
        return statistics
    return CloudStatistics(np.unique(ids[statistics.sample]).astype(np.int64), statistics.known)
