"""Header and records of a LAS file, each number checked against the file's size.

laspy's own reader of headers trusts them: it walks any announced number of records (4 billion take minutes), and reads
the whole file if the points begin inside the header.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from datetime import date, timedelta
from typing import Any, BinaryIO, NamedTuple

from .._source import Faults

SIZES = {0: 227, 1: 227, 2: 227, 3: 235, 4: 375, 5: 393}  # bytes of a header by minor version
LARGEST = 1 << 24  # maximum bytes of a record whose data are read
WANTED = {"LASF_Projection", "LASF_Spec", "laszip encoded", "copc"}
UNWANTED = {("copc", 1000)}  # the list of octree nodes, which is read in pages


class Record(NamedTuple):
    """A variable length record of a LAS file.

    Attributes
    ----------
    user, id : str and int
        Together they say what kind of record it is.
    start, size : int
        Offset and size of its data in bytes.
    data : bytes
        Data of records that the reader needs; empty for others.
    """

    user: str
    id: int
    start: int
    size: int
    data: bytes


class Header(NamedTuple):
    """Contents of the header.

    Attributes
    ----------
    minor : int
        Minor version: 4 for 1.4.
    format, row, total : int
        Point format, bytes per point and number of points.
    compressed : bool
    start, end : int
        Range of bytes of the points.
    returns : tuple of int
        Number of points for each return number: first returns, second returns and so on.
    scale, offset : (3,) tuple of float
        coordinate = offset + scale * integer.
    low, high : (3,) tuple of float
        Stated bounds of the points.
    records : tuple of Record
        Variable length records, also the extended ones after the points.
    stated : dict
        Version, software and so on, for `pointray info`.
    """

    minor: int
    format: int
    row: int
    total: int
    compressed: bool
    start: int
    end: int
    returns: tuple[int, ...]
    scale: tuple[float, float, float]
    offset: tuple[float, float, float]
    low: tuple[float, ...]
    high: tuple[float, ...]
    records: tuple[Record, ...]
    stated: dict[str, Any]

    def data_of(self, user: str, id: int) -> bytes | None:
        """Return the data of the first record with this user and number; None if there is none."""
        return next(iter(self.all_of(user, id)), None)

    def all_of(self, user: str, id: int) -> list[bytes]:
        """Return the data of all records with this user and number, without duplicates."""
        return list(dict.fromkeys(record.data for record in self.records if (record.user, record.id) == (user, id)))


def read_header(file: BinaryIO, size: int, faults: Faults) -> Header:
    """Read and check the header and the variable length records of a file of `size` bytes.

    Records that do not fit into the file are recorded in `faults`. Raise ValueError if the header is invalid.
    """
    file.seek(0)
    head = file.read(max(SIZES.values()))
    if len(head) < SIZES[0]:
        raise ValueError(f"is cut off in its header: {len(head)} bytes of {SIZES[0]}")
    major, minor = head[24], head[25]
    if major != 1 or minor not in SIZES:
        raise ValueError(f"unsupported LAS version {major}.{minor} (byte 24): expected 1.0 to 1.5")
    header_size, start, records = struct.unpack_from("<HII", head, 94)
    if header_size < SIZES[minor]:
        raise ValueError(f"is damaged: header size {header_size} (byte 94), expected {SIZES[minor]} or more")
    if not header_size <= start <= size or len(head) < SIZES[minor]:
        raise ValueError(f"is cut off or damaged: its points begin at byte {start:,} (byte 96) of {size:,}")
    found = [*_walk(file, (header_size, start), records, 54, faults)]
    end, waves = size, 0
    if minor >= 3:
        (waves,) = struct.unpack_from("<Q", head, 227)
    if minor >= 4:
        trailing, number = struct.unpack_from("<QI", head, 235)
        if number:
            if start <= trailing <= size:
                found += _walk(file, (trailing, size), number, 60, faults)
                end = trailing
            else:
                faults.add(
                    f"its extended variable length records begin at invalid byte {trailing:,} (byte 235): ignored"
                )
    return _filled(head, minor, start, min(end, waves) if start < waves <= size else end, tuple(found))


def _filled(head: bytes, minor: int, start: int, end: int, records: tuple[Record, ...]) -> Header:
    kind, row, count, *returns = struct.unpack_from("<BHI5I", head, 104)
    if minor >= 4:
        newer, *newer_returns = struct.unpack_from("<Q15Q", head, 247)
        if newer:
            count, returns = newer, newer_returns
    numbers = struct.unpack_from("<12d", head, 131)
    scale, offset = numbers[:3], numbers[3:6]
    for name, triple, good in (("scale", scale, 0 < min(scale)), ("offset", offset, True)):
        if not (good and all(abs(x) < float("inf") for x in triple)):  # also rejects NaN
            raise ValueError(f"is damaged: invalid coordinate {name} {triple} (byte 131)")
    return Header(
        minor,
        kind & 0x3F,
        row,
        count,
        bool(kind & 0x80),
        start,
        end,
        tuple(returns),
        scale,
        offset,
        numbers[7::2],
        numbers[6::2],
        records,
        {
            "version": f"1.{minor}",
            "system": _text(head[26:58]),
            "software": _text(head[58:90]),
            "date": _date(*struct.unpack_from("<HH", head, 90)),
        },
    )


def _walk(file: BinaryIO, where: tuple[int, int], number: int, head: int, faults: Faults) -> Iterator[Record]:
    """Yield the variable length records in a range of bytes.

    A record that does not fit is recorded in `faults`, and ends the iteration.

    where : first byte and end of the range; number : announced number of records
    head : bytes before the data of a record: 54, or 60 for extended records
    """
    start, end = where
    for k in range(number):
        file.seek(start)
        raw = file.read(head) if head <= end - start else b""
        size = struct.unpack_from("<H" if head == 54 else "<Q", raw, 20)[0] if raw else 0
        if not raw or size > end - start - head:
            kind = "" if head == 54 else "extended "
            faults.add(f"contains {k:,} of {number:,} {kind}variable length records announced, before byte {end:,}")
            return
        user, id = _text(raw[2:18]), struct.unpack_from("<H", raw, 18)[0]
        wanted = user in WANTED and size <= LARGEST and (user, id) not in UNWANTED
        yield Record(user, id, start + head, size, file.read(size) if wanted else b"")
        start += head + size


def _text(raw: bytes) -> str:
    """Decode a zero-terminated text as UTF-8, or as Latin-1 if it is not UTF-8."""
    raw = raw.split(b"\0")[0]
    try:
        return raw.decode().strip()
    except UnicodeDecodeError:
        return raw.decode("latin-1").strip()


def _date(day: int, year: int) -> str | None:
    """Return the date of a day of a year, from 1, as YYYY-MM-DD; None if it is invalid or the day is 0."""
    try:
        return str(date(year, 1, 1) + timedelta(day - 1)) if day else None
    except (ValueError, OverflowError):
        return None
