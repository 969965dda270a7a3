"""Points of laspy's objects, read and written as LAS files are."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from io import BytesIO
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...cloud.georeference import Georeference
from ...cloud.points import Points
from ..formats._source import CHUNK, Chunk, Faults, Listing, Source
from ..formats.las._crs import crs_of
from ..formats.las._header import read_header
from ..formats.las._rows import chunk_of, layout_of
from ..formats.las._write import write
from ..gather import gather
from ..opening import Opener
from ..selection import Selection
from .losses import package, warn_lost

LONGEST = 65535  # bytes of a variable length record


class LasDataSource(Source):
    """The rows of a `laspy.LasData`, whose bytes are those of an uncompressed LAS file."""

    def __init__(self, data: Any) -> None:
        self._rows: NDArray[np.uint8] = np.ascontiguousarray(data.points.array).view(np.uint8)
        self.faults = Faults(strict=False)
        stream = BytesIO()
        _header_of(data).write_to(stream)
        head = len(stream.getvalue())
        stream.seek(0)
        self._header = read_header(stream, head + len(self._rows), self.faults)
        self._layout = layout_of(self._header, self.faults)
        self._count = len(data.points.array)
        self.listing = Listing(
            self._count,
            self._layout.size,
            georeference=Georeference(*crs_of(self._header), self._header.scale, self._header.offset, format="LAS"),
        )

    def chunks(self) -> Iterator[Chunk]:
        """Yield the rows, about 2^18 at a time."""
        row = self._header.row
        for start in range(0, self._count, CHUNK):
            rows = self._rows[start * row : (start + CHUNK) * row]
            share = min((start + CHUNK) / self._count, 1.0)
            yield chunk_of(rows.view(self._layout.dtype), self._header, self._layout, share)


def _header_of(data: Any) -> Any:
    """Return a copy of the header with the scale of the rows, whose own may differ, and all variable length records."""
    header = copy.deepcopy(data.header)
    header.scales, header.offsets = data.points.scales, data.points.offsets
    header.update(data.points)
    records = [record for record in data.evlrs or () if len(record.record_data_bytes()) <= LONGEST]
    header.vlrs.extend(records)
    header.evlrs, header.number_of_evlrs, header.start_of_first_evlr = None, 0, 0
    return header


def points_of_las(data: Any) -> Points:
    """Return a `laspy.LasData` as points, with all that is read from a LAS file."""
    return gather([Opener("LasData", lambda: LasDataSource(data))], Selection(), None)


class _Memory(BytesIO):
    """A file in memory with a name, as the writer of LAS files expects it."""

    path = "points.las"


def to_laspy(points: Points) -> Any:
    """Return points as `laspy.LasData`; see `Points.to_laspy`."""
    laspy = package("laspy", "to_laspy")
    stream = _Memory()
    lost = write(stream, points)
    stream.seek(0)
    made = laspy.read(stream)
    warn_lost("to_laspy", lost)
    return made
