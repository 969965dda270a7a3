"""Columns without names: coordinates, normals, colours, point numbers and times are recognised by their values."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.arrays import Doubles
from ..colors import ColorRange

POSITIONS, NORMALS, COLORS = ("x", "y", "z"), ("nx", "ny", "nz"), ("r", "g", "b")
INDEX, TIME, INTENSITY, LABEL, ALPHA = "index", "gps_time", "intensity", "label", "alpha"
UNIT = 0.03  # tolerance of a normal's length: two decimals cause an error of 0.01
MIN_UNIT_FRACTION = 0.99  # fraction of the normals that must have this length, not counting 0 0 0 and NaN
MIN_TIME = 1e8  # larger numbers are times: seconds since 1970 or 1980, or fractions of them
MAX_STEP_DEVIATION = 0.5  # times have steps with a smaller relative deviation; sorted values of other kinds do not
DIM, BRIGHT = 15, 30  # integers up to DIM, next to others above BRIGHT, are counts or classes, not a colour channel
MOST_CLASSES = 50
MOST_NAMED = 8  # maximum number of columns that a note lists
CLEAR_RATIO = 0.7  # colour channels must differ less from each other than from the next column, by this factor
ADVICE = "name the columns with --columns x,y,z,r,g,b,..."
SAMPLE = 10_000  # rows of an array that are examined

Values = Doubles


class UndecidedError(ValueError):
    """Raised if columns without names cannot be recognised: two groups of them may be colours."""


class ColumnNames(NamedTuple):
    """Names found for the columns of a file that does not name them.

    Attributes
    ----------
    names : list of str
        Unrecognised columns are named column_4 and so on.
    note : str
        Message for the user; empty if all columns are recognised.
    """

    names: list[str]
    note: str


def recognise_columns(values: Values, is_whole: Sequence[bool], intensity_first: bool | None = None) -> ColumnNames:
    """Name the columns of a file without names by their values: coordinates, normals, colours, times and so on.

    Parameters
    ----------
    values : (n, k) float64
        First rows of a file.
    is_whole : sequence of bool
        Whether the numbers of a column are written without decimals.
    intensity_first : bool, optional
        Whether an intensity precedes the colours (True) or follows them (False), if their values do not decide.

    Raises
    ------
    UndecidedError
        If either of two groups of columns may be colours.
    """
    k = values.shape[1]
    names = [f"column_{c}" for c in range(1, k + 1)]
    first = _leading(values, is_whole)
    begin = int(first is not None)
    if first is not None:
        names[0] = first
    names[begin : begin + 3] = POSITIONS
    begin += 3
    more = values[:, begin:]
    normals = next((c for c in range(more.shape[1] - 2) if are_normals(more[:, c : c + 3])), None)
    if normals is not None:
        names[begin + normals : begin + normals + 3] = NORMALS
    colors, is_guess = _find_colors(more, is_whole[begin:], normals, intensity_first)
    if colors is not None:
        names[begin + colors : begin + colors + 3] = COLORS
    left = [c for c, name in enumerate(names) if name.startswith("column_")]
    if len(left) == 1:
        names[left[0]] = _scalar(values[:, left[0]], colors is not None and left[0] == begin + colors + 3)
    note = _note(names, begin > 3)
    if is_guess and colors is not None:
        note = f"columns {begin + colors + 1} to {begin + colors + 3} are read as colours; {note or ADVICE}"
    return ColumnNames(names, note)


def recognise_array_columns(blocks: Callable[[], Iterable[NDArray[Any]]], width: int) -> ColumnNames:
    """Name the columns of an array by their values; raise ValueError if two groups of columns may be colours.

    The first 10,000 rows decide; columns that are normals or colours there must be so in all rows.

    blocks : returns all rows in (m, width) blocks; called several times
    """
    head = next(iter(blocks()), np.empty((0, width)))[:SAMPLE]
    if not len(head):
        return ColumnNames([*POSITIONS, *(f"column_{c}" for c in range(4, width + 1))], "")
    is_whole = [head.dtype.kind != "f"] * width
    try:
        found = recognise_columns(head.astype(np.float64), is_whole)
    except UndecidedError as error:
        raise ValueError(f"{error}; name them with --columns x,y,z,...") from None
    names = list(found.names)
    for three, holds in ((NORMALS, _stay_normals), (COLORS, _stay_colors)):
        if three[0] in names:
            c = names.index(three[0])
            if not holds([block[:, c : c + 3] for block in blocks()]):
                names[c : c + 3] = [f"column_{c + at}" for at in (1, 2, 3)]
    return ColumnNames(names, _note(names, names[0] != "x"))


def _note(names: Sequence[str], has_leading_column: bool) -> str:
    notes = []
    if has_leading_column:
        kind = "contains point numbers" if names[0] == INDEX else "is read as time"
        notes.append(f"column 1 {kind}: x, y, z are columns 2 to 4")
    left = [name for name in names if name.startswith("column_")]
    if left:
        first, last = left[0].removeprefix("column_"), left[-1].removeprefix("column_")
        if len(left) > MOST_NAMED:
            notes.append(f"{len(left)} of the columns {first} to {last} are not recognised: read as {left[0]}, ...")
        else:
            numbers = ", ".join(name.removeprefix("column_") for name in left)
            some = f"columns {numbers} are" if len(left) > 1 else f"column {numbers} is"
            notes.append(f"{some} not recognised: read as {', '.join(left)}")
    return "; ".join([*notes, ADVICE]) if notes else ""


# ------------------------------------------------------------------------------------------------- leading columns


def _leading(values: Values, is_whole: Sequence[bool]) -> str | None:
    """Return the name of a column before x, y, z: "index" for point or scan line numbers, or "gps_time".

    Return None if there is none. x, y and z have decimals, point numbers do not. Times increase in even steps, sorted
    coordinates do not.

    values : (n, k), first rows; is_whole : whether the numbers of each column are written without decimals
    """
    if values.shape[1] < 4 or len(values) < 3:
        return None
    column, others = values[:, 0], values[:, 1:4]
    if not np.isfinite(column).all() or np.isnan(others).all():
        return None
    steps = np.diff(column)
    if column.min() > MIN_TIME and np.nanmax(np.abs(others)) < MIN_TIME:
        return TIME
    decimals = sum(not _are_whole(others[:, c]) for c in range(3))
    if (steps < 0).any() or not steps.any():
        return None
    if is_whole[0] or _are_whole(column):
        counts = bool((steps == 1).all()) or column[0] <= 1
        return INDEX if counts and decimals >= 2 and not any(is_whole[1:3]) else None
    rising = steps[steps > 0]
    is_even = len(rising) > 10 and rising.std() < MAX_STEP_DEVIATION * rising.mean()
    return TIME if is_even and decimals == 3 else None


def _are_whole(values: Values) -> bool:
    finite = values[np.isfinite(values)]
    return bool((finite == np.rint(finite)).all())


# ----------------------------------------------------------------------------------------------- normals and colours


def are_normals(rows: NDArray[Any]) -> bool:
    """Whether at least 99% of the (n, 3) rows that are neither zero nor NaN have length 1, within 0.03."""
    with np.errstate(over="ignore", invalid="ignore"):
        length = np.sqrt((rows.astype(np.float64) ** 2).sum(axis=1))
    length = length[np.isfinite(length) & (length > 0)]
    return len(length) > 0 and bool((np.abs(length - 1) <= UNIT).mean() >= MIN_UNIT_FRACTION)


def _find_colors(
    more: Values, is_whole: Sequence[bool], normals: int | None, intensity_first: bool | None
) -> tuple[int | None, bool]:
    """Return the number of the first of three colour columns, or None, and whether it is a guess.

    more : (n, m), the columns after x, y, z; they are numbered from 0
    is_whole : whether the numbers of each column are written without decimals
    normals : number of the first of three columns of normals, or None
    intensity_first : whether an intensity precedes the colours (True) or follows them (False); None if unknown
    """
    m = more.shape[1]
    taken = set() if normals is None else {normals, normals + 1, normals + 2}
    starts = [c for c in range(m - 2) if taken.isdisjoint((c, c + 1, c + 2))]
    is_strict = m - len(taken) > 4
    kinds: dict[int, list[int]] = {}
    for c in starts:
        kind = _color_kind(more[:, c : c + 3], all(is_whole[c : c + 3]), is_strict)
        if kind is None and m == 4 and c == intensity_first and _are_bytes(more[:, c:]):  # very dark colours
            kind = 0
        if kind is not None:
            kinds.setdefault(kind, []).append(c)
    if not kinds:
        return None, False
    found = kinds[min(kinds)]
    if len(found) == 1 or (m == 4 and _is_opaque(more[:, 3], min(kinds))):
        return found[0], False
    if intensity_first is not None and not is_strict:
        return (max(found) if intensity_first else min(found)), False
    varied = [c for c in found if np.ptp(more[:, c : c + 3], axis=0).all()] or found
    differences = {c: _difference(more[:, c : c + 3]) for c in varied}
    best, *others = sorted(varied, key=lambda c: differences[c])
    if not others or differences[best] < CLEAR_RATIO * differences[others[0]]:
        return best, True
    if is_strict:
        return None, False
    raise UndecidedError("ambiguous columns: colours, normals and intensity cannot be told apart")


def _color_kind(rows: Values, is_whole: bool, is_strict: bool) -> int | None:
    """Return the range of (n, 3) colours: 0 integers to 255, 1 integers to 65535, 2 floats to 1; None: not colours.

    is_whole : whether the numbers are written without decimals
    is_strict : accept only integers to 255 in columns that all vary and exceed 30: other values may look like colours
    """
    least, most = float(rows.min(initial=np.inf)), rows.max(axis=0, initial=0.0)
    if not least >= 0 or are_normals(rows):  # also excludes NaN
        return None
    if most.max() > 2 and (rows == np.rint(rows)).all():
        varied = np.ptp(rows, axis=0) > 0
        dim = (most > 0) & (most <= DIM)
        if most.max() > BRIGHT and dim.any() and varied.any():
            return None
        if is_strict and (most.max() > 255 or most.min() <= BRIGHT or not varied.all()):
            return None
        return 0 if most.max() <= 255 else 1 if most.max() <= 65535 else None
    return 2 if not is_strict and not is_whole and 0 < most.max() <= 1 else None


def _are_bytes(rows: Values) -> bool:
    return bool(((rows >= 0) & (rows <= 255) & (rows == np.rint(rows))).all())


def _is_opaque(column: Values, kind: int) -> bool:
    """Whether the column after colours is an alpha channel that is fully opaque.

    kind : range of the colours: 0 for integers to 255, 1 for integers to 65535, 2 for floats to 1
    """
    return bool((column == (255, 65535, 1)[kind]).all())


def _difference(rows: Values) -> float:
    """Return how much adjacent columns of (n, 3) values differ, relative to their size.

    It is small for the channels of colours.
    """
    left, right = rows[:, :-1], rows[:, 1:]
    return float((np.abs(left - right).mean(axis=0) / np.maximum((left + right).mean(axis=0), 1e-30)).sum())


def _scalar(column: Values, is_after_colors: bool) -> str:
    """Return the name of the only column that is not recognised otherwise: alpha, label or intensity.

    is_after_colors : whether it directly follows three colour columns
    """
    if is_after_colors:
        if len(column) > 1 and (column == column[0]).all() and column[0] in (1, 255, 65535):
            return ALPHA
        if _are_whole(column) and 0 <= column.min() and column.max() <= MOST_CLASSES:
            return LABEL
    return INTENSITY


def _stay_normals(parts: list[NDArray[Any]]) -> bool:
    return all(are_normals(part) or not np.nan_to_num(part).any() for part in parts)


def _stay_colors(parts: list[NDArray[Any]]) -> bool:
    """Whether the colours of all rows have the range, to 1, 255 or 65535, of the first 10,000 rows.

    parts : all rows in (m, 3) blocks
    """
    kind = parts[0].dtype
    try:
        return ColorRange.of(parts).white(kind) == ColorRange.of([parts[0][:SAMPLE]]).white(kind)
    except ValueError:
        return False
