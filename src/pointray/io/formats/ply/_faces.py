"""Triangles of PLY files whose faces all have the same number of corners, read by NumPy without importing trimesh."""

from __future__ import annotations

import io
import warnings
from itertools import chain
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from ._ascii import skip_lines
from ._binary import ORDERS, skip
from ._header import Element, Header, Order, bytes_left

CORNERS = ("vertex_index", "vertex_indices")


def read_triangles(path: Path, header: Header) -> NDArray[np.int64] | None:
    """Return the triangles of a PLY file, (m, 3) vertex indices; polygons are split into fans.

    Return None if faces have other lists than that of vertex indices, or different numbers of corners. Raise ValueError
    if the file is cut off before them.
    """
    index = [element.name for element in header.elements].index("face")
    faces = header.elements[index]
    if [p.name in CORNERS for p in faces.properties if p.length is not None] != [True]:
        return None
    with path.open("rb") as file:
        file.seek(header.size)
        is_text = header.format == "ascii"
        for element in header.elements[:index]:
            if is_text:
                skip_lines(file, element)
            else:
                skip(file, element, ORDERS[header.format])
        corners = _ascii_corners(file, faces) if is_text else _binary_corners(file, faces, ORDERS[header.format])
    if corners is None or corners.shape[1] < 3 or len(corners) < faces.rows:
        return None
    return np.concatenate([corners[:, [0, k, k + 1]] for k in range(1, corners.shape[1] - 1)])


def _binary_corners(file: BinaryIO, faces: Element, order: Order) -> NDArray[np.int64] | None:
    """Return the vertex indices of binary faces, (m, k); None if their number k varies or the file is cut off.

    order : byte order, "<" or ">"
    """
    start = file.tell()
    fields: list[tuple[Any, ...]] = []
    for k, p in enumerate(faces.properties):
        item = p.type.newbyteorder(order)
        if p.length is not None:
            length = p.length.newbyteorder(order)
            file.seek(start + np.dtype(fields).itemsize)
            first = np.fromfile(file, length, 1)
            width = int(first[0]) if len(first) and first[0] in range(256) else 0
            fields += [("length", length), ("corners", item, (width,))]
        else:
            fields.append((f"scalar {k}", item))
    file.seek(start)
    dtype = np.dtype(fields)
    if faces.rows * dtype.itemsize > bytes_left(file):
        return None
    rows = np.fromfile(file, dtype, faces.rows)
    return rows["corners"].astype(np.int64) if (rows["length"] == width).all() else None


def _ascii_corners(file: BinaryIO, faces: Element) -> NDArray[np.int64] | None:
    """Return the vertex indices of ascii faces, (m, k); None if their number k varies or a line is invalid."""
    column = [p.length is not None for p in faces.properties].index(True)
    with io.TextIOWrapper(file, "latin-1") as text, warnings.catch_warnings():
        warnings.simplefilter("error")  # for numbers that are not integers
        lines = filter(str.strip, text)
        first = next(lines, "")
        used = range(column, len(first.split()) - len(faces.properties) + column + 1)
        try:
            rows = np.loadtxt(
                chain([first], lines), np.int64, usecols=used, max_rows=faces.rows, ndmin=2, comments=None
            )
        except (ValueError, DeprecationWarning, UserWarning, OverflowError):
            return None
    return rows[:, 1:] if (rows[:, 0] == rows.shape[1] - 1).all() else None
