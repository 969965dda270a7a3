"""Separation of scattered points of a cloud on disk: found part by part, then moved to columns of their own.

Points of the surface are put back into file order, so that sorting them gives the kd order of a whole model's surface.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from ...base.arrays import Flags, Floats
from ...base.disk_columns import Columns
from ...base.progress import report_progress
from ...cloud.neighbors import take
from ...cloud.normals.estimate import estimate_normals
from ...cloud.sampled_statistics import of_distinct_positions
from ...cloud.statistics import CloudStatistics
from ...surface.splats.build import check_size
from ...surface.splats.local_planes import columns_of
from ...surface.splats.scattered.classification import FEW, scattered_places
from ...surface.splats.scattered.fitted_normals import Normals
from ...surface.splats.scattered.spheres import NOTHING_TO_DRAW, Drawing, shapes_of
from .arrange import CHUNK, SORTED
from .local import Local
from .stages import Cloud, ordering_of
from .work import Facts, Span, Work, within

# Columns: row of each point in the files; whether it is scattered; radius and direction if it is.
ROW, APART, SPHERES, DIRECTIONS = "row", "apart", "sphere-radii", "sphere-directions"
SURFACE, LOOSE = "surface", "loose"  # subfolders with columns
BY_ROW = "by-row"  # column of the surface's points, in ranges of rows that are not sorted yet
SEPARATED = "separated"
FOUND, SHAPED = 0.5, 0.8  # progress


class Shaping(NamedTuple):
    """Options for drawing scattered points, which lie on no surface.

    drawing : as spheres or as discs, and a factor for their radii
    radii : name of the column on disk with given radii; None: chosen from the spacing
    """

    drawing: Drawing
    radii: str | None

    def find(
        self, cloud: Cloud, local: Local, statistics: CloudStatistics, mask: Flags | None = None
    ) -> tuple[Floats, Floats]:
        """Return radii, (n,), and directions, (n, 3), of the points of a part and its margin as spheres or discs.

        The direction of a sphere points away from its neighbours; that of a disc is its normal.

        local : rows of the n points of the part and its margin; statistics : of the whole cloud
        mask : (n,), the points to compute; the results of other points are invalid; None: all
        """
        points = cloud.points(local)
        ordering = ordering_of(points.positions)
        given = None if self.radii is None else np.asarray(local.read(cloud.columns[self.radii]), np.float32)
        return shapes_of(points, ordering, self.drawing, given, of_distinct_positions(statistics, ordering.ids), mask)


def number_rows(columns: Columns, count: int) -> None:
    """Write a column with the number of each point in the order of the files, to which points are sorted back later."""
    column = columns.make(ROW, np.int32)
    for start in range(0, count, CHUNK):
        column.append(np.arange(start, min(start + CHUNK, count), dtype=np.int32))


def separate(work: Work, cloud: Cloud, names: Sequence[str], shaping: Shaping, span: Span) -> tuple[int, int]:
    """Find the scattered points, which lie on no surface, and move all points to the folders `SURFACE` and `LOOSE`.

    Each folder gets the columns of its points. If no points are scattered, nothing is moved; scattered points that are
    not drawn are dropped.

    Parameters
    ----------
    names : sequence of str
        Columns of the cloud, without `ROW`.
    shaping : Shaping
        How scattered points are drawn.
    span : (float, float)
        Begin and end of this stage, as fractions of all work.

    Returns
    -------
    surface, loose : int
        Number of points of the surface, and of scattered points that are drawn.

    Raises
    ------
    ValueError
        If all points are scattered and none are drawn.
    """
    columns, drawing = work.columns, shaping.drawing
    known = columns.get(SEPARATED)
    if known is None:
        work.make_column(APART, np.int8)
        found = [
            fact["scattered"] for fact in work.each("apart", partial(_find, work, cloud), within(span, 0.0, FOUND))
        ]
        count, is_shown = sum(found), drawing.scatter != "none"
        if count == cloud.total and not is_shown:
            raise ValueError(NOTHING_TO_DRAW)
        if count and is_shown and columns.get(f"apart-{DIRECTIONS}") is None:
            statistics = work.statistics_for("shapes", partial(shaping.find, cloud))
            work.make_column(SPHERES, np.float32)
            work.make_column(DIRECTIONS, np.float32, 3)
            work.each("shapes", partial(_shape, work, cloud, shaping, statistics), within(span, FOUND, SHAPED))
        if count:
            _put_apart(work, cloud.total, names, is_shown, within(span, SHAPED, 1.0))
        known = {"surface": cloud.total - count, "loose": count if is_shown else 0}
        columns.put(SEPARATED, known)
    return known["surface"], known["loose"]


def _find(work: Work, cloud: Cloud, part: int) -> Facts:
    """Write to the column `APART` which points of a part are scattered, that is, lie on no surface.

    Returns
    -------
    dict
        scattered : their number.
    """
    local = work.local(part)
    points = cloud.points(local)
    ordering, fitted = ordering_of(points.positions), points.normals is None
    if fitted and len(ordering.positions) > FEW:
        points = estimate_normals(points)
    normals = None
    if points.normals is not None:
        normals = Normals(columns_of(take(points.normals, ordering.rows)), fitted)
    scattered = scattered_places(ordering.positions, local.rows[ordering.rows], normals)[ordering.ids]
    local.write(work.columns[APART], scattered)
    return {"scattered": int(scattered[local.own].sum())}


def _shape(work: Work, cloud: Cloud, shaping: Shaping, statistics: CloudStatistics, part: int) -> None:
    """Write radii and directions of the scattered points of a part, which are drawn as spheres or discs."""
    apart = work.read(APART, part) != 0
    if not apart.any():
        return
    local = work.local(part)
    mask = np.zeros(len(local.rows), np.bool_)
    mask[local.own[apart]] = True
    radii, directions = shaping.find(cloud, local, statistics, mask)
    check_size(radii[mask])
    local.write_all(work.columns, {SPHERES: radii, DIRECTIONS: directions})


def _put_apart(work: Work, total: int, names: Sequence[str], is_shown: bool, span: Span) -> None:
    """Divide each column on disk into a column of the surface's points and a column of the scattered points.

    The old columns are removed.

    total : number of all points; names : names of the columns to divide
    is_shown : whether scattered points are drawn; if not, they are dropped
    span : begin and end of this stage, as fractions of all work
    """
    columns, report = work.columns, work.watch(span)
    surface, loose = (Columns(columns.folder / name) for name in (SURFACE, LOOSE))
    shapes = [SPHERES, DIRECTIONS] if is_shown else []
    every = [*(f"{SORTED}{name}" for name in names), *shapes]
    for k, name in enumerate(every):
        done, short = f"apart-{name}", name.removeprefix(SORTED)
        if columns.get(done) is None:
            source = columns[name]
            out = loose.make(short, source.dtype, source.width)
            for part in range(work.parts if is_shown else 0):
                out.append(work.read(name, part)[work.read(APART, part) != 0])
            loose.sync()
            if name not in shapes:
                _put_back(work, total, name, surface)
            columns.put(done, {})
        columns.drop(name)
        report_progress(report, (k + 1) / len(every))


def _put_back(work: Work, total: int, name: str, surface: Columns) -> None:
    """Read a column of all points in kd order, and write the surface's points among them in the order of the files.

    total : number of all points; name : name of the column to read
    surface : columns of the surface's points, to which the new column is added
    """
    columns, size = work.columns, work.size
    source = columns[name]
    between = surface.make(BY_ROW, source.dtype, source.width, total)
    places = surface.make(f"{BY_ROW}-{ROW}", np.int32, 0, total)
    counts = np.zeros(-(-total // size), np.int64)
    for part in range(work.parts):
        mine = np.flatnonzero(work.read(APART, part) == 0)
        rows, values = work.read(f"{SORTED}{ROW}", part)[mine], work.read(name, part)[mine]
        order = np.argsort(rows)
        rows, values = rows[order], values[order]
        ends = np.searchsorted(rows, np.arange(1, len(counts) + 1) * size)
        for k in np.flatnonzero(np.diff(ends, prepend=0)).tolist():
            some = slice(ends[k - 1] if k else 0, ends[k])
            between.write(k * size + int(counts[k]), values[some])
            places.write(k * size + int(counts[k]), rows[some])
            counts[k] += some.stop - some.start
    out = surface.make(name.removeprefix(SORTED), source.dtype, source.width)
    for k, stop in enumerate((counts + np.arange(len(counts)) * size).tolist()):
        some = slice(k * size, stop)
        out.append(between[some][np.argsort(places[some])])
    for one in (BY_ROW, f"{BY_ROW}-{ROW}"):
        surface.drop(one)
    surface.sync()
