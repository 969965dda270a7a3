"""Writer for E57: one scan for each scanner position, streamed through libE57."""

from __future__ import annotations

import errno
import hashlib
import os
import re
import uuid
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import Any

import numpy as np

from ....base.progress import Progress, report_progress
from ....cloud.georeference import SCAN
from ....cloud.points import Points
from .._losses import Losses, georeference_losses, is_metre
from .._source import CHUNK
from .._stations import Scan, scans_to_write
from ._fields import NORMAL_PREFIX, NORMAL_URI, PREFIX, STATE, URI, Field, fields_of
from ._header import read_xml
from ._scan import CARTESIAN, COLORS

INVALID = re.compile("[^\t\n\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")  # characters that XML cannot contain


def write(file: Any, points: Points, progress: Progress | None = None) -> Losses:
    """Write all data of the points to the file of a stream; return what E57 cannot store, in words."""
    from pye57 import libe57

    losses: Losses = []
    scans, states_scan = scans_to_write(points, losses)
    unit = points.georeference.unit if points.georeference.projection is None else "degree"
    if unit is not None and not is_metre(unit):
        losses.append(f"cannot store the unit {unit}: coordinates in E57 files are metres")
    losses += georeference_losses(points, ("crs", "unit", "stations"))
    if INVALID.search(points.georeference.crs or ""):
        losses.append("leaves out control characters of the coordinate system")
    missing = len(points) - int(np.count_nonzero(points.finite))
    if missing:
        losses.append(f"marks {missing:,} row{'s' * (missing > 1)} without a finite position as invalid")
    skip = (SCAN,) if states_scan else ()
    plan = [(scan, fields_of(points, scan, [] if k else losses, skip)) for k, scan in enumerate(scans)]
    with _as_os_errors():
        image = libe57.ImageFile(os.fspath(file.path), "w")
    done = 0
    try:
        with _as_os_errors():
            data = _header(libe57, image, points)
        for scan, fields in plan:
            for rows in _write_scan(libe57, (image, data), scan, fields):
                done += rows
                report_progress(progress, done / len(points))
        with _as_os_errors():
            image.close()
    except BaseException:
        with suppress(Exception):
            image.cancel()
        raise
    try:
        read_xml(file.path)
    except ValueError as error:
        raise OSError(errno.EIO, f"cannot be written completely: {error}") from None
    return losses


@contextmanager
def _as_os_errors() -> Iterator[None]:
    """Convert errors of libE57, which occur if the file cannot be written, to OSError."""
    try:
        yield
    except Exception as error:
        words = (str(error) or type(error).__name__).strip().splitlines()[0]
        raise OSError(errno.EIO, f"cannot be written by libE57: {words}") from error


def _header(libe57: Any, image: Any, points: Points) -> Any:
    """Write the header of a file; return the list of its scans, a vector of libE57. image : file of libE57"""
    for prefix, uri in (("", libe57.E57_V1_0_URI), (NORMAL_PREFIX, NORMAL_URI), (PREFIX, URI)):
        image.extensionsAdd(prefix, uri)
    known = hashlib.blake2b(points.positions.data, digest_size=16)
    known.update(points.origin.tobytes())
    texts = {
        "formatName": "ASTM E57 3D Imaging Data File",
        "guid": f"{{{uuid.UUID(bytes=known.digest())}}}",
        "e57LibraryVersion": libe57.E57_LIBRARY_ID,
        "coordinateMetadata": INVALID.sub("", points.georeference.crs or ""),
    }
    root = image.root()
    _fill(libe57, image, root, texts)
    root.set("versionMajor", libe57.IntegerNode(image, libe57.E57_FORMAT_MAJOR))
    root.set("versionMinor", libe57.IntegerNode(image, libe57.E57_FORMAT_MINOR))
    data = libe57.VectorNode(image, True)
    root.set("data3D", data)
    root.set("images2D", libe57.VectorNode(image, True))
    return data


def _write_scan(libe57: Any, target: tuple[Any, Any], scan: Scan, fields: list[Field]) -> Iterator[int]:
    """Write a scan; yield the number of rows of each block that has been written.

    target : file of libE57, and the list of its scans
    """
    image, data = target
    capacity = min(CHUNK, scan.size)
    arrays = {field.name: np.empty(capacity, field.buffer) for field in fields}
    with _as_os_errors():
        prototype, buffers = libe57.StructureNode(image), libe57.VectorSourceDestBuffer()
        for field in fields:
            prototype.set(field.name, field.node(libe57, image))
            buffers.append(libe57.SourceDestBuffer(image, field.name, arrays[field.name], capacity, True, False))
        node = libe57.StructureNode(image)
        number = data.childCount()
        _fill(libe57, image, node, _facts(scan, fields, number))
        points = libe57.CompressedVectorNode(image, prototype, libe57.VectorNode(image, True))
        node.set("points", points)
        data.append(node)
        writer = points.writer(buffers)
    for start in range(0, scan.size, capacity):
        rows = scan.part(start, min(start + capacity, scan.size))
        count = min(capacity, scan.size - start)
        for field in fields:
            arrays[field.name][:count] = field.values(rows)
        with _as_os_errors():
            writer.write(count)
        yield count
    with _as_os_errors():
        writer.close()


def _facts(scan: Scan, fields: list[Field], number: int) -> dict[str, Any]:
    """Return the description of a scan: name, pose, bounds and limits. number : of the scan, from 0"""
    guid = uuid.uuid5(uuid.NAMESPACE_URL, f"{number} {scan.station} {scan.size}")
    facts: dict[str, Any] = {"guid": f"{{{guid}}}", "name": f"Scan {number}"}
    if scan.station is not None:
        facts["pose"] = {
            "rotation": {"w": 1.0, "x": 0.0, "y": 0.0, "z": 0.0},
            "translation": dict(zip("xyz", scan.station, strict=True)),
        }
    known = {field.name: field for field in fields}
    bounds: dict[str, float] = {}
    for name in CARTESIAN:
        low, high = _limits(scan, known[name], known.get(STATE))
        scale, offset = known[name].grid or (1.0, 0.0)
        axis = name[-1].lower()
        bounds |= {f"{axis}Minimum": low * scale + offset, f"{axis}Maximum": high * scale + offset}
    facts["cartesianBounds"] = bounds
    if COLORS[0] in known:
        facts["colorLimits"] = {f"{n}{end}": v for n in COLORS for end, v in (("Minimum", 0), ("Maximum", 255))}
    if "intensity" in known:
        low, high = _limits(scan, known["intensity"])
        facts["intensityLimits"] = {"intensityMinimum": low, "intensityMaximum": high}
    return facts


def _limits(scan: Scan, field: Field, state: Field | None = None) -> tuple[float, float]:
    """Return the smallest and the largest finite value of a column; 0, 0 without any. state : of invalid rows"""
    low, high = np.inf, -np.inf
    for start in range(0, scan.size, CHUNK):
        rows = scan.part(start, min(start + CHUNK, scan.size))
        values = field.values(rows)
        values = values if state is None else values[state.values(rows) == 0]
        values = values[np.isfinite(values)]
        if len(values):
            low, high = min(low, float(values.min())), max(high, float(values.max()))
    return (low, high) if low <= high else (0.0, 0.0)


def _fill(libe57: Any, image: Any, node: Any, values: Mapping[str, Any]) -> None:
    """Add texts, numbers and structures by name to a structure of libE57. image : file of libE57"""
    for name, value in values.items():
        if isinstance(value, Mapping):
            inner = libe57.StructureNode(image)
            _fill(libe57, image, inner, value)
            node.set(name, inner)
        elif isinstance(value, str):
            node.set(name, libe57.StringNode(image, value))
        elif isinstance(value, int):
            node.set(name, libe57.IntegerNode(image, value, value, value))
        else:
            node.set(name, libe57.FloatNode(image, float(value)))
