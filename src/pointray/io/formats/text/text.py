"""Text with a point in each line: .xyz, .txt, .csv, .asc, .pts and the like.

Columns are named by the caller or a header, else recognised from the first rows (`_unnamed_columns.judge`): x y z,
normals of length 1, colours (whole numbers, or floats from 0 to 1), and one of intensity, label or alpha beside them,
with a point's number or a time before them. All others are attributes column_4 and so on, with a warning. A file in
which colours may be either of two groups of columns is refused.
"""

from __future__ import annotations

import re
from pathlib import Path

from .._source import HEAD, MAYBE, NO, SURE, Format, Request, Source
from ._lines import UTF8, UTF16, is_binary, is_ptx, numbers_in, top_of

EXTENSIONS = (".xyz", ".txt", ".csv", ".asc", ".pts", ".xyzn", ".xyzrgb", ".xyzi", ".neu", ".tsv", ".dat")
OTHERS = re.compile(rb"\s*(ply\s|[A-Z]*OFF\s|#\s*\.PCD|solid|<|\{|\[|v[nt]?\s|%PDF|ASTM-E57|LASF)")
GRID = re.compile(rb"\s*ncols\s+\d+\s", re.IGNORECASE)


def recognise(head: bytes, path: Path) -> int:
    """Whether a file is text with numbers in columns."""
    named = path.suffix.lower() in EXTENSIONS
    if head[:2] in UTF16:
        return MAYBE if named else NO
    if OTHERS.match(head) or is_binary(head) or is_ptx(head):
        return NO
    if GRID.match(head):
        return SURE
    top = top_of(head, len(UTF8) if head.startswith(UTF8) else 0)
    sure = bool(top.rows) and all(numbers_in(top.rows[0][1])[:3])
    if sure and top.header is not None:
        sure = not any(numbers_in(top.header)) and len(numbers_in(top.header)) >= 3
    return SURE if sure else MAYBE if named else NO


def _open(path: Path, request: Request) -> Source:
    with path.open("rb") as file:
        if GRID.match(file.read(HEAD)):
            raise ValueError("is a grid of heights (ESRI ASCII), not points: convert it to points first")
    from ._rows import TextSource  # not before it is needed: it loads Numba

    return TextSource(path, request)


FORMAT = Format(
    "Text",
    EXTENSIONS,
    recognise,
    _open,
    {
        "positions": "columns x, y, z, or easting, northing, height",
        "normals": "columns nx, ny, nz",
        "colors": "columns r, g, b or red, green, blue: whole numbers, or floats from 0 to 1 or 255",
        "attributes": "all other columns: whole numbers stay whole",
        "note": "columns are named by --columns or a header, else recognised from the first rows",
    },
)
