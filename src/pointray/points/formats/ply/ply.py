"""PLY files: ascii and binary, every order of properties.

plyfile reads no rows, for two reasons: it reads faces and ascii row by row in Python (the dragon's mesh: 1.7 s, here
0.01 s), and it believes the header's count, so that a damaged file asks for terabytes.
"""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray
from plyfile import PlyData, PlyElement, PlyListProperty

from ....data import Points
from ....progress import Progress, tell
from ....survey import Survey
from .._source import CHUNK, NO, SURE, Chunk, Format, Listing, Request, Source
from ._header import Header, read_header

NORMALS = (("nx", "ny", "nz"), ("normal_x", "normal_y", "normal_z"))
COLORS = (("red", "green", "blue"), ("r", "g", "b"), ("diffuse_red", "diffuse_green", "diffuse_blue"))
ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">"}
CHUNK_BYTES = 1 << 25  # bytes of a chunk's rows at most: a splat has 248
TEXT_BYTES = 1 << 20  # bytes of ascii that are parsed together
SPACE, END, LETTER = range(3)  # what a byte of ascii is; a line's end is CR or LF, so that CR LF ends a blank line too
LETTERS = np.array([END if c in "\r\n" else SPACE if c.isspace() else LETTER for c in map(chr, range(256))], np.uint8)

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
            _check_size(file, self._vertex, count, least)
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
        rows = _read_ascii if header.format == "ascii" else _read_binary
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


def _bytes_left(file: BinaryIO) -> int:
    here = file.tell()
    end = file.seek(0, io.SEEK_END)
    file.seek(here)
    return end - here


def _check_size(file: BinaryIO, element: Any, count: int, row: int) -> None:
    """Check the header's counts against the file's size, as a header may state anything."""
    left = _bytes_left(file)
    if count * row > left:
        rows = "vertices" if element.name == "vertex" else f"rows of the element {element.name!r}"
        raise ValueError(f"is cut off: {count:,} {rows} of {row} bytes or more are announced, {left:,} bytes are there")


def _has_lists(element: Any) -> bool:
    return any(isinstance(p, PlyListProperty) for p in element.properties)


# ------------------------------------------------------------------------------------------------------ binary


def _read_binary(file: BinaryIO, header: Header, index: int) -> Iterator[Columns]:
    order = ORDERS[header.format]
    for element, count in zip(header.elements[:index], header.counts[:index], strict=True):
        _skip(file, element, count, order)
    vertex, count = header.elements[index], header.counts[index]
    if _has_lists(vertex):
        yield _read_beside_lists(file, vertex, count, order)
        return
    dtype = np.dtype([(p.name, p.dtype(order)) for p in vertex.properties])
    _check_size(file, vertex, count, dtype.itemsize)
    step = max(min(CHUNK, CHUNK_BYTES // dtype.itemsize), 1)
    for start in range(0, count, step):
        rows = np.fromfile(file, dtype, min(step, count - start))
        if len(rows) < min(step, count - start):
            raise ValueError(f"is cut off at vertex {start + len(rows):,} of {count:,}")
        yield {name: rows[name] for name in dtype.names or ()}


def _skip(file: BinaryIO, element: Any, count: int, order: str) -> None:
    """Skip an element that comes before the vertices."""
    row = sum(_least_size(p) for p in element.properties)
    _check_size(file, element, count, row)
    if not _has_lists(element):
        file.seek(count * row, io.SEEK_CUR)
    elif count:
        from ._lists import walk_rows

        file.seek(walk_rows(*_bytes_from(file), count, element, order, np.empty((0, 0), np.int64)))


def _read_beside_lists(file: BinaryIO, vertex: Any, count: int, order: str) -> Columns:
    """Vertices with lists, which are dropped."""
    from ._lists import scalars_at, walk_rows

    _check_size(file, vertex, count, sum(_least_size(p) for p in vertex.properties))
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


# ------------------------------------------------------------------------------------------------------- ascii


def _read_ascii(file: BinaryIO, header: Header, index: int) -> Iterator[Columns]:
    for element, count in zip(header.elements[:index], header.counts[:index], strict=True):
        if element.properties and count:
            _skip_lines(file, element, count)
    vertex, count = header.elements[index], header.counts[index]
    names = [p.name for p in vertex.properties]
    _check_size(file, vertex, count, 2 * len(names) - 1)  # a digit and a space, but for the file's last
    lines = io.TextIOWrapper(file, "latin-1")
    try:
        if _has_lists(vertex):
            yield _numbers_beside_lists(lines, vertex, count)
            return
        rows = np.loadtxt(lines, np.float64, comments=None, max_rows=count, ndmin=2)
    finally:
        lines.detach()
    if rows.shape != (count, len(names)):
        raise ValueError(
            f"{count:,} lines of {len(names)} numbers are announced, {rows.shape[0]:,} of {rows.shape[1]} are there"
        )
    yield dict(zip(names, rows.T, strict=True))


def _skip_lines(file: BinaryIO, element: Any, count: int) -> None:
    """Skip `count` lines that are not blank, whatever ends them, to the start of the next such line."""
    within = False  # whether the current byte is in such a line
    while block := file.read(TEXT_BYTES):
        kinds = LETTERS[np.frombuffer(block, np.uint8)]
        offsets = np.flatnonzero(kinds != SPACE)
        letters = kinds[offsets] == LETTER
        first = letters & ~np.concatenate([[within], letters[:-1]])
        if first.sum() > count:
            file.seek(int(offsets[np.flatnonzero(first)[count]]) - len(block), io.SEEK_CUR)
            return
        count -= int(first.sum())
        within = bool(letters[-1]) if len(letters) else within
    raise ValueError(f"is cut off in the element {element.name!r}, or behind it")


def _numbers_beside_lists(lines: Iterable[str], vertex: Any, count: int) -> Columns:
    """Vertices with lists, which are dropped."""
    scalars = [p.name for p in vertex.properties if not isinstance(p, PlyListProperty)]
    rows = np.empty((count, len(scalars)))
    row = -1
    for row, fields in zip(range(count), filter(None, map(str.split, lines)), strict=False):  # noqa: B007
        at, numbers = 0, []
        for p in vertex.properties:
            if at >= len(fields):
                break
            if isinstance(p, PlyListProperty):
                at += _length_of(fields[at])
            else:
                numbers.append(fields[at])
            at += 1
        if at != len(fields) or len(numbers) < len(scalars):
            raise ValueError(f"is damaged: vertex {row:,} has not the values and lists that the header announces")
        rows[row] = numbers
    if row + 1 < count:
        raise ValueError(f"is cut off: {count:,} vertices are announced, {row + 1:,} are there")
    return dict(zip(scalars, rows.T, strict=True))


def _length_of(text: str) -> int:
    """The length of a list, which some writers store as a float."""
    length = float(text)
    if not (length >= 0 and length.is_integer()):  # false for NaN
        raise ValueError(f"is damaged: the length of a list is {text}")
    return int(length)


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
    return np.stack(columns, axis=1).astype(np.result_type(*(c.dtype.newbyteorder("=") for c in columns)), copy=False)


def write(file: Any, points: Points, progress: Progress | None = None) -> list[str]:
    """Write all that the points hold, binary little-endian; returns what PLY cannot hold."""
    columns: Columns = {}
    _add(columns, "xyz", points.positions)
    if points.normals is not None:
        _add(columns, NORMALS[0], points.normals)
    if points.colors is not None:
        _add(columns, COLORS[0], points.colors)
    words: list[str] = []
    for name, values in points.attributes.items():
        flat = _fitting(values, name, words).reshape(len(points), -1)
        _add(columns, [name] if values.ndim == 1 else [f"{name}_{i}" for i in range(flat.shape[1])], flat)
    dtype = np.dtype([(name, column.dtype) for name, column in columns.items()])
    moved = bool(points.origin.any())
    if moved:
        dtype = np.dtype([(n, np.float64 if n in ("x", "y", "z") else dtype[n]) for n in columns])
    comments = [f"crs {' '.join(points.crs.split())}"] if points.crs else []
    if points.survey.stations and len(points.survey.stations) > 0:
        words.append("cannot hold where the scanners stood")
    empty = PlyElement.describe(np.empty(0, dtype), "vertex")
    header = PlyData([empty], byte_order="<", comments=comments).header
    file.write(re.sub(r"(?m)^element vertex 0$", f"element vertex {len(points)}", header).encode("ascii") + b"\n")
    for start in range(0, len(points), CHUNK):
        part = slice(start, start + CHUNK)
        rows = np.empty(len(points.positions[part]), dtype.newbyteorder("<"))
        for k, (name, column) in enumerate(columns.items()):
            rows[name] = column[part] + points.origin[k] if moved and k < 3 else column[part]
        file.write(rows.data)
        tell(progress, min(part.stop / len(points), 1.0))
    return words


def _fitting(values: NDArray[Any], name: str, words: list[str]) -> NDArray[Any]:
    """Values of a type that PLY has: it has no bools and no whole numbers of 8 bytes."""
    if values.dtype == np.bool_:
        return values.astype(np.uint8)
    if values.dtype not in (np.int64, np.uint64):
        return values
    for dtype in (np.int32, np.uint32):
        if len(values) and values.min() >= np.iinfo(dtype).min and values.max() <= np.iinfo(dtype).max:
            return values.astype(dtype)
    floats = values.astype(np.float64)
    if len(values) and (values.max() > 2**53 or values.min() < -(2**53)):
        words.append(f"keeps {name} as floats of 8 bytes, which round its largest numbers")
    return floats


def _add(columns: Columns, names: Sequence[str], values: NDArray[Any]) -> None:
    for name, column in zip(names, values.T, strict=True):
        if name in columns or not re.fullmatch(r"[!-~]+", name):
            reason = "it stands for something else" if name in columns else "only ASCII without spaces is allowed"
            raise ValueError(f"a PLY file cannot hold an attribute named {name!r}: {reason}")
        columns[name] = column


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
