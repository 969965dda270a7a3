"""Vertices of binary PLY files, in chunks."""

from __future__ import annotations

import io
from collections.abc import Iterator
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray
from plyfile import PlyListProperty

from .._counts import missing
from .._source import CHUNK, Faults
from ._header import Header, bytes_left, check_size, has_lists, least_size

ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">"}
CHUNK_BYTES = 1 << 25  # maximum bytes of a chunk: a splat has 248

Columns = dict[str, NDArray[Any]]


def read_binary(file: BinaryIO, header: Header, index: int, most: int, faults: Faults) -> Iterator[Columns]:
    """Yield the columns of the vertices in chunks. most : maximum number of rows in the file"""
    order = ORDERS[header.format]
    for element, count in zip(header.elements[:index], header.counts[:index], strict=True):
        skip(file, element, count, order)
    vertex, count = header.elements[index], header.counts[index]
    if has_lists(vertex):
        yield _read_beside_lists(file, vertex, count, order, faults)
        return
    dtype = np.dtype([(p.name, p.dtype(order)) for p in vertex.properties])
    count = max(check_size(file, vertex, count, dtype.itemsize, faults), most if most > count else 0)
    step = max(min(CHUNK, CHUNK_BYTES // dtype.itemsize), 1)
    for start in range(0, count, step):
        rows = np.fromfile(file, dtype, min(step, count - start))
        if len(rows) < min(step, count - start):
            raise ValueError(f"is cut off at vertex {start + len(rows):,} of {count:,}")
        yield {name: rows[name] for name in dtype.names or ()}


def skip(file: BinaryIO, element: Any, count: int, order: str) -> None:
    """Skip an element before the vertices."""
    row = sum(least_size(p) for p in element.properties)
    check_size(file, element, count, row)
    if not has_lists(element):
        file.seek(count * row, io.SEEK_CUR)
    elif count:
        from ._lists import walk_rows

        file.seek(walk_rows(*_bytes_from(file), count, element, order, np.empty((0, 0), np.int64))[0])


def _read_beside_lists(file: BinaryIO, vertex: Any, count: int, order: str, faults: Faults) -> Columns:
    """Read vertices with lists, and drop the lists."""
    from ._lists import scalars_at, walk_rows

    least = sum(least_size(p) for p in vertex.properties)
    if faults.strict:
        check_size(file, vertex, count, least)
    scalars = [p for p in vertex.properties if not isinstance(p, PlyListProperty)]
    most = min(count, bytes_left(file) // least)
    (data, start), offsets = _bytes_from(file), np.empty((most, len(scalars)), np.int64)
    _, rows = walk_rows(data, start, most, vertex, order, offsets, partial=True)
    if rows < count:
        faults.add(f"is cut off in the element {vertex.name!r}, row {rows:,} of {count:,}: {missing(count, rows)}")
    offsets = offsets[:rows]
    return {p.name: scalars_at(data, offsets[:, k], np.dtype(p.dtype(order))) for k, p in enumerate(scalars)}


def _bytes_from(file: BinaryIO) -> tuple[NDArray[np.uint8], int]:
    """Return the whole file, memory-mapped, and the current position in it."""
    here = file.tell()
    return np.asarray(np.memmap(file, np.uint8, "r")), here
