"""Writer for PTX: one scan for each scanner position, as its grid, or as a single column of points."""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ....base.arrays import Doubles, Flags
from ....base.progress import Progress, report_progress
from ....cloud.georeference import SCAN
from ....cloud.points import Points, are_finite
from .._losses import Losses, column_losses, georeference_losses
from .._stations import Scan, scans_to_write
from ._decimals import ZERO, Accept, Texts, coordinates, floats, joined, texts_of
from ._ptx_headers import NO_STATION
from ._write import BLOCK

INTENSITY, UNKNOWN = "intensity", 0.5  # value of points without an intensity
ROW, COLUMN = "row_index", "column_index"
EMPTIEST = 16  # cells of a grid for each point, at most


class Grid(NamedTuple):
    """Cells of a scan: their columns and rows, and the row number of the point in each cell, (n,); -1: no return."""

    columns: int
    rows: int
    cells: NDArray[np.integer[Any]]


def write(file: Any, points: Points, progress: Progress | None = None) -> Losses:
    """Write points, colours and intensity to a stream as PTX; return what it cannot store, in words."""
    losses: Losses = []
    scans, states_scan = scans_to_write(points, losses)
    grids = [_grid_of(points, scan) for scan in scans]
    organised = sum(grid.columns > 1 for grid in grids)
    kept = (INTENSITY, *([SCAN] if states_scan else []), *((ROW, COLUMN) if organised else ()))
    losses += column_losses(points, False, kept)
    if 0 < organised < len(grids):
        losses.append(f"cannot store {ROW}, {COLUMN} of {len(grids) - organised} of {len(grids)} scans: not a grid")
    if any((np.diff(grid.cells[grid.cells >= 0]) < 0).any() for grid in grids):
        losses.append("stores the points column by column of their grid, in another order")
    losses += georeference_losses(points, ("stations",))
    intensity = _intensity_of(points, losses)
    done, hidden, total = 0, 0, sum(len(grid.cells) for grid in grids)
    for scan, grid in zip(scans, grids, strict=True):
        file.write(_header_of(scan, grid))
        for start in range(0, len(grid.cells), BLOCK):
            cells = grid.cells[start : start + BLOCK]
            text, lost = _rows_of(points, cells, scan, intensity)
            file.write(text)
            done, hidden = done + len(cells), hidden + lost
            report_progress(progress, done / total)
    missing = len(points) - int(np.count_nonzero(points.finite))
    if missing:
        losses.append(f"stores {missing:,} row{'s' * (missing > 1)} without a finite position as missing returns")
    if hidden:
        losses.append(f"stores {hidden:,} point{'s' * (hidden > 1)} at the scanner as missing returns: 0 0 0")
    return losses


def _header_of(scan: Scan, grid: Grid) -> bytes:
    place = "0 0 0" if scan.station is None else " ".join(repr(x + 0.0) for x in scan.station)
    axes = ["1 0 0", "0 1 0", "0 0 1"]
    stated = NO_STATION if scan.station is None else place
    lines = [str(grid.columns), str(grid.rows), stated, *axes, *(f"{axis} 0" for axis in axes), f"{place} 1"]
    return ("\n".join(lines) + "\n").encode()


def _grid_of(points: Points, scan: Scan) -> Grid:
    """Return the grid that row_index and column_index describe; a single column if they do not."""
    rows = np.arange(len(points), dtype=np.int32) if scan.rows is None else scan.rows
    column = Grid(1, len(rows), rows)
    indices = [points.attributes.get(name) for name in (COLUMN, ROW)]
    if any(index is None or index.ndim > 1 or index.dtype.kind not in "iu" for index in indices):
        return column
    across, down = (np.asarray(index)[rows].astype(np.float64) for index in indices)
    across, down = across - across.min(), down - down.min()
    width, height = int(across.max()) + 1, int(down.max()) + 1
    if width == 1 or width * height > EMPTIEST * len(rows):
        return column
    places = (across * height + down).astype(np.int64)
    cells = np.full(width * height, -1, np.int32)
    cells[places] = rows
    return Grid(width, height, cells) if np.count_nonzero(cells >= 0) == len(rows) else column


def _intensity_of(points: Points, losses: Losses) -> NDArray[Any] | None:
    """Return the intensities to be written, (n,), those of 8 and 16 bits from 0 to 1; None without any."""
    values = points.attributes.get(INTENSITY)
    if values is None or values.ndim > 1:
        return None
    if values.dtype not in (np.uint8, np.uint16):
        return values
    largest = int(np.iinfo(values.dtype).max)
    losses.append(f"stores intensity divided by {largest}")
    return (values / largest).astype(np.float32)


def _rows_of(
    points: Points, cells: NDArray[np.integer[Any]], scan: Scan, intensity: NDArray[Any] | None
) -> tuple[bytes, int]:
    """Return the lines of some cells, and the number of points that look like missing returns."""
    rows = np.maximum(cells, 0)
    missing = (cells < 0) | ~are_finite(points.positions[rows])
    texts: list[Texts] = []
    at_scanner = ~missing
    for values, accept in coordinates(points, rows, scan.station):
        values[missing] = 0
        text = floats(values, partial(_or_missing, accept, missing))
        at_scanner &= (np.count_nonzero(text, axis=0) == 1) & (text == ZERO).any(axis=0)
        texts.append(text)
    shown = np.full(len(rows), UNKNOWN, np.float32) if intensity is None else intensity[rows]
    if missing.any():
        shown = np.where(missing, np.float32(UNKNOWN), shown)
    texts.append(texts_of(shown))
    if points.colors is not None:
        colors = points.colors[rows] * ~missing[:, None]
        texts += [texts_of(colors[:, k]) for k in range(3)]
    return joined(texts, " "), int(np.count_nonzero(at_scanner))


def _or_missing(accept: Accept, missing: Flags, found: Doubles, rows: NDArray[np.int64]) -> Flags:
    return np.asarray(accept(found, rows) | missing[rows])
