"""Points on their surface -> splats, of which a tree is built."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.progress import Progress, tell
from ...base.warning_log import warn
from ...cloud.denoising.smooth import Placed
from ...cloud.neighbors import kd_order, take
from ..tree.build import Splats
from ..tree.settings import TreeSettings
from .levels import THIN
from .support import CROWD, find_support

SMALLEST, LARGEST = 1e-12, 1e12  # limits of a radius

Floats = NDArray[np.float32]


class Sizes(NamedTuple):
    """How wide splats are.

    given : (n,) float32, their radii; None: chosen
    scale : factor for all radii
    within : lower limit and upper limits, (n,) float32, of chosen radii; only for levels of detail
    others : (m, 3) float32, points of the cloud that are drawn otherwise, for chosen radii
    """

    given: Floats | None = None
    scale: float = 1.0
    within: tuple[float, Floats] | None = None
    others: Floats | None = None

    def select(self, mask: NDArray[np.bool_]) -> Sizes:
        """Those of some of the points."""
        given = None if self.given is None else self.given[mask]
        within = None if self.within is None else (self.within[0], self.within[1][mask])
        return self._replace(given=given, within=within)


class SplatBuild(NamedTuple):
    """Splats in kd order, and what is said of them.

    rows : (n,) int32, the caller's rows in that order, also those for which no splat stands
    radii : (n,) float32, their radii
    tight : whether many are too small to cover the surface
    """

    splats: Splats
    rows: NDArray[np.int32]
    radii: Floats
    tight: bool


def make_splats(
    placed: Placed,
    rows: NDArray[np.int32],
    sizes: Sizes,
    settings: TreeSettings,
    progress: Progress | None = None,
) -> SplatBuild:
    """Give each of some points a support. Warns of lone points and of those that lie where many others do.

    Parameters
    ----------
    placed : Placed
        Finite points.
    rows : (n,) int32
        The caller's row of each.
    """
    automatic, level = settings.overhang < np.inf, sizes.within is not None
    tell(progress, 0.0)
    points, noise, order, apart = placed
    order = kd_order(points.positions) if order is None else order
    positions, normals = take(points.positions, order), take(np.asarray(points.normals), order)
    colors, noise = (None if array is None else take(array, order) for array in (points.colors, noise))
    rows, given = take(rows, order), None if sizes.given is None else take(sizes.given, order)
    within = None if sizes.within is None else (sizes.within[0], take(sizes.within[1], order))
    del placed, points, order  # if the caller has no use for them, their memory is free from here on
    support = find_support(
        positions,
        normals,
        given,
        sizes.scale,
        borders=automatic,
        sheets=automatic and (settings.surface != "paper" or level),
        within=within,
        apart=apart,
        progress=progress,
        others=sizes.others,
        noise=None if level else noise,
    )
    check_size(support.radii)
    if support.note and not level:
        warn(support.note, stacklevel=3)
    sheets = support.sheets
    if level and sheets is not None and sheets.mean() < THIN:
        sheets = None
    if noise is not None:  # whatever a caller says of the noise, a surface has no bumps higher than that
        noise = np.minimum(noise, support.radii)
    splats = Splats(positions, normals, support.radii, rows, colors, support.borders, sheets, noise)
    return SplatBuild(_not_crowded(splats, support.crowded), rows, support.radii, support.tight)


def check_size(radii: Floats, scale: str = "radius_scale") -> None:
    """Check that the squares of radii and their inverses stay within float32. scale : the name of their factor"""
    if radii.min() < SMALLEST or radii.max() > LARGEST:
        raise ValueError(
            f"radii reach from {radii.min():.3g} to {radii.max():.3g} with {scale}: "
            f"they must be from {SMALLEST:g} to {LARGEST:g}"
        )


def _not_crowded(splats: Splats, crowded: NDArray[np.bool_]) -> Splats:
    """The splats without the crowded ones, with a warning if there are any."""
    lost = int(crowded.sum())
    if not lost:
        return splats
    warn(f"{lost:,} points lie where {CROWD} others do: left out", stacklevel=4)
    arrays: list[Any] = [None if array is None else np.ascontiguousarray(array[~crowded]) for array in splats]
    return Splats(*arrays)
