"""The floor of each point: the surface near it, whether or not the point lies on it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.progress import Progress, part_of
from .examine import FAR, OFF, ROUGH, ROUGHLY, SPACINGS, examined, join
from .local_fits import GROUP, Survey

Floats = NDArray[np.float32]
Rows = NDArray[np.int64]

LEAST = 20  # fewer points tell nothing
SUSPECT = 2.2  # noises off the floor of the survey, from which a point is examined
LAYER = 6.0  # spacings of the floor: farther off it, a point is no part of a second layer
COMPANY = 2  # points of a layer near each other, at least
SURVEYED = 0.7  # share of the time


class Floors(NamedTuple):
    """What is known of each position's floor.

    off : (n,) bool, whether it lies off its floor
    is_on : (n,) bool, whether it lies on a smooth one
    offset : (n, 3) float32, from where it is off, to the floor
    spacing : (n,) float32, of the floor's points, where it is off
    in_layer : (n,) bool, whether it is off as near to its floor as a second layer, with others beside it
    core : (n,) float32, distance to its `survey.CORE`-th neighbour
    near : (n, k) int32, its nearest neighbours, itself first
    """

    off: NDArray[np.bool_]
    is_on: NDArray[np.bool_]
    offset: Floats
    spacing: Floats
    in_layer: NDArray[np.bool_]
    core: Floats
    near: NDArray[np.int32]


class Ground:
    """The floors of positions that are looked at part by part; each part is a number of groups, see `Survey`.

    Parameters
    ----------
    positions : (n, 3) float32
        All different and in kd order; at least `LEAST`.
    """

    def __init__(self, positions: Floats) -> None:
        n = len(positions)
        self._positions, self.survey = positions, Survey(positions)
        # What the examination says: a word; offset to the floor, its spacing, points on this side.
        self._said, self._about = np.zeros(n, np.float32), np.zeros((n, 5), np.float32)

    def look(self, groups: Rows, progress: Progress | None = None, is_exact: bool = False) -> Rows:
        """Look at some groups; returns the rows that surely lie in a layer off their floor.

        is_exact : whether groups around them are surveyed too: what is said depends on no earlier look then
        """
        survey = self.survey
        survey.look(groups, part_of(progress, 0.0, SURVEYED))
        rows = (GROUP * groups[:, None] + np.arange(GROUP)).ravel()
        rows = rows[rows < len(self._said)]
        if is_exact:
            around = np.zeros_like(survey.known)
            around[survey.near[rows].ravel() // GROUP] = True
            survey.look(np.flatnonzero(around & ~survey.known))
        shared = survey.shared(rows)
        spacing = survey.spacing[rows]
        is_suspect = survey.height[rows] > np.maximum(SUSPECT * shared, 0.5 * SPACINGS * spacing)
        is_suspect |= survey.noise[rows] > ROUGH * shared + ROUGHLY * spacing  # what was fitted may be no floor
        suspects, noise = rows[is_suspect], shared[is_suspect]
        said = examined(survey.tree, self._positions, suspects, noise, part_of(progress, SURVEYED, 1.0))
        self._said[suspects], self._about[suspects] = said[:, 0], said[:, 1:]
        off = suspects[said[:, 0] == OFF]
        return off[_in_layer(self._about[off])]

    def forget(self) -> None:
        """Forget who lies off the floor; the survey stays."""
        self._said[:], self._about[:] = 0.0, 0.0

    def floors(self) -> Floors:
        """All that is known: of rows that were not looked at nothing is."""
        survey = self.survey
        off = join(survey.tree, self._positions, self._said, self._about)
        rows = np.arange(len(off)) if survey.known.all() else np.flatnonzero(np.isfinite(survey.noise))
        shared, spacing = survey.shared(rows), SPACINGS * survey.spacing[rows]
        is_on = np.zeros(len(off), np.bool_)
        is_on[rows] = (survey.height[rows] <= np.maximum(FAR * shared, spacing)) & (shared <= spacing) & ~off[rows]
        in_layer = off & _in_layer(self._about)
        return Floors(off, is_on, self._about[:, :3], self._about[:, 3], in_layer, survey.core, survey.near)


def _in_layer(about: Floats) -> NDArray[np.bool_]:
    """Which points lie as near to their floor as a second layer, with others beside them; see `Ground`."""
    square = np.einsum("ij,ij->i", about[:, :3], about[:, :3])
    return np.asarray((square <= (LAYER * about[:, 3]) ** 2) & (about[:, 4] >= COMPANY))


def find_floors(positions: Floats, progress: Progress | None = None) -> Floors:
    """The floors of positions, which are all different and in kd order; at least `LEAST` of them."""
    ground = Ground(positions)
    ground.look(np.arange(len(ground.survey.known)), progress)
    return ground.floors()
