"""Compressed points: the checked table of chunks, and decompression of groups of chunks on all cores.

Decompression is done by lazrs. Its reader of whole files is not used: it allocates what damaged entries of the table
announce, which ends the process without an exception.
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

from .._counts import count_mismatch
from .._source import CHUNK, Faults
from ._header import Header
from ._rows import unpack_u16

VARIABLE = 2**32 - 1  # rows per chunk if the table states them
DENSEST = 64  # maximum rows per compressed byte, beyond what the header announces; real scans have 0.1 to 0.3
LAYERS = {10: 9, 11: 1, 12: 2, 13: 1}  # layers by item type, in layered chunks; extra bytes have one per byte
EXTRA = 14
ENDLESS = b"\xff\xff\xff\xff"  # no valid arithmetic-coded stream begins like this
SIZES = {6: 20, 7: 8, 8: 6, 9: 29, 10: 30, 11: 6, 12: 8, 13: 29}  # bytes by item type; extra bytes have any size


class Packing(NamedTuple):
    """Compression of the points of a LAZ file.

    Attributes
    ----------
    data : bytes
        Contents of the record that describes it, for lazrs.
    rows : int
        Rows per chunk; `VARIABLE` if the table of chunks states them.
    layers : int
        Number of separately compressed streams per chunk, of point formats 6 and later; 0 if fields are interleaved.
    """

    data: bytes
    rows: int
    layers: int


class Part(NamedTuple):
    """A chunk of compressed rows, or all rows of an uncompressed file.

    Attributes
    ----------
    start, size : int
        Offset and size in bytes.
    rows : int
        Number of rows.
    """

    start: int
    size: int
    rows: int


def require(module: str) -> Any:
    """Import a module by name; raise ValueError with install instructions if it is missing."""
    try:
        return import_module(module)
    except ImportError:
        raise ValueError(f"needs {module}: pip install 'laspy[lazrs]'") from None


@contextmanager
def damage(what: str) -> Iterator[None]:
    """Convert exceptions that a library raises in the context to ValueError, also Rust panics.

    A panic is not derived from Exception.

    what : the part of the file that is read, for the message
    """
    try:
        yield
    except (KeyboardInterrupt, SystemExit, GeneratorExit, MemoryError):
        raise
    except BaseException as error:
        reason = " ".join(str(error).split())[:200]
        raise ValueError(f"is damaged or cut off: {what}: {reason or type(error).__name__}") from None


def packing_of(header: Header) -> Packing:
    """Return the compression that a file states; raise ValueError if it contradicts the header or is unsupported."""
    require("lazrs")
    data = header.data_of("laszip encoded", 22204)
    if data is None or len(data) < 34:
        raise ValueError("is damaged: the record that describes the compression of its points is missing")
    compressor, coder, rows, number = struct.unpack_from("<HH8xI16xH", data)
    items = unpack_u16(data[34 : 34 + 6 * number])
    kinds, sizes = items[::3], items[1::3]
    if compressor not in (2, 3) or coder:
        raise ValueError(
            f"has an unsupported compression ({compressor}, {coder}), which lazrs cannot read: rewrite it with LASzip"
        )
    known = all(SIZES.get(kind, size) == size for kind, size in zip(kinds, sizes, strict=False))
    if len(items) != 3 * number or sum(sizes) != header.row or not rows or not known:
        raise ValueError(
            f"is damaged: its compressed rows have {sum(sizes)} bytes in {number} items, expected {header.row} "
            "(byte 105)"
        )
    layers = 0
    if compressor == 3:
        layers = sum(size if kind == EXTRA else LAYERS.get(kind, 0) for kind, size in zip(kinds, sizes, strict=True))
    return Packing(data, rows, layers)


def parts_of(file: BinaryIO, header: Header, packing: Packing, size: int, faults: Faults) -> list[Part]:
    """Return the chunks of a file of `size` bytes; raise ValueError if they do not fill the bytes before their table.

    If the rows of the last chunk are known only after decompression, it gets the maximum that the header allows.

    packing : compression of the points; faults : records a wrong number of points in the header
    """
    import lazrs

    start, most = header.start + 8, max(header.total, sum(header.returns))
    at = _table_at(file, header, size)
    file.seek(at)
    head = file.read(8)
    number = struct.unpack("<4xI", head)[0] if len(head) == 8 else 0
    if not 0 < number <= (at - start) // header.row + 1:
        raise ValueError(f"is damaged: the table of its chunks at byte {at:,} has {number:,} entries")
    table = io.BytesIO(head + file.read(min(16 * number + 64, size - at)))  # an entry takes less than 16 bytes
    with damage(f"the table of its chunks at byte {at:,}"):
        entries = lazrs.read_chunk_table_only(table, lazrs.LazVlr(packing.data))
    if entries[-1][1] == 0:  # some programs write an empty entry after a full chunk
        entries.pop()
    rows, sizes = ([entry[k] for entry in entries] for k in (0, 1))
    if not sizes or sum(sizes) != at - start or min(sizes) < header.row:
        raise ValueError(f"is damaged: its chunks have {sum(sizes):,} bytes, {at - start:,} found")
    starts = np.cumsum([start, *sizes[:-1]]).tolist()
    if packing.rows != VARIABLE:
        rows = [packing.rows] * len(sizes)
        rows[-1] = _rows_of_last(file, header, packing, starts[-1], most - sum(rows[:-1]))
    credible = max(most, DENSEST * sum(sizes)) if packing.layers else most
    if min(rows) <= 0 or max(rows) > credible or (packing.layers and sum(rows) > credible):
        raise ValueError(f"is damaged: the header announces {most:,} rows, which its {number:,} chunks contradict")
    if packing.layers or packing.rows == VARIABLE:
        check_total(header, sum(rows), faults)
    return [Part(*part) for part in zip(starts, sizes, rows, strict=True)]


def _rows_of_last(file: BinaryIO, header: Header, packing: Packing, start: int, announced: int) -> int:
    """Return the number of rows of the last chunk, which the table of chunks does not state.

    A chunk of separately compressed layers states it after its first row. For others it is what the header announces,
    or the full number of rows of a chunk if that is impossible.

    start : offset of the chunk; announced : rows of the header that are not in earlier chunks
    """
    if not packing.layers:
        return announced if 0 < announced <= packing.rows else packing.rows
    file.seek(start + header.row)
    raw = file.read(4)
    return min(struct.unpack("<I", raw)[0] if len(raw) == 4 else 0, packing.rows)


def check_total(header: Header, rows: int, faults: Faults) -> None:
    """Record a fault if the number of rows found differs from the number in the header."""
    if rows != header.total:
        faults.add(count_mismatch(header.total, rows, "rows"))


def _table_at(file: BinaryIO, header: Header, size: int) -> int:
    """Return the offset of the table of chunks, which the file states before the points or in its last 8 bytes.

    Raise ValueError if it is invalid. size : of the file in bytes
    """
    for place in (header.start, size - 8):  # a writer that cannot seek stores the offset at the end
        file.seek(place)
        raw = file.read(8)
        at = struct.unpack("<q", raw)[0] if len(raw) == 8 else -1
        if header.start + 8 < at <= size - 8:
            return int(at)
        if at > 0 and place == header.start:
            break
    raise ValueError(f"is cut off: the table of its chunks (byte {header.start:,}) is missing or not yet written")


def unpacked_parts(
    file: BinaryIO, header: Header, packing: Packing, parts: Sequence[Part]
) -> Iterator[tuple[NDArray[np.uint8], int]]:
    """Decompress chunks in groups of about 2^18 rows; yield the rows of a group as bytes, and how many chunks are done.

    The bytes are in a buffer that is reused; the number counts the chunks of all groups so far. Raise ValueError if a
    chunk is damaged.

    parts : the chunks
    """
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
    """Return the number of rows of a chunk that does not state it; raise ValueError if there is not one row.

    Such chunks have no separately compressed layers. The number is found by bisection: decompressing too many rows
    fails at the end of the bytes.

    raw : the compressed bytes; row : bytes per row; part : the chunk, with the maximum number of rows
    """
    out = np.empty(part.rows * row, np.uint8)
    least, most = 0, part.rows  # `least` succeeds, `most` fails
    while most - least > 1:
        rows = (least + most) // 2
        try:
            _decompress(raw, packing, out[: rows * row], [part._replace(rows=rows)])
            least = rows
        except ValueError:
            most = rows
    if not least:
        raise ValueError(f"is damaged: the chunk of points at byte {part.start:,} contains no rows")
    return least


def _groups(parts: Sequence[Part]) -> Iterator[tuple[int, int]]:
    """Yield ranges of chunks (first, last + 1) of about 2^18 rows together, which are decompressed in one call."""
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
    """Check the rows and sizes stated in chunks, which lazrs trusts when it allocates memory.

    A chunk begins with a raw row; layered chunks continue with the number of rows and the sizes of the layers.
    Compressed bytes that begin with 0xffffffff, which no valid stream does, make lazrs end the process.

    raw : compressed bytes of the chunks in `group`; row : bytes per row
    layers : number of separately compressed streams per chunk, 0 if it is not layered
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
                raise ValueError(f"is damaged: the chunk of points at byte {part.start:,} has an invalid stream")
            first += size
        at += part.size
