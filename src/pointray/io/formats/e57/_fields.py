"""Columns of a scan to be written: their names, types in the file, and values."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ....cloud.geographic import in_file
from ....cloud.georeference import RESIDUAL, numbers_of
from ....cloud.points import Points, are_finite
from .._losses import Losses, separate_columns, unused_name
from .._source import CHUNK
from .._stations import Scan
from .._world import is_float64, world_rows
from ._scan import CARTESIAN, COLORS, INVALID_COLOR, NORMALS

PREFIX, URI = "pointray", "urn:pointray:attributes"  # of attributes that E57 does not define
NORMAL_PREFIX, NORMAL_URI = "nor", "http://www.libe57.org/E57_NOR_surface_normals.txt"
STATE, INVALID = "cartesianInvalidState", 2  # value of a point that is to be ignored
STANDARD = {  # attribute -> name in E57, and the kinds of its values
    "intensity": ("intensity", "iuf"),
    "row_index": ("rowIndex", "iu"),
    "column_index": ("columnIndex", "iu"),
    "return_index": ("returnIndex", "iu"),
    "return_count": ("returnCount", "iu"),
    "time_stamp": ("timeStamp", "iuf"),
}
MOST_STEPS = 2.0**52  # integer coordinates below this are exact in float64

Rows = slice | NDArray[np.integer[Any]]


class Field(NamedTuple):
    """A column to be written.

    Attributes
    ----------
    name : str
        Name in the file, with the prefix of an extension.
    values : callable
        What selects rows -> their values, (m,) of `dtype`.
    dtype : dtype
        Type of the values: floats, or integers.
    limits : (float, float)
        Smallest and largest integer that the file allows.
    grid : (float, float) or None
        Scale and offset, if the values are integers that stand for scale * integer + offset.
    """

    name: str
    values: Callable[[Rows], NDArray[Any]]
    dtype: np.dtype[Any]
    limits: tuple[int, int] = (0, 0)
    grid: tuple[float, float] | None = None

    def node(self, libe57: Any, file: Any) -> Any:
        """Return libE57's description of the column. file : image file of libE57"""
        if self.dtype.kind == "f":
            single = self.dtype.itemsize == 4
            limit = float(np.finfo(self.dtype).max)
            return libe57.FloatNode(file, 0.0, libe57.E57_SINGLE if single else libe57.E57_DOUBLE, -limit, limit)
        if self.grid is not None:
            return libe57.ScaledIntegerNode(file, self.limits[0], *self.limits, *self.grid)
        return libe57.IntegerNode(file, self.limits[0], *self.limits)

    @property
    def buffer(self) -> np.dtype[Any]:
        """Type of a buffer that pye57 reads correctly: "q", not NumPy's int64, for integers of more than 16 bits."""
        return np.dtype("q") if self.dtype.kind in "iu" and self.dtype.itemsize > 2 else self.dtype.newbyteorder("=")


def fields_of(points: Points, scan: Scan, losses: Losses, skip: Sequence[str] = ()) -> list[Field]:
    """Return the columns of a scan.

    losses : receives texts about what is stored otherwise; skip : attributes that need no column
    """
    fields = _positions(points, scan)
    if not points.finite.all():
        fields.append(Field(STATE, lambda rows: _states(points, rows), np.dtype("u1"), (0, INVALID)))
    if points.normals is not None:
        fields += _of_three(points.normals, [f"{NORMAL_PREFIX}:{name}" for name in NORMALS])
    if points.colors is not None:
        fields += _of_three(points.colors, COLORS)
    taken = {name.lower() for name in (*NORMALS, *COLORS, INVALID_COLOR)}
    exact = fields[0].grid is not None or is_float64(points)
    for name, values in points.attributes.items():
        if name not in skip and not (name == RESIDUAL and exact):
            fields += _of_attribute(name, values, taken, losses)
    return fields


def _of_attribute(name: str, values: NDArray[Any], taken: set[str], losses: Losses) -> list[Field]:
    if name in STANDARD and values.ndim == 1 and values.dtype.kind in STANDARD[name][1]:
        return [_of_column(STANDARD[name][0], values, losses)]
    fields = []
    for title, column in separate_columns(name, values, losses).items():
        plain = re.sub(r"^(?![A-Za-z_])", "_", re.sub(r"[^A-Za-z0-9_.-]", "_", title))
        fields.append(_of_column(f"{PREFIX}:{unused_name(plain, taken, losses, 'the column', title)}", column, losses))
    return fields


def _of_column(name: str, values: NDArray[Any], losses: Losses) -> Field:
    """Return the field of one column of an attribute, whose limits are those of its dtype."""
    kind = values.dtype
    if kind == np.bool_:
        return Field(name, lambda rows: values[rows].view(np.uint8), np.dtype("u1"), (0, 1))
    if kind == np.uint64:
        if len(values) and values.max() > np.iinfo(np.int64).max:
            losses.append(f"stores {name.rpartition(':')[2]} as 64-bit floats, which round its largest numbers")
            return Field(name, lambda rows: values[rows].astype(np.float64), np.dtype("f8"))
        return Field(name, lambda rows: values[rows].astype(np.int64), np.dtype("i8"), (0, 2**63 - 1))
    if kind.kind == "f":
        return Field(name, lambda rows: values[rows], kind)
    limits = np.iinfo(kind)
    return Field(name, lambda rows: values[rows], kind, (int(limits.min), int(limits.max)))


def _of_three(values: NDArray[Any], names: Any) -> list[Field]:
    """Return the fields of normals or colours, (n, 3)."""
    limits = (0, 255) if values.dtype == np.uint8 else (0, 0)
    return [
        Field(name, lambda rows, k=k: values[rows, k], values.dtype, limits)  # type: ignore[misc]
        for k, name in enumerate(names)
    ]


def _states(points: Points, rows: Rows) -> NDArray[np.uint8]:
    return np.where(are_finite(points.positions[rows]), 0, INVALID).astype(np.uint8)


# ----------------------------------------------------------------------------------------------------- positions


def _positions(points: Points, scan: Scan) -> list[Field]:
    """Return the coordinates of a scan relative to its scanner position: integers where the file had them, or floats.

    They are float32 if nothing is lost. Those of rows that are not finite are 0.
    """
    station = np.zeros(3) if scan.station is None else np.array(scan.station)
    limits = _integer_limits(points, scan)
    if limits is not None:
        known = points.georeference
        assert known.scale is not None and known.offset is not None
        grids = [(known.scale[k], known.offset[k] - float(station[k])) for k in range(3)]
        least = [low for low, _ in limits]
        return [
            Field(name, lambda rows, k=k: _numbers(points, rows, least)[:, k], np.dtype("i8"), limits[k], grids[k])  # type: ignore[misc]
            for k, name in enumerate(CARTESIAN)
        ]
    wide = is_float64(points) or bool(station.any())

    def values(rows: Rows, k: int) -> NDArray[Any]:
        world = world_rows(points, rows)
        column = world[:, k] - station[k] if wide else world[:, k]
        return np.where(are_finite(points.positions[rows]), column, 0)

    dtype = np.dtype("f8" if wide else "f4")
    return [
        Field(name, lambda rows, k=k: values(rows, k), dtype)  # type: ignore[misc]
        for k, name in enumerate(CARTESIAN)
    ]


def _numbers(points: Points, rows: Rows, missing: Sequence[int] = (0, 0, 0)) -> NDArray[np.int64]:
    """Return the integer coordinates of the original file, (m, 3); `missing` where a row is not finite."""
    known, residual = points.georeference, points.attributes.get(RESIDUAL)
    with np.errstate(invalid="ignore"):
        numbers = numbers_of(known, in_file(known, points.positions[rows] + points.origin))
    if residual is not None and residual.shape == points.positions.shape:
        numbers += residual[rows]
    numbers[~are_finite(points.positions[rows])] = missing
    return numbers


def _integer_limits(points: Points, scan: Scan) -> list[tuple[int, int]] | None:
    """Return the limits of a scan's integer coordinates along each axis; None if they do not restore its positions."""
    known = points.georeference
    if known.scale is None or known.offset is None:
        return None
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for start in range(0, scan.size, CHUNK):
        rows = scan.part(start, min(start + CHUNK, scan.size))
        numbers, local = _numbers(points, rows), points.positions[rows]
        finite = are_finite(local)
        if not finite.any():
            continue
        restored = np.array(known.offset) + np.array(known.scale) * numbers
        steps = np.abs(restored - in_file(known, local + points.origin)) / np.array(known.scale)
        rounded = np.abs(local) * np.float32(2.0**-23) / np.array(known.scale) + 1e-3
        is_kept = known.projection is not None or bool((steps <= rounded)[finite].all())
        low, high = np.fmin(low, numbers[finite].min(axis=0)), np.fmax(high, numbers[finite].max(axis=0))
        if not is_kept or max(-low.min(), high.max()) > MOST_STEPS:
            return None
    if not np.isfinite(low).all():
        low, high = np.zeros(3), np.zeros(3)
    if (low == high).all():  # libE57 cannot read scans whose columns all have 0 bits
        high[0] += 1
    return [(int(a), int(b)) for a, b in zip(low, high, strict=True)]
