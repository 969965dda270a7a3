"""Examination of the beginning of a text file: the separators, the start of the rows, and the columns."""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from .._source import Faults
from .._unnamed_columns import UndecidedError, recognise_columns
from ._columns import Layout, has_degrees, name_of, names_of, scanning
from ._lines import COMMENT, FIELDS, UTF8, UTF16, Top, is_row, shortened, top_of
from ._numbers import FLOAT, SKIP, Dialect, Reader, fields_of, number_of

EXAMINED = 1 << 18  # bytes examined
ROWS = 200  # rows examined to find the separators
MOST_COLUMNS = 1000
LONGEST_HEADER = 1 << 14  # characters
ADVICE = "name its columns with --columns x,y,z,... (- ignores one)"
INTENSITY_FIRST = {".pts": True, ".xyzrgb": False}  # by extension: whether intensity precedes the colours
MIXED = "ambiguous separators: its rows contain commas as well as semicolons or blanks"


class TextProperties(NamedTuple):
    """Properties of a text file found at its beginning.

    Attributes
    ----------
    dialect : Dialect
        Separators and decimal sign.
    names : list of str
        Names of the columns.
    whole : list of bool
        Whether the first rows of a column are all integers.
    start : int
        Byte offset of the first row.
    announced : int or None
        Number of rows stated in a line of its own before the first row (PTS).
    header : str or None
        The line with column names.
    has_degrees : bool
        Whether coordinates are longitude and latitude.
    row : float
        Average number of bytes per row.
    note : str
        Message for the user about columns without names.
    """

    dialect: Dialect
    names: list[str]
    whole: list[bool]
    start: int
    announced: int | None
    header: str | None
    has_degrees: bool
    row: float
    note: str = ""


def examine_text(text: bytes, path: Path, columns: Sequence[str] | None, faults: Faults) -> TextProperties:
    """Find separators, column names and the first row of a text file; ValueError if it is not a table of numbers.

    text : beginning of the file; columns : names given by the caller, or None
    faults : records an incomplete last line
    """
    if text[:2] in UTF16 or text[:200].count(0) > 20:
        raise ValueError("is encoded in UTF-16: save it as UTF-8 or ASCII")
    begin = len(UTF8) if text.startswith(UTF8) else 0
    whole_lines = text[: max(text.rfind(b"\n"), text.rfind(b"\r")) + 1] if len(text) >= EXAMINED else text
    top = top_of(whole_lines or text, begin)
    _check_top(top)
    rows = [line for _, line in top.rows[:ROWS] if is_row(line) and not COMMENT.match(line)]
    dialect = dialect_of(rows)._replace(newline=b"\n" if b"\n" in text else b"\r")
    fields = fields_of(rows[0], dialect)
    names = _named(fields, top, dialect, columns)
    k = len(names or fields)
    if k > MOST_COLUMNS:
        raise ValueError(f"the first row has {k:,} columns, more than {MOST_COLUMNS:,}")
    start = top.rows[0][0]
    names, whole, row, note = _numbers(whole_lines or text, start, dialect, names or k, path, rows[0], faults)
    degrees = columns is None and has_degrees(top.header or " ".join(top.comments[-3:]))
    return TextProperties(dialect, names, whole, start, top.announced, top.header, degrees, row, note)


def _check_top(top: Top) -> None:
    atoms = [line.split() for _, line in top.rows[:ROWS]]
    if top.announced is not None and atoms and all(re.fullmatch("[A-Z][a-z]?", f[0]) for f in atoms):
        raise ValueError("is a molecule (atoms with their elements), not a point cloud")
    if not top.rows:
        shown = f"; it begins with {shortened(top.header)}" if top.header else ""
        raise ValueError(f"contains no rows of at least three numbers{shown}")


def dialect_of(rows: Sequence[str]) -> Dialect:
    """Return the field separators and the decimal sign of rows of numbers; raise ValueError if they are ambiguous."""
    text = "\n".join(rows)
    if "," not in text:
        return Dialect(b";" if ";" in text else b"")
    semicolons = ";" in text
    fields = [re.split(r'[;\s"]+' if semicolons else r'[\s"]+', row.strip(' \t;"')) for row in rows]
    decimal = all(re.fullmatch(r"[+-]?\d+(,\d+)?([eE][+-]?\d+)?|[+-]?[nN][aA][nN]|", f) for row in fields for f in row)
    if decimal and all(len(row) >= 3 for row in fields):
        return Dialect(b";" if semicolons else b"", b",")
    mixed = next((row for row in rows if ";" in row or re.search(r"[\d.][ \t]+[-+.\d]", row)), None)
    if mixed is not None:
        raise ValueError(f"{MIXED}: {shortened(mixed)}")
    if re.search(r'"[^",\n]*,[^",\n]*"', re.sub(r'"\s*,\s*"', '";"', text)):
        raise ValueError(f"decimal commas and commas as separators cannot be told apart: {shortened(rows[0])}")
    return Dialect(b",")


def _named(fields: list[str], top: Top, dialect: Dialect, columns: Sequence[str] | None) -> list[str] | None:
    """Return the column names given by the caller or a header; None if neither names them.

    fields : words of the first row; top : lines before the rows; columns : names given by the caller, or None
    """
    k, row = len(fields), " ".join(fields)
    if columns is not None:
        if len(columns) != k:
            raise ValueError(f"{len(columns)} columns are named, but the first row has {k}: {shortened(row)}")
        return [name_of(name) for name in columns]
    headers = [top.header] if top.header is not None else top.comments[:-4:-1]
    for header in headers:
        for texts in _split(_as_utf8(header)[:LONGEST_HEADER], dialect):
            names = names_of(texts)
            if names is not None and len(names) in (k, k + 1 if dialect.delimiters else k):
                return names
    if top.header is not None:
        raise ValueError(
            f"invalid header {shortened(top.header)}: expected names with x, y, z for {k} columns, "
            f"as in the first row: {shortened(row)}: {ADVICE}"
        )
    return None


def _as_utf8(header: str) -> str:
    """Return a line that was decoded as Latin-1 as the UTF-8 that it is; the line itself if it is not."""
    try:
        return header.encode("latin-1").decode()
    except UnicodeDecodeError:
        return header


def _split(header: str, dialect: Dialect) -> list[list[str]]:
    """Split a header line into names in all likely ways: its separators may differ from those of the rows."""
    text = re.sub(r"^\s*(#|//)+\s*", "", header).strip()
    return [
        *([fields_of(text.replace(" ", "_"), dialect)] if dialect.delimiters else []),
        [field for field in re.split(r"[,;\t]\s*", text) if field],
        FIELDS.split(text.strip(' \t,;"')),
    ]


def _numbers(
    text: bytes, start: int, dialect: Dialect, names: list[str] | int, path: Path, first: str, faults: Faults
) -> tuple[list[str], list[bool], float, str]:
    """Parse the first rows; return the column names, which columns are integers, the bytes per row, and a note.

    The note explains to the user how names were recognised; it is "" if they were given.

    text : beginning of the file; start : offset of the first row
    names : column names, or the number of columns if the names must be recognised from the values
    first : the first row, for messages; faults : records an incomplete last line
    """
    if isinstance(names, int):
        k, modes = names, [FLOAT] * names
    else:
        k, modes = len(names), Layout.of(names).modes(len(names))
    try:
        block = next(Reader(io.BytesIO(text), dialect, modes, start, None, faults).blocks())
        scan = next(Reader(io.BytesIO(text), dialect, scanning(k, range(k)), start, None, faults).blocks())
    except ValueError as error:
        raise _explained(error, first, dialect, modes) from None
    if not len(block):
        raise ValueError(f"contains no rows of {k} numbers; the first row is {shortened(first)}")
    whole, note = [bool(x) for x in scan.stats[:, 0]], ""
    if isinstance(names, int):
        try:
            names, note = recognise_columns(
                block.take(range(k), np.float64), whole, INTENSITY_FIRST.get(path.suffix.lower())
            )
        except UndecidedError as error:
            raise ValueError(f"{error}: {ADVICE}; the first row is {shortened(first)}") from None
    return names, whole, (block.end - start) / len(block), note


def _explained(error: ValueError, row: str, dialect: Dialect, modes: list[int]) -> ValueError:
    """Return the error to raise for invalid first rows: the given one, or better advice if a column contains words.

    row : the first row; modes : how each column is read
    """
    for k, (field, mode) in enumerate(zip(fields_of(row, dialect), modes, strict=False), 1):
        if mode != SKIP and field and number_of(field, dialect) is None:
            what = f"column {k} contains {shortened(field)}, which is not a number"
            return ValueError(f"{what}: ignore the column with a - in --columns x,y,z,...")
    return error
