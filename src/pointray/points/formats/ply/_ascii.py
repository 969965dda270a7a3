"""Vertices of ascii PLY files, some rows at a time."""

from __future__ import annotations

import io
import re
from collections.abc import Iterable, Iterator
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray
from plyfile import PlyListProperty

from .._source import CHUNK
from ._header import Header, check_size, has_lists

Columns = dict[str, NDArray[Any]]

TEXT_BYTES = 1 << 20  # bytes that are looked through together
SPACE, END, LETTER = range(3)  # what a byte of ascii is; a line's end is CR or LF, so that CR LF ends a blank line too
LETTERS = np.array([END if c in "\r\n" else SPACE if c.isspace() else LETTER for c in map(chr, range(256))], np.uint8)


def read_ascii(file: BinaryIO, header: Header, index: int) -> Iterator[Columns]:
    for element, count in zip(header.elements[:index], header.counts[:index], strict=True):
        if element.properties and count:
            _skip_lines(file, element, count)
    vertex, count = header.elements[index], header.counts[index]
    names = [p.name for p in vertex.properties]
    check_size(file, vertex, count, 2 * len(names) - 1)  # a digit and a space, but for the file's last
    lines = io.TextIOWrapper(file, "latin-1")
    try:
        if has_lists(vertex):
            yield _numbers_beside_lists(lines, vertex, count)
            return
        yield from _rows_of_text(iter(lines), names, count)
    finally:
        lines.detach()


def _rows_of_text(lines: Iterator[str], names: list[str], count: int) -> Iterator[Columns]:
    """The numbers of all vertices, some at a time: lines behind them are not read."""
    done = 0
    while done < count:
        try:
            rows = np.loadtxt(lines, np.float64, comments=None, max_rows=min(CHUNK, count - done), ndmin=2)
        except ValueError as error:
            what = str(error).split("; use")[0]  # without advice about loadtxt
            at = re.search(r" at row (\d+)", what)
            if at is not None:
                what = f"{what[: at.start()]} near vertex {done + int(at[1]):,}{what[at.end() :]}"
            raise ValueError(what) from error
        done += len(rows)
        if rows.shape[1] != len(names) or (done < count and len(rows) < CHUNK):
            shape = f"{done:,} of {rows.shape[1]}"
            raise ValueError(f"{count:,} lines of {len(names)} numbers are announced, {shape} are there")
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
