"""PLY files: ascii and binary, every order of properties.

plyfile reads no rows, for two reasons: it reads faces and ascii row by row in Python (the dragon's mesh: 1.7 s, here
0.01 s), and it believes the header's count, so that a damaged file asks for terabytes.
"""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray
from plyfile import PlyListProperty

from ....survey import Survey
from .._source import CHUNK, NO, SURE, Chunk, Format, Listing, Request, Source
from ._ascii import read_ascii
from ._header import Header, check_size, has_lists, read_header
from ._names import COLORS, NORMALS
from ._write import write

ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">"}
SHORT = 64  # bytes of a row of which columns may be views, which keep it
CHUNK_BYTES = 1 << 25  # bytes of a chunk's rows at most: a splat has 248

Columns = dict[str, NDArray[Any]]


def recognise(head: bytes, path: Path) -> int:
    """Whether a file is a PLY file."""
    return SURE if re.match(rb"ply[ \t]*[\r\n]", head) else NO


class PlySource(Source):
    """The vertices of a PLY file; ValueError says what is wrong with its contents."""

    def __init__(self, path: Path, request: Request) -> None:
        self._path = path
        with path.open("rb") as file:
            self._header = header = read_header(file)
            found = [i for i, element in enumerate(header.elements) if element.name == "vertex"]
            if not found:
                names = ", ".join(element.name for element in header.elements)
                raise ValueError(f"has no element 'vertex', only: {names or 'nothing'}")
            self._index = found[0]
            self._vertex, count = header.elements[self._index], header.counts[self._index]
            _check_vertex(self._vertex, count)
            least = sum(_least_size(p) for p in self._vertex.properties)
            if header.format == "ascii":
                least = 2 * len(self._vertex.properties) - 1  # a digit and a space, but for the file's last
            file.seek(header.size)
            check_size(file, self._vertex, count, least)
        self._scalars = [p for p in self._vertex.properties if not isinstance(p, PlyListProperty)]
        self._types = {p.name: np.dtype(p.dtype()) for p in self._scalars}
        row = 36 + sum(np.dtype(p.dtype()).itemsize for p in self._scalars)
        crs = next((text[4:].strip() for text in header.comments if text.startswith("crs ")), None)
        facts = {
            "encoding": header.format,
            "comments": [text for text in header.comments if not text.startswith("crs ")],
        }
        self.listing = Listing(count, row, survey=Survey(crs or None), facts=facts)

    def chunks(self) -> Iterator[Chunk]:
        for columns, share in self._columns():
            yield self._to_chunk(columns, share)

    def _to_chunk(self, columns: Columns, share: float) -> Chunk:
        return _to_chunk(columns, self._types, share)

    def _columns(self) -> Iterator[tuple[Columns, float]]:
        """The columns of some vertices after those of others, and the share that has been read."""
        header = self._header
        rows = read_ascii if header.format == "ascii" else _read_binary
        done, count = 0, header.counts[self._index]
        with self._path.open("rb") as file, warnings.catch_warnings():
            warnings.simplefilter("ignore")  # loadtxt warns of no rows and of empty lists
            file.seek(header.size)
            for columns in rows(file, header, self._index):
                done += len(columns["x"])
                yield columns, done / count


def _check_vertex(vertex: Any, count: int) -> None:
    names = [p.name for p in vertex.properties if not isinstance(p, PlyListProperty)]
    if not {"x", "y", "z"} <= set(names):
        raise ValueError(f"its vertices have no properties x, y, z, only: {', '.join(names) or 'none'}")
    if count == 0:
        raise ValueError("holds no points: the header announces 0 vertices")


# ------------------------------------------------------------------------------------------------------ binary


def _read_binary(file: BinaryIO, header: Header, index: int) -> Iterator[Columns]:
    order = ORDERS[header.format]
    for element, count in zip(header.elements[:index], header.counts[:index], strict=True):
        _skip(file, element, count, order)
    vertex, count = header.elements[index], header.counts[index]
    if has_lists(vertex):
        yield _read_beside_lists(file, vertex, count, order)
        return
    dtype = np.dtype([(p.name, p.dtype(order)) for p in vertex.properties])
    check_size(file, vertex, count, dtype.itemsize)
    step = max(min(CHUNK, CHUNK_BYTES // dtype.itemsize), 1)
    for start in range(0, count, step):
        rows = np.fromfile(file, dtype, min(step, count - start))
        if len(rows) < min(step, count - start):
            raise ValueError(f"is cut off at vertex {start + len(rows):,} of {count:,}")
        yield {name: rows[name] for name in dtype.names or ()}


def _skip(file: BinaryIO, element: Any, count: int, order: str) -> None:
    """Skip an element that comes before the vertices."""
    row = sum(_least_size(p) for p in element.properties)
    check_size(file, element, count, row)
    if not has_lists(element):
        file.seek(count * row, io.SEEK_CUR)
    elif count:
        from ._lists import walk_rows

        file.seek(walk_rows(*_bytes_from(file), count, element, order, np.empty((0, 0), np.int64)))


def _read_beside_lists(file: BinaryIO, vertex: Any, count: int, order: str) -> Columns:
    """Vertices with lists, which are dropped."""
    from ._lists import scalars_at, walk_rows

    check_size(file, vertex, count, sum(_least_size(p) for p in vertex.properties))
    scalars = [p for p in vertex.properties if not isinstance(p, PlyListProperty)]
    (data, start), offsets = _bytes_from(file), np.empty((count, len(scalars)), np.int64)
    walk_rows(data, start, count, vertex, order, offsets)
    return {p.name: scalars_at(data, offsets[:, k], np.dtype(p.dtype(order))) for k, p in enumerate(scalars)}


def _bytes_from(file: BinaryIO) -> tuple[NDArray[np.uint8], int]:
    """The whole file, memory-mapped, and the current position in it."""
    here = file.tell()
    return np.asarray(np.memmap(file, np.uint8, "r")), here


def _least_size(p: Any) -> int:
    return int(np.dtype(p.list_dtype()[0] if isinstance(p, PlyListProperty) else p.dtype()).itemsize)


# ------------------------------------------------------------------------------------------------ to Points and back


def _to_chunk(columns: Columns, types: dict[str, np.dtype[Any]], share: float) -> Chunk:
    positions = _stack([columns.pop(name) for name in "xyz"])
    normals = next((names for names in NORMALS if columns.keys() >= set(names)), ())
    colors = next((names for names in COLORS if columns.keys() >= set(names)), ())
    stacked = [
        _stack([_typed(columns.pop(n), types[n]) for n in names]) if names else None for names in (normals, colors)
    ]
    attributes = {name: np.array(_typed(column, types[name])) for name, column in columns.items()}
    return Chunk(positions, stacked[0], stacked[1], attributes, share)


def _typed(column: NDArray[Any], stored: np.dtype[Any]) -> NDArray[Any]:
    """Numbers of an ascii file as what the header says they are; those that do not fit stay floats."""
    if column.dtype.kind != "f" or stored.kind == "f":
        return column.astype(stored, copy=False)
    limits = np.iinfo(stored)
    whole = np.isfinite(column).all() and (column == np.rint(column)).all()
    fits = whole and column.min() >= limits.min and column.max() <= limits.max
    return column.astype(stored) if fits else column


def _stack(columns: Sequence[NDArray[Any]]) -> NDArray[Any]:
    """Columns side by side: a view where they lie so in the file's rows, so that these are copied only once more."""
    first = columns[0]
    places = [column.ctypes.data - first.ctypes.data for column in columns]
    alike = all(column.dtype == first.dtype and column.strides == first.strides for column in columns)
    if (
        alike
        and first.strides[0] <= SHORT
        and first.dtype.isnative
        and places == [k * first.itemsize for k in range(len(columns))]
    ):
        return as_strided(first, (len(first), len(columns)), (first.strides[0], first.itemsize))
    return np.stack(columns, axis=1).astype(np.result_type(*(c.dtype.newbyteorder("=") for c in columns)), copy=False)


def _open(path: Path, request: Request) -> Source:
    """The vertices, or points on the triangles if these are asked for."""
    if request.sample is None:
        return PlySource(path, request)
    from ..mesh.mesh import on_triangles

    return on_triangles(path, request)


FORMAT = Format(
    "PLY",
    (".ply",),
    recognise,
    _open,
    {
        "positions": "x, y, z of the vertices",
        "normals": "nx, ny, nz or normal_x, normal_y, normal_z",
        "colors": "red, green, blue, or r, g, b, or diffuse_red, diffuse_green, diffuse_blue",
        "attributes": "all other properties but lists, with their types",
        "survey": "the coordinate system, as a comment that begins with crs",
    },
    write=write,
)
