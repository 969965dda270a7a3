"""Nearest neighbours: exact, of all points at once, along a kd order that keeps neighbours together in memory.

order : the kd order; sites : blocks of 16 points and boxes around them; search : blocks of queries against blocks of
points; rank : what one of these queries finds; single : one query alone; tree : all of it for Python;
distinct : equal positions; rows : rows of arrays in another order; cuts : the parts of a cloud too large for memory

Begin with search.
"""

from __future__ import annotations

from .distinct import distinct
from .order import kd_order
from .rows import take
from .tree import NeighborTree, neighbor_chunks, neighbors

__all__ = ["NeighborTree", "distinct", "kd_order", "neighbor_chunks", "neighbors", "take"]
