"""Writer for COPC: a LAZ file whose chunks are the nodes of an octree. The files are read as LAS.

copclib's interface for Python cannot describe extra bytes. Therefore lazrs compresses the nodes and laspy writes the
header; tests read the files with copclib and laspy.
"""

from __future__ import annotations

import struct
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ....base.arrays import Doubles, Rows
from ....base.memory import check_memory
from ....base.progress import Progress, part_of, report_progress
from ....cloud.points import Points
from .._losses import Losses, is_metre
from .._source import NO, Format
from . import las
from ._copc import ENTRY
from ._crs import KEYS, USER
from ._octree import Node, Octree, build
from ._plan import Plan, plan_of, record_of
from ._write import recording_errors

FORMATS = (6, 7, 8)  # point formats that COPC allows
BATCH = 1 << 18  # approximate number of points compressed at a time
INFO, PAGE = 1, 1000  # numbers of the records with the octree and with its nodes
BYTES = 56  # of memory that the octree takes for a point
BUILT = 0.2  # fraction of the time that the octree takes


def write(file: Any, points: Points, progress: Progress | None = None) -> Losses:
    """Write all data of the points to a stream as COPC; return what it cannot store, in words.

    Rows without a finite position are left out.
    """
    losses: Losses = []
    check_memory(BYTES * len(points), f"for the octree of {len(points):,} points")
    plan = plan_of(_with_wkt(points), losses, FORMATS)
    _require_wkt(plan.header, points, losses)
    octree = _octree_of(points, plan)
    report_progress(progress, BUILT)
    with recording_errors(file) as stream:
        _write(stream, points, (plan, octree), part_of(progress, BUILT, 1.0))
    return losses


def _octree_of(points: Points, plan: Plan) -> Octree:
    """Return the octree of the coordinates as they are stored."""
    scale, offset = np.array(plan.grid.scale), np.array(plan.grid.offset)
    rows = np.flatnonzero(plan.finite)

    def coordinates(some: Rows) -> Doubles:
        return np.asarray(offset + scale * plan.grid.numbers_of(points, some, plan.finite))

    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for start in range(0, len(rows), BATCH):
        xyz = coordinates(rows[start : start + BATCH])
        low, high = np.minimum(low, xyz.min(axis=0)), np.maximum(high, xyz.max(axis=0))
    return build(rows, (low, high + _slack(low, high, scale)), coordinates)


def _slack(low: Doubles, high: Doubles, scale: Doubles) -> float:
    """Return what is added to the maximum of all coordinates, so that rounding puts no point outside of its node.

    It is at least a step of the coordinates if all points coincide, so that the octree has a size. copclib computes
    the cubes of nodes from the minimum and the maximum in the header.

    low, high : (3,), minimum and maximum; scale : (3,), steps of the coordinates
    """
    return max(4 * float(np.spacing(np.abs((low, high)).max())), float(scale.max()) if (low == high).all() else 0.0)


def _write(stream: Any, points: Points, what: tuple[Plan, Octree], progress: Progress | None) -> None:
    """Write header, nodes and records. what : how the points are written, and the octree"""
    import laspy
    import lazrs

    plan, octree = what
    header = plan.header
    packing = lazrs.LazVlr.new_for_compression(header.point_format.id, header.point_format.num_extra_bytes, True)
    header.vlrs.insert(0, laspy.VLR("copc", INFO, "COPC info", bytes(160)))  # must be the first
    header.vlrs.append(laspy.vlrs.known.LasZipVlr(packing.record_data()))
    header.are_points_compressed = True
    header.partial_reset()
    header.write_to(stream)
    start, times = stream.tell(), (np.inf, -np.inf)
    compressor = lazrs.ParLasZipCompressor(stream, packing)
    for batch in _batches(octree.nodes):
        record = record_of(points, plan, octree.order[batch[0].begin : batch[-1].end])
        first = batch[0].begin
        compressor.compress_chunks([record.array[node.begin - first : node.end - first].tobytes() for node in batch])
        header.grow(record)
        finite = record.gps_time[np.isfinite(record.gps_time)]
        times = float(finite.min(initial=times[0])), float(finite.max(initial=times[1]))
        report_progress(progress, batch[-1].end / len(octree.order))
    compressor.done()
    end = stream.tell()
    page = _page_of(stream, packing, octree.nodes, start)
    records = [laspy.VLR("copc", PAGE, "COPC hierarchy", page), *plan.trailing]
    header.start_of_first_evlr, header.number_of_evlrs = end, len(records)
    laspy.vlrs.vlrlist.VLRList(records).write_to(stream, as_extended=True)
    times = times if times[0] <= times[1] else (0.0, 0.0)
    middle = octree.low + octree.side / 2
    facts = (*middle, octree.side / 2, octree.spacing, end + 60, len(page), *times)
    header.maxs = header.maxs + _slack(header.mins, header.maxs, header.scales)
    header.vlrs[0] = laspy.VLR("copc", INFO, "COPC info", struct.pack("<5d2Q2d", *facts).ljust(160, b"\0"))
    last = stream.tell()
    stream.seek(0)
    header.write_to(stream, ensure_same_size=True)
    stream.seek(last)


def _batches(nodes: list[Node]) -> list[list[Node]]:
    """Divide nodes into batches of at least 2^18 points, except the last one."""
    batches: list[list[Node]] = [[]]
    for node in nodes:
        if batches[-1] and node.begin - batches[-1][0].begin >= BATCH:
            batches.append([])
        batches[-1].append(node)
    return batches


def _page_of(stream: Any, packing: Any, nodes: list[Node], start: int) -> bytes:
    """Return the list of all nodes as one page of the hierarchy.

    packing : description of the compression by lazrs; start : offset of the points in the file
    """
    import lazrs

    stream.flush()
    with Path(stream.path).open("rb") as file:
        file.seek(start)
        sizes = [int(size) for _, size in lazrs.read_chunk_table(file, packing)]
    entries = np.zeros(len(nodes), ENTRY)
    entries["key"] = [node.key for node in nodes]
    entries["rows"] = [node.end - node.begin for node in nodes]
    entries["size"] = sizes
    entries["start"] = start + 8 + np.cumsum([0, *sizes[:-1]])
    return entries.tobytes()


def _with_wkt(points: Points) -> Points:
    """Replace an EPSG code of points by well-known text, which COPC requires, if pyproj is installed and knows it.

    WKT 2 is written for coordinate systems that WKT 1 cannot express, such as those of depths.
    """
    known = points.georeference
    if known.crs is None or "[" in known.crs:
        return points
    try:
        import pyproj

        crs = pyproj.CRS.from_user_input(known.crs)
    except Exception:  # pyproj has many errors
        return points
    for version in ("WKT1_GDAL", "WKT2_2019"):
        with suppress(Exception):
            return points.changed(georeference=replace(known, crs=crs.to_wkt(version)))
    return points


def _has_pyproj() -> bool:
    try:
        import pyproj  # noqa: F401
    except ImportError:
        return False
    return True


def _require_wkt(header: Any, points: Points, losses: Losses) -> None:
    """Declare that coordinate systems are well-known text, as COPC requires, and remove those that are not."""
    header.global_encoding.wkt = True
    if header.vlrs.get_by_id(USER, [KEYS]):
        header.vlrs = [record for record in header.vlrs if (record.user_id, record.record_id) != (USER, KEYS)]
        known = points.georeference
        if known.crs or not is_metre(known.unit):
            reason = "pyproj does not know it" if _has_pyproj() else "install pyproj"
            what = f"the coordinate system {known.crs}: {reason}" if known.crs else f"the unit {known.unit}"
            losses.append(f"cannot store {what}")


FORMAT = Format(
    "COPC",
    (".copc.laz",),
    lambda head, path: NO,  # read as LAS
    las.FORMAT.open,
    {
        **las.FORMAT.keeps,
        "note": "read like LAS; with bounds or resolution only the nodes needed; written with point formats 6 to 8, "
        "rows in the order of the octree, and an EPSG code as well-known text if pyproj is installed",
    },
    write=write,
)
