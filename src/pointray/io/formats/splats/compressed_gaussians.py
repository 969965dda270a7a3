"""3D Gaussian splatting, compressed PLY files of PlayCanvas and SuperSplat: 16 bytes per splat.

A vertex is four 32-bit integers. A row of the element 'chunk' has the bounding box of 256 vertices, the ranges of their
scales and, in newer files, of their colours.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ....base.arrays import Floats
from .._counts import missing
from .._source import NO, SURE, Chunk, Faults, Format, Request, Source
from ..ply._binary import ORDERS
from ..ply._header import Header, read_header
from ._common import KEEPS, ROWS, Splats, listing_of, opaque_chunks, smallest_three

IN_BOX = 256  # splats per chunk
WORDS = ("packed_position", "packed_rotation", "packed_scale", "packed_color")
PLACE, SCALE, COLOR = (
    tuple(f"{end}_{name}" for end in ("min", "max") for name in names)
    for names in (("x", "y", "z"), ("scale_x", "scale_y", "scale_z"), ("r", "g", "b"))
)
ROOT = np.float32(2**0.5)

Words = NDArray[np.uint32]


class Table(NamedTuple):
    """Location of an element in a file: offset of its first row, number of rows, and structured dtype of a row."""

    start: int
    rows: int
    dtype: np.dtype[Any]


def recognise(head: bytes, path: Path) -> int:
    """Detect PLY files of compressed splats: return `SURE` + 1, which outranks plain PLY, or `NO`.

    head : first bytes of the file
    """
    begins = re.match(rb"ply[ \t]*[\r\n]", head)
    return SURE + 1 if begins and re.search(rb"[\r\n]\s*property\s+\w+\s+packed_position\b", head) else NO


class CompressedSource(Source):
    """Reader of compressed Gaussian splats in PLY files of PlayCanvas and SuperSplat."""

    def __init__(self, path: Path, request: Request) -> None:
        self._path, self._opacity, self.faults = path, request.opacity, Faults(request.strict)
        with path.open("rb") as file:
            header = read_header(file)
            tables = _tables(header)
            vertices = _checked(tables, "vertex", WORDS)
            boxes = _checked(tables, "chunk", PLACE + SCALE)
            self._vertices = _fitted(vertices, boxes, file.seek(0, io.SEEK_END), self.faults)
            file.seek(boxes.start)
            self._boxes = np.fromfile(file, boxes.dtype, boxes.rows)
        self._facts = {"encoding": header.format, "comments": list(header.comments), "splats": self._vertices.rows}
        self.listing = listing_of(self._vertices.rows, self._opacity, self._facts)

    def chunks(self) -> Iterator[Chunk]:
        return opaque_chunks(self._splats(), self._opacity, self._facts)

    def _splats(self) -> Iterator[tuple[Splats, float]]:
        start, count, dtype = self._vertices
        with self._path.open("rb") as file:
            file.seek(start)
            for first in range(0, count, ROWS):
                rows = np.fromfile(file, dtype, min(ROWS, count - first))
                end = first + len(rows)
                if end < min(first + ROWS, count):
                    raise ValueError(f"is cut off at vertex {end:,} of {count:,}")
                boxes = np.repeat(self._boxes[first // IN_BOX : -(-end // IN_BOX)], IN_BOX)[: len(rows)]
                yield _unpack(rows, boxes), end / count


def _tables(header: Header) -> dict[str, Table]:
    """Return the location of each element of a PLY file by name; raise ValueError for text and for lists."""
    if header.format not in ORDERS:
        raise ValueError(f"compressed splats must be in a binary format, not {header.format}")
    tables: dict[str, Table] = {}
    start = header.size
    for element in header.elements:
        if element.has_lists:
            raise ValueError(f"element {element.name!r} contains lists; compressed splat files must not")
        dtype = element.dtype(ORDERS[header.format])
        tables[element.name] = Table(start, element.rows, dtype)
        start += element.rows * dtype.itemsize
    return tables


def _checked(tables: dict[str, Table], name: str, needed: tuple[str, ...]) -> Table:
    """Return the element with this name; raise ValueError if it or a needed property is missing.

    tables : location of each element by name; needed : names of properties
    """
    if name not in tables:
        raise ValueError(f"element {name!r} not found; available: {', '.join(tables)}")
    dtype = tables[name].dtype
    missing = [x for x in needed if x not in (dtype.names or ())]
    if missing:
        raise ValueError(f"element {name!r} lacks {', '.join(missing)}")
    wrong = [x for x in WORDS if name == "vertex" and (dtype[x].kind not in "iu" or dtype[x].itemsize != 4)]
    if wrong:
        raise ValueError(f"property {wrong[0]!r} has type {dtype[wrong[0]].name}, expected uint")
    return tables[name]


def _fitted(vertices: Table, boxes: Table, size: int, faults: Faults) -> Table:
    """Return the location of the vertices, one per Gaussian splat, that a file of `size` bytes contains.

    Missing vertices are recorded in `faults`. Raise ValueError if the header's counts are inconsistent or no
    vertex is complete.

    vertices, boxes : location of the splats, and of the bounding boxes of 256 of them each
    """
    if vertices.rows == 0:
        raise ValueError("contains no points: the header announces 0 vertices")
    if boxes.rows != -(-vertices.rows // IN_BOX):
        raise ValueError(
            f"is damaged: {vertices.rows:,} splats need {-(-vertices.rows // IN_BOX):,} chunks of {IN_BOX}, "
            f"the header announces {boxes.rows:,}"
        )
    end = max(table.start + table.rows * table.dtype.itemsize for table in (vertices, boxes))
    if end <= size:
        return vertices
    message = f"is cut off: {vertices.rows:,} splats reach to byte {end:,}, {size:,} bytes found"
    rows = (size - vertices.start) // vertices.dtype.itemsize
    if rows <= 0 or boxes.start > vertices.start:
        raise ValueError(message)
    faults.add(f"{message}: {missing(vertices.rows, rows)}")
    return vertices._replace(rows=rows)


# ------------------------------------------------------------------------------------------------------ unpacking


@np.errstate(over="ignore", invalid="ignore")
def _unpack(rows: NDArray[Any], boxes: NDArray[Any]) -> Splats:
    """Decode Gaussian splats, whose positions and scales are stored as fractions between the limits of a box.

    rows : (n,), structured, four 32-bit integers each; boxes : (n,), structured, the box of each splat
    """
    place, turn, scale, color = (rows[name].astype(np.uint32) for name in WORDS)
    shades = _fractions(color, (24, 16, 8, 0), (8, 8, 8, 8))
    if set(COLOR) <= set(boxes.dtype.names or ()):
        shades[:, :3] = _between(boxes, COLOR, shades[:, :3])
    return Splats(
        _between(boxes, PLACE, _fractions(place, (21, 11, 0), (11, 10, 11))),
        shades[:, :3],
        shades[:, 3],
        np.exp(_between(boxes, SCALE, _fractions(scale, (21, 11, 0), (11, 10, 11)))),
        smallest_three(turn >> 30, (_fractions(turn, (20, 10, 0), (10, 10, 10)) - np.float32(0.5)) * ROOT),
    )


def _fractions(words: Words, shifts: tuple[int, ...], bits: tuple[int, ...]) -> Floats:
    """Return bit fields of 32-bit integers as fractions of their maxima, (m, k) float32.

    shifts, bits : position of the lowest bit and number of bits of each of k fields
    """
    out = np.empty((len(words), len(shifts)), np.float32)
    for k, (shift, width) in enumerate(zip(shifts, bits, strict=True)):
        most = (1 << width) - 1
        out[:, k] = ((words >> shift) & most) / np.float32(most)
    return out


def _between(boxes: NDArray[Any], names: tuple[str, ...], share: Floats) -> Floats:
    """Interpolate between the minima and maxima of boxes, (m, 3) float32.

    names : fields of the boxes, three minima, then three maxima; share : (m, 3), 0 at the minimum, 1 at the maximum
    """
    out = np.empty(share.shape, np.float32)
    for k in range(3):
        low, high = (boxes[names[i]].astype(np.float32) for i in (k, k + 3))
        out[:, k] = low * (1 - share[:, k]) + high * share[:, k]
    return out


FORMAT = Format("3D Gaussian splatting, compressed", (".ply",), recognise, CompressedSource, KEEPS)
