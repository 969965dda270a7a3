"""Header of a PCD file: its fields, the number of points, their encoding and where they begin."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any, BinaryIO, NamedTuple

import numpy as np

from .._source import Faults

LONGEST_HEADER = 1 << 20
PADDING = "_"
KINDS = {"I": "i", "U": "u", "F": "f"}
ENCODINGS = ("ascii", "binary", "binary_compressed")
WORDS = ("VERSION", "FIELDS", "SIZE", "TYPE", "COUNT", "WIDTH", "HEIGHT", "VIEWPOINT", "POINTS", "DATA")
IDENTITY = (1.0, 0.0, 0.0, 0.0)


class Field(NamedTuple):
    """A field of a PCD file with `width` numbers per point."""

    name: str
    dtype: np.dtype[Any]
    width: int

    @property
    def size(self) -> int:
        """Bytes of the field in a row."""
        return self.dtype.itemsize * self.width


class Header(NamedTuple):
    """Contents of the header.

    Attributes
    ----------
    version : str
        Version of the format, or "".
    fields : sequence of Field
        In the file's order, including padding.
    points : int
        Number of points.
    shape : (int, int)
        Width and height, in pixels for an organised cloud.
    station : (3,) tuple of float or None
        Scanner position; None if unknown.
    encoding : str
        "ascii", "binary" or "binary_compressed".
    size, lines : int
        Bytes and lines of the header.
    """

    version: str
    fields: Sequence[Field]
    points: int
    shape: tuple[int, int]
    station: tuple[float, float, float] | None
    encoding: str
    size: int
    lines: int

    @property
    def row(self) -> int:
        """Bytes per row."""
        return sum(field.size for field in self.fields)

    @property
    def kept(self) -> list[Field]:
        """Fields other than padding."""
        return [field for field in self.fields if field.name != PADDING]


class Line(NamedTuple):
    """A line of the header: its number, from 1, and the words after the first."""

    number: int
    values: list[str]


def read_header(file: BinaryIO, faults: Faults) -> Header:
    """Read the header of a file; raise ValueError if it is invalid. Contradictory sizes are recorded in `faults`."""
    start = file.read(LONGEST_HEADER)
    last = re.search(rb"(?m)^[ \t]*DATA\b[^\n]*\n", start)
    if last is None:
        raise ValueError("the header is cut off: line 'DATA' not found")
    text = start[: last.end()].decode("latin-1")
    lines = _lines(text)
    encoding = " ".join(lines["DATA"].values).lower()
    if encoding not in ENCODINGS:
        raise ValueError(f"line {lines['DATA'].number}: got data {encoding[:30]!r}, expected {', '.join(ENCODINGS)}")
    fields = _fields(lines)
    count, shape = _count(lines, faults)
    version = " ".join(lines["VERSION"].values) if "VERSION" in lines else ""
    return Header(version, fields, count, shape, _station(lines), encoding, last.end(), text.count("\n"))


def _lines(text: str) -> dict[str, Line]:
    """Return the lines of a header by their first words."""
    lines: dict[str, Line] = {}
    for number, line in enumerate(text.split("\n"), 1):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        word = "FIELDS" if words[0] == "COLUMNS" else words[0]
        if word not in WORDS:
            raise ValueError(f"line {number}: {line.strip()[:40]!r} is not valid in a PCD header")
        if word in lines:
            raise ValueError(f"line {number}: duplicate line {word}")
        lines[word] = Line(number, words[1:])
    return lines


def _whole(text: str, number: int) -> int:
    if not (text.isascii() and text.isdecimal() and len(text) <= 15):
        raise ValueError(f"line {number}: {text[:40]!r} is not an integer")
    return int(text)


def _fields(lines: dict[str, Line]) -> list[Field]:
    if "FIELDS" not in lines:
        raise ValueError("invalid header: line FIELDS not found")
    names = lines["FIELDS"].values
    sizes, types, counts = (_row_of(lines, *one, len(names)) for one in (("SIZE", "4"), ("TYPE", "F"), ("COUNT", "1")))
    seen: set[str] = set()
    fields = []
    for name, size, kind, count in zip(names, sizes.values, types.values, counts.values, strict=True):
        if name in seen:
            raise ValueError(f"line {lines['FIELDS'].number}: duplicate field {name[:30]!r}")
        letter = kind.upper()
        if letter not in KINDS or size not in ("1", "2", "4", "8") or (letter, size) == ("F", "1"):
            raise ValueError(
                f"line {types.number}: the field {name[:30]!r} has an unknown type: {(kind + ' ' + size)[:30]!r}"
            )
        many = _whole(count, counts.number)
        seen |= {name} - {PADDING}
        if many > 0:  # a field without values is padding that takes no bytes (Ouster)
            fields.append(Field(name, np.dtype(f"<{KINDS[letter]}{size}"), many))
    return fields


def _row_of(lines: dict[str, Line], word: str, default: str, length: int) -> Line:
    """Return a header line that has one value per field; raise ValueError for another number of values.

    lines : of the header, by their first words; word : SIZE, TYPE or COUNT, which begins the wanted line
    default : value of all fields if there is no such line; length : number of fields
    """
    line = lines.get(word)
    if line is None:
        return Line(0, [default] * length)
    if len(line.values) != length:
        raise ValueError(f"line {line.number}: {word} has {len(line.values)} values for {length} fields")
    return line


def _count(lines: dict[str, Line], faults: Faults) -> tuple[int, tuple[int, int]]:
    """Return the number of points, and width and height. Old files lack the height, some lack both.

    lines : of the header, by their first words; faults : records a contradiction between them
    """

    def one(word: str, default: int) -> int:
        line = lines.get(word)
        if line is not None and len(line.values) != 1:
            raise ValueError(f"line {line.number}: {word} has {len(line.values)} values, expected 1")
        return default if line is None else _whole(line.values[0], line.number)

    points, width, height = one("POINTS", -1), one("WIDTH", 0), one("HEIGHT", 0)
    if width == 0 and height <= 1:
        width = max(points, 0)
    height = height or 1
    if points < 0 and "WIDTH" not in lines:
        raise ValueError("invalid header: neither POINTS nor WIDTH found")
    if points >= 0 and width * height != points:
        where = f"line {lines['POINTS'].number}"
        faults.add(f"{where}: {points:,} points announced, but WIDTH x HEIGHT is {width:,} x {height:,}")
        width, height = points, 1
    if width * height == 0:
        raise ValueError("contains no points: the header announces 0")
    return width * height, (width, height)


def _station(lines: dict[str, Line]) -> tuple[float, float, float] | None:
    """Return the scanner position; None for the default pose, which programs write if it is unknown.

    lines : of the header, by their first words
    """
    line = lines.get("VIEWPOINT")
    if line is None:
        return None
    try:
        x, y, z, *turn = (float(value) for value in line.values)
        if len(turn) != 4:
            raise ValueError
    except ValueError:
        raise ValueError(f"line {line.number}: VIEWPOINT must be 7 numbers, tx ty tz qw qx qy qz") from None
    known = any((x, y, z)) or (tuple(turn) != IDENTITY and any(turn))
    return (x, y, z) if known and np.isfinite((x, y, z)).all() else None
