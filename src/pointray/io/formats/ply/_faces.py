"""Triangles of PLY files whose faces all have the same number of corners, read by NumPy without importing trimesh."""

from __future__ import annotations

import io
import warnings
from itertools import chain
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray
from plyfile import PlyListProperty

from ._ascii import skip_lines
from ._binary import ORDERS, skip
from ._header import Header, bytes_left

CORNERS = ("vertex_index", "vertex_indices")


def read_triangles(path: Path, header: Header) -> NDArray[np.int64] | None:
    """Return the triangles of a PLY file, (m, 3); polygons are split into fans.

    Return None if faces have other lists, or different numbers of corners. Raise ValueError if the file is cut off
    before them.
    """
    index = [element.name for element in header.elements].index("face")
    faces, count = header.elements[index], header.counts[index]
    if [p.name in CORNERS for p in faces.properties if isinstance(p, PlyListProperty)] != [True]:
        return None
    with path.open("rb") as file:
        file.seek(header.size)
        is_text = header.format == "ascii"
        for element, rows in zip(header.elements[:index], header.counts[:index], strict=True):
            if not is_text:
                skip(file, element, rows, ORDERS[header.format])
            elif element.properties and rows:
                skip_lines(file, element, rows)
        if is_text:
            corners = _ascii_corners(file, faces.properties, count)
        else:
            corners = _binary_corners(file, faces.properties, count, ORDERS[header.format])
    if corners is None or corners.shape[1] < 3 or len(corners) < count:
        return None
    return np.concatenate([corners[:, [0, k, k + 1]] for k in range(1, corners.shape[1] - 1)])


def _binary_corners(file: BinaryIO, properties: Any, count: int, order: str) -> NDArray[np.int64] | None:
    """Return the corners of binary faces, (m, k); None if their number varies."""
    start = file.tell()
    fields: list[tuple[Any, ...]] = []
    for k, p in enumerate(properties):
        if isinstance(p, PlyListProperty):
            length, item = (np.dtype(kind) for kind in p.list_dtype(order))
            file.seek(start + np.dtype(fields).itemsize)
            first = np.fromfile(file, length, 1)
            width = int(first[0]) if len(first) and first[0] in range(256) else 0
            fields += [("length", length), ("corners", item, (width,))]
        else:
            fields.append((f"scalar {k}", p.dtype(order)))
    file.seek(start)
    dtype = np.dtype(fields)
    if count * dtype.itemsize > bytes_left(file):
        return None
    rows = np.fromfile(file, dtype, count)
    return rows["corners"].astype(np.int64) if (rows["length"] == width).all() else None


def _ascii_corners(file: BinaryIO, properties: Any, count: int) -> NDArray[np.int64] | None:
    """Return the corners of ascii faces, (m, k); None if their number varies."""
    column = [isinstance(p, PlyListProperty) for p in properties].index(True)
    with io.TextIOWrapper(file, "latin-1") as text, warnings.catch_warnings():
        warnings.simplefilter("error")  # for numbers that are not integers
        lines = filter(str.strip, text)
        first = next(lines, "")
        used = range(column, len(first.split()) - len(properties) + column + 1)
        try:
            rows = np.loadtxt(chain([first], lines), np.int64, usecols=used, max_rows=count, ndmin=2, comments=None)
        except (ValueError, DeprecationWarning, UserWarning, OverflowError):
            return None
    return rows[:, 1:] if (rows[:, 0] == rows.shape[1] - 1).all() else None
