"""Writer for glTF 2.0, binary: points with normals, colours and attributes.

Positions are float32 relative to the translation of a node. Colours are the 8-bit values of the points, as trimesh,
Open3D and MeshLab write and read them, although glTF defines vertex colours as linear.
"""

from __future__ import annotations

import json
import re
import struct
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ....base.arrays import Rows
from ....base.progress import Progress, report_progress
from ....cloud.georeference import RESIDUAL
from ....cloud.points import Points
from .._losses import Losses, georeference_losses, rows_left_out, separate_columns, unused_name
from .._source import CHUNK

GENERATOR = "pointray"
MAGIC, JSON, BINARY = b"glTF", 0x4E4F534A, 0x004E4942
LARGEST = 2**32 - 1  # bytes of a file
COMPONENTS = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "f4": 5126}
TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}
POINTS, ARRAY_BUFFER = 0, 34962  # mode of a primitive, target of a buffer view
UNIT = 5e-4  # tolerance of a normal's length


class Column(NamedTuple):
    """A vertex attribute: its name in glTF, the dtype of its numbers, their count for a point, and all values."""

    name: str
    dtype: np.dtype[Any]
    width: int
    values: NDArray[Any]

    @property
    def stride(self) -> int:
        """Bytes for a point, a multiple of four."""
        return -(-self.dtype.itemsize * self.width // 4) * 4


def write(file: Any, points: Points, progress: Progress | None = None) -> Losses:
    """Write all data of the points to a stream as GLB; return what it cannot store, in words.

    Rows without a finite position are left out.
    """
    losses = _coordinate_losses(points)
    order, known = _order_of(points, losses)
    columns = _columns_of(points, losses)
    size = sum(column.stride for column in columns) * len(order)
    head = _json_of(points, columns, order, known)
    if size + len(head) + 28 > LARGEST:
        raise ValueError(f"cannot be written: {size:,} bytes of points, GLB files have at most {LARGEST:,}")
    file.write(struct.pack("<4sIIII", MAGIC, 2, 28 + len(head) + size, len(head), JSON) + head)
    file.write(struct.pack("<II", size, BINARY))
    total, done = len(columns) * len(order), 0
    for column in columns:
        for rows in _blocks(order):
            file.write(_bytes_of(column, rows))
            done += len(rows)
            report_progress(progress, done / total)
    return losses


def _blocks(order: Rows) -> Iterator[Rows]:
    for start in range(0, len(order), CHUNK):
        yield order[start : start + CHUNK]


def _bytes_of(column: Column, rows: Rows) -> bytes:
    values = column.values[rows].reshape(len(rows), -1)
    if column.name == "NORMAL":
        values = _unit(values)
    elif values.dtype.kind == "f":
        values = np.nan_to_num(values, nan=0.0, posinf=0.0, neginf=0.0)
    out = np.zeros((len(rows), column.stride // column.dtype.itemsize), column.dtype)
    with np.errstate(over="ignore"):
        out[:, : values.shape[1]] = values
    if column.name == "COLOR_0":
        out[:, 3] = 255
    return out.tobytes()


def _coordinate_losses(points: Points) -> Losses:
    losses = georeference_losses(points)
    if points.georeference.projection is not None:
        losses.append("stores metres east and north of a place instead of degrees")
    if RESIDUAL in points.attributes:
        losses.append("rounds its coordinates to 32-bit floats about a centre")
    return losses + rows_left_out(points)


def _order_of(points: Points, losses: Losses) -> tuple[Rows, int]:
    """Return the rows in the order of the file, and the number of those with a normal, which come first."""
    order = np.flatnonzero(points.finite)
    if points.normals is None:
        return order, 0
    parts = [(rows, _lengths(points.normals[rows])) for rows in _blocks(order)]
    known = np.concatenate([np.isfinite(lengths) & (lengths > 0) for _, lengths in parts])
    if any((np.abs(lengths - 1) > UNIT)[np.isfinite(lengths) & (lengths > 0)].any() for _, lengths in parts):
        losses.append("stores normals with length 1")
    count = int(np.count_nonzero(known))
    if 0 < count < len(order) and not known[:count].all():
        losses.append("stores points without a normal after the others")
    return np.concatenate([order[known], order[~known]]), count


def _lengths(normals: NDArray[np.float32]) -> NDArray[np.float64]:
    with np.errstate(over="ignore", invalid="ignore"):
        return np.asarray(np.sqrt(np.einsum("ij,ij->i", normals, normals, dtype=np.float64)))


def _unit(normals: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return normals with length 1; those that have it nearly are not changed, and unknown ones are 0."""
    lengths = _lengths(normals)
    known = np.isfinite(lengths) & (lengths > 0)
    scale = np.where(known & (np.abs(lengths - 1) > UNIT), 1 / np.where(known, lengths, 1), 1)
    return np.where(known[:, None], normals * scale[:, None], 0).astype(np.float32)


def _columns_of(points: Points, losses: Losses) -> list[Column]:
    single = np.dtype("<f4")
    columns = [Column("POSITION", single, 3, points.positions)]
    if points.normals is not None:
        columns.append(Column("NORMAL", single, 3, points.normals))
    if points.colors is not None:
        columns.append(Column("COLOR_0", np.dtype("u1"), 4, points.colors))
    taken: set[str] = set()
    for name, values in points.attributes.items():
        if name == RESIDUAL:
            continue
        for title, piece in separate_columns(name, values, losses, 4).items():
            plain = re.sub(r"[^A-Za-z0-9_]+", "_", title).lower()  # readers cannot know the case
            used = unused_name(plain, taken, losses, "the attribute", title)
            table = piece.reshape(len(piece), -1)
            columns.append(Column(f"_{used.upper()}", _stored_type(title, table, losses), table.shape[1], table))
    return columns


def _stored_type(name: str, values: NDArray[Any], losses: Losses) -> np.dtype[Any]:
    """Return the type of an attribute in the file: its own, or float32. losses : receives what that changes"""
    kind = np.dtype("u1") if values.dtype == np.bool_ else values.dtype
    if kind.str[1:] in COMPONENTS and kind.kind != "f":
        return kind.newbyteorder("<")
    odd = rounded = 0
    for start in range(0, len(values), CHUNK):
        some = values[start : start + CHUNK]
        with np.errstate(over="ignore", invalid="ignore"):
            narrow = some.astype(np.float32)
            finite = np.isfinite(narrow)
            odd += int(np.count_nonzero(~finite))
            rounded += int(np.count_nonzero(narrow[finite].astype(kind) != some[finite]))
    if odd:
        losses.append(f"stores {odd:,} values of {name} that are not finite numbers of 32 bits as 0")
    if rounded:
        losses.append(f"rounds {name} to 32-bit floats")
    return np.dtype("<f4")


# ------------------------------------------------------------------------------------------------------------- JSON


def _json_of(points: Points, columns: list[Column], order: Rows, known: int) -> bytes:
    """Return the JSON of the file, padded. order : rows in the file, of which the first `known` have normals"""
    views: list[dict[str, Any]] = []
    accessors: list[dict[str, Any]] = []
    start = 0
    for column in columns:
        length = column.stride * len(order)
        view = {"buffer": 0, "byteOffset": start, "byteLength": length, "byteStride": column.stride}
        views.append(view | {"target": ARRAY_BUFFER})
        start += length
    primitives = []
    parts = [(0, known), (known, len(order))] if 0 < known < len(order) else [(0, len(order))]
    for begin, end in parts:
        names = {}
        for k, column in enumerate(columns):
            if column.name == "NORMAL" and begin >= known:
                continue
            names[column.name] = len(accessors)
            accessors.append(_accessor(column, k, order[begin:end], begin))
        primitives.append({"mode": POINTS, "attributes": names})
    node: dict[str, Any] = {"mesh": 0}
    if points.origin.any():
        node["translation"] = points.origin.tolist()
    tree = {
        "asset": {"version": "2.0", "generator": GENERATOR},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [node],
        "meshes": [{"primitives": primitives}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": start}],
    }
    text = json.dumps(tree, separators=(",", ":")).encode()
    return text + b" " * (-len(text) % 4)


def _accessor(column: Column, view: int, rows: Rows, begin: int) -> dict[str, Any]:
    """Return the description of some rows of a column. view : number of its buffer view; begin : first row in it"""
    facts: dict[str, Any] = {
        "bufferView": view,
        "byteOffset": begin * column.stride,
        "componentType": COMPONENTS[column.dtype.str[1:]],
        "count": len(rows),
        "type": TYPES[column.width],
    }
    if column.name == "COLOR_0":
        facts["normalized"] = True
    if column.name == "POSITION":
        limits = [(column.values[some].min(axis=0), column.values[some].max(axis=0)) for some in _blocks(rows)]
        facts["min"] = np.min([low for low, _ in limits], axis=0).astype(float).tolist()
        facts["max"] = np.max([high for _, high in limits], axis=0).astype(float).tolist()
    return facts
