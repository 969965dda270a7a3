"""Arrays in NumPy's own format: the header, rows read in blocks, and what unnamed columns are."""

from __future__ import annotations

import ast
import math
import re
import warnings
from collections.abc import Iterator
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from .._source import CHUNK

MAGIC = b"\x93NUMPY"
LONGEST_HEADER = 1 << 16  # bytes: beyond, a header is no list of columns that anybody wrote
BLOCK = 1 << 25  # bytes of rows that are read together, if they are long
MOST_COLUMNS = 64  # unnamed ones: wider arrays are depth pictures, or have their points in columns


class Stream(Protocol):
    """What arrays are read from."""

    def read(self, size: int = ..., /) -> bytes: ...


class Header(NamedTuple):
    """What the header of an array says. size : bytes of the header"""

    shape: tuple[int, ...]
    fortran: bool
    dtype: np.dtype[Any]
    size: int

    @property
    def nbytes(self) -> int:
        """Bytes of the array's values."""
        return math.prod(self.shape) * self.dtype.itemsize

    @property
    def rows(self) -> int:
        """Rows, if the last axis of an array of more than one is its columns."""
        return math.prod(self.shape[:-1]) if len(self.shape) > 1 else math.prod(self.shape)

    @property
    def width(self) -> int:
        """Columns; 0 if the array has one axis."""
        return self.shape[-1] if len(self.shape) > 1 else 0


def read_header(stream: Stream) -> Header:
    """The header at the start of a stream; ValueError says what is wrong with it."""
    start = stream.read(8)
    if len(start) < 8 or not start.startswith(MAGIC):
        raise ValueError(f"is no array of NumPy: it begins with {start[:8]!r}")
    if start[6] not in (1, 2, 3):
        raise ValueError(f"the header has the version {start[6]}.{start[7]}, not 1.0 to 3.0")
    digits = 2 if start[6] == 1 else 4
    length = int.from_bytes(stream.read(digits), "little")
    if length > LONGEST_HEADER:
        raise ValueError(f"the header is damaged: it announces {length:,} bytes of itself")
    text = stream.read(length)
    if len(text) < length:
        raise ValueError("the header is cut off")
    try:
        written = text.decode("utf-8" if start[6] == 3 else "latin-1")
    except UnicodeDecodeError as error:
        raise ValueError(f"the header is damaged: byte {8 + digits + error.start} is not UTF-8") from error
    shape, fortran, dtype = _parsed(written)
    return Header(shape, fortran, dtype, 8 + digits + length)


def _parsed(text: str) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Shape, whether columns lie together, and dtype."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of odd escapes, and of names of types that go out of use
            facts = ast.literal_eval(re.sub(r"(?<=\d)L\b", "", text.strip()))  # Python 2 wrote 10L
            shape, fortran = facts["shape"], facts["fortran_order"]
            dtype = np.lib.format.descr_to_dtype(facts["descr"])
    except (Exception, RecursionError) as error:
        raise ValueError(f"the header is damaged: {text.strip()[:80]!r}") from error
    whole = isinstance(shape, tuple) and all(type(n) is int and 0 <= n < 2**48 for n in shape)
    if not whole or len(shape) > 32 or type(fortran) is not bool:
        raise ValueError(f"the header is damaged: the shape is {str(shape)[:60]}")
    return shape, fortran, dtype


def check_dtype(dtype: np.dtype[Any]) -> None:
    """ValueError for values that are no numbers."""
    if dtype.hasobject:
        raise ValueError("holds Python objects, which may run a program when they are read: save numbers")
    if dtype.kind not in "biuf":
        raise ValueError(f"holds values of the type {dtype}, no numbers")


def fields_of(header: Header) -> dict[str, tuple[np.dtype[Any], int]]:
    """The dtype and the width of each field of a structured array, 0 for one number."""
    fields: dict[str, tuple[np.dtype[Any], int]] = {}
    if len(header.shape) != 1:
        raise ValueError(f"has the shape {header.shape} of rows with fields: one axis is expected")
    for name, field in (header.dtype.fields or {}).items():
        base, shape = field[0].base, field[0].shape
        if len(shape) > 1 or base.kind not in "biuf":
            raise ValueError(f"the field {name!r} holds values of the type {field[0]}, no numbers or rows of them")
        fields[name] = (base, shape[0] if shape else 0)
    return fields


def blocks_of(stream: Stream, header: Header, step: int) -> Iterator[NDArray[Any]]:
    """Rows from behind the header, at most `step` at a time: (m,) or (m, width) arrays.

    Nothing is memory-mapped: a file that is cut off while it is mapped kills the process.
    """
    columns = (header.width,) if len(header.shape) > 1 else ()
    if header.fortran and len(header.shape) > 1:
        whole = np.frombuffer(_exactly(stream, header.nbytes), header.dtype)
        whole = whole.reshape(header.shape, order="F").reshape(header.rows, header.width)
        for start in range(0, header.rows, step):
            yield whole[start : start + step]
        return
    row = header.dtype.itemsize * math.prod(columns)
    for start in range(0, header.rows, step):
        count = min(step, header.rows - start)
        yield np.frombuffer(_exactly(stream, count * row), header.dtype).reshape(count, *columns)


def _exactly(stream: Stream, size: int) -> bytes:
    data = stream.read(size)
    if len(data) < size:
        raise ValueError("is cut off")
    return data


def step_of(row: int) -> int:
    """Rows to read together. row : bytes of one"""
    return max(min(CHUNK, BLOCK // max(row, 1)), 1)


# ------------------------------------------------------------------------------------------- unnamed columns


def check_table(header: Header, columns: tuple[str, ...] | None) -> None:
    """ValueError if an array without names is no table of points."""
    check_dtype(header.dtype)
    shape = header.shape
    pixels = len(shape) == 3 and header.dtype.kind == "f"  # an organised cloud
    if (len(shape) != 2 and not pixels) or header.width < 3 or header.dtype.kind == "b":
        raise ValueError(f"has the shape {shape} of {header.dtype}: rows of x, y, z and perhaps more are expected")
    if columns is None and header.width > MOST_COLUMNS:
        raise ValueError(
            f"has the shape {shape}: rows of x, y, z and perhaps more are expected. If points are its columns, save "
            "it transposed; if it is a depth picture, give --intrinsics; otherwise name all columns with --columns"
        )
    if columns is not None and len(columns) != header.width:
        raise ValueError(f"has {header.width} columns, {len(columns)} are named")
