"""Vertices of ascii PLY files, in chunks."""

from __future__ import annotations

import io
import re
from collections.abc import Iterable, Iterator
from itertools import islice
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from ....base.arrays import Doubles
from .._counts import count_mismatch, missing, whole_lines
from .._odd_numbers import plain_lines
from .._source import CHUNK, Faults
from ._header import Element, Header, check_size

Columns = dict[str, NDArray[Any]]

TEXT_BYTES = 1 << 20  # bytes read at a time to skip lines
SPACE, END, LETTER = range(3)  # classes of bytes; CR and LF each end a line: CR LF is a line and a blank line
LETTERS = np.array([END if c in "\r\n" else SPACE if c.isspace() else LETTER for c in map(chr, range(256))], np.uint8)


def read_ascii(file: BinaryIO, header: Header, index: int, most: int, faults: Faults) -> Iterator[Columns]:
    """Yield the columns of the vertices by name, in chunks of rows; a wrong number of vertices is recorded in `faults`.

    index : number of the element with vertices
    most : upper limit for the number of vertices to read, which may exceed the announced one
    """
    for element in header.elements[:index]:
        skip_lines(file, element)
    vertex = header.elements[index]
    names = [p.name for p in vertex.properties]
    if faults.strict:
        check_size(file, vertex, 2 * len(names) - 1)  # digits and separators; the last line may lack a newline
    text = io.TextIOWrapper(file, "latin-1")
    try:
        lines = plain_lines(text)
        if vertex.has_lists:
            yield _numbers_beside_lists(lines, vertex, min(most, vertex.rows), faults)
        else:
            yield from _rows_of_text(whole_lines(lines, len(names), faults), names, vertex.rows, most, faults)
    finally:
        text.detach()


def _rows_of_text(lines: Iterator[str], names: list[str], count: int, most: int, faults: Faults) -> Iterator[Columns]:
    """Yield the columns of the vertices by name, in chunks of rows, from the lines of a text.

    Vertices after the announced ones are read, too; other lines there are recorded in `faults`.

    names : of the columns; count : announced number of vertices; most : upper limit for the number to read
    """
    done, wanted, found = 0, 0, 0
    while done < most and found == wanted:
        wanted = min(CHUNK, (count if done < count else most) - done)
        try:
            rows = _loaded(lines, wanted, done, len(names), count)
        except ValueError:
            if done < count:
                raise
            faults.add(f"{count:,} vertices expected, but other lines follow them")
            return
        found = len(rows)
        done += found
        if found:
            yield dict(zip(names, rows.T, strict=True))
    if done != count:
        message = f"{count:,} lines of {len(names)} numbers expected, {done:,} of {len(names)} found"
        faults.add(message if done > count else f"{message}: {missing(count, done)}")


def _loaded(lines: Iterator[str], wanted: int, done: int, width: int, count: int) -> Doubles:
    """Read the numbers of at most `wanted` lines, (m, width); raise ValueError, with the vertex, if one is invalid.

    done : vertices read before; count : announced number of vertices, for messages
    """
    try:
        rows = np.loadtxt(lines, np.float64, comments=None, max_rows=wanted, ndmin=2)
    except ValueError as error:
        what = str(error).split("; use")[0]  # without the advice about loadtxt
        at = re.search(r" at row (\d+)", what)
        if at is not None:
            what = f"{what[: at.start()]} near vertex {done + int(at[1]):,}{what[at.end() :]}"
        raise ValueError(what) from error
    if len(rows) and rows.shape[1] != width:
        shape = f"{done + len(rows):,} of {rows.shape[1]}"
        raise ValueError(f"{count:,} lines of {width} numbers expected, {shape} found")
    return rows


def skip_lines(file: BinaryIO, element: Element) -> None:
    """Move a text file past the nonblank lines of an element, to the start of the next nonblank line.

    Lines may end with LF, CR or both. Raise ValueError if the file ends before.
    """
    if not element.properties or not element.rows:
        return
    count, within = element.rows, False  # within: whether the current byte is inside a nonblank line
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
    raise ValueError(f"is cut off in the element {element.name!r} or after it")


def _numbers_beside_lists(lines: Iterable[str], vertex: Element, most: int, faults: Faults) -> Columns:
    """Read the scalar columns of vertices that also have lists; the lists are skipped.

    most : upper limit for the number of vertices to read; faults : records missing vertices
    """
    scalars, count = [p.name for p in vertex.scalars], vertex.rows
    rows, done, filled = np.empty((most, len(scalars))), 0, filter(str.strip, lines)
    for line in islice(filled, most):
        numbers = _beside_lists(line.split(), vertex)
        if numbers is None or len(numbers) < len(scalars):
            if faults.strict or next(filled, None) is not None:
                raise ValueError(f"is damaged: vertex {done:,} does not match the properties of the header")
            break
        rows[done] = numbers
        done += 1
    if done < count:
        faults.add(f"is cut off: {count_mismatch(count, done, 'vertices')}")
    return dict(zip(scalars, rows[:done].T, strict=True))


def _beside_lists(fields: list[str], vertex: Element) -> list[str] | None:
    """Return the words of a line that are not in lists, possibly too few; None if it does not fit the properties.

    fields : all words of the line
    """
    at, numbers = 0, []
    for p in vertex.properties:
        if at >= len(fields):
            break
        if p.length is not None:
            at += _length_of(fields[at])
        else:
            numbers.append(fields[at])
        at += 1
    return numbers if at == len(fields) else None


def _length_of(text: str) -> int:
    """Parse the length of a list, which some writers store as a float; raise ValueError if it is invalid."""
    length = float(text)
    if not (length >= 0 and length.is_integer()):  # also rejects NaN
        raise ValueError(f"is damaged: invalid list length {text}")
    return int(length)
