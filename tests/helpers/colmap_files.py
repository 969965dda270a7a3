"""Sparse points of COLMAP, text and binary."""

from __future__ import annotations

import struct

import numpy as np

N = 300

XYZ, RGB = np.random.default_rng(3).normal(size=(N, 3)), np.random.default_rng(4).integers(0, 256, (N, 3))

ERRORS, TRACKS = np.random.default_rng(5).random(N), np.random.default_rng(6).integers(0, 12, N)

IDS = np.arange(N, dtype=np.uint64) + np.uint64(1 << 63)

TITLE = """# 3D point list with one line of data per point:
#   POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)
# Number of points: 300, mean track length: 6
"""


def rows():
    return zip(IDS.tolist(), XYZ.tolist(), RGB.tolist(), ERRORS.tolist(), TRACKS.tolist(), strict=True)


def text():
    lines = (
        " ".join(map(str, [point, *xyz, *rgb, error, *range(2 * track)])) for point, xyz, rgb, error, track in rows()
    )
    return (TITLE + "\n".join(lines) + "\n").encode()


def binary(count=N):
    out = [struct.pack("<Q", count)]
    for point, xyz, rgb, error, track in rows():
        out.append(
            struct.pack("<Q3d3BdQ", point, *xyz, *rgb, error, track) + struct.pack(f"<{2 * track}I", *range(2 * track))
        )
    return b"".join(out)


WRITTEN = {"points3D.txt": text, "points3D.bin": binary}
