"""Orientation of normals: signs propagate within tiles, then between pieces by votes; groups are turned outward.

The kd order is cut into tiles, and the points of each tile are joined along its reliable edges (`pieces`). The pieces
vote on each other with all edges between them (`votes`) and are joined into groups (`joins`); each group is turned
outward as a whole (`outward`). A cloud that does not fit into memory takes the same steps part by part.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...base.arrays import Floats
from .joins import InMemoryVotes, join
from .outward import inward_groups
from .pieces import Signs, find_pieces
from .votes import cast_votes

NEAR = 11  # neighbours along which signs propagate, including the point itself: with 7, the dragon falls into 28 groups


def agree(positions: Floats, normals: Floats, near: NDArray[np.int32]) -> tuple[Signs, NDArray[np.int32]]:
    """Find signs with which the normals of neighbours face the same side, and connected groups of such points.

    Parameters
    ----------
    positions : (n, 3) float32
        In kd order.
    normals : (n, 3) float32, unit
    near : (n, k) int32
        Rows of the neighbours, the point itself first.

    Returns
    -------
    signs : (n,) int8
        1 or -1; the signs of a group may all be wrong.
    groups : (n,) int32
        Group of each point, numbered from 0; all its neighbours are in the same one.
    """
    all_rows = slice(0, len(positions))
    piece, sign, sizes = find_pieces(positions, normals, near, all_rows)
    group, turn = join(len(sizes), InMemoryVotes([cast_votes(positions, normals, near, all_rows, piece, sign)]))
    return sign * turn[piece], group[piece]


def orient(positions: Floats, normals: Floats, near: NDArray[np.int32]) -> Signs:
    """Return signs, (n,) of 1 or -1, with which normals agree and face outward, or up if there is no outside.

    positions, normals : (n, 3) in kd order; unit normals
    near : (n, k) rows of the neighbours, the point itself first
    """
    signs, groups = agree(positions, normals, near)
    signs[inward_groups(positions, normals, signs, groups)[groups]] *= -1
    return signs
