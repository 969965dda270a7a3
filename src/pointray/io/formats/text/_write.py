"""Writer for text with one point per line: .xyz, .txt and .asc with blanks, .csv with commas, .tsv with tabs."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, NamedTuple

from numpy.typing import NDArray

from ....base.progress import Progress, report_progress
from ....cloud.georeference import RESIDUAL
from ....cloud.points import Points
from .._losses import Losses, georeference_losses, separate_columns
from .._unnamed_columns import COLORS, NORMALS, POSITIONS
from .._world import is_float64

SEPARATORS = {".xyz": " ", ".txt": " ", ".asc": " ", ".csv": ",", ".tsv": "\t"}
WRITTEN = tuple(SEPARATORS)
BLOCK = 1 << 14  # rows converted at a time: they stay in the processor's cache
UNSAFE = re.compile(r"[^\w.+-]+")  # in names: separators, quotes and brackets
NUMBER = re.compile(r"(?=[\d.+-])")  # a name that begins like a number


class Column(NamedTuple):
    """A column after the coordinates: its name, and its values, (n,)."""

    name: str
    values: NDArray[Any]


def write(file: Any, points: Points, progress: Progress | None = None) -> Losses:
    """Write all data of the points to a stream as text; return what it cannot store, in words."""
    from ._decimals import coordinates, floats, joined, texts_of

    separator = SEPARATORS[Path(file.path).suffix.lower()]
    losses: Losses = []
    columns = _columns_of(points, losses)
    losses += georeference_losses(points)
    names = [*POSITIONS, *(column.name for column in columns)]
    if separator != " ":
        file.write((separator.join(names) + "\n").encode())
    elif columns:
        file.write(f"# {' '.join(names)}\n".encode())
    for start in range(0, len(points), BLOCK):
        part = slice(start, min(start + BLOCK, len(points)))
        texts = [floats(*axis) for axis in coordinates(points, part)]
        texts += [texts_of(column.values[part]) for column in columns]
        file.write(joined(texts, separator))
        report_progress(progress, part.stop / len(points))
    return losses


def _columns_of(points: Points, losses: Losses) -> list[Column]:
    columns: list[Column] = []
    for names, values in ((NORMALS, points.normals), (COLORS, points.colors)):
        columns += [] if values is None else [Column(name, values[:, k]) for k, name in enumerate(names)]
    taken = {*POSITIONS, *NORMALS, *COLORS}
    for name, values in points.attributes.items():
        if name == RESIDUAL and is_float64(points):
            continue
        for title, column in separate_columns(name, values, losses).items():
            columns.append(Column(_unused(title, taken, losses), column))
    return columns


def _unused(name: str, taken: set[str], losses: Losses) -> str:
    """Return a title for a column that readers do not take for another one.

    taken : names in use, as the reader understands them, to which it is added
    losses : receives a text if readers find another name than that of the attribute
    """
    from ._columns import LONGEST, name_of

    plain = UNSAFE.sub("_", name)
    plain = f"column_{plain}" if NUMBER.match(plain) else plain if name_of(plain) else "column"
    if len(plain.lower()) > LONGEST:  # lower case can be longer
        plain = plain.lower()[:LONGEST]
    title, number = plain, 1
    while (read := name_of(title)) in taken:
        number += 1
        tail = f"_{number}"
        title = (plain if len(plain.lower()) <= LONGEST - len(tail) else plain.lower()[: LONGEST - len(tail)]) + tail
    if read != name:
        losses.append(f"stores {name} as the column {title}" + (f", which is read as {read}" if read != title else ""))
    taken.add(read)
    return title
