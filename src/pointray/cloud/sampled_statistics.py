"""Statistics of a cloud, computed from a sample in which some points lie at one place: see `CloudStatistics`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .statistics import CloudStatistics, Rows


class SampledStatistics(CloudStatistics):
    """What is usual in a cloud, asked of a sample among the points at hand.

    Parameters
    ----------
    rows : (m,) int64
        The sample.
    known : dict of str to float, optional
        Where numbers are kept.
    """

    def __init__(self, rows: Rows, known: dict[str, float] | None = None) -> None:
        super().__init__(rows, known)
        self.sample = rows


def of_places(usual: CloudStatistics, ids: NDArray[np.integer] | None) -> CloudStatistics:
    """The same, where each place counts once. ids : (n,) the number of each point's place; None: each has its own"""
    if ids is None or not isinstance(usual, SampledStatistics):
        return usual
    return CloudStatistics(np.unique(ids[usual.sample]).astype(np.int64), usual.known)
