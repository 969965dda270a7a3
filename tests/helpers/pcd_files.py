"""PCD files in all encodings."""

import struct

import numpy as np

N = 60

XYZ, NORMALS = np.random.default_rng(5).normal(size=(2, N, 3)).astype(np.float32)

RGB = np.random.default_rng(6).integers(0, 256, (N, 3)).astype(np.uint8)

PACKED = (RGB.astype(np.uint32) * np.array([1 << 16, 1 << 8, 1], np.uint32)).sum(axis=1, dtype=np.uint32)

ENCODINGS = ("ascii", "binary", "binary_compressed")

COLUMNS = {
    **dict(zip("xyz", XYZ.T, strict=True)),
    "rgb": PACKED,
    "normal_x": NORMALS[:, 0],
    "normal_y": NORMALS[:, 1],
    "normal_z": NORMALS[:, 2],
    "ring": (np.arange(N) // 20).astype(np.uint8),
    "label": np.arange(N, dtype=np.int16) - 30,
    "timestamp": 1.7e9 + np.arange(N) / 7,
    "stamp": 2**63 + np.arange(N, dtype=np.uint64),
    "fpfh": np.random.default_rng(7).random((N, 5)).astype(np.float32),
}


def packed_by_lzf(data):
    """Compress by LZF: a slow reference that copies repetitions of three bytes or more."""
    out, literals, seen, at = bytearray(), bytearray(), {}, 0
    while at <= len(data):
        key = data[at : at + 3]
        before = seen.get(key, -1)
        seen[key] = at
        copies = len(key) == 3 and 0 <= before and at - before <= 8192
        if copies or at == len(data):
            for k in range(0, len(literals), 32):
                run = literals[k : k + 32]
                out += bytes([len(run) - 1]) + run
            literals.clear()
        if at == len(data):
            return bytes(out)
        if not copies:
            literals.append(data[at])
            at += 1
            continue
        length, back = 3, at - before - 1
        while length < 264 and at + length < len(data) and data[before + length] == data[at + length]:
            length += 1
        first = min(length - 2, 7)
        out += bytes([first << 5 | back >> 8, *([length - 9] if first == 7 else []), back & 255])
        at += length
    return bytes(out)


def header(columns, encoding, **lines):
    """A header's text; lines : others of a name, or None to leave one out"""
    n = len(next(iter(columns.values())))
    names = ["_" if name.startswith("_") else name for name in columns]
    text = {
        "VERSION": "0.7",
        "FIELDS": " ".join(names),
        "SIZE": " ".join(str(c.dtype.itemsize) for c in columns.values()),
        "TYPE": " ".join({"i": "I", "u": "U", "f": "F"}[c.dtype.kind] for c in columns.values()),
        "COUNT": " ".join(str(c.shape[1] if c.ndim > 1 else 1) for c in columns.values()),
        "WIDTH": n,
        "HEIGHT": 1,
        "VIEWPOINT": "0 0 0 1 0 0 0",
        "POINTS": n,
        "DATA": encoding,
        **lines,
    }
    return "# .PCD v.7\n" + "".join(f"{word} {value}\n" for word, value in text.items() if value is not None)


def body(columns, encoding):
    rows = [c.reshape(len(c), -1).astype(c.dtype.newbyteorder("<")) for c in columns.values()]
    if encoding == "ascii":
        lines = (" ".join(str(v) for row in rows for v in row[k]) for k in range(len(rows[0])))
        return "\n".join(lines).encode() + b"\n"
    if encoding == "binary":
        return b"".join(row[k].tobytes() for k in range(len(rows[0])) for row in rows)
    data = b"".join(row.tobytes() for name, row in zip(columns, rows, strict=True) if not name.startswith("_"))
    packed = packed_by_lzf(data)
    return struct.pack("<II", len(packed), len(data)) + packed


def save(path, columns=COLUMNS, encoding="binary", **lines):
    path.write_bytes(header(columns, encoding, **lines).encode() + body(columns, encoding))
    return path
