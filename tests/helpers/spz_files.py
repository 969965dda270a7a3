"""SPZ and .splat files."""

import struct

import numpy as np
import pytest

HARMONICS = [0, 3, 8, 15, 24]


def columns(made, version=3, bits=12, degree=0):
    """The columns of an SPZ file, from Niantic's description."""
    n = len(made.xyz)
    if version == 1:
        place = made.xyz.astype("<f2").tobytes()
    else:
        fixed = np.rint(made.xyz * (1 << bits)).astype("<i4")
        place = fixed.view(np.uint8).reshape(n, 3, 4)[:, :, :3].tobytes()
    color = byte((made.harmonic * 0.15 + 0.5) * 255)
    scale = byte((made.scale + 10) * 16)
    turn = b"".join((first_three if version < 3 else smallest_three)(q) for q in made.turn)
    return [place, byte(made.alpha * 255), color, scale, turn, bytes(3 * HARMONICS[degree] * n)]


def byte(values):
    return np.clip(np.rint(values), 0, 255).astype(np.uint8).tobytes()


def first_three(q):
    q = q / np.linalg.norm(q) * (1 if q[0] >= 0 else -1)
    return byte(q[1:] * 127.5 + 127.5)


def smallest_three(q):
    """The place of the largest of x, y, z, w in two bits, and the others: a sign and nine bits."""
    q = np.roll(q / np.linalg.norm(q), -1)
    place = int(np.abs(q).argmax())
    q = q * np.sign(q[place])
    word = place
    for k in range(4):
        if k != place:
            word = (word << 10) | (int(q[k] < 0) << 9) | int(511 * abs(q[k]) * np.sqrt(2) + 0.5)
    return struct.pack("<I", word)


def header(n, version=3, degree=0, bits=12, flags=0):
    return struct.pack("<4sIIBBBB", b"NGSP", version, n, degree, bits, flags, 0)


def plain(made, version=3, degree=0, bits=12, flags=0, n=None):
    """A file of version 1 to 3 before gzip."""
    n = len(made.xyz) if n is None else n
    return header(n, version, degree, bits, flags) + b"".join(columns(made, version, bits, degree))


def packed(made, degree=0, extension=b"", n=None, change=0):
    """A file of version 4; change : what is added to the table's sizes."""
    zstd = pytest.importorskip("backports.zstd")
    parts = [part for part in columns(made, 4, degree=degree) if part]
    small = [zstd.compress(part) for part in parts]
    n = len(made.xyz) if n is None else n
    start = header(n, 4, degree)[:-1] + struct.pack("<BI12x", len(parts), 32 + len(extension)) + extension
    table = b"".join(struct.pack("<QQ", len(s), len(p) + change) for s, p in zip(small, parts, strict=True))
    return start + table + b"".join(small)


def rows(made):
    """A .splat file."""
    out = np.empty(len(made.xyz), [("x", "<f4", 3), ("s", "<f4", 3), ("c", "u1", 4), ("q", "u1", 4)])
    out["x"], out["s"] = made.xyz, np.exp(made.scale)
    out["c"] = np.rint(np.column_stack([made.rgb, made.alpha * 255]))
    unit = made.turn / np.linalg.norm(made.turn, axis=1, keepdims=True)
    out["q"] = np.clip(np.rint(unit * 128 + 128), 0, 255)
    return out.tobytes()
