"""Where second layers are: blocks of the kd order are opened, and those beside them as long as layers go on.

What a block shows depends on the points in and around it alone, not on which blocks were opened before. So a cloud in
parts opens the blocks that the whole would.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...base.progress import Progress, part_of, tell
from .floors import Ground
from .local_fits import GROUP

Rows = NDArray[np.int64]

STRETCH = 16 * GROUP  # points that follow each other in kd order: a place about 8 spacings wide
SAMPLE, SHARE = 20_000, 32  # points that are looked at in any case; a block has at most so many stretches
SHOWS = 2  # points off their floor, from which a stretch shows a layer
SEEDS = 0.5  # share of the time, where no layer shows


def block_size(total: int) -> int:
    """How many points of the kd order are a block of a cloud: a power of two, at most 2,048."""
    return STRETCH << min(max(total // SAMPLE, 1).bit_length() - 1, SHARE.bit_length() - 1)


class Search:
    """The search for layers among some points of a cloud.

    Parameters
    ----------
    ground : Ground
        Of which nothing is known yet.
    total : int
        How many points the cloud has.
    numbers : (m,) int64
        The place of each point at hand in the kd order of all.
    """

    def __init__(self, ground: Ground, total: int, numbers: Rows) -> None:
        self._ground, size = ground, block_size(total)
        starts = numbers[::STRETCH]
        self._blocks = starts // size
        # The stretch in the middle of a block stands for it.
        self._is_seed = starts % size // STRETCH == size // STRETCH // 2

    def seeds(self, progress: Progress | None = None) -> Rows:
        """The blocks whose middle shows a layer, ascending."""
        off = self._off(np.flatnonzero(self._is_seed), False, progress)
        self._ground.forget()
        return np.unique(self._blocks[off // STRETCH])

    def open(self, blocks: Rows, progress: Progress | None = None) -> Rows:
        """Look at all points at hand of some blocks; returns the blocks that their layers may go on to, ascending."""
        off = self._off(np.flatnonzero(np.isin(self._blocks, blocks)), True, progress)
        return np.unique(self._blocks[self._ground.survey.near[off].ravel() // STRETCH])

    def everywhere(self, progress: Progress | None = None) -> None:
        """Open all blocks that show layers, one after the other."""
        todo = known = self.seeds(part_of(progress, 0.0, SEEDS))
        while len(todo):
            share = len(known) / (int(self._blocks[-1]) + 1)
            beside = self.open(todo, part_of(progress, SEEDS, SEEDS + (1.0 - SEEDS) * share))
            todo = np.setdiff1d(beside, known)
            known = np.union1d(known, todo)
        tell(progress, 1.0)

    def _off(self, stretches: Rows, is_exact: bool, progress: Progress | None) -> Rows:
        """The rows off their floor in those of some stretches that show a layer."""
        groups = (STRETCH // GROUP * stretches[:, None] + np.arange(STRETCH // GROUP)).ravel()
        groups = groups[groups < len(self._ground.survey.known)]
        off = self._ground.look(groups, progress, is_exact)
        shows = np.bincount(off // STRETCH, minlength=len(self._blocks)) >= SHOWS
        return off[shows[off // STRETCH]]
