"""Vertices of binary PLY files, in chunks."""

from __future__ import annotations

import io
from collections.abc import Iterator
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from .._counts import missing
from .._source import CHUNK, Faults
from ._header import Element, Header, Order, bytes_left, check_size

ORDERS: dict[str, Order] = {"binary_little_endian": "<", "binary_big_endian": ">"}
CHUNK_BYTES = 1 << 25  # maximum bytes of a chunk: a splat has 248

Columns = dict[str, NDArray[Any]]


def read_binary(file: BinaryIO, header: Header, index: int, most: int, faults: Faults) -> Iterator[Columns]:
    """Yield the columns of the vertices by name, in chunks of rows; missing vertices are recorded in `faults`.

    index : number of the element with vertices
    most : upper limit for the number of vertices to read, which may exceed the announced one
    """
    order = ORDERS[header.format]
    for element in header.elements[:index]:
        skip(file, element, order)
    vertex = header.elements[index]
    if vertex.has_lists:
        yield _read_beside_lists(file, vertex, order, faults)
        return
    dtype = vertex.dtype(order)
    count = max(check_size(file, vertex, dtype.itemsize, faults), most if most > vertex.rows else 0)
    step = max(min(CHUNK, CHUNK_BYTES // dtype.itemsize), 1)
    for start in range(0, count, step):
        rows = np.fromfile(file, dtype, min(step, count - start))
        if len(rows) < min(step, count - start):
            raise ValueError(f"is cut off at vertex {start + len(rows):,} of {count:,}")
        yield {name: rows[name] for name in dtype.names or ()}


def skip(file: BinaryIO, element: Element, order: Order) -> None:
    """Move a file past an element, which precedes the vertices; raise ValueError if it is cut off.

    order : byte order, "<" or ">"
    """
    check_size(file, element, element.least_size)
    if not element.has_lists:
        file.seek(element.rows * element.least_size, io.SEEK_CUR)
    elif element.rows:
        from ._lists import walk_rows

        file.seek(walk_rows(*_bytes_from(file), element.rows, element, order, np.empty((0, 0), np.int64))[0])


def _read_beside_lists(file: BinaryIO, vertex: Element, order: Order, faults: Faults) -> Columns:
    """Read the scalar columns of vertices that also have lists; the lists are skipped.

    order : byte order, "<" or ">"; faults : records missing rows
    """
    from ._lists import scalars_at, walk_rows

    if faults.strict:
        check_size(file, vertex, vertex.least_size)
    count, types = vertex.rows, vertex.dtype(order)
    most = min(count, bytes_left(file) // vertex.least_size)
    (data, start), offsets = _bytes_from(file), np.empty((most, len(vertex.scalars)), np.int64)
    _, rows = walk_rows(data, start, most, vertex, order, offsets, partial=True)
    if rows < count:
        faults.add(f"is cut off in the element {vertex.name!r}, row {rows:,} of {count:,}: {missing(count, rows)}")
    offsets = offsets[:rows]
    return {name: scalars_at(data, offsets[:, k], types[name]) for k, name in enumerate(types.names or ())}


def _bytes_from(file: BinaryIO) -> tuple[NDArray[np.uint8], int]:
    """Return the whole file, memory-mapped, and the current position in it."""
    here = file.tell()
    return np.asarray(np.memmap(file, np.uint8, "r")), here
