"""Parsing of columns of numbers in text, block by block on all cores.

Each number equals the result of Python's float to the last bit; integers stay integers. The compiled part is
`_number_kernel`. 10 million lines of six numbers (330 MB) take 1.6 s on one core; np.loadtxt takes 9.7 s.

`Dialect` describes the separators, `Reader` reads blocks of rows.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ....engine.jit import run
from .._odd_numbers import odd_number
from .._source import Faults
from ._lines import BLOCK, LONGEST, line_at, shortened
from ._number_kernel import (
    BLANK,
    COLUMNS,
    DELIMITER,
    DIGIT,
    DOT,
    END,
    FINE,
    FLOAT,
    INT,
    IS_WHOLE,
    LEAST,
    MARK,
    MOST,
    NOT_WHOLE,
    ODD,
    ROWS,
    SCAN,
    SINGLE,
    SKIP,
    STATES,
    STATS,
    WHERE,
    WHY,
    parse_pieces,
)
from ._powers_of_ten import powers_of_ten

__all__ = ["FLOAT", "INT", "SCAN", "SKIP", "Block", "Dialect", "Reader", "line_at", "number_of", "smallest"]

ROW = 64  # approximate bytes of a row
FIRST = 1 << 14  # bytes of the first block after a line that interrupts the rows: such lines may be close together
PIECE = 1 << 18  # bytes of a block that a thread parses at a time
NUMBER = re.compile(r"[+-]?((\d+(\.\d*)?|\.\d+)(e[+-]?\d+)?|nan|inf|infinity)", re.IGNORECASE | re.ASCII)


class Dialect(NamedTuple):
    """Notation of numbers in a text.

    Attributes
    ----------
    delimiters : bytes
        Each of these bytes separates two fields, which may be empty. Any number of blanks separates too.
    decimal : bytes
        Decimal separator.
    comments : bool
        Whether lines beginning with # or // are skipped.
    newline : bytes
        Byte that ends lines.
    """

    delimiters: bytes = b""
    decimal: bytes = b"."
    comments: bool = True
    newline: bytes = b"\n"

    @property
    def table(self) -> NDArray[np.uint8]:
        """Class of each byte value for the parser, (256,): digit, decimal sign, blank, delimiter, line end, other."""
        table = np.zeros(256, np.uint8)
        for kind, letters in (
            (DIGIT, b"0123456789"),
            (BLANK, b' \t\v\f"\x1a'),  # also quotes around numbers in CSV, and the end-of-file byte of MS-DOS
            (END, b"\r\n"),
            (DOT, self.decimal),
            (DELIMITER, self.delimiters),
        ):
            table[list(letters)] = kind
        return table


@dataclass(frozen=True)
class Block:
    """Some parsed rows of a text.

    Attributes
    ----------
    pieces : list of (n, k) int64
        Bits of float64, or integers, for k columns; valid until the next block is read.
    modes : (k,) uint8
        How each column was read: `FLOAT`, `INT`, `SCAN` or `SKIP`.
    stats : (k, 3) int64
        For columns in mode `SCAN` or `INT`: whether all values are integers, the minimum and the maximum.
    end : int
        Offset in the file after the last row.
    """

    pieces: Sequence[NDArray[np.int64]]
    modes: NDArray[np.uint8]
    stats: NDArray[np.int64]
    end: int

    def __len__(self) -> int:
        return sum(map(len, self.pieces))

    def take(self, columns: Sequence[int], dtype: Any) -> NDArray[Any]:
        """Return the columns with these numbers as an array (n, m) of `dtype`."""
        out, start = np.empty((len(self), len(columns)), dtype), 0
        with np.errstate(over="ignore"):  # overflow to infinity
            for piece in self.pieces:
                rows = slice(start, start + len(piece))
                for j, c in enumerate(columns):
                    out[rows, j] = piece[:, c].view(np.float64) if self.modes[c] == FLOAT else piece[:, c]
                start += len(piece)
        return out


class Reader:
    """Parser of the rows of numbers in a text file, from an offset on.

    Parameters
    ----------
    file : binary stream
    dialect : Dialect
        Separators and decimal sign.
    modes : sequence of int
        How to read each column: `FLOAT`, `INT`, `SKIP` (it may contain anything), or `SCAN`, which only finds whether
        it has integers, and their limits.
    start : int
        Offset of the first row.
    rows : int or None
        Expected number of rows, which limits the first read.
    faults : Faults, optional
        Receives the fault of an incomplete last line, which is left out.

    Attributes
    ----------
    at : int
        Current offset: the end of the file, or a line with a single field, which ends the rows.
    """

    def __init__(
        self,
        file: BinaryIO,
        dialect: Dialect,
        modes: Sequence[int],
        start: int = 0,
        rows: int | None = None,
        faults: Faults | None = None,
    ) -> None:
        self._file, self._dialect, self._faults = file, dialect, faults
        self._modes = np.array(modes, np.uint8)
        self._setting = np.concatenate([dialect.table, [dialect.comments], self._modes]).astype(np.uint8)
        self._out = np.empty(0, np.int64)
        self.at = start
        self._next = BLOCK if rows is None else min(BLOCK, FIRST + rows * ROW)

    def blocks(self) -> Iterator[Block]:
        """Yield the rows in blocks, to the end of the file or a line with a single field.

        Raise ValueError, with the line, for a wrong number of columns or an invalid number.
        """
        while text := self._read():
            block, why, where = self._parse(text)
            if why in (COLUMNS, NOT_WHOLE) and not self._is_cut(where):
                raise self._error(why, where)
            self.at = where if why == SINGLE else self.at + len(text)
            self._next = min(2 * self._next, BLOCK)
            yield replace(block, end=self.at)
            if why == SINGLE:
                self._next = FIRST
                return

    def _read(self) -> bytes:
        """Return the next whole lines of the file, up to 4 MiB or one longer line; b"" at the end."""
        self._file.seek(self.at)
        text = self._file.read(self._next)
        wanted, end = self._next, text.rfind(self._dialect.newline)
        while len(text) == wanted and end < 0:
            if len(text) > LONGEST:
                raise ValueError(f"line {line_at(self._file, self.at)[0]:,} is longer than {LONGEST:,} bytes")
            more = self._file.read(FIRST)
            wanted += FIRST
            end = len(text) + more.rfind(self._dialect.newline) if self._dialect.newline in more else -1
            text += more
        if len(text) == wanted:
            return text[: end + 1]
        return text + b"\n" if text and text[-1:] not in (b"\r", b"\n") else text  # the last line may lack a newline

    def _parse(self, text: bytes) -> tuple[Block, int, int]:
        """Parse whole lines; return their rows, why parsing ended, and at which offset in the file.

        The reason is `FINE` if all lines are parsed, otherwise the kind of error in the line at the offset.
        """
        pieces = self._cut(text)
        count, k = len(pieces) - 1, len(self._modes)
        states = np.zeros((count, STATES), np.int64)
        stats = np.zeros((count, k, STATS), np.int64)
        stats[:] = [1, np.iinfo(np.int64).max, np.iinfo(np.int64).min]
        if len(self._out) < len(text):
            self._out = np.empty(len(text), np.int64)
        data = np.frombuffer(text, np.uint8)
        run(parse_pieces, count, data, pieces, self._setting, powers_of_ten(), self._out, states, stats)
        rows = []
        why, where = FINE, len(text)
        for t, state in enumerate(states):
            items = self._out[pieces[t] : pieces[t] + state[ROWS] * k].reshape(-1, k)
            if state[ODD]:
                items = items[: self._read_odd(text, items)]
            rows.append(items)
            if state[WHY] != FINE:
                why, where = int(state[WHY]), int(state[WHERE])
                break
        stats = stats[: len(rows)]
        limits = np.stack(
            [stats[..., IS_WHOLE].min(axis=0), stats[..., LEAST].min(axis=0), stats[..., MOST].max(axis=0)], axis=1
        )
        return Block(rows, self._modes, limits, 0), why, self.at + where

    def _cut(self, text: bytes) -> NDArray[np.int64]:
        """Divide a text into pieces of whole lines for threads; return their offsets, followed by its end."""
        starts = [0]
        while starts[-1] + 2 * PIECE < len(text):
            end = text.find(self._dialect.newline, starts[-1] + PIECE)
            if end < 0 or end + 1 == len(text):
                break
            starts.append(end + 1)
        return np.array([*starts, len(text)], np.int64)

    def _read_odd(self, text: bytes, items: NDArray[np.int64]) -> int:
        """Parse the unusual words that the kernel leaves to Python's float; return the number of complete rows.

        items : (n, k), in which these words are marked by NaN with their offset in the text, and are replaced
        """
        for row, column in np.argwhere((items >> 48 == MARK >> 48) & (self._modes == FLOAT)):
            begin = int(items[row, column] & ((1 << 48) - 1))
            value = number_of(self._token(text, begin), self._dialect)
            if value is None and self._is_cut(self.at + begin):
                return int(row)
            if value is None:
                raise self._error(NOT_WHOLE, self.at + begin)
            items[row, column] = np.float64(value).view(np.int64)
        return len(items)

    def _is_cut(self, where: int) -> bool:
        """Whether the line at an offset is an incomplete last line, without newline, and record that as a fault."""
        if self._faults is None or self._faults.strict:
            return False
        self._file.seek(where)
        rest = self._file.read(LONGEST)
        _, line, _ = line_at(self._file, where)
        is_cut = not re.search(rb"[\r\n]", rest) and len(fields_of(line, self._dialect)) <= len(self._modes)
        if is_cut:
            self._faults.add("its last line is cut off")
        return is_cut

    def _token(self, text: bytes, begin: int) -> str:
        end = re.compile(rb'[ \t\v\f"\r\n' + re.escape(self._dialect.delimiters) + b"]").search(text, begin)
        return text[begin : end.start() if end else len(text)].decode("latin-1")

    def _error(self, why: int, where: int) -> ValueError:
        """Return the error for the line at an offset.

        why : `COLUMNS` for a wrong number of columns, otherwise the number at the offset is invalid
        """
        number, line, within = line_at(self._file, where)
        shown = shortened(line)
        if why == COLUMNS:
            fields = len(fields_of(line, self._dialect))
            return ValueError(f"line {number:,} has {fields} columns, expected {len(self._modes)}: {shown}")
        word = self._token(line.encode("latin-1"), within)
        what = f"{shortened(word)} is not {'a whole ' if number_of(word, self._dialect) is not None else 'a '}number"
        return ValueError(f"line {number:,}: {what if word else 'a number is missing'}: {shown}")


def number_of(text: str, dialect: Dialect) -> float | None:
    """Return the float that a word represents, with the decimal sign of `dialect`; None if it is not a number."""
    if dialect.decimal != b".":
        text = "?" if "." in text else text.replace(dialect.decimal.decode(), ".")
    if NUMBER.fullmatch(text):
        return float(text)
    return odd_number(text)


def fields_of(line: str, dialect: Dialect) -> list[str]:
    """Split a line into fields by the separators of `dialect`; a delimiter at its end adds no field."""
    line = line.replace('"', " ").replace("\x1a", " ").strip()
    if not dialect.delimiters:
        return line.split()
    delimiters = re.escape(dialect.delimiters.decode())
    fields = re.split(rf"\s*[{delimiters}]\s*|\s+", line.strip())
    return fields[:-1] if len(fields) > 1 and not fields[-1] else fields


def smallest(low: int, high: int) -> np.dtype[Any]:
    """Return the smallest integer type for values from `low` to `high`: uint8, int16, uint16, int32 or int64."""
    for dtype in (np.uint8, np.int16, np.uint16, np.int32):
        if np.iinfo(dtype).min <= low and high <= np.iinfo(dtype).max:
            return np.dtype(dtype)
    return np.dtype(np.int64)
