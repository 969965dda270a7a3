"""Points of a LAS file as columns: the layout of a point format, and conversion of rows of bytes."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ....cloud.georeference import RESIDUAL
from .._source import Chunk, Faults
from ._header import Header, _text

FORMATS = 11  # point formats 0 to 10
TYPES = ("u1", "i1", "u2", "i2", "u4", "i4", "u8", "i8", "f4", "f8")  # 1 to 10; then pairs, then triples
EXTRA, SCALED, MOVED = 192, 8, 16  # bytes of a description of extra bytes; flags for scale and offset
NORMALS = (("normalx", "normaly", "normalz"), ("nx", "ny", "nz"), ("normal_x", "normal_y", "normal_z"))
COLORS = ("red", "green", "blue")


class Column(NamedTuple):
    """A column of a LAS file.

    Attributes
    ----------
    name : str
        Name of the attribute.
    field : str
        Field of a row that contains it.
    mask : int
        Its bits in the field; 0: the whole field.
    scale, offset : (k,) array or None
        For extra bytes: value = offset + scale * number.
    """

    name: str
    field: str
    mask: int = 0
    scale: Any = None
    offset: Any = None


class Layout(NamedTuple):
    """Layout of the rows of a file.

    Attributes
    ----------
    dtype : dtype
        Structured type of a row.
    columns : tuple of Column
        The attributes.
    normals : tuple of Column
        Components of the normals: three or none.
    colors : bool
        Whether a row has red, green and blue.
    """

    dtype: np.dtype[Any]
    columns: tuple[Column, ...]
    normals: tuple[Column, ...]
    colors: bool

    @property
    def size(self) -> int:
        """Bytes per row after conversion to columns."""
        return 24 + 6 * self.colors + 12 * bool(self.normals) + sum(_size(c, self.dtype) for c in self.columns)


def layout_of(header: Header, faults: Faults) -> Layout:
    """Return the layout of a file's rows: its point format and extra bytes; ValueError if the header is inconsistent.

    Invalid descriptions of extra bytes are recorded in `faults`.
    """
    from laspy.point.dims import COMPOSED_FIELDS, POINT_FORMATS_DTYPE

    if header.format >= FORMATS:
        raise ValueError(f"unsupported point format {header.format} (byte 104): expected 0 to 10")
    standard, parts = POINT_FORMATS_DTYPE[header.format], COMPOSED_FIELDS[header.format]
    spare = header.row - standard.itemsize
    if spare < 0:
        raise ValueError(
            f"is damaged: its rows have {header.row} bytes (byte 105), "
            f"those of point format {header.format} need {standard.itemsize} or more"
        )
    columns = [
        column
        for field in standard.names
        for column in (
            [Column(p.name, field, p.mask) for p in parts[field]] if field in parts else [Column(field, field)]
        )
        if field not in ("X", "Y", "Z", *COLORS)
    ]
    fields = [(name, standard[name].newbyteorder("<")) for name in standard.names]
    taken = {column.name for column in columns} | {RESIDUAL}
    extras = _extras_of(header.all_of("LASF_Spec", 4) if spare else [], spare, taken, faults)
    for k, (column, dtype) in enumerate(extras):
        fields.append((f"extra {k}", dtype))
        if dtype.itemsize:
            columns.append(column._replace(field=f"extra {k}"))
    normals = _normals_of(columns, np.dtype(fields))
    rest = tuple(column for column in columns if column not in normals)
    return Layout(np.dtype(fields), rest, normals, "red" in standard.names)


def _extras_of(
    records: Sequence[bytes], spare: int, taken: set[str], faults: Faults
) -> list[tuple[Column, np.dtype[Any]]]:
    """Return the columns in the extra bytes of a row, each with its dtype; undescribed bytes come last, as one column.

    A description with an unknown type or too many bytes is recorded in `faults`: it is ignored, as are all after it.

    records : data of the records that describe extra bytes; spare : number of extra bytes of a row
    taken : names of other columns, to which the new ones are added
    """
    extras: list[tuple[Column, np.dtype[Any]]] = []
    data = b"".join(record[: len(record) // EXTRA * EXTRA] for record in records)
    for at in range(0, len(data), EXTRA):
        kind, flags = data[at + 2 : at + 4]
        name = _text(data[at + 4 : at + 36]) or "extra"
        if kind > 3 * len(TYPES):
            faults.add(f"the extra bytes {name!r} have the unknown type {kind}: their description is ignored")
            break
        count = (kind - 1) // len(TYPES) + 1 if kind else flags
        base = np.dtype("<" + TYPES[(kind - 1) % len(TYPES)]) if kind else np.dtype("u1")
        if base.itemsize * count > spare:
            faults.add(
                f"the extra bytes {name!r} are described as {base.itemsize * count} bytes, but {spare} are left: "
                f"the description is ignored"
            )
            break
        scale = np.frombuffer(data, "<f8", count, at + 112) if kind and flags & SCALED else None
        offset = np.frombuffer(data, "<f8", count, at + 136) if kind and flags & MOVED else None
        column = Column(_unique(name, taken), "", 0, scale, offset)
        extras.append((column, base if count == 1 else np.dtype((base, (count,)))))
        spare -= base.itemsize * count
    if spare:
        extras.append((Column(_unique("ExtraBytes", taken), ""), np.dtype(("u1", (spare,)) if spare > 1 else "u1")))
    return extras


def _unique(name: str, taken: set[str]) -> str:
    while name in taken:
        name += "_"
    taken.add(name)
    return name


def _normals_of(columns: list[Column], dtype: np.dtype[Any]) -> tuple[Column, ...]:
    """Return the three columns with the components of the normals, by their names; () without normals.

    dtype : structured type of a row
    """
    known = {c.name.lower(): c for c in columns if dtype[c.field].ndim == 0}
    found = next((tuple(known[name] for name in names) for names in NORMALS if known.keys() >= set(names)), ())
    floats = all(dtype[c.field].kind == "f" or c.scale is not None for c in found)
    return found if floats else ()


def _size(column: Column, dtype: np.dtype[Any]) -> int:
    field = dtype[column.field]
    scaled = column.scale is not None or column.offset is not None
    return 8 * field.itemsize // field.base.itemsize if scaled else field.itemsize


def chunk_of(rows: NDArray[Any], header: Header, layout: Layout, share: float) -> Chunk:
    """Convert rows of a file, (n,) of a structured dtype, to columns in world coordinates.

    share : fraction of the file read so far
    """
    positions = np.empty((len(rows), 3))
    for k, name in enumerate("XYZ"):  # offset + scale * integer, rounded like laspy
        np.multiply(rows[name], header.scale[k], out=positions[:, k])
        positions[:, k] += header.offset[k]
    normals = colors = None
    if layout.normals:
        normals = np.stack([_values_of(rows, column) for column in layout.normals], axis=1)
    if layout.colors:
        colors = np.empty((len(rows), 3), np.uint16)
        for k, name in enumerate(COLORS):
            colors[:, k] = rows[name]
    attributes = {column.name: _values_of(rows, column) for column in layout.columns}
    return Chunk(positions, normals, colors, attributes, share)


def _values_of(rows: NDArray[Any], column: Column) -> NDArray[Any]:
    values = rows[column.field]
    if column.mask:
        low = (column.mask & -column.mask).bit_length() - 1
        bits = values & np.uint8(column.mask)
        return np.right_shift(bits, np.uint8(low), out=bits)
    if column.scale is None and column.offset is None:
        return np.array(values, values.dtype.newbyteorder("="), order="C")
    scale = np.ones(1) if column.scale is None else column.scale
    offset = np.zeros(1) if column.offset is None else column.offset
    with np.errstate(all="ignore"):  # a damaged scale can cause infinities
        return np.asarray(
            values * (scale if values.ndim > 1 else scale[0]) + (offset if values.ndim > 1 else offset[0])
        )


def unpack_u16(data: bytes) -> tuple[int, ...]:
    """Return bytes as 16-bit unsigned integers, little-endian."""
    return struct.unpack(f"<{len(data) // 2}H", data[: len(data) // 2 * 2])
