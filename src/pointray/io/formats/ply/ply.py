"""PLY files: ascii and binary, with properties in any order."""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray

from ....base.arrays import Doubles
from ....cloud.georeference import Georeference
from .._counts import count_lines, rows_after
from .._packed_colors import PackedColors, find_packed
from .._source import NO, SURE, Chunk, Faults, Format, Listing, Request, Source
from ._ascii import read_ascii
from ._binary import read_binary
from ._faces import read_triangles
from ._header import Element, Header, bytes_left, check_size, read_header
from ._names import COLORS, NORMALS, POSITIONS, VERTICES, find
from ._write import write

SHORT = 64  # maximum bytes of a row whose columns may be views, which keep the row alive

Columns = dict[str, NDArray[Any]]


def recognise(head: bytes, path: Path) -> int:
    """Detect PLY files: return `SURE` or `NO`. head : first bytes of the file"""
    return SURE if re.match(rb"ply[ \t]*[\r\n]", head) else NO


class PlySource(Source):
    """Reader of PLY files: the vertices."""

    def __init__(self, path: Path, request: Request) -> None:
        self._path, self.faults = path, Faults(request.strict)
        with path.open("rb") as file:
            self.header = header = read_header(file)
            kinds = [element.name.lower() for element in header.elements]
            found = [kinds.index(name) for name in VERTICES if name in kinds]
            if not found:
                names = ", ".join(element.name for element in header.elements)
                raise ValueError(f"element 'vertex' not found; available: {names or 'none'}")
            self._index = found[0]
            self._vertex = header.elements[self._index]
            _check_vertex(self._vertex)
            self._most = count = _most(file, header, self._index, self.faults)
        self._packed = PackedColors()
        self._types = {p.name: p.type for p in self._vertex.scalars}
        row = 36 + sum(dtype.itemsize for dtype in self._types.values())
        crs = next((text[4:].strip() for text in header.comments if text.startswith("crs ")), None)
        facts = {
            "encoding": header.format,
            "comments": [text for text in header.comments if not text.startswith("crs ")],
        }
        self.has_texture = any(text.startswith("TextureFile") for text in header.comments)
        self.listing = Listing(count, row, georeference=Georeference(crs or None), facts=facts)

    def chunks(self) -> Iterator[Chunk]:
        for columns, share in self._columns():
            yield self._to_chunk(columns, share)
            self.note = self._packed.note or self.note

    def _to_chunk(self, columns: Columns, share: float) -> Chunk:
        return _to_chunk(columns, self._types, self._packed, share)

    def _columns(self) -> Iterator[tuple[Columns, float]]:
        """Yield the columns of the vertices by name, in chunks of rows, with the fraction that has been read."""
        header = self.header
        rows = read_ascii if header.format == "ascii" else read_binary
        done = 0
        with self._path.open("rb") as file, warnings.catch_warnings():
            warnings.simplefilter("ignore")  # loadtxt warns of missing rows and empty lists
            file.seek(header.size)
            for columns in rows(file, header, self._index, self._most, self.faults):
                done += len(next(iter(columns.values())))
                yield columns, done / self._most


def _most(file: BinaryIO, header: Header, index: int, faults: Faults) -> int:
    """Return an upper limit for the number of vertices to read, for which the file has enough lines or bytes.

    It exceeds the announced number only where additional vertices may follow: at the end of the file.

    index : number of the element with vertices; faults : records additional vertices of a binary file
    """
    vertex = header.elements[index]
    count = vertex.rows
    is_text, is_last = header.format == "ascii", index == len(header.elements) - 1
    row = 2 * len(vertex.properties) - 1 if is_text else vertex.least_size  # minimum bytes
    file.seek(header.size)
    if faults.strict:
        check_size(file, vertex, row)
    if is_text:
        most = count_lines(file) - sum(element.rows for element in header.elements[:index])
        return max(most if is_last else min(most, count), 1)
    there = bytes_left(file) // row
    if count <= there and index == 0 and is_last and not vertex.has_lists:
        return count + _count_extra(file, header, count, row, faults)
    return max(min(count, there), 1)


def _count_extra(file: BinaryIO, header: Header, count: int, row: int, faults: Faults) -> int:
    """Return the number of vertices after the announced ones of a binary file, which are recorded in `faults`.

    count : announced number; row : bytes per vertex
    """
    extra = bytes_left(file) - count * row
    if extra < row:
        return 0
    start = header.size + count * row
    rows = rows_after(file, start, start + extra, row)
    what = f"{rows:,} more" if rows else "which are not read"
    faults.add(f"{count:,} vertices expected, {extra:,} bytes follow them, {what}")
    return rows


def _check_vertex(vertex: Element) -> None:
    names = [p.name for p in vertex.scalars]
    if not find(POSITIONS, names):
        raise ValueError(f"properties x, y, z of the vertices not found; available: {', '.join(names) or 'none'}")
    if vertex.rows == 0:
        raise ValueError("contains no points: the header announces 0 vertices")


# ------------------------------------------------------------------------------------------------ to Points and back


def _to_chunk(columns: Columns, types: dict[str, np.dtype[Any]], packed: PackedColors, share: float) -> Chunk:
    positions = _stack([columns.pop(name) for name in find(POSITIONS, columns)])
    normals, colors = find(NORMALS, columns), find(COLORS, columns)
    stacked = [
        _stack([_typed(columns.pop(n), types[n]) for n in names]) if names else None for names in (normals, colors)
    ]
    if not colors and (name := find_packed((name, types[name]) for name in columns)):
        column = columns.pop(name)
        stacked[1] = packed.unpack(column if types[name].kind == "f" else _typed(column, types[name]))
    attributes = {name: np.array(_typed(column, types[name])) for name, column in columns.items()}
    return Chunk(positions, stacked[0], stacked[1], attributes, share)


def _typed(column: NDArray[Any], stored: np.dtype[Any]) -> NDArray[Any]:
    """Convert numbers of an ascii file to the type stated in the header; numbers that do not fit stay floats."""
    if column.dtype.kind != "f" or stored.kind == "f":
        return column.astype(stored, copy=False)
    limits = np.iinfo(stored)
    whole = np.isfinite(column).all() and (column == np.rint(column)).all()
    fits = whole and column.min() >= limits.min and column.max() <= limits.max
    return column.astype(stored) if fits else column


def _stack(columns: Sequence[NDArray[Any]]) -> NDArray[Any]:
    """Stack (m,) columns to (m, k): as a view if they are adjacent in the file's rows, which saves a copy."""
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
    """Return a reader of the vertices of a PLY file, or of points sampled on its triangles.

    Points are sampled if that is requested, or if the vertices are too sparse to represent the surface.
    """
    if request.sample == 0:
        return PlySource(path, request)
    from ..mesh.mesh import has_few_vertices, has_trimesh, ply_source

    source: Source | None = ply_source(path, request, _surface)
    if source is None:
        source = PlySource(path, request)
        if not has_trimesh() and has_few_vertices(path):
            source.note = "its triangles are ignored because trimesh is missing: pip install 'pointray[mesh]'"
    return source


def _surface(path: Path) -> tuple[Doubles, NDArray[np.int64]] | None:
    """Return vertices, (n, 3), and triangles, (m, 3), of a PLY file, read without trimesh.

    Return None if the file has a texture, faces with different numbers of corners, or invalid indices.
    """
    source = PlySource(path, Request(strict=True))
    triangles = None if source.has_texture else read_triangles(path, source.header)
    if triangles is None:
        return None
    positions = np.concatenate([chunk.positions for chunk in source.chunks()]).astype(np.float64)
    return (positions, triangles) if 0 <= triangles.min() and triangles.max() < len(positions) else None


FORMAT = Format(
    "PLY",
    (".ply",),
    recognise,
    _open,
    {
        "positions": "x, y, z of the element vertex or point; names in upper or lower case",
        "normals": "nx, ny, nz or normal_x, normal_y, normal_z",
        "colors": "red, green, blue or r, g, b, also after diffuse_ or scalar_; rgb or rgba packed in one number",
        "attributes": "all other properties except lists, with their types",
        "survey": "the coordinate system, in a comment that begins with crs",
    },
    write=write,
)
