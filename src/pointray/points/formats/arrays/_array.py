"""Arrays in NumPy's own format: the header, rows read in blocks, and what unnamed columns are."""

from __future__ import annotations

import ast
import math
import re
import warnings
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from .._source import CHUNK

MAGIC = b"\x93NUMPY"
LONGEST_HEADER = 1 << 16  # bytes: beyond, a header is no list of columns that anybody wrote
BLOCK = 1 << 25  # bytes of rows that are read together, if they are long
MOST_COLUMNS = 64  # unnamed ones: wider arrays are depth pictures, or have their points in columns
COLUMNS = ("x", "y", "z")
NORMALS = ("nx", "ny", "nz")
COLORS = ("r", "g", "b")
UNIT = 0.02  # a normal's length may be off by so much


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


def default_names(width: int, triples: Iterable[str]) -> tuple[str, ...]:
    """Names of columns. triples : what each three columns after x, y, z are: "normals", "colors" or "" """
    names = [*COLUMNS, *(f"column_{k + 1}" for k in range(3, width))]
    for k, triple in enumerate(triples, 1):
        if triple:
            names[3 * k : 3 * k + 3] = NORMALS if triple == "normals" else COLORS
    return tuple(names)


def judged(blocks: Iterable[NDArray[Any]], width: int) -> tuple[str, ...]:
    """Names of the columns of (m, width) blocks: normals and colours behind x, y, z are told from all their values."""
    triples = [Triple() for _ in range(width // 3 - 1)] if width in (6, 9) else []
    if not triples:
        return default_names(width, ())
    for block in blocks:
        for k, triple in enumerate(triples, 1):
            triple.add(block[:, 3 * k : 3 * k + 3])
        if not any(triple.may_be for triple in triples):
            break
    kinds: list[str] = []
    for triple in triples:
        kinds.append(triple.kind if triple.kind not in kinds else "")
    return default_names(width, kinds)


class Triple:
    """What three columns are: normals of unit length, or colours from 0 to 1 or in whole numbers to 255."""

    def __init__(self) -> None:
        self._normals, self._colors, self._whole, self._floats = True, True, True, True
        self._units, self._rows, self._most = 0, 0, 0.0

    @property
    def may_be(self) -> bool:
        """Whether they may still be either."""
        return self._normals or self._colors

    @property
    def kind(self) -> str:
        """Either "normals", "colors" or "", after all blocks."""
        if self._normals and 2 * self._units > self._rows:
            return "normals"
        bright = 2 < self._most if self._whole else 0 < self._most <= 1
        return "colors" if self._colors and (bright or (self._most == 1 and self._floats)) else ""

    def add(self, block: NDArray[Any]) -> None:
        """Take (m, 3) values into account: NaN and zero are missing normals, but no colours."""
        probe = block[:1000]
        for part in (probe, block) if len(block) > len(probe) else (block,):
            self._normals = self._normals and self._are_normals(part)
            self._colors = self._colors and self._are_colors(part)
        if self._normals:
            self._units += int((_lengths(block) > 0.5).sum())
            self._rows += len(block)

    def _are_normals(self, block: NDArray[Any]) -> bool:
        if block.dtype.kind != "f":
            return False
        lengths = _lengths(block)
        return bool(((np.abs(lengths - 1) < UNIT) | (lengths == 0) | np.isnan(lengths)).all())

    def _are_colors(self, block: NDArray[Any]) -> bool:
        if not block.size:
            return True
        low, high = float(block.min()), float(block.max())
        if not (low >= 0 and high <= 255):
            return False
        self._most, self._floats = max(self._most, high), block.dtype.kind == "f"
        self._whole = self._whole and (not self._floats or bool((block == np.rint(block)).all()))
        return self._whole or self._most <= 1


def _lengths(block: NDArray[Any]) -> NDArray[Any]:
    with np.errstate(over="ignore", invalid="ignore"):
        return np.sqrt(np.einsum("ij,ij->i", block, block))
