"""Files of arrays: consecutive .npy arrays, named by a JSON description at the beginning. Read by memory mapping.

Files are not trusted: names, types and lengths are validated here; the caller validates the values.
"""

from __future__ import annotations

import json
import math
import mmap
import os
from collections.abc import Iterable, Mapping
from contextlib import suppress
from typing import IO, Any, NamedTuple, Protocol

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from ..base.atomic_write import check_regular, replacing
from ..base.progress import Progress

SMALL = 1 << 20  # bytes: smaller files are read instead of mapped, as each mapping takes a file descriptor
ALIGN = 64  # bytes: alignment of arrays, and padding after the last one, for loads past its end
CHUNK = 1 << 24  # items written between two progress reports

Arrays = dict[str, NDArray[Any]]


class Pieces(Protocol):
    """An array, or an object such as a column on disk that returns pieces of an array for slices of its rows."""

    @property
    def dtype(self) -> np.dtype[Any]: ...
    @property
    def shape(self) -> tuple[int, ...]: ...
    def __getitem__(self, rows: slice, /) -> NDArray[Any]: ...


class Kind(NamedTuple):
    """A kind of file and the version of its format, by which `read_arrays` decides whether it can read a file.

    Attributes
    ----------
    format : str
        Name of the kind in the JSON description at the beginning of the file.
    version : int
        Current version of the format.
    layout : list of int
        Sizes of the records in its arrays; files with other sizes cannot be read.
    noun : str
        Name of the kind in messages, such as "a saved model".
    outdated : str
        Message for another version or layout.
    older : tuple of int
        Earlier versions that can be read.
    """

    format: str
    version: int
    layout: list[int]
    noun: str
    outdated: str
    older: tuple[int, ...] = ()


def write_arrays(
    path: str | os.PathLike[str], kind: Kind, about: Mapping[str, Any], arrays: Mapping[str, Pieces], report: Progress
) -> None:
    """Write named arrays to a file, which gets its name when it is complete. `read_arrays` reads it.

    Parameters
    ----------
    path : str or path
    kind : Kind
        Kind and version of the file.
    about : dict
        Additional entries of the JSON description at the beginning of the file.
    arrays : dict of str to array
        Arrays, or objects that return arrays for slices and have dtype and shape, such as columns on disk.
    report : callable
        Called with the fraction done.
    """
    known = {"format": kind.format, "version": kind.version, "layout": kind.layout, "arrays": list(arrays)}
    head = np.frombuffer(json.dumps({**known, **about}).encode(), np.uint8)
    total, done = sum(math.prod(array.shape) for array in arrays.values()) or 1, 0
    with replacing(path) as file:
        for array in (head, *arrays.values()):
            descr = {"descr": npy.dtype_to_descr(array.dtype), "fortran_order": False, "shape": array.shape}
            npy.write_array_header_1_0(file, descr)
            rows = max(CHUNK // math.prod(array.shape[1:]), 1)
            for start in range(0, array.shape[0], rows):
                piece = np.ascontiguousarray(array[start : start + rows])
                file.write(piece.reshape(-1).data)
                if array is not head:
                    done += piece.size
                    report(done / total)
            file.write(bytes(-file.tell() % ALIGN))
        file.write(bytes(ALIGN))


def read_arrays(path: str | os.PathLike[str], kind: Kind) -> tuple[dict[str, Any], Arrays]:
    """Read a file that `write_arrays` has written; return its description and its arrays by name.

    The arrays of files over 1 MiB are memory-mapped; changes to them do not change the file.

    Raises
    ------
    OSError
        If the file cannot be opened.
    ValueError
        If the file is of another kind or version, or is truncated; the message does not name the file.
    """
    with check_regular(path).open("rb") as stream:
        size = os.fstat(stream.fileno()).st_size
        if stream.read(6) != b"\x93NUMPY":
            raise ValueError(f"not {kind.noun}")
        stream.seek(0)
        # Pages of a mapped file are copied on write: the file does not change.
        is_small, number = size <= SMALL, stream.fileno()
        memory = bytearray(stream.read()) if is_small else mmap.mmap(number, 0, access=mmap.ACCESS_COPY)
        stream.seek(0)
        about = _description(_next_array(stream, memory, size, "the description"), kind)
        arrays = {name: _next_array(stream, memory, size, name) for name in about["arrays"]}
        if stream.tell() + ALIGN > size:
            raise ValueError("the file is cut off")
    return about, arrays


def _description(head: NDArray[Any], kind: Kind) -> dict[str, Any]:
    """Parse the JSON description of a file; raise a ValueError if the file is of another kind or version.

    head : first array of the file, the bytes (uint8) of the JSON text
    """
    try:
        about = json.loads(head.tobytes())
        names = [str(name) for name in about["arrays"]]
        known = about["format"], about["version"], about["layout"]
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise ValueError(f"not {kind.noun}, or its description is damaged") from error
    if known[0] != kind.format:
        raise ValueError(f"not {kind.noun}")
    if known[1] not in (kind.version, *kind.older) or known[2] != kind.layout:
        raise ValueError(kind.outdated)
    return {**about, "arrays": names}


def _next_array(stream: IO[bytes], memory: mmap.mmap | bytearray, size: int, name: str) -> NDArray[Any]:
    """Return the array at the stream's position without copying it; move the stream to the array after it.

    memory : the contents of the file, mapped or read; size : of the file in bytes; name : of the array, for messages
    """
    try:
        if npy.read_magic(stream) != (1, 0):
            raise ValueError("unsupported version")
        shape, fortran, dtype = npy.read_array_header_1_0(stream)
    except Exception as error:  # NumPy's parser raises nearly anything for a malformed header
        raise ValueError(f"the header of {name} is damaged") from error
    if fortran or dtype.hasobject or dtype.newbyteorder("=") != dtype or min(shape, default=0) < 0 or len(shape) > 2:
        raise ValueError(f"{name} is an unsupported kind of array")
    start, count = stream.tell(), math.prod(shape)
    if start + count * dtype.itemsize > size:
        raise ValueError(f"the file is cut off in {name}")
    stream.seek(start + count * dtype.itemsize)
    stream.seek(-stream.tell() % ALIGN, os.SEEK_CUR)
    if count == 0:
        return np.empty(shape, dtype)
    return np.frombuffer(memory, dtype, count, start).reshape(shape)


def drop_pages(arrays: Iterable[NDArray[Any]]) -> None:
    """Release the memory of mapped arrays; the system reads it from the file again when needed.

    Changes to the arrays are lost. Arrays that are not mapped are ignored. Does nothing on systems without support.
    """
    files = {id(file): file for file in map(_mapping_of, arrays) if file is not None}
    for file in files.values():
        with suppress(AttributeError, OSError, ValueError):
            file.madvise(mmap.MADV_DONTNEED)


def _mapping_of(array: NDArray[Any]) -> mmap.mmap | None:
    """Return the memory-mapped file that holds an array; None if the array is not mapped."""
    base: Any = array
    while isinstance(base, np.ndarray | memoryview):
        base = base.base if isinstance(base, np.ndarray) else base.obj
    return base if isinstance(base, mmap.mmap) else None


def take_array(found: Arrays, name: str, dtype: type, shape: tuple[int, ...]) -> NDArray[Any]:
    """Remove the array `name` from `found` and return it; raise a ValueError if its dtype or shape is wrong.

    found : arrays by name, as `read_arrays` returns them; shape : expected lengths, -1 for any length
    """
    if name not in found:
        raise ValueError(f"{name} is missing")
    array = found.pop(name)
    right = array.ndim == len(shape) and all(a in (b, -1) for a, b in zip(shape, array.shape, strict=True))
    if array.dtype != dtype or not right:
        raise ValueError(f"{name} is of unexpected type or shape: {array.dtype} {array.shape}")
    return array
