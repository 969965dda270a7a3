"""A saved model as bytes: its header, its arrays, and the file made of them again."""

from __future__ import annotations

import io
import json
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

ALIGN = 64


class Saved(NamedTuple):
    """The parts of a file: the description, and the arrays that it names."""

    about: dict[str, Any]
    arrays: dict[str, NDArray[Any]]


def split(data: bytes) -> Saved:
    """Split a valid file into its parts."""
    stream, found = io.BytesIO(data), []
    while stream.tell() + ALIGN < len(data):
        npy.read_magic(stream)
        shape, _, dtype = npy.read_array_header_1_0(stream)
        content = stream.read(math.prod(shape) * dtype.itemsize)
        found.append(np.frombuffer(content, dtype).reshape(shape).copy())
        stream.seek(-stream.tell() % ALIGN, io.SEEK_CUR)
    about = json.loads(found[0].tobytes())
    return Saved(about, dict(zip(about["arrays"], found[1:], strict=True)))


def join(saved: Saved, lie: Callable[[int, bytes], bytes] = lambda k, header: header) -> bytes:
    """Join parts to a file. lie : changes the header of the k-th array"""
    head = np.frombuffer(json.dumps(saved.about).encode(), np.uint8)
    out = io.BytesIO()
    for k, array in enumerate((head, *saved.arrays.values())):
        header = io.BytesIO()
        npy.write_array_header_1_0(header, npy.header_data_from_array_1_0(array))
        out.write(lie(k, header.getvalue()))
        out.write(np.ascontiguousarray(array).tobytes())
        out.write(bytes(-out.tell() % ALIGN))
    return out.getvalue() + bytes(ALIGN)


def copied(saved: Saved) -> Saved:
    return Saved(json.loads(json.dumps(saved.about)), {name: array.copy() for name, array in saved.arrays.items()})
