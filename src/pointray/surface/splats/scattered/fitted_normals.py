"""Surface detection from normals: on a surface they follow its curvature, as arcs through pairs of points show."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ....base.arrays import Flags, Floats
from ..local_planes import off_arcs
from .rules import AROUND, COARSE, LINE_GAP, STRIP_SLIMNESS, Evidence, medians

# Heights off the arcs of surface points, over distances, are less than ARCS_OFF and less than ARCS times those off the
# planes; or the latter are less than FLAT.
ARCS_OFF, ARCS, FLAT = 0.3, 0.6, 0.17
IN_PLANE = 3  # of 8 neighbours in one plane with a point according to both normals: an edge
# Fitted normals are no evidence along a line, whose points lie on arcs for any normals. Lines are neighbourhoods of 16
# slimmer than LINE_SLIM, unless that of every 4th point is a surface's. Wires side by side are neighbourhoods of every
# 4th point that are slim and reach over WIRES_GAP times as far.
LINE_SLIM, WIRES_GAP = 0.2, 2.0


class Normals(NamedTuple):
    """Unit normals of n points, and whether they were fitted to the positions: weaker evidence of a surface.

    xyz : three of (n,) float32
    """

    xyz: tuple[Floats, ...]
    fitted: bool


def follow_normals(
    xyz: tuple[Floats, ...],
    normals: Normals,
    near: NDArray[np.int32],
    surface: Floats,
    evidence: Evidence,
    threads: int | None,
) -> None:
    """Mark points as surface, in place, where normals follow the curvature: arcs through neighbours fit the normals.

    xyz : x, y and z of n points
    near : (n, k) rows of each point and its neighbours
    surface : (n,) 1 for surface points, else 0; updated
    evidence : planes fitted to the neighbours at four scales; they show lines, along which fitted normals prove nothing
    """
    *heights, same = off_arcs(xyz, normals.xyz, near, (1, AROUND), threads)
    arc, plane = (medians(values, near, threads) for values in heights)
    follows = (plane < FLAT) | ((arc < ARCS_OFF) & (arc < ARCS * plane)) | (same >= IN_PLANE)
    if normals.fitted:
        follows &= _off_lines(near, evidence, threads)
    surface[follows] = 1


def _off_lines(near: NDArray[np.int32], evidence: Evidence, threads: int | None) -> Flags:
    """Return where a point's neighbours form neither a line nor wires side by side, (n,).

    near : (n, k) rows of each point and its neighbours
    evidence : planes fitted at four scales, with ratios of variances and distances of the farthest neighbours
    """
    slim, slimmer = (medians(values, near, threads) for values in evidence.slimnesses[1:3])
    wide, far = (medians(values, near, threads) for values in evidence.reaches[1:])
    wires = (far > WIRES_GAP * wide) & (slimmer < STRIP_SLIMNESS)
    lines_of_a_surface = (slimmer > COARSE.slimness) & (far < LINE_GAP * wide)
    return np.asarray(((slim >= LINE_SLIM) & ~wires) | lines_of_a_surface)
