"""Conversion of the columns of files to the columns and types of `Points`, without rows that are not finite."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.arrays import Doubles
from ...base.disk_columns import Column, Columns
from ...base.progress import Progress, part_of, report_progress
from ...cloud.georeference import RESIDUAL, SCAN, Georeference
from ...cloud.points import are_finite, check_any_finite, check_attribute
from ...cloud.preparation import warn_of_left_out
from .. import joining
from ..colors import GREY, ColorRange, to_shades
from ..formats._source import CHUNK
from ..joining import Part
from ..locating import georeferenced, locate, origin_of, sample_step
from ..missing_columns import warn_missing_columns
from .raw import RAW, Raw
from .spooled import ATTRIBUTE, COLORS, NORMALS, POSITIONS, Spooled

LEFT_OUT, LOSSES = f"{RAW}left-out", f"{RAW}losses"

Rows = NDArray[Any]


class File(NamedTuple):
    """A file that has been read to disk, with the range of its rows.

    Attributes
    ----------
    part : Part
        Name, georeference, and chunks without rows, which carry only the types of the columns.
    begin, end : int
        Range of its rows among those of all files.
    color_range : ColorRange
        Statistics of its colours.
    first : int or None
        Index of its first scanner position, counted over all files; None if it has none, or if no file has.
    """

    part: Part
    begin: int
    end: int
    color_range: ColorRange
    first: int | None = None


class Cloud(NamedTuple):
    """Rows of all files, in columns on disk with the types of the files.

    Attributes
    ----------
    columns : Columns
        Folder of the columns.
    raws : dict of str to Raw
        Columns by name: "positions", "normals", "colors", and "attribute." + name for attributes.
    files : list of File
        Files in order, each with the range of its rows.
    """

    columns: Columns
    raws: dict[str, Raw]
    files: list[File]

    @property
    def rows(self) -> int:
        """Number of rows of all files."""
        return self.files[-1].end if self.files else 0

    def raw(self, name: str) -> Raw:
        """Return the column with this name, as stored in the files; it is created empty if missing."""
        if name not in self.raws:
            self.raws[name] = Raw(self.columns, len(self.raws))
        return self.raws[name]

    def blocks(self, progress: Progress | None) -> Iterator[tuple[File, int, int]]:
        """Yield all rows in blocks (file, begin, end), ranges of rows of the cloud that lie within one file."""
        for file in self.files:
            for begin in range(file.begin, file.end, CHUNK):
                report_progress(progress, begin / self.rows)
                yield file, begin, min(begin + CHUNK, file.end)


class Target(NamedTuple):
    """Column to be written, in its final type.

    Attributes
    ----------
    dtype : dtype
    width : int
        Numbers per row; 0 for a column of shape (n,).
    rows : callable
        (file, begin, end) -> rows of the cloud in this range, converted.
    plain : bool
        Whether rows read from the files that already have this dtype are written unchanged.
    """

    dtype: np.dtype[Any]
    width: int
    rows: Callable[[File, int, int], Rows]
    plain: bool = True


class Located(NamedTuple):
    """Result of writing the positions of a cloud to disk, in float32 about an origin.

    Attributes
    ----------
    origin : (3,) float64
        World coordinates = origin + positions.
    georeference : Georeference
        With a local projection, if the files have degrees.
    rows : int
        Number of finite rows.
    left_out : Column or None
        True for rows that are not finite; None if all are.
    losses : Column or None
        Rounding errors of the finite rows, in steps of the files' integer coordinates; None if float32 loses nothing.
    """

    origin: Doubles
    georeference: Georeference
    rows: int
    left_out: Column | None
    losses: Column | None


def convert(cloud: Cloud, progress: Progress | None) -> Spooled:
    """Convert all columns from the types of the files to those of `Points`; return the description of the result.

    Rows that are not finite are left out. Each old column is removed once it is converted.
    """
    files = [f._replace(part=joining.colored(f.part, f.color_range)) for f in cloud.files if f.part.chunks]
    parts = [file.part for file in files]
    georeference, firsts = joining.common_georeference(parts), joining.first_stations(parts)
    if firsts is not None:
        files = [file._replace(first=first) for file, first in zip(files, firsts, strict=True)]
    cloud = cloud._replace(files=files)
    warn_missing_columns([(part.name, part.chunks[0]) for part in parts])
    targets = {NORMALS: _normals(cloud), COLORS: _colors(cloud)}
    targets |= {ATTRIBUTE + name: _attribute(cloud, name) for name in joining.attributes_of(parts)}
    if firsts is not None:
        targets[ATTRIBUTE + SCAN] = _scans(cloud)
    made = {name: target for name, target in targets.items() if target is not None}
    ends = [(k + 1) / (len(made) + 1) for k in range(len(made) + 1)]
    located = _locate(cloud, georeference, part_of(progress, 0.0, ends[0]))
    attributes = [name for name in made if name.startswith(ATTRIBUTE)]
    if located.losses is not None and ATTRIBUTE + RESIDUAL not in made:
        attributes.append(ATTRIBUTE + RESIDUAL)
    names = {name: f"{ATTRIBUTE}{k}" for k, name in enumerate(attributes)}
    for (name, target), begin, end in zip(made.items(), ends[:-1], ends[1:], strict=True):
        _write(cloud, located, name, names.get(name, name), target, part_of(progress, begin, end))
        cloud.raw(name).drop()
        report_progress(progress, end)
    if located.losses is not None:  # replaces an attribute of the files with the same name
        cloud.columns.rename(LOSSES, names[ATTRIBUTE + RESIDUAL])
    cloud.columns.drop(LEFT_OUT)
    cloud.columns.sync()
    labels = [name.removeprefix(ATTRIBUTE) for name in attributes]
    lost = cloud.rows - located.rows
    return Spooled(located.rows, located.origin, located.georeference, labels, NORMALS in made, COLORS in made, lost)


# ------------------------------------------------------------------------------------------------------- positions


def _locate(cloud: Cloud, georeference: Georeference, progress: Progress | None) -> Located:
    """Write the finite positions relative to an origin in float32, and their rounding errors.

    Return the origin, the georeference, the number of rows, and the columns of rounding errors and of rows left out.

    georeference : of all files, to which a local projection is added if coordinates are in degrees
    """
    raw, columns, total = cloud.raw(POSITIONS), cloud.columns, cloud.rows
    georeference, sample = georeferenced(raw.sample(sample_step(total)), georeference)
    origin = origin_of(sample, total)
    positions = columns.make(POSITIONS, np.float32, 3)
    left_out: Column | None = None
    losses: Column | None = None
    for _, begin, end in cloud.blocks(progress):
        local, lost = np.empty((end - begin, 3), np.float32), None
        for rows, some in locate(raw.read(begin, end), origin, georeference, local):
            lost = np.zeros((end - begin, 3), np.int32) if lost is None else lost
            lost[rows] = some
        if lost is not None and losses is None:
            losses = columns.make(LOSSES, np.int32, 3, rows=len(positions))
        finite = are_finite(local)
        if not finite.all():
            left_out = columns.make(LEFT_OUT, np.bool_, rows=total) if left_out is None else left_out
            left_out.write(begin, ~finite)
            local, lost = local[finite], None if lost is None else lost[finite]
        positions.append(local)
        if losses is not None:
            losses.append(np.zeros((len(local), 3), np.int32) if lost is None else lost)
    raw.drop()
    check_any_finite(len(positions), total)
    warn_of_left_out(total - len(positions), total)
    return Located(origin, georeference, len(positions), left_out, losses)


# ----------------------------------------------------------------------------------------------------- other columns


def _write(cloud: Cloud, located: Located, name: str, new: str, target: Target, progress: Progress | None) -> None:
    """Write a column in its final type, without the rows left out. One that needs no conversion is only renamed.

    located : result of writing the positions, which states the rows left out
    name : of the column as read from the files; new : its final name; target : its final type and rows
    """
    whole = cloud.raw(name).whole(cloud.rows)
    if target.plain and whole is not None and whole.dtype == target.dtype and located.left_out is None:
        cloud.columns.rename(whole.name, new)
        return
    column = cloud.columns.make(new, target.dtype, target.width)
    for file, begin, end in cloud.blocks(progress):
        rows = target.rows(file, begin, end)
        if located.left_out is not None:
            rows = rows[~located.left_out[begin:end]]
        with np.errstate(over="ignore"):  # overflow to infinity
            column.append(rows.astype(target.dtype, copy=False))


def _attribute(cloud: Cloud, name: str) -> Target:
    kind = joining.kind_of(name, [chunk.attributes.get(name) for file in cloud.files for chunk in file.part.chunks])
    assert kind is not None  # a file has it
    (dtype, shape), raw = kind, cloud.raw(ATTRIBUTE + name)
    kept = check_attribute(name, np.empty((0, *shape), dtype), 0)
    return Target(kept.dtype, sum(shape), lambda _, begin, end: raw.read(begin, end, dtype, joining.missing_of(dtype)))


def _normals(cloud: Cloud) -> Target | None:
    kind, raw = (
        joining.kind_of(NORMALS, [chunk.normals for file in cloud.files for chunk in file.part.chunks]),
        cloud.raw(NORMALS),
    )
    if kind is None:
        return None
    dtype = kind[0]
    return Target(np.dtype(np.float32), 3, lambda _, begin, end: raw.read(begin, end, dtype))


def _colors(cloud: Cloud) -> Target | None:
    """Return the column of 8-bit colours to be written, converted by the range of each file.

    Return None if no file has colours.
    """
    raw, colored_files = cloud.raw(COLORS), sum(joining.color_kind(file.part) is not None for file in cloud.files)
    if not colored_files:
        raw.drop()
        return None

    def rows(file: File, begin: int, end: int) -> Rows:
        kind = joining.color_kind(file.part)
        if kind is None:
            return np.full((end - begin, 3), GREY, np.uint8)
        return to_shades(raw.read(begin, end, kind), file.color_range.scale(kind))

    return Target(np.dtype(np.uint8), 3, rows, plain=colored_files == len(cloud.files))


def _scans(cloud: Cloud) -> Target:
    """Return the column to be written with the index of each row's scanner position, counted over all files."""
    raw = cloud.raw(ATTRIBUTE + SCAN)

    def rows(file: File, begin: int, end: int) -> Rows:
        own = raw.read(begin, end) if SCAN in file.part.chunks[0].attributes else None
        return joining.scans_of(own, end - begin, file.first)

    return Target(np.dtype(np.int32), 0, rows, plain=False)
