"""Writer for LAS 1.4 and LAZ: choice of the point format, scale and offset, and extra bytes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ....base.arrays import Flags
from ....base.progress import Progress, report_progress
from ....cloud.geographic import in_file
from ....cloud.georeference import RESIDUAL, Georeference, numbers_of
from ....cloud.points import Points
from .._source import CHUNK
from ._crs import USER, WKT, records_for

Losses = list[str]
CANDIDATES = (0, 2, 1, 6, 3, 7, 8)  # point formats without waveforms, smallest rows first
MOST_EXTRAS, MOST_BYTES = 65535 // 192, 65535  # extra bytes that a record can describe; bytes of a row
LONGEST_NAME, LONGEST_RECORD = 32, 65535  # bytes
SHADES = 257  # 16-bit value per step of an 8-bit value
DEGREE = 1e-6  # step in degrees per step in metres: fine enough that nothing is lost by rounding
WEEK = 604800.0  # seconds: a larger GPS time is not a time of the week
NORMALS = ("NormalX", "NormalY", "NormalZ")
PACKED = {"X", "Y", "Z", "x", "y", "z", "bit_fields", "raw_classification", "classification_flags"}


class Extra(NamedTuple):
    """A column to be written as extra bytes: its name, and its values, (n,) or (n, 2) or (n, 3)."""

    name: str
    values: NDArray[Any]


def write(file: Any, points: Points, progress: Progress | None = None) -> Losses:
    """Write all data of the points to a stream as LAS 1.4 or, if its path ends with .laz, LAZ.

    Rows without a finite position are left out. Return descriptions of this and of what LAS cannot store.
    """
    import laspy

    losses: Losses = []
    format, standard = _choose_format(points)
    extras = _extras_of(points, format, standard, losses)
    header = laspy.LasHeader(version="1.4", point_format=format)
    header.generating_software = "pointray"
    header.add_extra_dims([laspy.ExtraBytesParams(x.name, _type_of(x.values)) for x in extras])
    for record in header.vlrs.get("ExtraBytesVlr"):  # laspy would store limits from the first row of each chunk only
        for described in record.extra_bytes_structs:
            described.options &= ~6 if described.data_type else 255
    grid = _Grid(points, losses)
    header.scales, header.offsets = np.array(grid.scale), np.array(grid.offset)
    trailing = _state_crs(header, points.georeference, losses)
    time = points.attributes.get("gps_time") if "gps_time" in standard else None
    if time is not None and np.abs(time).max() > WEEK:
        header.global_encoding.gps_time_type = laspy.header.GpsTimeType.STANDARD
    if points.georeference.stations:
        losses.append("cannot store the scanner positions")
    missing = len(points) - int(points.finite.sum())
    if missing:
        losses.append(f"leaves out {missing:,} row{'s' * (missing > 1)} without a finite position")
    stream = _ErrorRecorder(file)
    try:
        _write_rows(stream, points, (header, standard, extras, grid, trailing), progress)
    except BaseException as error:
        if stream.error is not None:
            raise stream.error from None
        if isinstance(error, Exception | KeyboardInterrupt | SystemExit):
            raise
        raise ValueError(f"lazrs cannot compress the points: {error}") from None  # a Rust panic
    return losses


def _write_rows(stream: Any, points: Points, plan: tuple[Any, ...], progress: Progress | None) -> None:
    import laspy

    header, standard, extras, grid, trailing = plan
    packed = Path(stream.path).suffix.lower() == ".laz"
    backend = laspy.LazBackend.LazrsParallel if packed else None
    finite = points.finite
    whole = bool(finite.all())
    with laspy.LasWriter(stream, header, do_compress=packed, laz_backend=backend, closefd=False) as writer:
        for start in range(0, len(points), CHUNK):
            part = slice(start, start + CHUNK)
            rows = np.zeros(len(points.positions[part]), header.point_format.dtype())
            record = laspy.PackedPointRecord(rows, header.point_format)
            numbers = grid.numbers_of(points, part, finite)
            for k, axis in enumerate("XYZ"):
                rows[axis] = numbers[:, k]
            if points.colors is not None:
                for k, name in enumerate(("red", "green", "blue")):
                    rows[name] = points.colors[part, k].astype(np.uint16) * SHADES
            for name in standard:
                values = points.attributes[name][part]
                record[name] = values if name in rows.dtype.names else values.astype(np.uint8)  # a bit field
            for name, values in extras:
                rows[name] = values[part]
            writer.write_points(record if whole else laspy.PackedPointRecord(rows[finite[part]], header.point_format))
            report_progress(progress, min(part.stop / len(points), 1.0))
        if trailing:
            writer.write_evlrs(laspy.vlrs.vlrlist.VLRList(trailing))


class _ErrorRecorder:
    """Output stream that keeps its first exception, which lazrs hides."""

    def __init__(self, file: Any) -> None:
        self._file, self.path = file, file.path
        self.error: BaseException | None = None

    def _do(self, name: str, *arguments: Any) -> Any:
        try:
            return getattr(self._file, name)(*arguments)
        except BaseException as error:
            self.error = self.error or error
            raise

    def write(self, data: Any) -> Any:
        return self._do("write", data)

    def seek(self, offset: int, whence: int = 0) -> Any:
        return self._do("seek", offset, whence)

    def tell(self) -> Any:
        return self._do("tell")

    def flush(self) -> Any:
        return self._do("flush")


# ------------------------------------------------------------------------------------------------------- columns


def _choose_format(points: Points) -> tuple[int, list[str]]:
    """Return the LAS point format that stores as many attributes as possible, and the names of these attributes.

    Among several such formats it is the one with the smallest rows.
    """
    import laspy

    best: tuple[int, list[str]] = 0, []
    found = False
    for format in CANDIDATES:
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
    if points.normals is not None:
        extras += [Extra(name, points.normals[:, k]) for k, name in enumerate(NORMALS)]
        taken |= set(NORMALS)
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
    width = 1 if values.ndim == 1 else values.shape[1]
    if width <= 3:
        values = values[:, 0] if values.ndim == 2 and width == 1 else values
        return [Extra(_name(name, taken, losses), values)] if width else []
    losses.append(f"stores the {width} columns of {name} separately, as {name}_0 and so on")
    return [Extra(_name(f"{name}_{k}", taken, losses), values[:, k]) for k in range(width)]


def _name(name: str, taken: set[str], losses: Losses) -> str:
    """Return an unused name of at most 32 bytes for a column of extra bytes.

    taken : names that are in use, to which it is added; losses : receives a note if the name is changed
    """
    free, number = name.replace("\0", " ").encode()[:LONGEST_NAME].decode(errors="ignore"), 1
    while free in taken or not free:
        number += 1
        tail = f"_{number}"
        free = name.encode()[: LONGEST_NAME - len(tail)].decode(errors="ignore") + tail
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


# ----------------------------------------------------------------------------------------------------- coordinates


class _Grid:
    """Scale and offset of the integer coordinates to be written: those of the original file, or as fine as float32.

    Attributes
    ----------
    scale, offset : (3,) tuple of float
        coordinate = offset + scale * integer.
    """

    def __init__(self, points: Points, losses: Losses) -> None:
        self._residual: NDArray[Any] | None = None
        self._shift = np.zeros(3, np.int64)
        self._georeference = points.georeference
        if not self._fits(points):
            if points.georeference.scale is not None:
                losses.append(
                    f"rounds its coordinates: too large for 32 bits at steps of {min(points.georeference.scale):g}"
                )
            self._residual, self._shift = None, np.zeros(3, np.int64)
            size = max(float(np.abs(points.bounds - points.origin).max()), 1e-30)
            step = float(f"1e{int(np.floor(np.log10(size * 2.0**-24)))}")  # float32 is not finer there
            across = step if points.georeference.projection is None else step * DEGREE
            offset = in_file(points.georeference, points.origin[None])[0].tolist()
            self._georeference = replace(points.georeference, scale=(across, across, step), offset=tuple(offset))
        self.scale = self._georeference.scale
        self.offset = tuple((np.array(self._georeference.offset) + self._shift * np.array(self.scale)).tolist())

    def _fits(self, points: Points) -> bool:
        """Whether 32-bit integers with the file's original scale hold all coordinates.

        If necessary, the offset is moved by whole steps.
        """
        if self._georeference.scale is None:
            return False
        residual = points.attributes.get(RESIDUAL)
        if residual is not None and residual.shape == (len(points), 3) and residual.dtype.kind == "i":
            self._residual = residual
        with np.errstate(over="ignore"):
            bounds = in_file(self._georeference, points.bounds)
            farthest = np.abs((bounds - np.array(self._georeference.offset)) / np.array(self._georeference.scale)).max()
        if farthest < 2.0**31 - 2**12:  # float32 may be off by 128 steps there
            return True
        if not farthest < 2.0**52:
            return False
        finite = points.finite
        parts = [slice(start, start + CHUNK) for start in range(0, len(points), CHUNK)]
        limits = [_limits(self._whole(points, part)[finite[part]]) for part in parts if finite[part].any()]
        low, high = np.min([low for low, _ in limits], axis=0), np.max([high for _, high in limits], axis=0)
        if low.min() < -(2**31) or high.max() >= 2**31:
            self._shift = (low + high + 1) // 2
        return bool((high - low < 2**32).all())

    def _whole(self, points: Points, part: slice) -> NDArray[np.int64]:
        numbers = numbers_of(self._georeference, in_file(self._georeference, points.positions[part] + points.origin))
        if self._residual is not None:
            numbers += self._residual[part]
        return numbers

    def numbers_of(self, points: Points, part: slice, finite: Flags) -> NDArray[np.int64]:
        """Return the integer coordinates of a range of rows, (m, 3); 0 where a row is not finite.

        finite : (n,), whether each of all rows has a finite position
        """
        with np.errstate(invalid="ignore"):
            numbers = self._whole(points, part) - self._shift
        numbers[~finite[part]] = 0
        if numbers.min() < -(2**31) or numbers.max() >= 2**31:
            raise ValueError("cannot be written: its coordinates do not fit into 32-bit integers")
        return numbers


def _limits(numbers: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    return numbers.min(axis=0), numbers.max(axis=0)
