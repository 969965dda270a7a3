"""Search for second layers by ranges of the kd order, continuing with adjacent ranges as long as layers go on.

The result for a range depends only on the points in and around it, not on earlier ranges. A cloud in parts thus
examines the same ranges as the whole.
"""

from __future__ import annotations

import numpy as np

from ...base.arrays import Rows
from ...base.progress import Progress, part_of, report_progress
from .floors import FloorSearch
from .local_fits import GROUP

RANGE = 16 * GROUP  # consecutive points in kd order, about 8 spacings wide
SAMPLE, SHARE = 20_000, 32  # points examined in any case; largest number of ranges of a block
SHOWS = 2  # points off their floor with which a range shows a layer
SEEDS = 0.5  # progress if no layer is found


def block_size(total: int) -> int:
    """Return how many consecutive points in kd order are searched for second layers at once: a power of two to 2,048.

    Second layers are sparse duplicates of a surface, beside it, from misaligned scans.

    total : points of the cloud
    """
    return RANGE << min(max(total // SAMPLE, 1).bit_length() - 1, SHARE.bit_length() - 1)


class LayerSearch:
    """Search for second layers, duplicates of a surface from misaligned scans, by ranges of the kd order of a cloud.

    A range, up to 2,048 consecutive points, is examined if a few points in its middle lie in such a layer, or if a
    layer continues into it from a range that has been examined.

    Parameters
    ----------
    floor_search : FloorSearch
        Examines the points; without any results yet.
    total : int
        Number of points of the cloud.
    numbers : (m,) int64
        Place of each given point in the cloud's kd order.
    """

    def __init__(self, floor_search: FloorSearch, total: int, numbers: Rows) -> None:
        self._floor_search, size = floor_search, block_size(total)
        starts = numbers[::RANGE]
        self._blocks = starts // size
        # The middle range of a block represents it.
        self._is_seed = starts % size // RANGE == size // RANGE // 2

    def seeds(self, progress: Progress | None = None) -> Rows:
        """Return the numbers of the ranges of the kd order in whose middle points lie in a second layer, ascending.

        A second layer is a sparse duplicate of a surface, from a misaligned scan. The search begins in these ranges.
        """
        off = self._off(np.flatnonzero(self._is_seed), False, progress)
        self._floor_search.forget()
        return np.unique(self._blocks[off // RANGE])

    def open(self, blocks: Rows, progress: Progress | None = None) -> Rows:
        """Examine all points of some ranges of the kd order; return the ranges to examine next.

        These are the ranges with neighbours of points found in a second layer (a duplicate of a surface from a
        misaligned scan), which may continue there. They can include ranges that were examined before.

        blocks : numbers of the ranges to examine, as the result
        """
        off = self._off(np.flatnonzero(np.isin(self._blocks, blocks)), True, progress)
        return np.unique(self._blocks[self._floor_search.fits.near[off].ravel() // RANGE])

    def examine_all(self, progress: Progress | None = None) -> None:
        """Examine all ranges of the kd order that show second layers, and those in which the layers continue.

        A second layer is a sparse duplicate of a surface, from a misaligned scan.

        `FloorSearch.floors` then returns the results.
        """
        todo = known = self.seeds(part_of(progress, 0.0, SEEDS))
        while len(todo):
            share = len(known) / (int(self._blocks[-1]) + 1)
            beside = self.open(todo, part_of(progress, SEEDS, SEEDS + (1.0 - SEEDS) * share))
            todo = np.setdiff1d(beside, known)
            known = np.union1d(known, todo)
        report_progress(progress, 1.0)

    def _off(self, ranges: Rows, is_exact: bool, progress: Progress | None) -> Rows:
        """Examine some ranges of 64 points; return the rows that lie in a second layer, where a range has at least two.

        A second layer is a sparse duplicate of a surface, from a misaligned scan.

        is_exact : whether the result must not depend on ranges examined earlier
        """
        groups = (RANGE // GROUP * ranges[:, None] + np.arange(RANGE // GROUP)).ravel()
        groups = groups[groups < len(self._floor_search.fits.known)]
        off = self._floor_search.examine(groups, progress, is_exact)
        shows = np.bincount(off // RANGE, minlength=len(self._blocks)) >= SHOWS
        return off[shows[off // RANGE]]
