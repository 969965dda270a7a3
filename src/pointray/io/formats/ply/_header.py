"""Header of a PLY file: its elements, their numbers of rows, and where the rows begin.

plyfile parses the grammar and the type names, from a copy of the header with counts of 0.
"""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from plyfile import PlyData, PlyListProperty, PlyParseError

from .._counts import missing
from .._source import Faults
from ._names import VERTICES

LONGEST_HEADER = 1 << 20


class Header(NamedTuple):
    """Contents of the header."""

    elements: Sequence[Any]  # plyfile's PlyElement, without rows
    counts: Sequence[int]
    format: str
    size: int  # bytes
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
    counts = [_count(line) for line in lines if line.split()[0] == "element"]
    return Header(_parse_elements(lines), counts, lines[1].split()[1], last.end(), comments)


def _count(line: str) -> int:
    fields = line.split()
    if len(fields) != 3 or not fields[2].isdecimal() or len(fields[2]) > 15:
        raise ValueError(f"invalid header line {line!r}: expected element, name and count")
    return int(fields[2])


def _parse_elements(lines: list[str]) -> Sequence[Any]:
    """Parse the header with plyfile; with counts of 0 it reads nothing else."""
    empty = [re.sub(r"^(element\s+\S+)\s+\d+$", r"\1 0", line) for line in lines]
    text = "\n".join(empty) + "\n"
    try:
        return tuple(PlyData.read(io.BytesIO(text.encode("ascii", "replace"))).elements)
    except (PlyParseError, ValueError) as error:
        raise ValueError(f"invalid header: {error}") from error


def bytes_left(file: BinaryIO) -> int:
    here = file.tell()
    end = file.seek(0, io.SEEK_END)
    file.seek(here)
    return end - here


def check_size(file: BinaryIO, element: Any, count: int, row: int, faults: Faults | None = None) -> int:
    """Return how many of the announced rows fit into the rest of the file.

    Missing rows are a fault. Raise ValueError if there are no `faults`, or not even one row.
    """
    left = bytes_left(file)
    if count * row <= left:
        return count
    rows = "vertices" if element.name.lower() in VERTICES else f"rows of the element {element.name!r}"
    message = f"is cut off: {count:,} {rows} of {row} bytes or more expected, {left:,} bytes found"
    if faults is None or left < row:
        raise ValueError(message)
    faults.add(f"{message}: {missing(count, left // row)}")
    return left // row


def least_size(p: Any) -> int:
    """Return the minimum bytes of a property: those of a value, or of an empty list."""
    return int(np.dtype(p.list_dtype()[0] if isinstance(p, PlyListProperty) else p.dtype()).itemsize)


def has_lists(element: Any) -> bool:
    return any(isinstance(p, PlyListProperty) for p in element.properties)
