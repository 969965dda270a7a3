"""COPC files of any size: an octree of points, some levels deep, written with lazrs."""

from __future__ import annotations

import io
import struct
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

Key = tuple[int, int, int, int]


class CopcFile(NamedTuple):
    """A COPC file that was written.

    Attributes
    ----------
    path : Path
    chunks : dict of key to (first byte, size)
        The chunk of each node of the octree, by level, x, y, z.
    pages : list of (first byte, size)
        Pages of the list of nodes.
    start : int
        First byte of the points: size of the header with its records.
    """

    path: Path
    chunks: dict[Key, tuple[int, int]]
    pages: list[tuple[int, int]]
    start: int

    def bytes_of(self, *levels: int) -> int:
        """Return the bytes of all chunks of some levels."""
        return sum(size for key, (_, size) in self.chunks.items() if key[0] in levels)


def write_copc(path: Path, xyz: np.ndarray, levels: int, rng: np.random.Generator, spacing: float = 16.0) -> CopcFile:
    """Write points in a cube from 0 to 1024 as COPC; each level has four times as many points as the one above.

    Nodes are stored in random order. Each node of level 2 has a page of its own, with the nodes below.
    """
    import laspy
    import lazrs

    las = laspy.LasData(laspy.LasHeader(version="1.4", point_format=6))
    las.header.scales = [1 / 64] * 3
    share = 4.0 ** np.arange(levels)
    level = rng.choice(levels, len(xyz), p=share / share.sum())
    cells = (xyz / (1024 / 2.0**level)[:, None]).astype(np.int64)
    keys, which = np.unique(np.column_stack([level, cells]), axis=0, return_inverse=True)
    order = np.argsort(rng.permutation(len(keys))[which.reshape(-1)], kind="stable")
    las.x, las.y, las.z = xyz[order].T
    las.intensity = (np.arange(len(xyz)) % 60_000)[order].astype(np.uint16)
    stream = io.BytesIO()
    las.write(stream)
    plain, rows = stream.getvalue(), las.points.array
    vlr = lazrs.LazVlr.new_for_compression(6, 0, True)
    record = bytes(vlr.record_data())
    first = 375 + 54 + 160 + 54 + len(record)
    data = io.BytesIO()
    data.write(bytes(first))
    compressor, chunks, counts, at = lazrs.LasZipCompressor(data, vlr), {}, {}, first + 8
    groups = np.split(np.arange(len(xyz)), np.flatnonzero(np.diff(which.reshape(-1)[order])) + 1)
    for k, group in enumerate(groups):
        key = tuple(keys[which.reshape(-1)[order[group[0]]]].tolist())
        compressor.compress_many(rows[group].tobytes())
        if k < len(groups) - 1:
            compressor.finish_current_chunk()
            chunks[key], at = (at, data.tell() - at), data.tell()
        counts[key] = len(group)
    compressor.done()
    chunks[key] = at, struct.unpack_from("<q", data.getvalue(), first)[0] - at
    end = len(data.getvalue())
    pages, hierarchy = _pages(chunks, counts, end + 60)
    info = struct.pack("<5d2Q2d", 512, 512, 512, 512, spacing, *pages[0], 0, 0).ljust(160, b"\0")
    out = bytearray(data.getvalue())
    out[:375] = plain[:375]
    out[6] |= 0x10  # the coordinate system, if any, is well-known text
    struct.pack_into("<II", out, 96, first, 2)
    out[104] = plain[104] | 0x80
    struct.pack_into("<QI", out, 235, end, 1)
    out[375:first] = b"".join(
        struct.pack("<H16sHH32s", 0, user, number, len(content), b"") + content
        for user, number, content in ((b"copc", 1, info), (b"laszip encoded", 22204, record))
    )
    out += struct.pack("<H16sHQ32s", 0, b"copc", 1000, len(hierarchy), b"") + hierarchy
    path.write_bytes(out)
    return CopcFile(path, chunks, pages, first)


def _pages(chunks: dict[Key, Any], counts: dict[Key, int], at: int) -> tuple[list[tuple[int, int]], bytes]:
    """Return first byte and size of each page, and the pages: one for levels 0 and 1, one for each node of level 2."""
    below: dict[tuple[int, ...], list[Key]] = {}
    for key in chunks:
        if key[0] > 1:
            below.setdefault(tuple(x >> (key[0] - 2) for x in key[1:]), []).append(key)
    top = [key for key in chunks if key[0] < 2]
    size = 32 * (len(top) + len(below))
    pages, parts, root = [(at, size)], [], b""
    for node, keys in sorted(below.items()):
        part = b"".join(struct.pack("<4iQii", *key, *chunks[key], counts[key]) for key in keys)
        place = pages[-1][0] + pages[-1][1]
        root += struct.pack("<4iQii", 2, *node, place, len(part), -1)
        pages.append((place, len(part)))
        parts.append(part)
    root = b"".join(struct.pack("<4iQii", *key, *chunks[key], counts[key]) for key in top) + root
    return pages, root + b"".join(parts)
