"""Floor of each point: the local surface near it, whether or not the point lies on it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.arrays import Flags, Floats, Rows
from ...base.progress import Progress, part_of
from .examine import FAR, OFF, ROUGH, ROUGHLY, SPACINGS, examine_rows, join
from .local_fits import GROUP, LocalSurfaceFits

LEAST = 20  # with fewer points no floor is searched
SUSPECT = 2.2  # distance from the fitted floor, in noises, above which a point is examined
LAYER = 6.0  # greatest distance of a second layer, in spacings of the floor
COMPANY = 2  # neighbouring points of a layer, at least
SURVEYED = 0.7  # progress after the local fits


class Floors(NamedTuple):
    """Floor of each position: the surface near it that most of its neighbours lie on, whether or not it does itself.

    off : (n,) bool, whether it lies off its floor
    is_on : (n,) bool, whether it lies on a smooth floor
    offset : (n, 3) float32, to the floor, where it is off
    spacing : (n,) float32, of the floor's points, where it is off
    in_layer : (n,) bool, whether it is off by at most 6 spacings, as in a second layer, with others next to it
    core : (n,) float32, distance to its eighth neighbour
    near : (n, k) int32, its nearest neighbours, itself first
    """

    off: Flags
    is_on: Flags
    offset: Floats
    spacing: Floats
    in_layer: Flags
    core: Floats
    near: NDArray[np.int32]


class FloorSearch:
    """Search, part by part, for points that lie off their floor: the surface near them.

    A part is a set of groups of four points, consecutive in kd order, which share a first fit.

    Parameters
    ----------
    positions : (n, 3) float32
        Distinct, in kd order; at least 20.
    """

    def __init__(self, positions: Floats) -> None:
        n = len(positions)
        self._positions, self.fits = positions, LocalSurfaceFits(positions)
        # Results of the examination: verdict; offset to the floor, its spacing, points on this side.
        self._verdicts, self._details = np.zeros(n, np.float32), np.zeros((n, 5), np.float32)

    def examine(self, groups: Rows, progress: Progress | None = None, is_exact: bool = False) -> Rows:
        """Fit surfaces around groups of points; return the rows that certainly lie off them, in a second layer.

        A second layer is a duplicate of a surface, such as from a misaligned scan.

        groups : (g,) ascending numbers of groups; group g holds the four rows from 4 g on
        is_exact : whether surrounding groups are fitted as well: the result then depends on no earlier call
        """
        fits = self.fits
        fits.examine(groups, part_of(progress, 0.0, SURVEYED))
        rows = (GROUP * groups[:, None] + np.arange(GROUP)).ravel()
        rows = rows[rows < len(self._verdicts)]
        if is_exact:
            around = np.zeros_like(fits.known)
            around[fits.near[rows].ravel() // GROUP] = True
            fits.examine(np.flatnonzero(around & ~fits.known))
        shared = fits.shared(rows)
        spacing = fits.spacing[rows]
        is_suspect = fits.height[rows] > np.maximum(SUSPECT * shared, 0.5 * SPACINGS * spacing)
        is_suspect |= fits.noise[rows] > ROUGH * shared + ROUGHLY * spacing  # the fitted surface may be no floor
        suspects, noise = rows[is_suspect], shared[is_suspect]
        verdicts = examine_rows(fits.tree, self._positions, suspects, noise, part_of(progress, SURVEYED, 1.0))
        self._verdicts[suspects], self._details[suspects] = verdicts[:, 0], verdicts[:, 1:]
        off = suspects[verdicts[:, 0] == OFF]
        return off[_in_layer(self._details[off])]

    def forget(self) -> None:
        """Discard the results of `examine`: which points lie off their surface. Keep the fitted surfaces."""
        self._verdicts[:], self._details[:] = 0.0, 0.0

    def floors(self) -> Floors:
        """Return the surface near each point, and which points lie off it: neither on nor off if not examined."""
        fits = self.fits
        off = join(fits.tree, self._positions, self._verdicts, self._details)
        rows = np.arange(len(off)) if fits.known.all() else np.flatnonzero(np.isfinite(fits.noise))
        shared, spacing = fits.shared(rows), SPACINGS * fits.spacing[rows]
        is_on = np.zeros(len(off), np.bool_)
        is_on[rows] = (fits.height[rows] <= np.maximum(FAR * shared, spacing)) & (shared <= spacing) & ~off[rows]
        in_layer = off & _in_layer(self._details)
        return Floors(off, is_on, self._details[:, :3], self._details[:, 3], in_layer, fits.core, fits.near)


def _in_layer(details: Floats) -> Flags:
    """Return which points may lie in a second layer of a surface, a duplicate of it from a misaligned scan, (n,) bool.

    Such points are near enough to the surface, with others next to them.

    details : (n, 5) offset to the surface, x y z; its point spacing; number of neighbours on the point's side of it
    """
    square = np.einsum("ij,ij->i", details[:, :3], details[:, :3])
    return np.asarray((square <= (LAYER * details[:, 3]) ** 2) & (details[:, 4] >= COMPANY))


def find_floors(positions: Floats, progress: Progress | None = None) -> Floors:
    """Find the surface near each position, and which positions lie off it.

    positions : (n, 3) distinct, in kd order; at least 20
    """
    floor_search = FloorSearch(positions)
    floor_search.examine(np.arange(len(floor_search.fits.known)), progress)
    return floor_search.floors()
