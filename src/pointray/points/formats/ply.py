"""PLY files: ascii and binary, every order of properties.

plyfile reads no rows, for two reasons: it reads faces and ascii row by row in Python (the dragon's mesh: 1.7 s, here
0.01 s), and it believes the header's count, so that a damaged file asks for terabytes.
"""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray
from plyfile import PlyData, PlyElement, PlyListProperty

from ...data import Points, check_count
from ...progress import Progress, part_of, tell
from ._ply_header import Header, read_header

NORMALS = (("nx", "ny", "nz"), ("normal_x", "normal_y", "normal_z"))
COLORS = (("red", "green", "blue"), ("r", "g", "b"), ("diffuse_red", "diffuse_green", "diffuse_blue"))
ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">"}
TEXT_BYTES = 1 << 20  # bytes of ascii that are parsed together
STACKED = 1 << 18  # rows that are copied together
SPACE, END, LETTER = range(3)  # what a byte of ascii is; a line's end is CR or LF, so that CR LF ends a blank line too
LETTERS = np.array([END if c in "\r\n" else SPACE if c.isspace() else LETTER for c in map(chr, range(256))], np.uint8)

Columns = dict[str, NDArray[Any]]


class _Watched(io.FileIO):
    """A file that tells how much of it has been read."""

    def __init__(self, path: Path, progress: Progress | None) -> None:
        super().__init__(path, "rb")
        self._progress, self._size = progress, max(path.stat().st_size, 1)

    def readinto(self, buffer: Any) -> int | None:
        tell(self._progress, min(self.tell() / self._size, 1.0))
        return super().readinto(buffer)


def read(path: Path, progress: Progress | None = None) -> Points:
    """Read the vertices of a PLY file; ValueError says what is wrong with its contents."""
    with io.BufferedReader(_Watched(path, progress), TEXT_BYTES) as file, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # loadtxt warns of no rows and of empty lists
        header = read_header(file)
        found = [i for i, element in enumerate(header.elements) if element.name == "vertex"]
        if not found:
            names = ", ".join(element.name for element in header.elements)
            raise ValueError(f"has no element 'vertex', only: {names or 'nothing'}")
        vertex, count = header.elements[found[0]], header.counts[found[0]]
        _check_vertex(vertex, count)
        file.seek(header.size)
        rows = _read_ascii if header.format == "ascii" else _read_binary
        columns = rows(file, header, found[0])
    copied = progress if header.format != "ascii" else None
    return _to_points(columns, {p.name: np.dtype(p.dtype()) for p in vertex.properties}, copied)


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


def _check_rows(file: BinaryIO, vertex: Any, count: int, row: int) -> None:
    """ValueError if vertices are missing, or if there are more than can be held."""
    _check_size(file, vertex, count, row)
    check_count(count)


def _has_lists(element: Any) -> bool:
    return any(isinstance(p, PlyListProperty) for p in element.properties)


# ------------------------------------------------------------------------------------------------------ binary


def _read_binary(file: BinaryIO, header: Header, index: int) -> Columns:
    order = ORDERS[header.format]
    for element, count in zip(header.elements[:index], header.counts[:index], strict=True):
        _skip(file, element, count, order)
    vertex, count = header.elements[index], header.counts[index]
    if _has_lists(vertex):
        return _read_beside_lists(file, vertex, count, order)
    dtype = np.dtype([(p.name, p.dtype(order)) for p in vertex.properties])
    _check_rows(file, vertex, count, dtype.itemsize)
    rows = np.memmap(file, dtype, "r", offset=file.tell(), shape=(count,))
    return {name: rows[name] for name in dtype.names or ()}


def _skip(file: BinaryIO, element: Any, count: int, order: str) -> None:
    """Skip an element that comes before the vertices."""
    row = sum(_least_size(p) for p in element.properties)
    _check_size(file, element, count, row)
    if not _has_lists(element):
        file.seek(count * row, io.SEEK_CUR)
    elif count:
        from ._ply_lists import walk_rows

        file.seek(walk_rows(*_bytes_from(file), count, element, order, np.empty((0, 0), np.int64)))


def _read_beside_lists(file: BinaryIO, vertex: Any, count: int, order: str) -> Columns:
    """Vertices with lists, which are dropped."""
    from ._ply_lists import scalars_at, walk_rows

    _check_rows(file, vertex, count, sum(_least_size(p) for p in vertex.properties))
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


def _read_ascii(file: BinaryIO, header: Header, index: int) -> Columns:
    for element, count in zip(header.elements[:index], header.counts[:index], strict=True):
        if element.properties and count:
            _skip_lines(file, element, count)
    vertex, count = header.elements[index], header.counts[index]
    names = [p.name for p in vertex.properties]
    _check_rows(file, vertex, count, 2 * len(names) - 1)  # a digit and a space, but for the file's last
    lines = io.TextIOWrapper(file, "latin-1")
    try:
        if _has_lists(vertex):
            return _numbers_beside_lists(lines, vertex, count)
        rows = np.loadtxt(lines, np.float64, comments=None, max_rows=count, ndmin=2)
    finally:
        lines.detach()
    if rows.shape != (count, len(names)):
        raise ValueError(
            f"{count:,} lines of {len(names)} numbers are announced, {rows.shape[0]:,} of {rows.shape[1]} are there"
        )
    return dict(zip(names, rows.T, strict=True))


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


def _to_points(columns: Columns, types: dict[str, np.dtype[Any]], progress: Progress | None) -> Points:
    first = part_of(progress, 0.0, 0.6)  # the first column reads everything from the disk
    positions = _stack([columns.pop(name) for name in "xyz"], first)
    normals = next((names for names in NORMALS if columns.keys() >= set(names)), ())
    colors = next((names for names in COLORS if columns.keys() >= set(names)), ())
    return Points(
        positions,
        _stack([columns.pop(name) for name in normals], part_of(progress, 0.6, 0.8)) if normals else None,
        _to_uint8(_stack([columns.pop(name) for name in colors]), types[colors[0]]) if colors else None,
        columns,
    )


def _stack(columns: Sequence[NDArray[Any]], progress: Progress | None = None) -> NDArray[Any]:
    dtype = np.result_type(*(column.dtype.newbyteorder("=") for column in columns))
    rows = np.empty((len(columns[0]), len(columns)), dtype)
    for start in range(0, len(rows), STACKED):
        part = slice(start, start + STACKED)
        for i, column in enumerate(columns):
            rows[part, i] = column[part]
        tell(progress, min(part.stop / len(rows), 1.0))
    return rows


def _to_uint8(colors: NDArray[Any], stored: np.dtype[Any]) -> NDArray[Any]:
    """8-bit colours from a file's: 8 or 16 bits, 8 bits in a wider integer or float, or floats from 0 to 1."""
    if colors.dtype == np.uint8:
        return colors
    if stored == np.int8 and colors.min() < 0:
        return colors.astype(np.int8).view(np.uint8)
    low, high = colors.min(), colors.max()
    if stored.kind == "f":
        eight_bits = 2 < high <= 255 and low >= 0
        return np.rint(colors).astype(np.uint8) if eight_bits else colors
    if not (low >= 0 and high <= 65535):
        raise ValueError(f"its colours reach from {low} to {high}, not 0 to 255 or 65535")
    return np.rint(colors / (1 if high <= 255 else 257)).astype(np.uint8)


def write(file: io.BufferedIOBase, points: Points) -> None:
    """Write all that the points hold, binary little-endian."""
    columns: Columns = {}
    positions = points.world if points.origin.any() else points.positions
    _add(columns, "xyz", positions)
    if points.normals is not None:
        _add(columns, NORMALS[0], points.normals)
    if points.colors is not None:
        _add(columns, COLORS[0], points.colors)
    for name, values in points.attributes.items():
        flat = values.ndim == 1
        _add(
            columns,
            [name] if flat else [f"{name}_{i}" for i in range(values.shape[1])],
            values.reshape(len(points), -1),
        )
    rows = np.empty(len(points), [(name, column.dtype) for name, column in columns.items()])
    for name, column in columns.items():
        rows[name] = column
    PlyData([PlyElement.describe(rows, "vertex")], byte_order="<").write(file)


def _add(columns: Columns, names: Sequence[str], values: NDArray[Any]) -> None:
    for name, column in zip(names, values.T, strict=True):
        if name in columns or not re.fullmatch(r"[!-~]+", name):
            reason = "it stands for something else" if name in columns else "only ASCII without spaces is allowed"
            raise ValueError(f"a PLY file cannot hold an attribute named {name!r}: {reason}")
        columns[name] = column
