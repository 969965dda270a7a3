"""Exact nearest neighbours of many points at once, based on a kd order that keeps neighbours together in memory.

order : kd order; sites : blocks of 16 points and their bounding boxes; search : blocks of queries against blocks of
points; rank : ranking of one query's candidates; single : a single query; tree : the Python interface;
few_queries : neighbours of a few points of a large cloud; distinct : equal positions; components : connected components
of a neighbour graph; rows : parallel gathering of array rows; cuts : parts of a cloud too large for memory

Begin with search.
"""

from __future__ import annotations

from .distinct import distinct
from .order import kd_order
from .rows import take
from .tree import NeighborTree, neighbor_chunks, neighbors

__all__ = ["NeighborTree", "distinct", "kd_order", "neighbor_chunks", "neighbors", "take"]
