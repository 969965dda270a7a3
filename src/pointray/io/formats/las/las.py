"""LAS, LAZ and COPC, versions 1.0 to 1.5.

laspy names the fields of each point format and writes files; lazrs decompresses. The header is read in `_header`, which
checks every number against the file's size.

Each dimension becomes an attribute with its own dtype; bit fields become uint8. Extra bytes with a scale or an offset
become float64, offset + scale * number as computed by laspy. They are written as float64, with equal values but not
equal bytes.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from ....cloud.georeference import Georeference
from ...remote.range_reader import announce
from .._counts import missing, rows_after
from .._source import CHUNK, NO, SURE, Chunk, Faults, Format, Listing, Request, Source
from ._copc import Copc, copc_of, is_copc, nodes_of
from ._crs import crs_of
from ._header import Header, read_header
from ._laz import Part, check_total, packing_of, parts_of, unpacked_parts
from ._rows import Layout, chunk_of, layout_of
from ._write import write

logging.getLogger("laspy").addHandler(logging.NullHandler())  # it logs what it raises anyway


def recognise(head: bytes, path: Path) -> int:
    """Detect LAS and LAZ files: return `SURE` or `NO`. head : first bytes of the file"""
    return SURE if head.startswith(b"LASF") else NO


def in_pieces(head: bytes, request: Request) -> bool:
    """Return whether a file is COPC and a request needs only some of its octree. head : first bytes of the file"""
    chosen = request.bounds is not None or request.resolution is not None
    return chosen and is_copc(head)


class LasSource(Source):
    """Reader of LAS, LAZ and COPC files."""

    def __init__(self, path: Path, request: Request) -> None:
        self._size, self.faults = path.stat().st_size, Faults(request.strict)
        self._file: BinaryIO = path.open("rb")
        try:
            self._header = header = read_header(self._file, self._size, self.faults)
            self._layout = layout_of(header, self.faults)
            self._copc = copc_of(header)
            self._parts = self._list_parts(request)
        except BaseException:
            self._file.close()
            raise
        chosen = self._copc is not None and (request.bounds is not None or request.resolution is not None)
        rows = sum(part.rows for part in self._parts)
        self.listing = Listing(
            None if chosen else rows,
            self._layout.size,
            rows,
            Georeference(*crs_of(header), header.scale, header.offset, format="LAS"),
            _facts(header, self._layout, self._copc),
        )

    def _list_parts(self, request: Request) -> list[Part]:
        """Return the pieces of the file to read: chunks of compressed rows, or one piece with all uncompressed rows.

        Raise ValueError if the header announces no rows.
        """
        header = self._header
        if header.total == 0 and (header.compressed or self.faults.strict):
            raise ValueError("contains no points: the header announces 0; it may be incomplete")
        if sum(header.returns) > header.total:
            self.faults.add(f"its header announces {header.total:,} rows, but {sum(header.returns):,} returns")
        if not header.compressed:
            return [_rows_of(self._file, header, self.faults)]
        self._packing = packing_of(header)
        if self._copc is not None and (request.bounds is not None or request.resolution is not None):
            return nodes_of(self._file, header, self._copc, request, self._size, self.faults)
        return parts_of(self._file, header, self._packing, self._size, self.faults)

    def chunks(self) -> Iterator[Chunk]:
        for rows, share in self._unpacked() if self._header.compressed else self._plain():
            yield chunk_of(rows.view(self._layout.dtype), self._header, self._layout, share)

    def _plain(self) -> Iterator[tuple[NDArray[np.uint8], float]]:
        """Yield the bytes of about 2^18 uncompressed rows, in a buffer that is reused, and the fraction read so far."""
        part, row = self._parts[0], self._header.row
        buffer = np.empty(min(part.rows, CHUNK) * row, np.uint8)
        self._file.seek(part.start)
        for start in range(0, part.rows, CHUNK):
            rows = buffer[: min(CHUNK, part.rows - start) * row]
            done = self._file.readinto(rows.data)  # type: ignore[attr-defined]  # a buffered file has it
            if done != len(rows):
                raise ValueError(f"is cut off in row {start + done // row:,} of {part.rows:,}")
            yield rows, min((start + CHUNK) / part.rows, 1.0)

    def _unpacked(self) -> Iterator[tuple[NDArray[np.uint8], float]]:
        there = 0
        announce(self._file, [(part.start, part.start + part.size) for part in self._parts])
        for rows, done in unpacked_parts(self._file, self._header, self._packing, self._parts):
            there += len(rows) // self._header.row
            yield rows, done / len(self._parts)
        if self.listing.count is not None:
            check_total(self._header, there, self.faults)

    def close(self) -> None:
        self._file.close()


def _rows_of(file: BinaryIO, header: Header, faults: Faults) -> Part:
    """Return the place and number of the rows of an uncompressed file; raise ValueError if there is not one.

    A number of rows other than that in the header is recorded in `faults`.
    """
    rows, size, there = header.total, header.total * header.row, header.end - header.start
    if size > there:
        rows = there // header.row
        message = (
            f"is cut off: {header.total:,} rows of {header.row} bytes expected, {there:,} bytes found: {rows:,} rows"
        )
        faults.add(f"{message}: {missing(header.total, rows)}")
        if not rows:
            raise ValueError(message)
    elif there - size >= header.row:
        more = rows_after(file, header.start + size, header.end, header.row)
        faults.add(
            f"its header announces {rows:,} rows; {there - size:,} more bytes follow, "
            f"as many as {(there - size) // header.row:,} rows" + ("" if more else ", which are not read")
        )
        rows += more
    if not rows:
        raise ValueError("contains no points: the header announces 0; it may be incomplete")
    return Part(header.start, rows * header.row, rows)


def _facts(header: Header, layout: Layout, copc: Copc | None) -> dict[str, Any]:
    """Return what `pointray info` shows about a file, by name."""
    stated = {name: value for name, value in header.stated.items() if value}
    facts: dict[str, Any] = {
        **stated,
        "point format": header.format,
        "compressed": header.compressed,
        "points by return": list(header.returns),
        "scale": list(header.scale),
        "offset": [x + 0.0 for x in header.offset],  # some programs write -0
        "bounds": [list(header.low), list(header.high)] if np.isfinite((header.low, header.high)).all() else None,
    }
    scaled = [c.name for c in (*layout.columns, *layout.normals) if c.scale is not None or c.offset is not None]
    if scaled:
        facts["scaled extra bytes"] = scaled
    if copc is not None:
        facts["COPC spacing"], facts["COPC size"] = copc.spacing, copc.side
    return facts


FORMAT = Format(
    "LAS",
    (".las", ".laz"),
    recognise,
    LasSource,
    {
        "positions": "offset + scale * integer coordinates; the original integers are restored on writing",
        "normals": "extra bytes NormalX, NormalY, NormalZ or nx, ny, nz",
        "colors": "red, green, blue",
        "attributes": "all other dimensions with their types; bit fields as uint8; extra bytes with a scale as float64",
        "survey": "coordinate system (well-known text or EPSG code), unit, scale and offset",
        "note": "includes LAZ and COPC; versions 1.0 to 1.5, point formats 0 to 10; written as 1.4; no waveforms",
    },
    write=write,
    in_pieces=in_pieces,
)
