"""E57 files, read with pye57: several scans, each with its pose.

Positions and normals are transformed by the pose of their scan. All scans are read as one file: columns that only some
scans have are filled in the others, as for several files.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from ....base.arrays import Floats
from ....cloud.georeference import SCAN, Georeference
from ...colors import GREY
from .._counts import count_mismatch
from .._source import NO, SURE, Chunk, Faults, Format, Listing, Request, Source
from .._stations import scan_numbers
from ._fields import PREFIX
from ._header import MAGIC, read_xml
from ._scan import CARTESIAN, SPHERICAL, STATES, Field, Scan, scans_of
from ._write import write

BLOCK = 1 << 18  # rows read at a time: a million take 0.1 GiB more and are not faster
MOST_STEPS = 2**31  # largest integer coordinate for which the file's grid is kept

T = TypeVar("T")


def recognise(head: bytes, path: Path) -> int:
    """Detect E57 files: return `SURE` or `NO`. head : first bytes of the file"""
    return SURE if head.startswith(MAGIC) else NO


class E57Source(Source):
    """Reader of E57 files: the points of all scans, transformed to world coordinates by the pose of each."""

    def __init__(self, path: Path, request: Request) -> None:
        self._path, self.faults = path, Faults(request.strict)
        root, size = read_xml(path)
        self._scans = scans = scans_of(root, size, self.faults)
        self._dtype = np.dtype("f4" if all(map(_is_single, scans)) else "f8")
        self._columns, self._numbers = _columns(scans), scan_numbers([scan.posed for scan in scans])
        facts = {"software": root.text_at("e57LibraryVersion"), "guid": root.text_at("guid")}
        self._facts: dict[str, Any] = {key: text for key, text in facts.items() if text}
        self._facts["scans"] = [scan.facts for scan in scans]
        total = sum(scan.count for scan in scans)
        invalid = any(name in scan.fields for scan in scans for name in STATES)
        row = 36 + sum(dtype.itemsize for dtype in self._columns.values())
        row += 12 * any(scan.normals for scan in scans) + 3 * any(scan.colors for scan in scans)
        georeference = _georeference(scans, root.text_at("coordinateMetadata"))
        self.listing = Listing(None if invalid else total, row, total, georeference, self._facts)

    def chunks(self) -> Iterator[Chunk]:
        from pye57 import libe57

        file = _explaining_errors("cannot be opened", libe57.ImageFile, os.fspath(self._path), "r")
        total, done, left_out = sum(scan.count for scan in self._scans), 0, 0
        try:
            for number, scan in enumerate(self._scans):
                for block in _blocks(libe57, file, scan, self.faults):
                    done += len(next(iter(block.values())))
                    chunk, invalid = self._to_chunk(scan, number, block, done / total)
                    left_out += invalid
                    yield chunk
        finally:
            file.close()
        if left_out:
            self._facts["left_out"] = left_out

    def _to_chunk(self, scan: Scan, number: int, block: dict[str, NDArray[Any]], share: float) -> tuple[Chunk, int]:
        """Return the valid rows of a block in world coordinates, and the number of rows marked as invalid.

        number : index of the scan among those with points; block : columns by name; share : fraction of the file read
        """
        before = len(next(iter(block.values())))
        bad = [block[name] != 0 for name in STATES if name in block]
        if bad and (invalid := np.any(bad, axis=0)).any():
            block = {name: values[~invalid] for name, values in block.items()}
        n = len(next(iter(block.values())))
        normals, colors = self._normals(scan, block, n), self._colors(scan, block, n)
        attributes = {}
        own = {_plain(name): name for name in scan.fields if name in block}
        for name, dtype in self._columns.items():
            if name == SCAN and len(self._scans) > 1:
                attributes[name] = np.full(n, self._numbers[number], dtype)
            elif name in own:
                attributes[name] = block[own[name]].astype(dtype)
            else:
                attributes[name] = np.full(n, np.nan if dtype.kind == "f" else 0, dtype)
        return Chunk(_positions(scan, block, self._dtype), normals, colors, attributes, share), before - n

    def _normals(self, scan: Scan, block: dict[str, NDArray[Any]], n: int) -> Floats | None:
        if not any(other.normals for other in self._scans):
            return None
        if not scan.normals:
            return np.zeros((n, 3), np.float32)
        return _to_world([block[name] for name in scan.normals], scan, np.float32, (0, 0, 0))

    def _colors(self, scan: Scan, block: dict[str, NDArray[Any]], n: int) -> NDArray[Any] | None:
        """Return the colours of a block as 8 bits, or as floats whose range is found later, (n, 3).

        They are grey or NaN where missing. Return None if no scan has colours.

        block : columns by name
        """
        if not any(other.colors for other in self._scans):
            return None
        floats = any(other.fields[name].dtype.kind == "f" for other in self._scans for name in other.colors)
        dtype, missing = (np.float32, np.nan) if floats else (np.uint8, GREY)
        out = np.full((n, 3), missing, dtype)
        for k, (name, (black, gain)) in enumerate(zip(scan.colors, scan.scale, strict=True)):
            if block[name].dtype == dtype and gain == 1 and black == 0:
                out[:, k] = block[name]
            else:
                scaled = (block[name] - black) * gain
                out[:, k] = scaled if floats else np.clip(np.rint(scaled), 0, 255)
        if scan.invalid_color:
            out[block[scan.invalid_color] != 0] = missing
        return out


def _is_single(scan: Scan) -> bool:
    """Whether float32 holds all positions of a scan exactly: float32 in the file and not transformed by a pose."""
    fields = [scan.fields[name] for name in scan.places]
    return not scan.turned and scan.places is CARTESIAN and all(field.dtype == np.float32 for field in fields)


def _columns(scans: list[Scan]) -> dict[str, np.dtype[Any]]:
    """Return the dtype of each attribute of the scans by name.

    If there are several scans, "scan", from `scan_numbers`, is one of the attributes.
    """
    found: dict[str, list[np.dtype[Any]]] = {}
    for scan in scans:
        for name in _others(scan):
            found.setdefault(_plain(name), []).append(scan.fields[name].dtype)
    columns = {name: np.result_type(*dtypes) for name, dtypes in found.items()}
    if len(scans) > 1:
        columns[SCAN] = np.dtype(np.int32)
    return columns


def _others(scan: Scan) -> list[str]:
    used = {*CARTESIAN, *SPHERICAL, *STATES, *scan.normals, *scan.colors, scan.invalid_color}
    return [name for name in scan.fields if name not in used]


def _plain(name: str) -> str:
    """Return the attribute's name for a column: row_index for "rowIndex"; the prefix of an extension is dropped.

    Names of the extension that pointray writes are kept.
    """
    if name.startswith(f"{PREFIX}:"):
        return name.removeprefix(f"{PREFIX}:")
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name.rpartition(":")[2]).lower()


def _georeference(scans: list[Scan], crs: str) -> Georeference:
    """Return the georeference of a file, in metres. Scans without a pose have no scanner position.

    crs : coordinate system stated in the file, or ""
    """
    stations = tuple(scan.station for scan in scans if scan.posed)
    scale, offset = _grid(scans)
    return Georeference(crs or None, "metre", scale, offset, stations, format="E57")


def _grid(scans: list[Scan]) -> tuple[Any, Any]:
    """Return the scale and the offset of the coordinates, (3,) each, if the scans store them as integers.

    A coordinate is scale * integer + offset. Return (None, None) unless all scans have the same scale and offset,
    cartesian coordinates and no rotation.
    """
    first = [scans[0].fields[name] for name in scans[0].places]
    for scan in scans:
        fields = [scan.fields[name] for name in scan.places]
        if scan.turned or scan.places is SPHERICAL or [f.grid for f in fields] != [f.grid for f in first]:
            return None, None
        if any(field.grid is None or field.grid[0] <= 0 or field.largest > MOST_STEPS for field in fields):
            return None, None
    scale, offset = zip(*(field.grid for field in first if field.grid), strict=True)
    return scale, offset


# ----------------------------------------------------------------------------------------------------------- rows


def _explaining_errors(what: str, call: Callable[..., T], *args: Any) -> T:
    """Call a function of libE57; convert its errors to ValueError. what : begins the message"""
    try:
        return call(*args)
    except Exception as error:
        words = re.sub(r" *\(Error\w+\)$", "", (str(error) or type(error).__name__).strip().splitlines()[0])
        raise ValueError(f"{what}: {words}") from error


def _blocks(libe57: Any, file: Any, scan: Scan, faults: Faults) -> Iterator[dict[str, NDArray[Any]]]:
    """Yield the columns of a scan by name, 2^18 rows at a time, in buffers that are reused.

    file : image file of libE57; faults : records missing points
    """
    wanted = [*scan.places, *scan.normals, *scan.colors, *_others(scan), *STATES, scan.invalid_color]
    fields = [scan.fields[name] for name in dict.fromkeys(wanted) if name in scan.fields]
    capacity, done = min(BLOCK, scan.count), 0
    arrays = [np.empty(capacity, _buffer(field.dtype)) for field in fields]
    buffers = libe57.VectorSourceDestBuffer()
    for field, array in zip(fields, arrays, strict=True):
        buffers.append(libe57.SourceDestBuffer(file, field.name, array, capacity, True, True))
    where = f"is damaged in scan {scan.index}"
    reader = _explaining_errors(where, lambda: file.root()["data3D"][scan.index]["points"].reader(buffers))
    while done < scan.count:
        n = _explaining_errors(f"{where} after point {done:,}", reader.read)
        if not 0 < n <= min(capacity, scan.count - done):
            break
        done += n
        yield {f.name: _fitted(f, array[:n]) for f, array in zip(fields, arrays, strict=True)}
    reader.close()
    if done != scan.announced:
        faults.add(f"is cut off in scan {scan.index}: {count_mismatch(scan.announced, done, 'points')}")


def _buffer(dtype: np.dtype[Any]) -> np.dtype[Any]:
    """Return a dtype of the same size or wider for a buffer that pye57 can fill.

    For integers of more than 16 bits this is only "q": it mistakes NumPy's int64, "l" on Linux, for 32 bits.
    """
    return np.dtype("q") if dtype.kind in "iu" and dtype.itemsize > 2 else dtype


def _fitted(field: Field, values: NDArray[Any]) -> NDArray[Any]:
    """Convert values read for a column to its dtype; raise ValueError if they are out of range."""
    if values.dtype == field.dtype:
        return values
    limits = np.iinfo(field.dtype)
    if values.min() < limits.min or values.max() > limits.max:
        raise ValueError(f"is damaged: {field.name} contains values outside its stated limits")
    return values.astype(field.dtype)


def _positions(scan: Scan, block: dict[str, NDArray[Any]], dtype: np.dtype[Any]) -> NDArray[Any]:
    """Return the world coordinates of the rows of a block, (n, 3) of `dtype`. block : columns by name"""
    columns = [block[name] for name in scan.places]
    if scan.places is SPHERICAL:
        distance, azimuth, elevation = (np.asarray(column, np.float64) for column in columns)
        flat = distance * np.cos(elevation)
        columns = [flat * np.cos(azimuth), flat * np.sin(azimuth), distance * np.sin(elevation)]
    return _to_world(columns, scan, dtype, scan.station)


def _to_world(columns: Sequence[NDArray[Any]], scan: Scan, dtype: Any, shift: Sequence[float]) -> NDArray[Any]:
    """Rotate vectors by the scan's pose and add `shift`; return (n, 3) of `dtype`.

    The work is done column by column: a product of small matrices takes three times as long.

    columns : three (n,) arrays; shift : scanner position, or zero for normals
    """
    out = np.empty((len(columns[0]), 3), dtype)
    for k, axis in enumerate(scan.rotation):
        terms = [(factor, column) for factor, column in zip(axis, columns, strict=True) if factor]
        if not scan.turned:
            out[:, k] = columns[k]
            continue
        total = np.multiply(terms[0][1], terms[0][0], dtype=np.float64)
        for factor, column in terms[1:]:
            total += np.multiply(column, factor, dtype=np.float64)
        out[:, k] = total + shift[k]
    return out


FORMAT = Format(
    "E57",
    (".e57",),
    recognise,
    E57Source,
    {
        "positions": "cartesian or spherical coordinates, transformed by the pose of their scan; rows marked as "
        "invalid are left out",
        "normals": "normalX, normalY, normalZ of the extension, rotated by the pose",
        "colors": "colorRed, colorGreen, colorBlue, converted from the scan's colour limits to 8 bits",
        "attributes": "intensity, row_index, column_index, time_stamp, return_index and all other numeric columns, "
        "in the smallest type for the limits in the file; scaled integers as float64; scan: the number of the scan, "
        "negative for scans without a pose if others have one",
        "survey": "coordinateMetadata as the coordinate system; metres; scanner positions",
        "note": "images are ignored; written with one scan for each scanner position (attribute scan), without "
        "rotation; attributes that E57 does not define are columns of an extension",
    },
    extra=("pye57", "e57"),
    write=write,
)
