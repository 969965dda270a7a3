"""Levels of detail: clouds of mean points over the cells of ever coarser grids.

`subsample` is no substitute: its splats are as wide as the shape allows, but colours need detail down to a pixel.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.arrays import Floats
from ...cloud.points import Points
from .averages import attribute_averages
from .groups import Groups, groups_in_cells

LEAST_POINTS = 700  # 200 points no longer show the statue's shape or shading: images are 9% brighter
LEAST_GAIN = 1.5  # least ratio of the numbers of points of successive levels
# Sheets are kept only if at least this share of a level's splats has an opposite sheet close by. Without them a plate
# thinner than 1.6 radii was invisible, as its sides cancel. For scans with a lower share, sheets bring images only 3 to
# 7% closer to those of all points and take 1.3 to 1.7 times as long; 1,000 statues take 2.2 times as long.
THIN = 0.5
# Least support, in cell edges. A few small supports shorten the rays' steps everywhere: frames took 1.4 to 1.7 times as
# long. Larger supports reduce flicker: 1,000 distant statues change by 0.63 (smallest covering supports), 0.50 (1.0),
# 0.48 (1.1), 0.46 (1.2) of the change with all points; but 10,000 take 163, 175, 188 ms with 1.0, 1.1, 1.2.
SUPPORT = 1.0


class Fine(NamedTuple):
    """Splats that are averaged to make a coarser level of detail.

    positions, normals : (n, 3) float32; radii : (n,) float32, support radii
    colors : (n, 3) uint8 or None; noise : (n,) float32 or None, standard deviation of the noise that was smoothed away
    """

    positions: Floats
    normals: Floats
    radii: Floats
    colors: NDArray[np.uint8] | None
    noise: Floats | None


class Coarse(NamedTuple):
    """Splats of a level of detail, each the mean of a group of finer ones; their radii are chosen later.

    positions, normals : (m, 3) float32; limits : (m,) float32, upper limits of their support radii
    colors : (m, 3) uint8 or None; noise : (m,) float32 or None, standard deviation of the noise that was smoothed away
    """

    positions: Floats
    normals: Floats
    limits: Floats
    colors: NDArray[np.uint8] | None
    noise: Floats | None


def coarsen(
    points: Points, radii: Floats, cell: float, noise: Floats | None = None
) -> tuple[Points, Floats, Floats | None]:
    """Make a coarser level of detail: average the points in each grid cell that face the same of six axis directions.

    Parameters
    ----------
    points : Points
        Finite, with unit normals.
    radii : (n,) float32
        Support radii of the points.
    cell : float
        Edge length of the cells.
    noise : (n,) float32, optional
        Standard deviation of the noise that was smoothed away at each point.

    Returns
    -------
    points : Points
        With the same origin, in the order of each group's first point. Colours are root mean squares, which is nearly
        the mean of linear light. Attributes are means of finite values, NaN where fewer than half are finite; of
        categories the most common value.
    limits : (m,) float32
        Upper limit of each point's support radius: the extent of its group's supports, at least the size of a cell.
    noise : (m,) float32 or None
        Mean noise of each group.
    """
    assert points.normals is not None
    groups = groups_in_cells(points.positions, points.normals, cell)
    found = means_of(groups, Fine(points.positions, points.normals, radii, points.colors, noise), cell)
    attributes = attribute_averages(points.attributes, groups.order, groups.starts[:-1])
    coarse = Points.about(points.origin, found.positions, found.normals, found.colors, attributes, points.georeference)
    return coarse, found.limits, found.noise


def means_of(groups: Groups, fine: Fine, cell: float) -> Coarse:
    """Average each group of splats: mean positions, normals and noise, root mean square colours, limits of radii.

    fine : the splats
    groups : their rows in groups that share a grid cell
    cell : edge length of the cells, the least limit of a radius
    """
    normals, colors = groups.mean(fine.normals), None
    if fine.colors is not None:
        colors = np.rint(np.sqrt(groups.mean(fine.colors.astype(np.float32) ** 2))).astype(np.uint8)
    middles = groups.mean(fine.positions).astype(np.float32)
    size = np.linalg.norm(normals, axis=1, keepdims=True)
    limits = np.maximum(groups.reach(fine.positions, fine.radii, middles), np.float32(SUPPORT * cell))
    return Coarse(
        middles,
        (normals / np.where(size > 0, size, 1.0)).astype(np.float32),  # stays 0 where no normal could be fitted
        limits,
        colors,
        None if fine.noise is None else groups.mean(fine.noise).astype(np.float32),
    )
