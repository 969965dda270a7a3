"""Header of a PLY file: its elements, their numbers of rows, and where the rows begin."""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from typing import Any, BinaryIO, Literal, NamedTuple

import numpy as np

from .._counts import missing
from .._source import Faults
from ._names import VERTICES

LONGEST_HEADER = 1 << 20
Order = Literal["<", ">"]
FORMAT = re.compile(r"format\s+(ascii|binary_little_endian|binary_big_endian)\s+1\.0")
NAMES = {"i1": "char", "u1": "uchar", "i2": "short", "u2": "ushort", "i4": "int", "u4": "uint"}
NAMES |= {"f4": "float", "f8": "double"}  # of NumPy types
TYPES = {name: np.dtype(code) for code, name in NAMES.items()} | {np.dtype(code).name: np.dtype(code) for code in NAMES}


class Property(NamedTuple):
    """Property of an element: a number, or a list of numbers.

    Attributes
    ----------
    name : str
    type : dtype
        Of the number, or of the numbers in the list.
    length : dtype or None
        Of the list's length; None for a number.
    """

    name: str
    type: np.dtype[Any]
    length: np.dtype[Any] | None = None

    @property
    def least_size(self) -> int:
        """Minimum bytes in a row: those of a number, or of an empty list."""
        return (self.type if self.length is None else self.length).itemsize


class Element(NamedTuple):
    """Element of a file: rows of properties."""

    name: str
    rows: int
    properties: list[Property]

    @property
    def scalars(self) -> list[Property]:
        """Properties that are not lists."""
        return [p for p in self.properties if p.length is None]

    @property
    def has_lists(self) -> bool:
        """Whether any property is a list."""
        return len(self.scalars) < len(self.properties)

    @property
    def least_size(self) -> int:
        """Minimum bytes of a row."""
        return sum(p.least_size for p in self.properties)

    def dtype(self, order: Order) -> np.dtype[Any]:
        """Return the structured dtype of the scalars of a row. order : "<" or ">", the byte order"""
        return np.dtype([(p.name, p.type.newbyteorder(order)) for p in self.scalars])


class Header(NamedTuple):
    """Contents of the header.

    Attributes
    ----------
    elements : sequence of Element
    format : str
        "ascii", "binary_little_endian" or "binary_big_endian".
    size : int
        Bytes of the header.
    comments : sequence of str
        Texts of the lines comment and obj_info.
    """

    elements: Sequence[Element]
    format: str
    size: int
    comments: Sequence[str]


def read_header(file: BinaryIO) -> Header:
    """Read the header of a file; raise ValueError if it is invalid."""
    start = file.read(LONGEST_HEADER)
    first = re.match(rb"ply[ \t]*(\r\n|\n|\r)", start)
    if first is None:
        raise ValueError("is empty" if not start else f"is not a PLY file: it begins with {start[:12]!r}")
    # After a bare CR the data begin, even if the next byte is an LF.
    end = {b"\r\n": rb"\r?\n", b"\n": rb"[ \t\r]*\n", b"\r": rb"[ \t]*\r"}[first[1]]
    last = re.search(rb"[\r\n][ \t]*end_header" + end, start)
    if last is None:
        raise ValueError("the header is cut off: line 'end_header' not found")
    lines = [line.strip() for line in start[: last.end()].decode("latin-1").splitlines()]
    comments = [line.split(None, 1)[1] for line in lines if re.match(r"(comment|obj_info)\s+\S", line)]
    lines = [line for line in lines if line and line.split()[0] not in ("comment", "obj_info")]
    encoding = FORMAT.fullmatch(lines[1])
    if encoding is None:
        raise ValueError(f"invalid header line {lines[1][:80]!r}: expected format, encoding and 1.0")
    return Header(_parse_elements(lines[2:-1]), encoding[1], last.end(), comments)


def _parse_elements(lines: Sequence[str]) -> Sequence[Element]:
    """Parse the lines of a header that declare elements and their properties; raise ValueError for other lines."""
    elements: list[Element] = []
    for line in lines:
        match line.encode("ascii", "replace").decode().split():
            case ["element", name, count] if count.isdecimal() and len(count) <= 15:
                elements.append(Element(name, int(count), []))
            case ["property", kind, name] if elements and kind in TYPES:
                elements[-1].properties.append(Property(name, TYPES[kind]))
            case ["property", "list", length, kind, name] if elements and {length, kind} <= TYPES.keys():
                elements[-1].properties.append(Property(name, TYPES[kind], TYPES[length]))
            case _:
                raise ValueError(
                    f"invalid header line {line[:80]!r}: expected element, name and count, or property, type and name; "
                    f"types: {', '.join(TYPES)}"
                )
    for names in ([e.name for e in elements], *([p.name for p in e.properties] for e in elements)):
        if len(set(names)) < len(names):
            raise ValueError("invalid header: two elements, or two properties of an element, have the same name")
    return elements


def bytes_left(file: BinaryIO) -> int:
    here = file.tell()
    end = file.seek(0, io.SEEK_END)
    file.seek(here)
    return end - here


def check_size(file: BinaryIO, element: Element, row: int, faults: Faults | None = None) -> int:
    """Return how many of an element's announced rows of `row` bytes fit into the rest of the file.

    Missing rows are recorded in `faults`. Raise ValueError if rows are missing and `faults` is None, or if not even one
    row fits.
    """
    left, count = bytes_left(file), element.rows
    if count * row <= left:
        return count
    rows = "vertices" if element.name.lower() in VERTICES else f"rows of the element {element.name!r}"
    message = f"is cut off: {count:,} {rows} of {row} bytes or more expected, {left:,} bytes found"
    if faults is None or left < row:
        raise ValueError(message)
    faults.add(f"{message}: {missing(count, left // row)}")
    return left // row
