"""Who holds which instances of a scene whose models are spread over several processes."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from ..engine.kernels.records import KIND, MODEL, PLANE, SHAPE_ROW
from .visible_trees import instances_of
from .world import Snapshot, reach_boxes

Rows = NDArray[np.int64]


class Shares:
    """The instances of models, each of which one of several holders holds: stretches of about as many bytes.

    A stretch of a model's parts lies together in space, so that few rays meet those of several holders.

    Attributes
    ----------
    rows : (n,) int64
        The rows of the instances.
    owners : (n,) int64
        Who holds each: a number of `holders`.
    holders : list of str
    """

    def __init__(self, scene: Snapshot, holders: Iterable[str]) -> None:
        records = instances_of(scene.world)
        self.rows = np.flatnonzero(records[:, KIND] == MODEL)
        nbytes = np.array([model.nbytes for model in scene.models], float)
        self._nbytes = nbytes[records[self.rows, SHAPE_ROW].astype(int)]
        self.holders = list(holders)
        middles = np.cumsum(self._nbytes) - self._nbytes / 2
        cuts = self._nbytes.sum() * np.arange(1, len(self.holders)) / max(len(self.holders), 1)
        self.owners = np.searchsorted(cuts, middles)

    def of(self, holder: str) -> Rows:
        """The rows that somebody holds."""
        return self.rows[self.owners == self.holders.index(holder)]

    def pass_on(self, there: Iterable[str]) -> bool:
        """Give what those held who are not there any more to others, and to those who are new; whether there were any.

        Whoever holds the least gets the next one.
        """
        now = list(there)
        if not now or set(self.holders) <= set(now):
            return False
        number = np.array([now.index(holder) if holder in now else -1 for holder in self.holders])
        self.owners, self.holders = number[self.owners], now
        load = np.bincount(self.owners[self.owners >= 0], self._nbytes[self.owners >= 0], len(now))
        for k in np.flatnonzero(self.owners < 0):
            self.owners[k] = load.argmin()
            load[self.owners[k]] += self._nbytes[k]
        return True


def held_scene(scene: Snapshot, rows: Rows) -> Snapshot:
    """A scene in which rays hit nothing of the parts that lie on disk, but of those of some rows, which are opened."""
    away = np.setdiff1d(scene.on_disk, rows)
    records = instances_of(scene.world).copy()
    records[away, KIND] = PLANE  # nobody looks what it is
    return scene._replace(world=scene.world._replace(instances=records.reshape(-1)))


def boxes_of(scene: Snapshot, rows: Rows) -> NDArray[np.float64]:
    """World boxes around all that rays can hit of instances, (n, 6).

    They have no end where levels of detail may reach beyond them and no tree over the instances cuts these off.
    """
    if scene.world.top_children.size == 0 and any(model.levels for model in scene.models):
        return np.tile([-np.inf] * 3 + [np.inf] * 3, (len(rows), 1))
    return reach_boxes(scene.world.instances, scene.models, rows)
