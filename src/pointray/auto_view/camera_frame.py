"""Detection of depth camera frames: all points lie in front of a camera at the origin, each in another direction.

The camera looks along +z with y down, or along -z with y up. Normals are not needed.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..base.arrays import Doubles, Rows

STRAY = 0.002  # share of the points that may lie outside the frame
SIGHT = 1.2  # largest tangent of half the field of view
PLACES = 250  # pixels whose neighbours are examined
FEWEST = 50  # points of a frame
JUMPS = 0.2, 0.4  # largest share of neighbouring pixels with a depth jump: in general, and on a regular pixel grid
STEEP, QUANTUM = 12.0, 0.02  # jump: more than this depth per image distance plus this share of the depth
EVEN = 0.62  # distance to the nearest pixel over that to the fourth: 0.7 to 1 on a grid, below 0.5 at random
BESIDE = 0.2  # largest offset of the frame's centre from the optical axis, as a share of its half size
WIDE, ASPECT = 0.25, (1.0, 2.2)  # smallest tangent of half the field of view; range of aspect ratios
THINNED = 0.6  # certainty of a frame without a regular pixel grid


class Frame(NamedTuple):
    """A detected frame of a depth camera: points that one camera at the origin sees, facing along +z or -z.

    Attributes
    ----------
    up : str
        Axis that is up in its image: "-y" if it looks along +z, "y" if along -z.
    certainty : float
        From 0 to 1; 1 for a regular grid of pixels.
    """

    up: str
    certainty: float


def find_camera_frame(positions: Doubles) -> Frame | None:
    """Return the frame of a depth camera at the origin that the points form; None if they form none.

    Its image must contain nearly all points, without depth jumps between most neighbours. It indicates the up axis.

    positions : (n, 3), world
    """
    x, y, z = positions.T
    ahead = 1.0 if np.median(z) > 0 else -1.0
    depth = ahead * z
    within = (depth > 0) & (np.maximum(np.abs(x), np.abs(y)) < SIGHT * depth)
    if within.mean() < 1 - STRAY or len(depth) < FEWEST:
        return None
    depth = depth[within]
    pixels = np.stack([x[within], y[within]], axis=1) / depth[:, None]
    rows = np.linspace(0, len(depth) - 1, min(PLACES, len(depth))).astype(int)
    apart, near = _nearest_pixels(pixels, rows)
    jumps = np.abs(depth[rows] - depth[near]) / depth[rows] > STEEP * apart[:, 0] + QUANTUM
    is_even = bool(np.median(apart[:, 0] / np.maximum(apart[:, 3], 1e-300)) > EVEN)
    if jumps.mean() > JUMPS[is_even] or not (is_even or _fills_picture(pixels)):
        return None
    return Frame("-y" if ahead > 0 else "y", 1.0 if is_even else THINNED)


def _fills_picture(pixels: Doubles) -> bool:
    """Return whether image positions, (n, 2), fill a centred rectangle with the aspect ratio of a camera."""
    low, high = np.quantile(pixels, [STRAY, 1 - STRAY], axis=0)
    half, middle = (high - low) / 2, (high + low) / 2
    is_centred = bool((np.abs(middle) <= BESIDE * half).all())
    return is_centred and half.min() > WIDE and ASPECT[0] <= half[0] / half[1] <= ASPECT[1]


def _nearest_pixels(pixels: Doubles, rows: Rows) -> tuple[Doubles, Rows]:
    """Return the distances of pixels to their four nearest neighbours, (m, 4), and the index of the nearest, (m,).

    pixels : (n, 2), image positions of points; rows : (m,), indices of the pixels whose neighbours are sought
    """
    order = np.argsort(pixels[:, 0])
    reach = min(int(4.0 * np.sqrt(len(pixels))), len(pixels) // 2)
    middle = np.searchsorted(pixels[order, 0], pixels[rows, 0])
    first = np.clip(middle - reach, 0, len(pixels) - 2 * reach)
    near = order[first[:, None] + np.arange(2 * reach)]
    squared = np.square(pixels[near, 0] - pixels[rows, None, 0]) + np.square(pixels[near, 1] - pixels[rows, None, 1])
    squared[near == rows[:, None]] = np.inf
    four = np.argpartition(squared, 4, axis=1)[:, :4]
    distances = np.sqrt(np.take_along_axis(squared, four, axis=1))
    best = np.take_along_axis(four, distances.argmin(axis=1)[:, None], axis=1)
    return np.sort(distances, axis=1), np.take_along_axis(near, best, axis=1)[:, 0]
