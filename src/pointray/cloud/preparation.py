"""Preparation of a model's points: finite rows, smoothed positions and unit normals, before radii are estimated."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..base.memory import check_memory, trim_heap
from ..base.progress import Progress, part_of
from ..base.warning_log import warn
from .denoising.smooth import Placed, place
from .kd_ordering import compute_kd_ordering
from .outliers import merge_for_model
from .points import FARTHEST, Points

PEAK = 350  # bytes per point at the peak, beyond the points themselves, for noisy points; clean ones take 100 to 190
MERGED = 0.15  # share of the progress after which second layers are merged
SMALL = 1 << 16  # points from which memory is checked: fewer take less than the kernels do
MEMORY_ADVICE = "use fewer points (--max-points, --every) or run `pointray prepare --tolerance` on a larger machine"


def finite_rows(points: Points) -> NDArray[np.int32]:
    """Return the rows with a finite position, (m,) int32; warn if some have none."""
    used = np.flatnonzero(points.finite).astype(np.int32)
    warn_of_left_out(len(points) - len(used), len(points))
    return used


def warn_of_left_out(lost: int, total: int) -> None:
    """Warn if some points of a cloud are left out because their positions are not finite.

    lost, total : number of points left out, and of all points
    """
    if lost:
        text = f"{lost:,} of {total:,} points have no finite position below {FARTHEST:g}: left out"
        warn(text, stacklevel=4)


def placed_for_model(points: Points, sigma: str | float, merge: bool, progress: Progress) -> Placed:
    """Prepare points for a model: merge second layers, repair or estimate unit normals, and smooth noise.

    points : finite
    sigma : standard deviation of the noise, in the points' unit; "auto": measured locally; 0: nothing is smoothed
    merge : whether second layers (misaligned scans of a surface) may be moved onto the surface; ignored if sigma is 0
    """
    merge, ordering = merge and sigma != 0.0, None
    if merge:
        ordering = compute_kd_ordering(points)
        merged = merge_for_model(points, part_of(progress, 0.0, MERGED), ordering)
        points, ordering = merged, ordering if merged is points else ordering.moved(merged)
    placed, message = place(points, sigma, part_of(progress, MERGED if merge else 0.0, 1.0), ordering)
    if message:
        warn(message, stacklevel=3)
    if len(points) > SMALL:
        trim_heap()
    if ordering is None:
        return placed
    apart = placed.noise is None and len(ordering.rows) == len(ordering.ids)
    return placed._replace(order=ordering.order(), apart=apart)


def check_model_memory(count: int) -> None:
    """Raise a ValueError if there is too little memory to make a model of `count` points; small clouds always pass."""
    if count < SMALL:
        return
    try:
        check_memory(PEAK * count, f"to make a model of {count:,} points")
    except ValueError as error:
        raise ValueError(f"{error}; {MEMORY_ADVICE}") from None
