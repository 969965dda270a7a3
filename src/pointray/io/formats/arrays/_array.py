"""Arrays in NumPy's format: header, rows read in blocks, and checks of unnamed columns."""

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
LONGEST_HEADER = 1 << 16  # bytes: longer headers are damaged
BLOCK = 1 << 25  # maximum bytes of rows read at a time
MOST_COLUMNS = 64  # maximum unnamed columns: wider arrays are depth images, or have points in columns


class Stream(Protocol):
    """A binary stream from which arrays are read: a file, or a member of a zip archive."""

    def read(self, size: int = ..., /) -> bytes: ...


class Header(NamedTuple):
    """Header of an array in NumPy's format.

    fortran : whether the values are in Fortran order, column by column; size : bytes of the header
    """

    shape: tuple[int, ...]
    fortran: bool
    dtype: np.dtype[Any]
    size: int

    @property
    def nbytes(self) -> int:
        """Number of bytes of the values after the header."""
        return math.prod(self.shape) * self.dtype.itemsize

    @property
    def rows(self) -> int:
        """Number of rows: the product of all axes, without the last of several, which is the columns."""
        return math.prod(self.shape[:-1]) if len(self.shape) > 1 else math.prod(self.shape)

    @property
    def width(self) -> int:
        """Number of columns; 0 if the array has one axis."""
        return self.shape[-1] if len(self.shape) > 1 else 0


def read_header(stream: Stream) -> Header:
    """Read the header at the start of a stream; raise ValueError if it is invalid."""
    start = stream.read(8)
    if len(start) < 8 or not start.startswith(MAGIC):
        raise ValueError(f"is not a NumPy array: it begins with {start[:8]!r}")
    if start[6] not in (1, 2, 3):
        raise ValueError(f"unsupported header version {start[6]}.{start[7]}, expected 1.0 to 3.0")
    digits = 2 if start[6] == 1 else 4
    length = int.from_bytes(stream.read(digits), "little")
    if length > LONGEST_HEADER:
        raise ValueError(f"the header is damaged: invalid length of {length:,} bytes")
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
    """Parse the text of an array's header; return the shape, whether the order is Fortran's, and the dtype."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about invalid escapes and deprecated type names
            facts = ast.literal_eval(re.sub(r"(?<=\d)L\b", "", text.strip()))  # Python 2 wrote 10L
            shape, fortran = facts["shape"], facts["fortran_order"]
            dtype = np.lib.format.descr_to_dtype(facts["descr"])
    except (Exception, RecursionError) as error:
        raise ValueError(f"the header is damaged: {text.strip()[:80]!r}") from error
    whole = isinstance(shape, tuple) and all(type(n) is int and 0 <= n < 2**48 for n in shape)
    if not whole or len(shape) > 32 or type(fortran) is not bool:
        raise ValueError(f"the header is damaged: invalid shape {str(shape)[:60]}")
    return shape, fortran, dtype


def check_dtype(dtype: np.dtype[Any]) -> None:
    """Raise ValueError if the values of an array are neither numbers nor bools."""
    if dtype.hasobject:
        raise ValueError("contains Python objects, which are unsafe to load: save numbers instead")
    if dtype.kind not in "biuf":
        raise ValueError(f"contains values of type {dtype}, expected numbers")


def fields_of(header: Header) -> dict[str, tuple[np.dtype[Any], int]]:
    """Return the dtype and the width of each field of a structured array; width 0 for a single number."""
    fields: dict[str, tuple[np.dtype[Any], int]] = {}
    if len(header.shape) != 1:
        raise ValueError(f"has the shape {header.shape}: rows with fields must have one axis")
    for name, field in (header.dtype.fields or {}).items():
        base, shape = field[0].base, field[0].shape
        if len(shape) > 1 or base.kind not in "biuf":
            raise ValueError(f"the field {name!r} contains values of type {field[0]}, expected numbers or rows of them")
        fields[name] = (base, shape[0] if shape else 0)
    return fields


def blocks_of(stream: Stream, header: Header, step: int) -> Iterator[NDArray[Any]]:
    """Yield the rows after the header, at most `step` at a time, as (m,) or (m, width) arrays.

    The file is not memory-mapped: truncating a mapped file kills the process.
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
    """Return the number of rows to read at a time, at most 2^18 and 32 MiB. row : bytes per row"""
    return max(min(CHUNK, BLOCK // max(row, 1)), 1)


# ------------------------------------------------------------------------------------------- unnamed columns


def check_table(header: Header, columns: tuple[str, ...] | None) -> None:
    """Raise ValueError if an array without field names is not a table whose rows are points: x, y, z and others.

    columns : names of its columns given by the caller, or None
    """
    check_dtype(header.dtype)
    shape = header.shape
    pixels = len(shape) == 3 and header.dtype.kind == "f"  # organised cloud
    if (len(shape) != 2 and not pixels) or header.width < 3 or header.dtype.kind == "b":
        raise ValueError(f"has the shape {shape} of {header.dtype}: expected rows of x, y, z and optional columns")
    if columns is None and header.width > MOST_COLUMNS:
        raise ValueError(
            f"has the shape {shape}: expected rows of x, y, z and optional columns. If each column is a point, save "
            "it transposed; for a depth image, pass --intrinsics; otherwise name all columns with --columns"
        )
    if columns is not None and len(columns) != header.width:
        raise ValueError(f"has {header.width} columns, but {len(columns)} are named")
