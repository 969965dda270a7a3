"""Distribution of a scene's instances over several processes, each of which opens only its own."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from ..base.arrays import Doubles, Rows
from ..engine.kernels.records import KIND, MODEL, PLANE, SHAPE_ROW
from .visible_trees import instances_of
from .world import Snapshot, surface_boxes


class Shares:
    """Assignment of the instances of models to holders, in contiguous ranges of about equal size in bytes.

    A holder is a process, such as a worker of a cluster, that opens only the models of its own instances. The parts in
    a range are close together in space, so few rays hit parts of several holders.

    Attributes
    ----------
    rows : (n,) int64
        Rows of the instances.
    owners : (n,) int64
        Holder of each instance, an index of `holders`.
    holders : list of str
        Names of the holders, such as addresses of workers.
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
        """Return the rows of a holder's instances."""
        return self.rows[self.owners == self.holders.index(holder)]

    def pass_on(self, there: Iterable[str]) -> bool:
        """Reassign the instances of lost holders to the present ones; return whether any holder was lost.

        Each instance goes to the holder with the fewest bytes.

        there : names of the present holders; if empty, nothing changes
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
    """Return a scene in which rays miss the parts on disk that are not in the given rows of instances. Opens nothing.

    A worker intersects rays with it, and opens only the parts assigned to it.
    """
    away = np.setdiff1d(scene.on_disk, rows)
    records = instances_of(scene.world).copy()
    records[away, KIND] = PLANE  # any kind but MODEL: the table of planes does not list it
    return scene._replace(world=scene.world._replace(instances=records.reshape(-1)))


def boxes_of(scene: Snapshot, rows: Rows) -> Doubles:
    """Return world boxes around the surfaces of the instances in some rows, (n, 6): min x y z, max x y z.

    Coarser levels of detail may extend beyond these boxes. Tracing clips them to the BVH over the instances; in a scene
    of a few models without BVH, the boxes are infinite if there are levels.
    """
    if scene.world.top_children.size == 0 and any(model.levels for model in scene.models):
        return np.tile([-np.inf] * 3 + [np.inf] * 3, (len(rows), 1))
    return surface_boxes(scene.world.instances, scene.models, rows)
