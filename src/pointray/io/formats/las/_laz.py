"""Compressed points: the table of their chunks, checked, and decompressing a group of chunks on all cores.

lazrs decompresses; its reader of whole files is not used, as it believes the table: it asks for as much memory as
damaged entries announce, which ends the process, where no error can be caught.
"""

from __future__ import annotations

import io
import struct
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .._counts import unequal
from .._source import CHUNK, Faults
from ._header import Header
from ._rows import unpack_u16

VARIABLE = 2**32 - 1  # as the rows of a chunk: the table tells
DENSEST = 64  # rows in a byte, if the header announces fewer; real scans have 0.1 to 0.3
LAYERS = {10: 9, 11: 1, 12: 2, 13: 1}  # of an item of a row, in chunks of layers; extra bytes have one each
EXTRA = 14
ENDLESS = b"\xff\xff\xff\xff"  # no arithmetic coder begins so
SIZES = {6: 20, 7: 8, 8: 6, 9: 29, 10: 30, 11: 6, 12: 8, 13: 29}  # bytes of an item in a row; extra bytes have any


class Packing(NamedTuple):
    """How points are compressed: lazrs's description, rows of a chunk, layers of a chunk (0: none)."""

    data: bytes
    rows: int
    layers: int


class Part(NamedTuple):
    """A chunk of compressed rows."""

    start: int
    size: int
    rows: int


def require(module: str) -> Any:
    """A module that a plain install has; ValueError, which says how to install it, if it is absent all the same."""
    try:
        return import_module(module)
    except ImportError:
        raise ValueError(f"needs {module}: pip install 'laspy[lazrs]'") from None


@contextmanager
def damage(what: str) -> Iterator[None]:
    """What a library raises becomes a ValueError; a panic of Rust is no Exception."""
    try:
        yield
    except (KeyboardInterrupt, SystemExit, GeneratorExit, MemoryError):
        raise
    except BaseException as error:
        reason = " ".join(str(error).split())[:200]
        raise ValueError(f"is damaged or cut off: {what}: {reason or type(error).__name__}") from None


def packing_of(header: Header) -> Packing:
    """How the points are compressed; ValueError if that contradicts the header, or cannot be read."""
    require("lazrs")
    data = header.data_of("laszip encoded", 22204)
    if data is None or len(data) < 34:
        raise ValueError("is damaged: its points are compressed, but the record that says how is missing")
    compressor, coder, rows, number = struct.unpack_from("<HH8xI16xH", data)
    items = unpack_u16(data[34 : 34 + 6 * number])
    kinds, sizes = items[::3], items[1::3]
    if compressor not in (2, 3) or coder:
        raise ValueError(
            f"is compressed in a way ({compressor}, {coder}) that lazrs cannot read: write it anew with LASzip"
        )
    known = all(SIZES.get(kind, size) == size for kind, size in zip(kinds, sizes, strict=False))
    if len(items) != 3 * number or sum(sizes) != header.row or not rows or not known:
        raise ValueError(
            f"is damaged: its compressed rows have {sum(sizes)} bytes in {number} items, the header says {header.row} "
            "(byte 105)"
        )
    layers = 0
    if compressor == 3:
        layers = sum(size if kind == EXTRA else LAYERS.get(kind, 0) for kind, size in zip(kinds, sizes, strict=True))
    return Packing(data, rows, layers)


def parts_of(file: BinaryIO, header: Header, packing: Packing, size: int, faults: Faults) -> list[Part]:
    """The chunks of a file of `size` bytes; ValueError if they do not fill the bytes before their table.

    Where only decompression tells the rows of the last chunk, it gets the most that the header leaves for it.
    """
    import lazrs

    start, most = header.start + 8, max(header.total, sum(header.returns))
    at = _table_at(file, header, size)
    file.seek(at)
    head = file.read(8)
    number = struct.unpack("<4xI", head)[0] if len(head) == 8 else 0
    if not 0 < number <= (at - start) // header.row + 1:
        raise ValueError(f"is damaged: the table of its chunks at byte {at:,} has {number:,} entries")
    table = io.BytesIO(head + file.read(min(16 * number + 64, size - at)))  # two numbers take fewer bytes
    with damage(f"the table of its chunks at byte {at:,}"):
        entries = lazrs.read_chunk_table_only(table, lazrs.LazVlr(packing.data))
    if entries[-1][1] == 0:  # written by some programs behind a full chunk
        entries.pop()
    rows, sizes = ([entry[k] for entry in entries] for k in (0, 1))
    if not sizes or sum(sizes) != at - start or min(sizes) < header.row:
        raise ValueError(f"is damaged: its chunks have {sum(sizes):,} bytes, {at - start:,} are there")
    starts = np.cumsum([start, *sizes[:-1]]).tolist()
    if packing.rows != VARIABLE:
        rows = [packing.rows] * len(sizes)
        rows[-1] = _rows_of_last(file, header, packing, starts[-1], most - sum(rows[:-1]))
    credible = max(most, DENSEST * sum(sizes)) if packing.layers else most
    if min(rows) <= 0 or max(rows) > credible or (packing.layers and sum(rows) > credible):
        raise ValueError(f"is damaged: the header announces {most:,} rows, its {number:,} chunks hold others")
    if packing.layers or packing.rows == VARIABLE:
        check_total(header, sum(rows), faults)
    return [Part(*part) for part in zip(starts, sizes, rows, strict=True)]


def _rows_of_last(file: BinaryIO, header: Header, packing: Packing, start: int, announced: int) -> int:
    """The rows of the last chunk, at byte `start`: as a chunk of layers states them, else those announced."""
    if not packing.layers:
        return announced if 0 < announced <= packing.rows else packing.rows
    file.seek(start + header.row)
    raw = file.read(4)
    return min(struct.unpack("<I", raw)[0] if len(raw) == 4 else 0, packing.rows)


def check_total(header: Header, rows: int, faults: Faults) -> None:
    """Record a fault if there are other rows than the header announces."""
    if rows != header.total:
        faults.add(unequal(header.total, rows, "rows"))


def _table_at(file: BinaryIO, header: Header, size: int) -> int:
    """Where the table of chunks begins."""
    for place in (header.start, size - 8):  # a writer that could not seek leaves it at the end
        file.seek(place)
        raw = file.read(8)
        at = struct.unpack("<q", raw)[0] if len(raw) == 8 else -1
        if header.start + 8 < at <= size - 8:
            return int(at)
        if at > 0 and place == header.start:
            break
    raise ValueError(f"is cut off: the table of its chunks (byte {header.start:,}) is not there, or not yet written")


def unpacked_parts(
    file: BinaryIO, header: Header, packing: Packing, parts: Sequence[Part]
) -> Iterator[tuple[NDArray[np.uint8], int]]:
    """The bytes of rows, about `CHUNK` rows at a time, and how many of the parts that was; the bytes are used again."""
    whole = np.empty(0, np.uint8)
    for first, last in _groups(parts):
        group = parts[first:last]
        raw = _read_parts(file, group)
        _check_parts(raw, group, header.row, packing.layers)
        need = sum(part.rows for part in group) * header.row
        if len(whole) < need:
            whole = np.empty(need, np.uint8)
        try:
            _decompress(raw, packing, whole[:need], group)
        except ValueError:
            if packing.layers or last < len(parts):
                raise
            rows = _rows_there(raw[-group[-1].size :], packing, header.row, group[-1])
            group = [*group[:-1], group[-1]._replace(rows=rows)]
            need = sum(part.rows for part in group) * header.row
            _decompress(raw, packing, whole[:need], group)
        yield whole[:need], last


def _decompress(raw: bytearray, packing: Packing, out: NDArray[np.uint8], group: Sequence[Part]) -> None:
    import lazrs

    with damage(f"the chunk of points at byte {group[0].start:,}"):
        lazrs.decompress_points_with_chunk_table(raw, packing.data, out, [(p.rows, p.size) for p in group])


def _rows_there(raw: bytearray, packing: Packing, row: int, part: Part) -> int:
    """The most rows that a chunk without layers can be decompressed to, found by bisection; ValueError if none.

    Such a chunk does not state its rows; decompressing more of them runs out of bytes.

    row : bytes of a row
    """
    out = np.empty(part.rows * row, np.uint8)
    least, most = 0, part.rows  # the first succeeds, the second fails
    while most - least > 1:
        rows = (least + most) // 2
        try:
            _decompress(raw, packing, out[: rows * row], [part._replace(rows=rows)])
            least = rows
        except ValueError:
            most = rows
    if not least:
        raise ValueError(f"is damaged: the chunk of points at byte {part.start:,} holds no rows")
    return least


def _groups(parts: Sequence[Part]) -> Iterator[tuple[int, int]]:
    """Parts that are decompressed together."""
    first = rows = 0
    for k, part in enumerate(parts):
        if rows and rows + part.rows > CHUNK:
            yield first, k
            first, rows = k, 0
        rows += part.rows
    if rows:
        yield first, len(parts)


def _read_parts(file: BinaryIO, group: Sequence[Part]) -> bytearray:
    raw = bytearray(sum(part.size for part in group))
    view, at = memoryview(raw), 0
    for part in group:
        file.seek(part.start)
        done = file.readinto(view[at : at + part.size])  # type: ignore[attr-defined]  # a buffered file has it
        if done != part.size:
            raise ValueError(f"is cut off at byte {part.start + done:,}, in a chunk of points")
        at += part.size
    return raw


def _check_parts(raw: bytearray, group: Sequence[Part], row: int, layers: int) -> None:
    """A chunk begins with a row; with layers, their rows and sizes follow: lazrs asks for that memory.

    Each stream of compressed bytes begins with a number below the largest one, else lazrs ends the process.
    """
    at = 0
    for part in group:
        head = row + 4 + 4 * layers if layers else row
        sizes = [part.size - row]
        if layers:
            rows, *sizes = struct.unpack_from(f"<{1 + layers}I", raw, at + row) if part.size >= head else (0,)
            if rows != part.rows or sum(sizes) != part.size - head:
                raise ValueError(
                    f"is damaged: the chunk of points at byte {part.start:,} has {rows:,} rows, not {part.rows:,}, or "
                    "layers of other sizes"
                )
        first = at + head
        for size in sizes:
            if size >= len(ENDLESS) and raw[first : first + len(ENDLESS)] == ENDLESS:
                raise ValueError(f"is damaged: the chunk of points at byte {part.start:,} has a stream of ones")
            first += size
        at += part.size
