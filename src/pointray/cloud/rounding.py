"""Detection of rounded coordinates: points on steps that are coarse for their spacing have lost their surface.

Steps are searched per axis among round decimal numbers and powers of two, as used by people and floats. Steps alone
prove little: rasters and voxels lie on steps as wide as their spacing. Points count as rounded if they have

- one axis, or all, on exactly the step of float32 at these coordinates, or
- two or three axes on coarse steps, and in addition several points at the same position or points farther apart than a
  step: in a raster each position has one point, and the next one is one step away.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..base.arrays import Doubles, Floats
from .neighbors.few_queries import Neighborhoods, find_neighborhoods
from .points import Points

COARSE = 0.25  # spacings: smaller steps are hardly visible
SAMPLE = 5_000  # rows whose coordinates are examined
LEVELS = 8  # distinct coordinates required on an axis: the two sides of a box lie on steps too
ON_STEPS = 0.99  # share of the rows
EXACT = 0.02  # tolerance of a coordinate, in steps
AREAS, AREA = 500, 64  # neighbourhoods from which the spacing is estimated, and their points
LEAST = 1_000  # rows: smaller clouds are not tested
ALIKE = 0.15  # share of rows that coincide with another row: a cube's faces with 2,600 points have 9%
APART = 1.1  # steps between neighbours: a raster has 1, random points less than this for steps from 0.6 spacings on


def find_rounding(points: Points) -> tuple[tuple[float, float, float], str | None]:
    """Find the steps that coordinates were rounded to, where these are coarse for the point spacing.

    Parameters
    ----------
    points : Points

    Returns
    -------
    steps : tuple of three floats
        Steps of x, y and z, in the points' unit; 0 if not rounded, or too finely to be visible.
    message : str or None
        One line that describes the rounding; None if no step is coarse.
    """
    none = (0.0, 0.0, 0.0)
    finite = points.finite
    positions = points.positions if finite.all() else points.positions[finite]
    if len(positions) < LEAST:
        return none, None
    chosen = np.random.default_rng(0).choice(len(positions), min(SAMPLE, len(positions)), replace=False, shuffle=False)
    sample = positions[chosen]
    exact = 2 * np.spacing(np.abs(sample).max(axis=0)).astype(np.float64)
    world = sample + points.origin
    steps = [_step(world[:, axis], exact[axis]) for axis in range(3)]
    if not any(steps):
        return none, None
    near = find_neighborhoods(positions, AREAS, AREA)
    spacing = _mean_spacing(near)
    coarse = [axis for axis in range(3) if steps[axis] > COARSE * spacing > 0]
    largest = np.abs(world).max(axis=0)
    single = [axis for axis in coarse if steps[axis] == float(np.spacing(np.float32(largest[axis])))]
    if len(coarse) > 1 and len(single) < 3 and not _is_no_raster(positions, near, coarse, steps):
        return none, None
    rounded = coarse if len(coarse) > 1 else single
    if not rounded:
        return none, None
    x, y, z = (steps[axis] if axis in rounded else 0.0 for axis in range(3))
    return (x, y, z), _message((x, y, z), largest, bool(single), spacing)


def _message(steps: Sequence[float], largest: Doubles, single: bool, spacing: float) -> str:
    """Return a message with the coarsest step, its cause and a remedy.

    steps : of x, y and z, 0 if not rounded
    largest : (3,) largest absolute coordinate of each axis
    single : whether the step is that of float32 at these coordinates
    spacing : mean point spacing
    """
    axis = int(np.argmax(steps))
    named = [name for name, step in zip("xyz", steps, strict=True) if step]
    where = "" if len(named) == 3 else f" in {' and '.join(named)}"
    cause = f" (float32 at {largest[axis]:.2g})".replace("e+0", "e") if single else ""
    cure = "export with double precision or a local origin" if single else "export with more decimals"
    return (
        f"coordinates are rounded to steps of {steps[axis]:g}{where}{cause}, {steps[axis] / spacing:.2g} times "
        f"the mean point spacing: finer detail is lost; {cure}"
    )


def _step(values: Doubles, exact: float) -> float:
    """Return the largest step on which nearly all coordinates lie, counted from one of them; 0 if there is none.

    values : (m,) coordinates along one axis
    exact : rounding error of the stored coordinates, which limits how fine a step can be recognised
    """
    values = values - np.median(values)
    values -= values[np.abs(values).argmin()]
    extent = float(np.abs(values).max())
    for step in _candidates(exact / EXACT, extent):
        levels = np.rint(values / step)
        fits = np.abs(values - levels * step) <= EXACT * step
        if fits.mean() >= ON_STEPS:
            whole = levels[fits].astype(np.int64)
            times = int(np.gcd.reduce(whole))
            return step * times if len(np.unique(whole)) >= LEVELS else 0.0
    return 0.0


def _candidates(low: float, high: float) -> list[float]:
    """Return the steps that people and floats use, powers of two and 1, 2, 2.5, 5 times powers of ten, descending.

    low, high : least and greatest step
    """
    if not 0 < low < high:
        return []
    twos = [2.0**e for e in range(int(np.floor(np.log2(low))), int(np.ceil(np.log2(high))) + 1)]
    tens = range(int(np.floor(np.log10(low))), int(np.ceil(np.log10(high))) + 1)
    decimals = [float(f"{digit}e{e}") for e in tens for digit in (1, 2, 2.5, 5)]
    return sorted({step for step in (*twos, *decimals) if low <= step <= high}, reverse=True)


def _mean_spacing(near: Neighborhoods) -> float:
    """Return the mean point spacing: the square root of the area per row, counting rows with equal positions.

    near : neighbourhoods of some points of the cloud
    """
    return float(np.median(near.farthest * np.sqrt(np.pi / near.shared.sum(axis=1))))


def _is_no_raster(positions: Floats, near: Neighborhoods, axes: Sequence[int], steps: Sequence[float]) -> bool:
    """Return whether points on coarse steps were rounded to them, rather than measured in a raster of that width.

    In a raster each position has one point, and the next is one step away. True if many rows share a position on the
    coarse axes, or neighbours are on average more than a step apart.

    near : neighbourhoods of some points
    axes, steps : the coarse axes, and the steps of x, y and z
    """
    offsets = positions[near.rows][:, :, axes].astype(np.float64) - positions[near.rows[:, :1]][:, :, axes]
    levels = np.rint(offsets / [steps[axis] for axis in axes]).astype(np.int64)
    different = sum(len(np.unique(rows, axis=0)) for rows in levels)
    apart = np.sqrt((levels**2).sum(axis=2).astype(np.float64))
    apart[apart == 0] = np.inf
    return bool(different < (1 - ALIKE) * near.shared.sum() or np.mean(apart.min(axis=1)) > APART)
