"""SPZ: Niantic's compressed 3D Gaussian splatting, at most 20 bytes per splat.

Data are stored column by column. Versions 1 to 3 are compressed with gzip as a whole, which is removed before the file
is opened here. In version 4 each column is compressed with Zstandard, after a table of the sizes. Axes are unchanged: x
right, y up, z backward.
"""

from __future__ import annotations

import io
import struct
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ....base.arrays import Floats
from ....base.extras import require
from ....cloud.georeference import Georeference
from .._source import NO, SURE, Chunk, Format, Request, Source
from ._common import HARMONIC, KEEPS, ROWS, Splats, listing_of, opaque_chunks, smallest_three
from ._spz_write import FINEST, HEADER, MAGIC, OLD, SHADE, write

TABLE_ROW = struct.Struct("<QQ")  # compressed and uncompressed bytes of a column
HARMONICS = (0, 3, 8, 15, 24)  # number of spherical harmonics above degree 0, by maximum degree
ZSTD_RATIO = 1024  # maximum ratio of the uncompressed columns to the file size, as in Niantic's library
ANTIALIASED = 1
ROOT_HALF = np.float32(0.5**0.5)

Bytes = NDArray[np.uint8]


class Header(NamedTuple):
    """Contents of the header.

    Attributes
    ----------
    version, splats : int
        Version of the format and number of splats.
    degree : int
        Maximum degree of the spherical harmonics.
    bits : int
        Fractional bits of the coordinates.
    flags : int
        Bit 0: trained with antialiasing.
    columns : int
        Number of columns, in version 4.
    table : int
        Offset of the table of columns, in version 4.
    """

    version: int
    splats: int
    degree: int
    bits: int
    flags: int
    columns: int
    table: int

    @property
    def widths(self) -> tuple[int, ...]:
        """Bytes per splat in each column: position, opacity, colour, scale, rotation, harmonics."""
        return 6 if self.version == 1 else 9, 1, 3, 3, 4 if self.version > 2 else 3, 3 * HARMONICS[self.degree]


def recognise(head: bytes, path: Path) -> int:
    """Detect SPZ files: return `SURE` or `NO`. Versions 1 to 3 must have been decompressed.

    head : first bytes of the file
    """
    return SURE if head.startswith(MAGIC) else NO


class SpzSource(Source):
    """Reader of Gaussian splats in SPZ files."""

    def __init__(self, path: Path, request: Request) -> None:
        self._path, self._opacity = path, request.opacity
        with path.open("rb") as file:
            self._header = header = _read_header(file)
            self._parts = _packed_parts(file, header) if header.version > 3 else _plain_parts(file, header)
        if header.version > 3:
            require("backports.zstd", "files", "an SPZ file of version 4")
        self._facts: dict[str, Any] = {
            "version": header.version,
            "splats": header.splats,
            "harmonics": header.degree,
            "antialiased": bool(header.flags & ANTIALIASED),
        }
        listing = listing_of(header.splats, self._opacity, self._facts)
        self.listing = replace(listing, georeference=Georeference(format="SPZ"))

    def chunks(self) -> Iterator[Chunk]:
        return opaque_chunks(self._splats(), self._opacity, self._facts)

    def _splats(self) -> Iterator[tuple[Splats, float]]:
        header = self._header
        with ExitStack() as stack:
            files = [_column(self._path, part, header.version > 3, stack) for part in self._parts]
            for first in range(0, header.splats, ROWS):
                n = min(ROWS, header.splats - first)
                columns = [_read(f, n, w, first) for f, w in zip(files, header.widths, strict=False)]
                yield _unpack(header, columns), (first + n) / header.splats


# --------------------------------------------------------------------------------------------------------- header


def _read_header(file: BinaryIO) -> Header:
    """Read the header of a file; raise ValueError if it is invalid."""
    start = file.read(HEADER.size)
    if len(start) < OLD:
        raise ValueError(f"is cut off: expected a header of {OLD} bytes, got {len(start)}")
    magic, *fields = HEADER.unpack(start.ljust(HEADER.size, b"\0"))
    if magic != MAGIC:
        raise ValueError(f"is not an SPZ file: it begins with {magic!r}")
    header = Header(*fields)
    if not 1 <= header.version <= 4:
        raise ValueError(f"unsupported SPZ version {header.version}; expected 1 to 4")
    if header.splats == 0:
        raise ValueError("contains no points: the header announces 0 splats")
    if header.degree >= len(HARMONICS):
        raise ValueError(f"is damaged: invalid degree {header.degree} of harmonics, more than {len(HARMONICS) - 1}")
    if header.bits > FINEST:
        raise ValueError(f"is damaged: its coordinates have {header.bits} fractional bits, more than {FINEST}")
    return header


def _plain_parts(file: BinaryIO, header: Header) -> list[tuple[int, int]]:
    """Return offset and bytes of each uncompressed column but the harmonics; ValueError if the file is cut off."""
    size, end, parts = file.seek(0, io.SEEK_END), OLD, []
    for width in header.widths:
        parts.append((end, header.splats * width))
        end += header.splats * width
    if end > size:
        raise ValueError(f"is cut off: {header.splats:,} splats reach to byte {end:,}, {size:,} bytes found")
    return parts[:-1]


def _packed_parts(file: BinaryIO, header: Header) -> list[tuple[int, int]]:
    """Return offset and bytes of each compressed column but the harmonics, from the table in the file.

    Raise ValueError if the table is inconsistent or the file is cut off.
    """
    size = file.seek(0, io.SEEK_END)
    needed = [header.splats * width for width in header.widths if width]
    if header.columns != len(needed):
        raise ValueError(f"is damaged: got {header.columns} columns, expected {len(needed)}")
    end = header.table + header.columns * TABLE_ROW.size
    if header.table < HEADER.size or end > size:
        raise ValueError(f"is cut off: its table of columns is at byte {header.table:,} of {size:,}")
    file.seek(header.table)
    parts: list[tuple[int, int]] = []
    for length, unpacked in TABLE_ROW.iter_unpack(file.read(header.columns * TABLE_ROW.size)):
        if unpacked != needed[len(parts)]:
            raise ValueError(f"is damaged: column {len(parts)} has {unpacked:,} bytes, expected {needed[len(parts)]:,}")
        parts.append((end, length))
        end += length
    if end > size:
        raise ValueError(f"is cut off: its columns reach to byte {end:,}, {size:,} bytes found")
    if needed[0] > ZSTD_RATIO * size:
        raise ValueError(f"is damaged: {header.splats:,} splats do not fit into {size:,} bytes")
    return parts[:5]


# -------------------------------------------------------------------------------------------------------- columns


class _Part(io.RawIOBase):
    """Range of bytes of a file, readable as a file of its own."""

    def __init__(self, file: BinaryIO, start: int, length: int) -> None:
        self._file, self._left = file, length
        file.seek(start)

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int:
        block = self._file.read(min(self._left, len(buffer)))
        self._left -= len(block)
        buffer[: len(block)] = block
        return len(block)


def _column(path: Path, part: tuple[int, int], packed: bool, stack: ExitStack) -> Any:
    """Open a column as a file of uncompressed bytes that is closed with the stack.

    part : offset and bytes of the column; packed : whether it is compressed
    """
    raw = _Part(stack.enter_context(path.open("rb")), *part)
    if not packed:
        return raw
    return stack.enter_context(require("backports.zstd", "files", "an SPZ file of version 4").ZstdFile(raw))


def _read(file: Any, n: int, width: int, first: int) -> Bytes:
    """Read the next n rows of a column, (n, width) uint8. first : number of the first splat, for messages"""
    blocks, missing = [], n * width
    while missing:
        try:
            block = file.read(missing)
        except Exception as error:
            if isinstance(error, OSError):
                raise
            raise ValueError(f"is damaged near splat {first:,}: {error}") from error  # EOFError, ZstdError
        if not block:
            raise ValueError(f"is cut off near splat {first + (n * width - missing) // width:,}")
        blocks.append(block)
        missing -= len(block)
    return np.frombuffer(b"".join(blocks), np.uint8).reshape(n, width)


# ------------------------------------------------------------------------------------------------------ unpacking


@np.errstate(over="ignore", invalid="ignore")
def _unpack(header: Header, columns: list[Bytes]) -> Splats:
    places, opacity, shades, scales, turns = columns
    return Splats(
        places.view("<f2").astype(np.float32) if header.version == 1 else _fixed(places, header.bits),
        0.5 + (shades / np.float32(255) - np.float32(0.5)) * np.float32(HARMONIC / SHADE),
        opacity[:, 0] / np.float32(255),
        np.exp(scales / np.float32(16) - np.float32(10)),
        _quaternions(turns),
    )


def _fixed(places: Bytes, bits: int) -> Floats:
    """Convert signed 24-bit fixed-point coordinates, (n, 9) uint8, to (n, 3) float32, which is exact.

    bits : number of fractional bits
    """
    wide = np.zeros((len(places), 3, 4), np.uint8)
    wide[:, :, 1:] = places.reshape(-1, 3, 3)
    return (wide.view("<i4")[:, :, 0] >> 8).astype(np.float32) * np.float32(2.0**-bits)


def _quaternions(turns: Bytes) -> Floats:
    """Decode quaternions w, x, y, z, (n, 4).

    turns : (n, 3) uint8: x, y, z, where w is positive; or (n, 4): the three smallest components in 10 bits each
    """
    if turns.shape[1] == 3:
        return smallest_three(np.zeros(len(turns)), turns / np.float32(127.5) - 1)
    word = turns.view("<u4")[:, 0]
    rest = np.empty((len(word), 3), np.float32)
    for k, shift in enumerate((20, 10, 0)):
        part = (word >> shift) & 1023
        rest[:, k] = np.where(part & 512, -1, 1) * (part & 511) * (ROOT_HALF / 511)
    return np.roll(smallest_three(word >> 30, rest), 1, axis=1)  # stored as x, y, z, w


FORMAT = Format("SPZ", (".spz",), recognise, SpzSource, KEEPS, write=write)
