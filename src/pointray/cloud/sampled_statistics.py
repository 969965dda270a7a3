"""A sample of points, some of which lie at one place, asked for numbers that are known of places: see `Usual`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .statistics import Rows, Usual


class Sampled(Usual):
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


def of_places(usual: Usual, ids: NDArray[np.integer] | None) -> Usual:
    """The same, where each place counts once. ids : (n,) the number of each point's place; None: each has its own"""
    if ids is None or not isinstance(usual, Sampled):
        return usual
    return Usual(np.unique(ids[usual.sample]).astype(np.int64), usual.known)
