"""Normals tell a surface: on one they turn with it, as the arc through two points at right angles to both shows."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..local_planes import off_arcs
from .rules import AROUND, COARSE, LINE_GAP, STRIP_SLIMNESS, Evidence, medians

Floats = NDArray[np.float32]

# On a surface heights off the arcs are less than the first share of the distances, and less than the second share of
# those off the planes; or the latter are less than the third share.
ARCS_OFF, ARCS, FLAT = 0.3, 0.6, 0.17
IN_PLANE = 3  # of 8 neighbours that lie in one plane with a point by both normals: an edge
# Fitted normals are no evidence along a line, which lies on arcs whatever they are: where the wide neighbourhood is
# slimmer than the first, unless that of every 4th point is a surface's, or where the latter is slim and reaches over
# the third number times as far.
LINE_SLIM, WIRES_GAP = 0.2, 2.0


class Normals(NamedTuple):
    """Unit normals, and whether they were fitted to the positions."""

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
    """Mark points as surface, in place, where the normals turn as those of a curved surface do."""
    *heights, same = off_arcs(xyz, normals.xyz, near, (1, AROUND), threads)
    arc, plane = (medians(values, near, threads) for values in heights)
    follows = (plane < FLAT) | ((arc < ARCS_OFF) & (arc < ARCS * plane)) | (same >= IN_PLANE)
    if normals.fitted:
        follows &= _off_lines(near, evidence, threads)
    surface[follows] = 1


def _off_lines(near: NDArray[np.int32], evidence: Evidence, threads: int | None) -> NDArray[np.bool_]:
    """Return where the neighbourhoods are no lines, and no wires side by side."""
    slim, slimmer = (medians(values, near, threads) for values in evidence.slimnesses[1:3])
    wide, far = (medians(values, near, threads) for values in evidence.reaches[1:])
    wires = (far > WIRES_GAP * wide) & (slimmer < STRIP_SLIMNESS)
    lines_of_a_surface = (slimmer > COARSE.slimness) & (far < LINE_GAP * wide)
    return np.asarray(((slim >= LINE_SLIM) & ~wires) | lines_of_a_surface)
