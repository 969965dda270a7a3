"""PLY files of Gaussian splats: as training writes them, and compressed."""

import numpy as np
from plyfile import PlyData, PlyElement

NAMES = ["x", "y", "z", "nx", "ny", "nz", *(f"f_dc_{k}" for k in range(3)), *(f"f_rest_{k}" for k in range(9))]
NAMES += ["opacity", *(f"scale_{k}" for k in range(3)), *(f"rot_{k}" for k in range(4))]


def trained(made, without=(), dtype="f4", **more):
    """The vertices that training writes."""
    n = len(made.xyz)
    zeros = np.zeros((n, 3))
    columns = [*made.xyz.T, *zeros.T, *made.harmonic.T, *np.ones((9, n)), made.opacity, *made.scale.T, *made.turn.T]
    named = {name: c.astype(dtype) for name, c in zip(NAMES, columns, strict=True) if name not in without} | more
    rows = np.empty(n, [(name, column.dtype) for name, column in named.items()])
    for name, column in named.items():
        rows[name] = column
    return PlyElement.describe(rows, "vertex")


def save(path, *elements, text=False, order="<"):
    PlyData(list(elements), text, order).write(str(path))
    return path


BOX = [f"{end}_{name}" for part in ("xyz", "rgb") for end in ("min", "max") for name in part]

BOX[6:6] = [f"{end}_scale_{name}" for end in ("min", "max") for name in "xyz"]


def packed(made, shades=True, chunks=None, names=None, harmonics=True):
    """A compressed file of splats, from PlayCanvas's description."""
    n = len(made.xyz)
    words, boxes = np.empty((n, 4), "<u4"), []
    for start in range(0, n, 256):
        rows = slice(start, start + 256)
        box, (x, s, c) = ranges(made, rows, shades)
        boxes.append(box)
        words[rows, 0] = bits(x, (11, 10, 11))
        words[rows, 1] = [quaternion(q) for q in made.turn[rows]]
        words[rows, 2] = bits(s, (11, 10, 11))
        words[rows, 3] = bits(np.column_stack([c, made.alpha[rows]]), (8, 8, 8, 8))
    table = [f"property float {name}" for name in BOX[: 18 if shades else 12]]
    lines = ["ply", "format binary_little_endian 1.0", "comment made by hand"]
    lines += [f"element chunk {len(boxes) if chunks is None else chunks}", *table, f"element vertex {n}"]
    lines += [f"property uint packed_{name}" for name in names or ("position", "rotation", "scale", "color")]
    lines += [f"element sh {n}", *(f"property uchar f_rest_{k}" for k in range(9))] if harmonics else []
    body = np.array(boxes, "<f4").tobytes() + words.tobytes() + (bytes(9 * n) if harmonics else b"")
    return "\n".join([*lines, "end_header", ""]).encode() + body


def ranges(made, rows, shades):
    """The box of a chunk, and the shares between its least and greatest values."""
    values = [made.xyz[rows], made.scale[rows], 0.5 + 0.28209479177387814 * made.harmonic[rows]]
    if not shades:
        ends = [*((v.min(axis=0), v.max(axis=0)) for v in values[:2]), (np.zeros(3), np.ones(3))]
    else:
        ends = [(v.min(axis=0), v.max(axis=0)) for v in values]
    box = np.concatenate([e for pair in ends for e in pair])[: 18 if shades else 12]
    shares = [
        np.clip((v - low) / np.maximum(high - low, 1e-9), 0, 1) for v, (low, high) in zip(values, ends, strict=True)
    ]
    return box, shares


def bits(shares, widths):
    word = np.zeros(len(shares), np.uint32)
    for column, width in zip(shares.T, widths, strict=True):
        word = (word << np.uint32(width)) | np.rint(column * ((1 << width) - 1)).astype(np.uint32)
    return word


def quaternion(q):
    """The place of the largest of w, x, y, z, and the others in 10 bits."""
    q = q / np.linalg.norm(q)
    place = int(np.abs(q).argmax())
    q = q * np.sign(q[place])
    word = place
    for k in range(4):
        if k != place:
            word = (word << 10) | round((q[k] * np.sqrt(0.5) + 0.5) * 1023)
    return word
