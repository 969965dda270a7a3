"""Points in glTF 2.0, binary, as pointray writes them. Other glTF files are meshes, which trimesh reads."""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ....base.arrays import Doubles
from ....cloud.georeference import Georeference
from .._source import CHUNK, NO, SURE, Chunk, Format, Listing, Request, Source
from ._glb_write import BINARY, COMPONENTS, GENERATOR, JSON, MAGIC, TYPES, write

HEADER = 20  # bytes before the JSON
LARGEST_JSON = 1 << 24
MOST_PRIMITIVES = 2
DTYPES = {number: np.dtype(f"<{name}") for name, number in COMPONENTS.items()}
WIDTHS = {name: width for width, name in TYPES.items()}
COLOR, NORMAL, POSITION = "COLOR_0", "NORMAL", "POSITION"


def recognise(head: bytes, path: Path) -> int:
    """Detect GLB files written by pointray: return `SURE` or `NO`. head : first bytes of the file"""
    own = f'"generator":"{GENERATOR}"'.encode()
    return SURE if head.startswith(MAGIC) and own in head[: HEADER + 100] else NO


class Column(NamedTuple):
    """A vertex attribute of one primitive: the dtype and the count of its numbers, its offset and stride in bytes."""

    dtype: np.dtype[Any]
    width: int
    start: int
    stride: int

    def rows(self, file: BinaryIO, begin: int, end: int) -> NDArray[Any]:
        """Read some rows, (m, width)."""
        file.seek(self.start + begin * self.stride)
        length = (end - begin - 1) * self.stride + self.width * self.dtype.itemsize
        data = file.read(length)
        if len(data) < length:
            raise ValueError(f"is cut off at byte {self.start + begin * self.stride + len(data):,}")
        return np.ndarray((end - begin, self.width), self.dtype, data, 0, (self.stride, self.dtype.itemsize))


class Primitive(NamedTuple):
    """Points with the same attributes: their number, and the attributes by name."""

    size: int
    columns: dict[str, Column]


class GlbSource(Source):
    """Reader of points in GLB files that pointray has written."""

    def __init__(self, path: Path, request: Request) -> None:
        self._path = path
        try:
            tree, start, size = _read_json(path)
            self._primitives = [_primitive(tree, one, start, size) for one in _listed(tree["meshes"][0]["primitives"])]
            self._shift = _translation(tree["nodes"][0])
        except (KeyError, IndexError, TypeError, AttributeError, OverflowError, RecursionError) as error:
            raise ValueError(f"is damaged: unexpected content of its JSON: {type(error).__name__} {error}") from None
        self._types = self._common_types()
        count = sum(primitive.size for primitive in self._primitives)
        row = 36 + sum(dtype.itemsize * width for dtype, width in self._types.values())
        self.listing = Listing(count, row, georeference=Georeference(format="glTF"), facts={"kind": "points"})

    def _common_types(self) -> dict[str, tuple[np.dtype[Any], int]]:
        """Return the dtype and the width of all attributes by name."""
        types: dict[str, tuple[np.dtype[Any], int]] = {}
        for primitive in self._primitives:
            for name, column in primitive.columns.items():
                if types.setdefault(name, (column.dtype, column.width)) != (column.dtype, column.width):
                    raise ValueError(f"is damaged: the attribute {name[:40]} has several types")
        return types

    def chunks(self) -> Iterator[Chunk]:
        done = 0
        with self._path.open("rb") as file:
            for primitive in self._primitives:
                for begin in range(0, primitive.size, CHUNK):
                    end = min(begin + CHUNK, primitive.size)
                    done += end - begin
                    assert self.listing.count is not None
                    yield self._chunk(file, primitive, (begin, end), done / self.listing.count)

    def _chunk(self, file: BinaryIO, primitive: Primitive, span: tuple[int, int], share: float) -> Chunk:
        """Return rows `span` of a primitive as a chunk. share : fraction of the file read so far"""
        found: dict[str, NDArray[Any]] = {}
        for name, (dtype, width) in self._types.items():
            column = primitive.columns.get(name)
            rows = np.zeros((span[1] - span[0], width), dtype) if column is None else column.rows(file, *span)
            found[name] = np.asarray(rows, dtype.newbyteorder("="), order="C")
        positions: NDArray[Any] = found.pop(POSITION)
        if self._shift.any():
            positions = positions + self._shift
        normals, colors = found.pop(NORMAL, None), found.pop(COLOR, None)
        attributes = {
            name.removeprefix("_").lower(): rows[:, 0].copy() if rows.shape[1] == 1 else rows
            for name, rows in found.items()
        }
        return Chunk(positions, normals, None if colors is None else colors[:, :3], attributes, share)


def _read_json(path: Path) -> tuple[Any, int, int]:
    """Return the JSON of a file, and offset and size in bytes of its binary part; ValueError if that is invalid."""
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(HEADER)
        if len(head) < HEADER:
            raise ValueError(f"is cut off: it has {size} bytes, the header needs {HEADER}")
        _, version, total, length, kind = struct.unpack("<4sIIII", head)
        if version != 2 or kind != JSON:
            raise ValueError(f"unsupported version {version}, expected 2")
        if total > size:
            raise ValueError(f"is cut off: {total:,} bytes expected, {size:,} found")
        if length > min(LARGEST_JSON, size - HEADER - 8):
            raise ValueError(f"is damaged: invalid length {length:,} of its JSON")
        text = file.read(length)
        binary, kind = struct.unpack("<II", file.read(8))
    start = HEADER + length + 8
    if kind != BINARY or binary > size - start:
        raise ValueError(f"is cut off: {binary:,} bytes of data expected, {size - start:,} found")
    try:
        return json.loads(text), start, binary
    except (ValueError, RecursionError) as error:
        raise ValueError(f"is damaged: its JSON: {error}") from None


def _listed(primitives: Any) -> list[Any]:
    if not isinstance(primitives, list) or not 0 < len(primitives) <= MOST_PRIMITIVES:
        raise ValueError(f"is damaged: its mesh must have 1 to {MOST_PRIMITIVES} primitives")
    return primitives


def _translation(node: Any) -> Doubles:
    shift = np.array([float(x) for x in node.get("translation", (0, 0, 0))], np.float64)
    if shift.shape != (3,) or not np.isfinite(shift).all():
        raise ValueError("is damaged: invalid translation of its node")
    return shift


def _primitive(tree: Any, primitive: Any, start: int, size: int) -> Primitive:
    """Return a primitive, checked against the binary part of the file, `size` bytes from offset `start`."""
    columns: dict[str, Column] = {}
    counts = set()
    for name, index in primitive["attributes"].items():
        accessor = tree["accessors"][_whole(index)]
        view = tree["bufferViews"][_whole(accessor["bufferView"])]
        dtype, width = DTYPES[accessor["componentType"]], WIDTHS[accessor["type"]]
        count, packed = _whole(accessor["count"]), dtype.itemsize * width
        stride = _whole(view.get("byteStride", packed))
        offset = _whole(view.get("byteOffset", 0)) + _whole(accessor.get("byteOffset", 0))
        if not 0 < packed <= stride <= 256 or count < 1 or offset + (count - 1) * stride + packed > size:
            raise ValueError(f"is damaged: {count:,} values of the attribute {name[:40]} at byte {start + offset:,}")
        columns[name] = Column(dtype, width, start + offset, stride)
        counts.add(count)
    wanted = {POSITION: ("<f4", 3), NORMAL: ("<f4", 3), COLOR: ("|u1", 4)}
    if POSITION not in columns or len(counts) != 1:
        raise ValueError("is damaged: a primitive has no positions, or attributes of different lengths")
    for name, column in columns.items():
        if name in wanted and (column.dtype.str, column.width) != wanted[name]:
            raise ValueError(f"is damaged: the attribute {name} has an unexpected type")
    return Primitive(counts.pop(), columns)


def _whole(value: Any) -> int:
    """Return a number of the JSON that must be a nonnegative integer."""
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value < math.inf:
        raise ValueError(f"is damaged: its JSON contains {str(value)[:40]!r}, expected a nonnegative integer")
    return value


FORMAT = Format(
    "GLB points",
    (".glb",),
    recognise,
    GlbSource,
    {
        "positions": "float32, relative to the translation of a node",
        "normals": "of points that have one; others are 0 0 0",
        "colors": "8 bits",
        "attributes": "integers of 8 and 16 bits, and float32",
        "survey": "none",
        "note": "GLB files with points, as pointray writes them; other GLB files are meshes; 32-bit and 64-bit "
        "attributes become float32; colours are sRGB, as in trimesh and Open3D, not linear",
    },
    write=write,
)
