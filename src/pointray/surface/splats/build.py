"""Splats with radii, borders and sheets from prepared points: the input of `build_tree`."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.arrays import Flags, Floats
from ...base.progress import Progress, report_progress
from ...base.warning_log import warn
from ...cloud.denoising.smooth import Placed
from ...cloud.neighbors import kd_order, take
from ..tree.build import Splats
from ..tree.settings import TreeSettings
from .levels import THIN
from .support import CROWD, find_support

SMALLEST, LARGEST = 1e-12, 1e12  # limits of a radius


class Sizes(NamedTuple):
    """Radii of n splats, or how to choose them.

    given : (n,) float32, support radii; None to choose them
    scale : factor for all radii
    within : lower limit, and (n,) float32 upper limits, of chosen radii; only for levels of detail
    others : (m, 3) float32, positions of the scattered points of the same cloud. They get no radii, but chosen discs
        beside them span narrower gaps
    """

    given: Floats | None = None
    scale: float = 1.0
    within: tuple[float, Floats] | None = None
    others: Floats | None = None

    def select(self, mask: Flags) -> Sizes:
        """Return the sizes of the points in a mask (n,)."""
        given = None if self.given is None else self.given[mask]
        within = None if self.within is None else (self.within[0], self.within[1][mask])
        return self._replace(given=given, within=within)


class SplatBuild(NamedTuple):
    """Splats in kd order, with the rows and radii of all points.

    splats : input of `build_tree`, without points that share their position with many others
    rows : (n,) int32, the caller's row of each point in kd order, including points without a splat
    radii : (n,) float32, support radii of these points
    tight : whether many radii are too small to cover the surface
    """

    splats: Splats
    rows: NDArray[np.int32]
    radii: Floats
    tight: bool


def make_splats(
    placed: Placed, rows: NDArray[np.int32], sizes: Sizes, settings: TreeSettings, progress: Progress | None = None
) -> SplatBuild:
    """Make splats of points: sort them in kd order and find their supports.

    Warns of isolated points, and of points that are left out because many others share their position.

    Parameters
    ----------
    placed : Placed
        Finite points.
    rows : (n,) int32
        The caller's row of each point.
    sizes : Sizes
        Radii, or how to choose them.
    settings : TreeSettings
        Kind of surface, and largest distance of hits beyond open borders; borders are found if that is finite.
    progress : callable, optional
    """
    automatic, level = settings.overhang < np.inf, sizes.within is not None
    report_progress(progress, 0.0)
    points, noise, order, apart = placed
    order = kd_order(points.positions) if order is None else order
    positions, normals = take(points.positions, order), take(np.asarray(points.normals), order)
    colors, noise = (None if array is None else take(array, order) for array in (points.colors, noise))
    rows, given = take(rows, order), None if sizes.given is None else take(sizes.given, order)
    within = None if sizes.within is None else (sizes.within[0], take(sizes.within[1], order))
    del placed, points, order  # frees their memory, unless the caller holds references
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
    if noise is not None:  # bumps cannot be higher than a support radius, whatever noise the caller passed
        noise = np.minimum(noise, support.radii)
    splats = Splats(positions, normals, support.radii, rows, colors, support.borders, sheets, noise)
    return SplatBuild(_not_crowded(splats, support.crowded), rows, support.radii, support.tight)


def check_size(radii: Floats, scale: str = "radius_scale") -> None:
    """Raise ValueError unless squares of radii and their inverses fit into float32.

    scale : name of the parameter that scaled them, for the message
    """
    if radii.min() < SMALLEST or radii.max() > LARGEST:
        raise ValueError(
            f"radii range from {radii.min():.3g} to {radii.max():.3g} with {scale} applied: "
            f"expected {SMALLEST:g} to {LARGEST:g}"
        )


def _not_crowded(splats: Splats, crowded: Flags) -> Splats:
    """Remove the splats in the mask `crowded`, which share their position with many others, with a warning."""
    lost = int(crowded.sum())
    if not lost:
        return splats
    warn(f"{lost:,} points left out: {CROWD} others have the same position", stacklevel=4)
    arrays: list[Any] = [None if array is None else np.ascontiguousarray(array[~crowded]) for array in splats]
    return Splats(*arrays)
