"""NPZ files: named NumPy arrays in a zip archive. Files written by pointray are restored without loss."""

from __future__ import annotations

import math
import zipfile
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....base.progress import Progress, report_progress
from ....base.warning_log import warn
from ....cloud.georeference import RESIDUAL
from ....cloud.points import Points
from .._named_columns import POSITIONS, SPECIAL, Columns, Roles, roles_of
from .._source import MAYBE, NO, SURE, Chunk, Format, Listing, Request, Source
from .._unnamed_columns import recognise_array_columns
from .._world import is_float64, world_rows
from ._array import blocks_of, check_dtype, check_table, fields_of, step_of
from ._members import SUFFIX, Member, georeference_of, members_of, opened, pop_metadata

NAME = 30  # offset of the name of an archive's first member
ATTRIBUTES = "attributes/"  # prefix of attributes whose names are reserved
FACTS = ("crs", "unit", "origin", "scale", "offset", "stations")


def recognise(head: bytes, path: Path) -> int:
    """Detect NPZ files: return `SURE` if the first member is an array, `MAYBE` for other zip files named .npz, or `NO`.

    head : first bytes of the file
    """
    if head[NAME : NAME + int.from_bytes(head[26:28], "little")].endswith(b".npy") and head.startswith(b"PK\3\4"):
        return SURE
    return MAYBE if head.startswith((b"PK\3\4", b"PK\5\6")) and path.suffix.lower() == ".npz" else NO


class NpzSource(Source):
    """Reader of NPZ files: arrays for positions, normals, colours and attributes in a zip archive."""

    def __init__(self, path: Path, request: Request) -> None:
        self._path = path
        with opened(path) as archive:
            members = members_of(archive, path.stat().st_size)
            facts = pop_metadata(archive, members)
        self._origin = np.array(facts["origin"]) if "origin" in facts else None
        first, self._table = _first(members)
        if self._table:
            _check_table(members[first], request.columns)
        self._count = members[first].header.rows
        if self._count == 0:
            raise ValueError(f"contains no points: the array {first!r} has no rows")
        members = {name: _as_column(m, members[first].header.shape[:-1]) for name, m in members.items()}
        self._members = {name: m for name, m in members.items() if _is_column(name, m, self._count)}
        self._left_out = [name for name in members if name not in self._members]
        self._names = request.columns
        self._types_and_roles(("x", "y", "z"))
        row = sum(member.header.nbytes for member in self._members.values()) // self._count
        self._step = step_of(row)
        self.listing = Listing(self._count, 36 + row, georeference=georeference_of(facts))

    def chunks(self) -> Iterator[Chunk]:
        if self._left_out:
            warn(
                f"arrays without one number per point are ignored: {', '.join(map(repr, self._left_out[:20]))}",
                stacklevel=2,
            )
        names = self._table_names()
        roles, done = self._types_and_roles(names), 0
        for blocks in self._blocks(list(self._members)):
            done += len(next(iter(blocks.values())))
            chunk = roles.chunk(self._expanded(blocks, names), done / self._count)
            if self._origin is not None:
                chunk = chunk._replace(positions=chunk.positions + self._origin)
            attributes = {name.removeprefix(ATTRIBUTES): values for name, values in chunk.attributes.items()}
            yield chunk._replace(attributes=attributes)

    def _blocks(self, names: list[str]) -> Iterator[Columns]:
        """Yield blocks of rows of the arrays with these names, as a dict of (m,) or (m, k) arrays by name."""
        with opened(self._path) as archive, ExitStack() as stack:
            streams = [stack.enter_context(self._members[name].open(archive)) for name in names]
            headers = [self._members[name].header for name in names]
            parts = [blocks_of(*one, self._step) for one in zip(streams, headers, strict=True)]
            for blocks in zip(*parts, strict=True):
                yield dict(zip(names, blocks, strict=True))

    def _table_names(self) -> tuple[str, ...]:
        """Return the column names of the one array that holds several columns of the points; () if there is none.

        They are its field names, given by the caller, or recognised from the values.
        """
        table = self._table
        if not table:
            return ()
        header = self._members[table].header
        if header.dtype.names:
            return tuple(header.dtype.names)
        if not self._names:
            names, self.note = recognise_array_columns(
                lambda: (blocks[table] for blocks in self._blocks([table])), header.width
            )
            self._names = tuple(names)
        return self._names

    def _types_and_roles(self, names: tuple[str, ...]) -> Roles:
        types = {n: (m.header.dtype, m.header.width) for n, m in self._members.items() if n != self._table}
        if self._table:
            header = self._members[self._table].header
            fields = fields_of(header) if header.dtype.fields else dict.fromkeys(names, (header.dtype, 0))
            types.update(fields)
        return roles_of(types)

    def _expanded(self, blocks: Columns, names: tuple[str, ...]) -> Columns:
        """Replace the one array that holds several columns of the points by its columns, except those named "-".

        blocks : rows of all arrays by name; names : of the columns
        """
        if not self._table:
            return blocks
        block = blocks.pop(self._table)
        named = block.dtype.names is not None
        columns = {name: block[name] if named else block[:, k] for k, name in enumerate(names) if name != "-"}
        return {**blocks, **columns}


def _first(members: dict[str, Member]) -> tuple[str, str]:
    """Return two names: of the array with the positions (or x), and of the one whose columns must be identified.

    The second name equals the first, or is "" if that array certainly has coordinates only. Raise ValueError if there
    are no positions.

    members : arrays of the archive by name
    """
    if not members:
        raise ValueError("contains no arrays")
    lower = {name.lower(): name for name in members}
    for name in members:
        if name.lower() in SPECIAL:
            check_dtype(members[name].header.dtype)
    for key in POSITIONS:
        if key in lower and members[lower[key]].header.width >= 3:
            return lower[key], "" if members[lower[key]].header.width == 3 else lower[key]
    if {"x", "y", "z"} <= lower.keys():
        return lower["x"], ""
    tables = [name for name, m in members.items() if m.header.dtype.fields or m.header.width >= 3]
    if len(tables) != 1:
        names = ", ".join(repr(name[:30])[1:-1] for name in list(members)[:20])
        raise ValueError(
            f"positions not found: expected an array positions, points or xyz, or arrays x, y, z; available: {names}"
        )
    return tables[0], tables[0]


def _check_table(member: Member, columns: tuple[str, ...] | None) -> None:
    if member.header.dtype.hasobject or not member.header.dtype.fields:
        check_table(member.header, columns)


def _as_column(member: Member, pixels: tuple[int, ...]) -> Member:
    """Return an array of image shape as a column, (n,), if the positions are an image of the same shape.

    Other arrays are returned unchanged.

    pixels : shape of the positions without the last axis
    """
    header = member.header
    if len(pixels) < 2 or header.shape != pixels or header.fortran:
        return member
    return member._replace(header=header._replace(shape=(math.prod(pixels),)))


def _is_column(name: str, member: Member, count: int) -> bool:
    """Whether an array has one value or row per point.

    Raise ValueError if it has another number of rows, and its name is one of positions, normals or colours.

    count : number of points
    """
    header = member.header
    if name.lower() in SPECIAL and header.rows != count:
        raise ValueError(f"the array {name!r} has {header.rows:,} rows, expected {count:,} for its points")
    is_table = bool(header.dtype.fields) and not header.dtype.hasobject
    return (header.dtype.kind in "biuf" or is_table) and header.rows == count and header.shape != ()


# ----------------------------------------------------------------------------------------------------- writing


def write(file: Any, points: Points, progress: Progress | None = None) -> list[str]:
    """Write all data of the points to a stream, as a zip archive of arrays; return [], because nothing is lost."""
    georeference, float64 = points.georeference, is_float64(points)
    facts = {
        name: getattr(georeference, name) for name in ("crs", "unit", "scale", "offset") if getattr(georeference, name)
    }
    if georeference.stations:
        facts["stations"] = georeference.stations
    arrays = {"positions": points.positions, "normals": points.normals, "colors": points.colors}
    for name, values in points.attributes.items():
        if name != RESIDUAL or not float64:  # included in the positions
            arrays[_member_name(name)] = values
    there = {name: values for name, values in arrays.items() if values is not None}
    with zipfile.ZipFile(file, "w") as archive:
        for name, fact in facts.items():
            _write_array(archive, name, np.array(fact))
        for k, (name, values) in enumerate(there.items()):
            _write_array(archive, name, values, points if name == "positions" and float64 else None)
            report_progress(progress, (k + 1) / len(there))
    return []


def _member_name(name: str) -> str:
    """Return the name of the array that stores an attribute: its own, or with a prefix where that means other data.

    Names like "colors" or "crs" would be read as colours or as the coordinate system.

    Raise ValueError if an archive cannot have such a name.
    """
    try:
        long = len(name.encode("utf-8")) > 60_000
    except UnicodeEncodeError:
        long = True
    if long or "\0" in name or "\\" in name:
        raise ValueError(f"an NPZ file cannot store an attribute named {name[:60]!r}")
    special = name.lower() in SPECIAL or name in FACTS or name.startswith(ATTRIBUTES)
    return ATTRIBUTES + name if special else name


def _write_array(archive: zipfile.ZipFile, name: str, values: NDArray[Any], world_of: Points | None = None) -> None:
    """Write an array to an archive in parts.

    world_of : if given, write the world coordinates of these points in float64 instead; `values` only gives the shape
    """
    dtype = np.dtype(np.float64) if world_of is not None else values.dtype
    facts = {"descr": np.lib.format.dtype_to_descr(dtype), "fortran_order": False, "shape": values.shape}
    with archive.open(name + SUFFIX, "w", force_zip64=True) as stream:
        np.lib.format.write_array_header_1_0(stream, facts)
        if values.ndim == 0:
            stream.write(values.tobytes())
            return
        step = step_of(dtype.itemsize * (values.size // max(len(values), 1)))
        for start in range(0, len(values), step):
            part = slice(start, start + step)
            stream.write(np.ascontiguousarray(values[part] if world_of is None else world_rows(world_of, part)).data)


FORMAT = Format(
    "NPZ",
    (".npz",),
    recognise,
    NpzSource,
    {
        "positions": "positions, points, xyz, pos, pts, coords, pts3d, world_points (also as images); x, y, z; "
        "a single array is read like NPY; origin",
        "normals": "normals or normal; nx, ny, nz",
        "colors": "colors, colours, color, rgb; r, g, b or red, green, blue",
        "attributes": "all other arrays with one row per point, with their types",
        "survey": "crs, unit, scale, offset, stations",
        "note": "written without loss",
    },
    write=write,
)
