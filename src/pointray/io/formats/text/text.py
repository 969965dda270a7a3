"""Text with one point per line: .xyz, .txt, .csv, .asc, .pts and similar.

Columns are named by the caller or a header, or recognised from the first rows (see `_unnamed_columns`): x y z,
normals of length 1, colours (integers, or floats from 0 to 1), one intensity, label or alpha next to them, and a point
number or a time before them. Other columns become attributes column_4 and so on, with a warning. A file is refused if
either of two groups of columns may be colours.
"""

from __future__ import annotations

import re
from pathlib import Path

from .._source import HEAD, MAYBE, NO, SURE, Format, Request, Source
from ._lines import UTF8, UTF16, is_binary, is_ptx, numbers_in, top_of
from ._write import WRITTEN, write

EXTENSIONS = (".xyz", ".txt", ".csv", ".asc", ".pts", ".xyzn", ".xyzrgb", ".xyzi", ".neu", ".tsv", ".dat")
OTHERS = re.compile(rb"\s*(ply\s|[A-Z]*OFF\s|#\s*\.PCD|solid|<|\{|\[|v[nt]?\s|%PDF|ASTM-E57|LASF)")
GRID = re.compile(rb"\s*ncols\s+\d+\s", re.IGNORECASE)


def recognise(head: bytes, path: Path) -> int:
    """Detect text with columns of numbers: return `SURE`, `MAYBE` for a usual extension, or `NO`.

    head : first bytes of the file
    """
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
            raise ValueError("is a height grid (ESRI ASCII): convert it to points first")
    from ._rows import TextSource  # imported late: it loads Numba

    return TextSource(path, request)


FORMAT = Format(
    "Text",
    EXTENSIONS,
    recognise,
    _open,
    {
        "positions": "columns x, y, z, or easting, northing, height",
        "normals": "columns nx, ny, nz",
        "colors": "columns r, g, b or red, green, blue: integers, or floats from 0 to 1 or 255",
        "attributes": "all other columns; integers stay integers",
        "note": "columns are named by --columns or a header, otherwise recognised from the first rows; written as "
        ".xyz, .txt and .asc (blanks, names in a comment), .csv (commas) and .tsv (tabs), with as few decimals as "
        "restore the points",
    },
    write=write,
    written=WRITTEN,
)
