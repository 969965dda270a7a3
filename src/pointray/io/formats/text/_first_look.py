"""A first look at a text file: what separates its numbers, where its rows begin, and what its columns are."""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from .._source import Faults
from .._unnamed_columns import UndecidedError, judge
from ._columns import Layout, has_degrees, name_of, names_of, scanning
from ._lines import COMMENT, FIELDS, UTF8, UTF16, Top, is_row, shortened, top_of
from ._numbers import FLOAT, SKIP, Dialect, Reader, fields_of, number_of

LOOK = 1 << 18  # bytes that are looked at
ROWS = 200  # rows by which the separators are told
MOST_COLUMNS = 1000
LONGEST_HEADER = 1 << 14  # letters
HOW = "say what they are: --columns x,y,z,... (- leaves one out)"
INTENSITY_FIRST = {".pts": True, ".xyzrgb": False}  # by the extension: whether intensity stands before colours
MIXED = "its rows have commas, and semicolons or blanks: which of them separates numbers cannot be told"


class Look(NamedTuple):
    """What is known of a file's beginning.

    Attributes
    ----------
    dialect : Dialect
    names : list of str
        What the columns are.
    whole : list of bool
        Whether the first rows of a column have whole numbers only.
    start : int
        The offset at which rows begin.
    announced : int or None
        The number of rows in a line of its own before the first (PTS).
    header : str or None
        The line with names.
    has_degrees : bool
        Whether coordinates are longitude and latitude.
    row : float
        Bytes of a row, on average.
    note : str
        What the user has to know of columns without names.
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


def look_at(text: bytes, path: Path, columns: Sequence[str] | None, faults: Faults) -> Look:
    """Look at a file's beginning; ValueError says what is wrong with it."""
    if text[:2] in UTF16 or text[:200].count(0) > 20:
        raise ValueError("is text in UTF-16: save it in UTF-8 or ASCII")
    begin = len(UTF8) if text.startswith(UTF8) else 0
    whole_lines = text[: max(text.rfind(b"\n"), text.rfind(b"\r")) + 1] if len(text) >= LOOK else text
    top = top_of(whole_lines or text, begin)
    _check_top(top)
    rows = [line for _, line in top.rows[:ROWS] if is_row(line) and not COMMENT.match(line)]
    dialect = dialect_of(rows)._replace(newline=b"\n" if b"\n" in text else b"\r")
    fields = fields_of(rows[0], dialect)
    names = _named(fields, top, dialect, columns)
    k = len(names or fields)
    if k > MOST_COLUMNS:
        raise ValueError(f"its first row has {k:,} columns, more than {MOST_COLUMNS:,}")
    start = top.rows[0][0]
    names, whole, row, note = _numbers(whole_lines or text, start, dialect, names or k, path, rows[0], faults)
    degrees = columns is None and has_degrees(top.header or " ".join(top.comments[-3:]))
    return Look(dialect, names, whole, start, top.announced, top.header, degrees, row, note)


def _check_top(top: Top) -> None:
    atoms = [line.split() for _, line in top.rows[:ROWS]]
    if top.announced is not None and atoms and all(re.fullmatch("[A-Z][a-z]?", f[0]) for f in atoms):
        raise ValueError("is a molecule (atoms with their elements), not a point cloud")
    if not top.rows:
        shown = f"; it begins with {shortened(top.header)}" if top.header else ""
        raise ValueError(f"has no rows of at least three numbers{shown}")


def dialect_of(rows: Sequence[str]) -> Dialect:
    """What separates the numbers of rows; ValueError if that cannot be told."""
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
        raise ValueError(f"its numbers have decimal commas, and commas between them: {shortened(rows[0])}")
    return Dialect(b",")


def _named(fields: list[str], top: Top, dialect: Dialect, columns: Sequence[str] | None) -> list[str] | None:
    """The names of the columns as the caller or a header gives them; None if neither does."""
    k, row = len(fields), " ".join(fields)
    if columns is not None:
        if len(columns) != k:
            raise ValueError(f"{len(columns)} columns are named, its first row has {k}: {shortened(row)}")
        return [name_of(name) for name in columns]
    headers = [top.header] if top.header is not None else top.comments[:-4:-1]
    for header in headers:
        for texts in _split(header[:LONGEST_HEADER], dialect):
            names = names_of(texts)
            if names is not None and len(names) in (k, k + 1 if dialect.delimiters else k):
                return names
    if top.header is not None:
        raise ValueError(
            f"its header {shortened(top.header)} does not name x, y, z, or not {k} columns, "
            f"as the first row has: {shortened(row)}: {HOW}"
        )
    return None


def _split(header: str, dialect: Dialect) -> list[list[str]]:
    """The fields of a header: it may have other separators than the rows."""
    text = re.sub(r"^\s*(#|//)+\s*", "", header).strip()
    return [
        *([fields_of(text.replace(" ", "_"), dialect)] if dialect.delimiters else []),
        [field for field in re.split(r"[,;\t]\s*", text) if field],
        FIELDS.split(text.strip(' \t,;"')),
    ]


def _numbers(
    text: bytes, start: int, dialect: Dialect, names: list[str] | int, path: Path, first: str, faults: Faults
) -> tuple[list[str], list[bool], float, str]:
    """The names of columns, judged from the first rows if there are none; which are whole; bytes of a row; a note."""
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
        raise ValueError(f"has no rows of {k} numbers; the first one is {shortened(first)}")
    whole, note = [bool(x) for x in scan.stats[:, 0]], ""
    if isinstance(names, int):
        try:
            names, note = judge(block.take(range(k), np.float64), whole, INTENSITY_FIRST.get(path.suffix.lower()))
        except UndecidedError as error:
            raise ValueError(f"{error}: {HOW}; its first row is {shortened(first)}") from None
    return names, whole, (block.end - start) / len(block), note


def _explained(error: ValueError, row: str, dialect: Dialect, modes: list[int]) -> ValueError:
    """An error of the first rows, with what to do about columns of words."""
    for k, (field, mode) in enumerate(zip(fields_of(row, dialect), modes, strict=False), 1):
        if mode != SKIP and field and number_of(field, dialect) is None:
            what = f"column {k} holds {shortened(field)}, which is no number"
            return ValueError(f"{what}: leave it out with a - in --columns x,y,z,...")
    return error
