"""How many points a file's own header announces, by parsers that know nothing else."""

from __future__ import annotations

import gzip
import io
import math
import re
import struct
import zipfile
from collections.abc import Sequence
from contextlib import suppress

from numpy.lib import format as npy

from attack.byte_changes import PAGE

Counts = Sequence[int]  # the counts that are right; empty: nothing is announced


def told(kind: str, name: str, data: bytes) -> Counts:
    """The counts that may be read from a file, which was accepted."""
    if kind in ("las", "laz", "copc") and data[:4] == b"LASF":
        return _las(data)
    if kind == "kitti":
        return (len(data) // 16, len(data) // 20, len(data) // 24)
    if kind == "colmap" and not data.startswith(b"#"):
        return struct.unpack_from("<Q", data)
    if kind == "splat":
        return (len(data) // 32,)
    if kind == "spz":
        plain = gzip.decompress(data)[:16] if data[:2] == b"\x1f\x8b" else data
        return struct.unpack_from("<I", plain, 8)
    if kind in ("ply", "gaussians") and data[:3] == b"ply":
        return _words(data, rb"^\s*element\s+vertex\s+(\S+)")
    if kind == "pcd":
        return _words(data, rb"^\s*POINTS\s+(\S+)")
    if kind == "npy" and data[:6] == b"\x93NUMPY":
        return _array(data)
    if kind == "npz":
        with suppress(Exception), zipfile.ZipFile(io.BytesIO(data)) as archive:  # names and headers that are damaged
            return _array(archive.read("positions.npy"))
    if kind == "e57":
        xml = _xml(data)
        count = sum(int(found) for found in re.findall(rb'recordCount="(\d+)"', xml))
        return range(count, 0, -1) if b"InvalidState" in xml else (count,)  # rows that say so are left out
    if kind == "off":  # equal vertices are one
        found = re.search(rb"^\s*OFF\s+(\d+)\s", data)
        return range(int(found[1]), 0, -1) if found else ()
    return ()


def _las(data: bytes) -> Counts:
    (legacy,) = struct.unpack_from("<I", data, 107)
    newer = struct.unpack_from("<Q", data, 247)[0] if data[25] >= 4 else 0
    return (newer or legacy,)


def _xml(data: bytes) -> bytes:
    """What an E57 file says of itself, without the checksums between."""
    start, length = struct.unpack_from("<QQ", data, 24)
    plain = b"".join(data[at : at + PAGE - 4] for at in range(0, len(data), PAGE))
    start -= 4 * (start // PAGE)
    return plain[start : start + length]


def _array(data: bytes) -> Counts:
    """Rows of an array: the last axis is a row's columns, unless they have names. Empty if NumPy refuses it."""
    with suppress(ValueError), io.BytesIO(data) as stream:
        version = npy.read_magic(stream)
        shape, _, dtype = (npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0)(stream)
        return (math.prod(shape if dtype.names else shape[:-1]),)
    return ()


def _words(data: bytes, pattern: bytes) -> Counts:
    found = re.findall(pattern, data[:4096], re.MULTILINE)
    return tuple(int(word) for word in found if word.isdigit())
