"""Comparison of the counts in a header with the contents of the file."""

from __future__ import annotations

import io
from collections.abc import Iterable, Iterator
from typing import BinaryIO

import numpy as np

from ._source import Faults

BLOCK = 1 << 22  # bytes read at a time
PROBE = 1 << 13  # bytes after the announced rows that are checked for zeros


def readable_rows(announced: int, row: int, there: int, noun: str, faults: Faults) -> int:
    """Return how many of the announced rows of `row` bytes fit into the remaining `there` bytes of a file.

    Missing rows are recorded in `faults`. Raise ValueError if not even one is complete.

    noun : word for the rows in the message, such as "points"
    """
    if announced * row <= there:
        return announced
    message = f"is cut off: {announced:,} {noun} of {row} bytes or more expected, {there:,} bytes found"
    faults.add(f"{message}: {missing(announced, there // row)}")
    if there < row:
        raise ValueError(message)
    return there // row


def count_mismatch(announced: int, there: int, noun: str) -> str:
    """Return a message about a file with `there` rows instead of `announced` ones.

    noun : word for the rows in the message, such as "points"
    """
    text = f"{announced:,} {noun} expected, {there:,} found"
    return text if there > announced else f"{text}: {missing(announced, there)}"


def missing(announced: int, there: int) -> str:
    """Return a message that says how many of `announced` rows are missing in a file with only `there` rows."""
    return f"{announced - there:,} of {announced:,} are missing"


def rows_after(file: BinaryIO, start: int, end: int, row: int) -> int:
    """Return how many rows of `row` bytes fill the range `start` to `end` of a file, after the announced rows.

    Return 0 if the bytes are not a whole number of rows, or begin with zeros: then they are padding.
    """
    file.seek(start)
    is_rows = (end - start) % row == 0 and file.read(min(PROBE, end - start)).strip(b"\0")
    return (end - start) // row if is_rows else 0


def count_lines(file: BinaryIO, end: int | None = None) -> int:
    """Count the lines from the current position of a file to byte `end` (default: its end), except empty ones.

    A line of blanks counts. Lines end with CR, LF or both.
    """
    count, within = 0, False
    here = file.tell()
    left = (file.seek(0, io.SEEK_END) if end is None else end) - here
    file.seek(here)
    while block := file.read(min(BLOCK, left)):
        left -= len(block)
        data = np.frombuffer(block, np.uint8)
        letters = (data != 10) & (data != 13)
        count += int(np.count_nonzero(letters[1:] & ~letters[:-1])) + (bool(letters[0]) and not within)
        within = bool(letters[-1])
    return count


def whole_lines(lines: Iterable[str], fields: int, faults: Faults) -> Iterator[str]:
    """Yield the lines of a text, but not a last one with fewer than `fields` words: the file is cut off within it.

    The omission is recorded in `faults`; if `faults.strict`, the line is yielded.
    """
    held: list[str] = []  # a row, and the blank lines after it
    for line in lines:
        if held and not line.isspace():
            yield from held
            held.clear()
        held.append(line)
    if held and 0 < len(held[0].split()) < fields and not faults.strict:
        faults.add("its last line is cut off")
    else:
        yield from held
