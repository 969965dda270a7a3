"""What is written to LAS, LAZ and COPC files: the point format, scale and offset, extra bytes and coordinate system."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ....base.arrays import Flags
from ....cloud.georeference import RESIDUAL, Georeference
from ....cloud.points import Points
from .._losses import Losses, rows_left_out, separate_columns
from .._named_columns import names_with_roles
from ._crs import USER, WKT, records_for
from ._grid import Grid, Rows
from ._rows import NORMALS as NORMAL_NAMES

CANDIDATES = (0, 2, 1, 6, 3, 7, 8)  # point formats without waveforms, smallest rows first
MOST_EXTRAS, MOST_BYTES = 65535 // 192, 65535  # extra bytes that a record can describe; bytes of a row
LONGEST_NAME, LONGEST_RECORD = 32, 65535  # bytes
SHADES = 257  # 16-bit value per step of an 8-bit value
WEEK = 604800.0  # seconds: a larger GPS time is not a time of the week
NORMALS = ("NormalX", "NormalY", "NormalZ")
PACKED = {"X", "Y", "Z", "x", "y", "z", "bit_fields", "raw_classification", "classification_flags"}


class Extra(NamedTuple):
    """A column to be written as extra bytes: its name, and its values, (n,) or (n, 2) or (n, 3)."""

    name: str
    values: NDArray[Any]


class Plan(NamedTuple):
    """What is written of points, and how.

    Attributes
    ----------
    header : LasHeader
        Header of laspy, without the number of points and their bounds.
    standard : list of str
        Attributes that are fields of the point format.
    extras : list of Extra
        Columns written as extra bytes.
    grid : Grid
        Scale and offset of the coordinates.
    trailing : list of VLR
        Records that are too long for the header.
    finite : (n,) bool
        Rows that are written.
    """

    header: Any
    standard: list[str]
    extras: list[Extra]
    grid: Grid
    trailing: list[Any]
    finite: Flags


def plan_of(points: Points, losses: Losses, formats: Sequence[int] = CANDIDATES) -> Plan:
    """Decide how points are written; `losses` receives descriptions of what cannot be stored.

    formats : point formats to choose from, those with smaller rows first
    """
    import laspy

    format, standard = _choose_format(points, formats)
    extras = _extras_of(points, format, standard, losses)
    header = laspy.LasHeader(version="1.4", point_format=format)
    header.generating_software = "pointray"
    header.add_extra_dims([laspy.ExtraBytesParams(x.name, _type_of(x.values)) for x in extras])
    for record in header.vlrs.get("ExtraBytesVlr"):  # laspy would store limits from the first row of each chunk only
        for described in record.extra_bytes_structs:
            described.options &= ~6 if described.data_type else 255
    grid = Grid(points, losses)
    header.scales, header.offsets = np.array(grid.scale), np.array(grid.offset)
    trailing = _state_crs(header, points.georeference, losses)
    time = points.attributes.get("gps_time") if "gps_time" in standard else None
    if time is not None and np.abs(time).max() > WEEK:
        header.global_encoding.gps_time_type = laspy.header.GpsTimeType.STANDARD
    if points.georeference.stations:
        losses.append("cannot store the scanner positions")
    losses += rows_left_out(points)
    return Plan(header, standard, extras, grid, trailing, points.finite)


def record_of(points: Points, plan: Plan, part: Rows) -> Any:
    """Return some rows as laspy's record of points. Rows that are not finite have the coordinates 0."""
    import laspy

    format = plan.header.point_format
    rows = np.zeros(len(points.positions[part]), format.dtype())
    record = laspy.PackedPointRecord(rows, format)
    numbers = plan.grid.numbers_of(points, part, plan.finite)
    for k, axis in enumerate("XYZ"):
        rows[axis] = numbers[:, k]
    if points.colors is not None:
        colors = points.colors[part].astype(np.uint16) * SHADES
        for k, name in enumerate(("red", "green", "blue")):
            rows[name] = colors[:, k]
    for name in plan.standard:
        values = points.attributes[name][part]
        record[name] = values if name in rows.dtype.names else values.astype(np.uint8)  # a bit field
    for name, values in plan.extras:
        rows[name] = values[part]
    return record


# ------------------------------------------------------------------------------------------------------- columns


def _choose_format(points: Points, formats: Sequence[int]) -> tuple[int, list[str]]:
    """Return the LAS point format that stores as many attributes as possible, and the names of these attributes.

    Among several such formats it is the one with the smallest rows.

    formats : point formats to choose from
    """
    import laspy

    best: tuple[int, list[str]] = formats[0], []
    found = False
    for format in formats:
        dimensions = {d.name: d for d in laspy.PointFormat(format).dimensions}
        if points.colors is not None and "red" not in dimensions:
            continue
        held = [n for n, v in points.attributes.items() if n in dimensions and _fits(v, dimensions[n])]
        held = [name for name in held if name not in ("red", "green", "blue", "X", "Y", "Z")]
        if not found or len(held) > len(best[1]):
            best, found = (format, held), True
    return best


def _fits(values: NDArray[Any], dimension: Any) -> bool:
    """Whether a field of a point format stores the values of an attribute exactly.

    dimension : laspy's description of the field
    """
    if values.ndim != 1:
        return False
    if dimension.dtype is not None and dimension.dtype.kind == "f":
        return bool(values.dtype.kind == "f" and values.dtype.itemsize <= dimension.dtype.itemsize)
    if values.dtype.kind == "f" and not (np.isfinite(values).all() and (values == np.rint(values)).all()):
        return False
    return bool(values.min() >= dimension.min and values.max() <= dimension.max)


def _extras_of(points: Points, format: int, standard: list[str], losses: Losses) -> list[Extra]:
    """Return the columns to be written as extra bytes: normals, and attributes that the point format does not store.

    format : number of the point format; standard : names of the attributes that it stores
    losses : receives descriptions of what cannot be stored
    """
    import laspy

    dimensions = laspy.PointFormat(format)
    taken = PACKED | set(dimensions.dimension_names)
    extras: list[Extra] = []
    widths = {name: 1 if values.ndim == 1 else values.shape[1] for name, values in points.attributes.items()}
    if points.normals is not None:
        extras += [Extra(name, points.normals[:, k]) for k, name in enumerate(NORMALS)]
        taken |= {*NORMALS, *(name for name in widths if name.lower() in NORMAL_NAMES[0])}
    else:
        taken |= names_with_roles(widths, NORMAL_NAMES)
    size = dimensions.size + 4 * len(extras)
    for name, values in points.attributes.items():
        if name in standard or name == RESIDUAL:
            continue
        columns = _columns_of(name, values, taken, losses)
        size += sum(_type_of(c.values).itemsize for c in columns)
        if size > MOST_BYTES or len(extras) + len(columns) > MOST_EXTRAS:
            losses.append(f"cannot store {name}: a row has at most {MOST_EXTRAS} extra columns and {MOST_BYTES} bytes")
            size -= sum(_type_of(c.values).itemsize for c in columns)
            continue
        extras += columns
    return extras


def _columns_of(name: str, values: NDArray[Any], taken: set[str], losses: Losses) -> list[Extra]:
    """Split an attribute into columns of extra bytes, each of at most three numbers per row.

    taken : names that are in use, to which the new ones are added; losses : receives notes on changed names
    """
    values = values.view(np.uint8) if values.dtype == np.bool_ else values
    columns = separate_columns(name, values, losses, 3)
    return [Extra(_name(title, taken, losses), column) for title, column in columns.items()]


def _name(name: str, taken: set[str], losses: Losses) -> str:
    """Return an unused name of at most 32 bytes for a column of extra bytes.

    taken : names that are in use, to which it is added; losses : receives a note if the name is changed
    """
    plain = name.replace("\0", " ").strip().encode(errors="replace") or b"extra"  # readers remove blanks at the ends
    free, number = plain[:LONGEST_NAME].decode(errors="ignore").strip(), 1
    while free in taken:
        number += 1
        tail = f"_{number}"
        free = plain[: LONGEST_NAME - len(tail)].decode(errors="ignore") + tail
    if free != name:
        losses.append(f"stores {name} as the extra bytes {free}")
    taken.add(free)
    return free


def _type_of(values: NDArray[Any]) -> np.dtype[Any]:
    return values.dtype if values.ndim == 1 else np.dtype((values.dtype, values.shape[1:]))


def _state_crs(header: Any, georeference: Georeference, losses: Losses) -> list[Any]:
    """Write the coordinate system to a header; return the records that are too long for it, to follow the points.

    header : of laspy; losses : receives a description of what cannot be stored
    """
    import laspy

    trailing: list[Any] = []
    unit = georeference.unit if georeference.projection is None else "degree"
    for number, data in records_for(georeference.crs, unit, losses):
        record = laspy.VLR(USER, number, "coordinate system", data)
        (header.vlrs if len(data) <= LONGEST_RECORD else trailing).append(record)
        header.global_encoding.wkt = number == WKT
    return trailing
