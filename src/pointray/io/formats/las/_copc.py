"""COPC: a LAZ file whose chunks are the nodes of an octree, coarse ones first. Only requested nodes are read.

laspy's `CopcReader` reads all nodes it finds at once, and does not terminate on pages that refer to each other.
Therefore pages are read here; tests compare the results.
"""

from __future__ import annotations

import math
import struct
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ....base.arrays import Doubles, Flags
from ...remote.range_reader import announce
from .._source import Faults, Request
from ._header import Header
from ._laz import Part, check_total

ENTRY = np.dtype([("key", "<i4", 4), ("start", "<u8"), ("size", "<i4"), ("rows", "<i4")])
DEEPEST = 31  # maximum level: node coordinates are int32


class Copc(NamedTuple):
    """Contents of the record that describes the octree of a COPC file.

    Attributes
    ----------
    low : (3,) float64
        Minimum corner of the root node, a cube.
    side, spacing : float
        Edge length of the root node and the spacing of its points; both are halved at each level of the octree.
    start, size : int
        Offset and size in bytes of the first page of the list of nodes; it refers to further pages.
    """

    low: Doubles
    side: float
    spacing: float
    start: int
    size: int


def copc_of(header: Header) -> Copc | None:
    """Return the octree that the COPC record of a file describes; None if the file has no such record."""
    data = header.data_of("copc", 1)
    if data is None or len(data) < 72 or not header.compressed:
        return None
    x, y, z, half, spacing, start, size = struct.unpack_from("<5d2Q", data)
    return Copc(np.array([x, y, z]) - half, 2 * half, spacing, start, size)


def is_copc(head: bytes) -> bool:
    """Return whether a file is COPC, whose first record is that of the octree. head : first bytes of the file"""
    return head.startswith(b"LASF") and head[377:393].rstrip(b"\0") == b"copc" and head[393:395] == b"\1\0"


def nodes_of(file: BinaryIO, header: Header, copc: Copc, request: Request, size: int, faults: Faults) -> list[Part]:
    """Return the octree nodes with points that a request needs, as chunks of compressed rows in the file's order.

    Raise ValueError if the octree is damaged.

    size : of the file in bytes; faults : records a wrong number of points
    """
    if not (np.isfinite(copc.low).all() and 0 < copc.side < math.inf and 0 < copc.spacing < math.inf):
        raise ValueError("is damaged: invalid size or spacing of the octree")
    pages, seen, left = [(copc.start, copc.size)], set(), size
    found: list[NDArray[Any]] = []
    while pages:
        announce(file, [(first, first + bytes) for first, bytes in pages], keep=True)
        start, length = pages.pop()
        left -= length  # overlapping pages could loop forever
        if start in seen or left < 0 or not 0 < length <= size - start or length % ENTRY.itemsize:
            raise ValueError(f"is damaged: a page of its octree, {length:,} bytes at byte {start:,}, is invalid")
        seen.add(start)
        file.seek(start)
        page = np.frombuffer(file.read(length), ENTRY)
        page = page[_wanted(page["key"], header, copc, request)]
        more = page["rows"] == -1
        pages += [(int(entry["start"]), int(entry["size"])) for entry in page[more]]
        found.append(page[(page["rows"] != 0) & ~more])
    nodes = np.concatenate(found)
    nodes = nodes[np.argsort(nodes["start"], kind="stable")]
    _check_nodes(nodes, header)
    check_total(header, max(int(nodes["rows"].sum(dtype=np.int64)), header.total), faults)
    return [Part(int(n["start"]), int(n["size"]), int(n["rows"])) for n in nodes]


def _check_nodes(nodes: NDArray[Any], header: Header) -> None:
    ends = nodes["start"] + nodes["size"].astype(np.uint64)
    good = (nodes["rows"] > 0) & (nodes["size"] >= header.row) & (nodes["start"] >= header.start + 8)
    good &= (nodes["start"] < header.end) & (ends <= header.end)
    good[1:] &= nodes["start"][1:] >= ends[:-1]
    if not good.all():
        node = nodes[np.flatnonzero(~good)[0]]
        raise ValueError(
            f"is damaged: a node of its octree, {node['rows']:,} rows in {node['size']:,} bytes "
            f"at byte {node['start']:,}, is invalid"
        )


def _wanted(keys: NDArray[np.int32], header: Header, copc: Copc, request: Request) -> Flags:
    """Return which octree nodes a request needs, (n,): those in its bounds, down to the level of its resolution.

    keys : (n, 4), level and x, y, z of each node
    """
    level = keys[:, 0]
    if ((level < 0) | (level > DEEPEST) | (keys[:, 1:] < 0).any(axis=1)).any():
        raise ValueError("is damaged: a node lies outside the octree")
    wanted = level < levels_for(copc, request.resolution)
    if request.bounds is not None:
        side = copc.side / 2.0**level
        low = copc.low + keys[:, 1:] * side[:, None]
        slack = np.array(header.scale)  # a point on the boundary of two nodes may be in either
        inside = (low - slack <= request.bounds[1]) & (low + side[:, None] + slack >= request.bounds[0])
        wanted &= inside.all(axis=1)
    return np.asarray(wanted)


def levels_for(copc: Copc, resolution: float | None) -> int:
    """Return the number of octree levels to read: the last one is the first that is as fine as `resolution`.

    resolution : coarsest acceptable point spacing; None: all levels
    """
    if resolution is None:
        return DEEPEST + 1
    ratio = copc.spacing / resolution
    return max(1, math.ceil(math.log2(ratio)) + 1) if 0 < ratio < math.inf else DEEPEST + 1
