"""Repair of truncated mesh files: text formats, and formats whose header announces counts."""

from __future__ import annotations

import re

import numpy as np

from ....base.arrays import Doubles
from .._counts import missing
from .._source import Faults

STL_HEADER, TRIANGLE = 84, 50  # bytes of binary STL
ROW = np.dtype([("normal", "<f4", 3), ("corners", "<f4", 9), ("attribute", "<u2")])
LARGEST = 1e12  # maximum coordinate of a plausible STL file
NUMBER = rb"[ \t]+[-+]?(?:\d+\.?\d*|\.\d+|nan|inf)(?:e[-+]?\d+)?"
BAD_LINE = re.compile(
    rb"^[ \t]*(?:vn?(?!(?:" + NUMBER + rb"){3,8}[ \t]*(?:#.*)?\r?$)"
    rb"|f(?!(?:[ \t]+-?\d+(?:/-?\d*){0,2})+[ \t]*(?:#.*)?\r?$))[ \t]",
    re.MULTILINE | re.IGNORECASE,
)
RELATIVE = re.compile(rb"^[ \t]*f[ \t][^\n#]*-", re.MULTILINE)
SHORT_FACE = re.compile(rb"^[ \t]*f(?:[ \t]+\S+){0,2}[ \t]*\Z", re.MULTILINE)  # a last line without newline


def whole_text(data: bytes, kind: str, faults: Faults) -> bytes:
    """Return a mesh file without its incomplete end, and with adjusted counts; ValueError if too little is left.

    data : the file; kind : its format, "obj", "off" or "stl"; others are unchanged; faults : records what is missing
    """
    if kind == "obj":
        return _whole_obj(data, faults)
    if kind == "off":
        return _whole_off(data, faults)
    if kind != "stl":
        return data
    return _whole_text_stl(data, faults) if is_text_stl(data, len(data)) else _whole_stl(data)


def _whole_obj(data: bytes, faults: Faults) -> bytes:
    """Remove an incomplete last line of an OBJ file, recorded in `faults`; ValueError for any other invalid line."""
    bad = None if b"\\\n" in data else BAD_LINE.search(data)  # lines continued on the next one are not checked
    if bad is None:
        bad = SHORT_FACE.search(data)
    if bad is None:
        return data
    line = data[bad.start() :].split(b"\n", 1)[0].strip()[:60].decode("latin-1")
    number = data.count(b"\n", 0, bad.start()) + 1
    message = f"line {number:,} is {line!r}"
    if b"\n" in data[bad.start() :].lstrip():
        raise ValueError(message)
    faults.add(f"{message}: it is cut off")
    return data[: bad.start()]


def absolute(data: bytes) -> bytes:
    """Replace negative indices in the faces of an OBJ file; raise ValueError if one refers to no row.

    They count back from the last row before the face, but trimesh counts from the last row of the file.
    """
    if not RELATIVE.search(data):
        return data
    counts = {b"v": 0, b"vt": 0, b"vn": 0}

    def index(text: bytes, count: int) -> bytes:
        if not text.startswith(b"-"):
            return text
        if not 1 <= -int(text) <= count:
            raise ValueError(f"a face has index {int(text):,}, but only {count:,} rows of its kind precede it")
        return b"%d" % (count + 1 + int(text))

    lines = data.replace(b"\r\n", b"\n").replace(b"\\\n", b"").split(b"\n")
    for k, line in enumerate(lines):
        word = next(iter(line.split(None, 1)), b"")
        if word in counts:
            counts[word] += 1
        elif word == b"f" and b"-" in line:
            corners = line.partition(b"#")[0].split()[1:]
            lines[k] = b"f " + b" ".join(b"/".join(map(index, c.split(b"/"), counts.values())) for c in corners)
    return b"\n".join(lines)


def _whole_off(data: bytes, faults: Faults) -> bytes:
    """Adjust the counts of an OFF file to its lines and record missing ones, which trimesh would not notice."""
    head, _, body = re.sub(rb"#[^\n]*", b"", data).partition(b"OFF")
    lines = [line for line in body.splitlines() if line.strip()]
    vertices, faces = (int(word) for word in (lines[0] if lines else b"").split()[:2])
    rows = lines[1:]
    if rows and not data.endswith((b"\n", b"\r")) and _is_short(rows[-1].split(), len(rows) > vertices):
        rows.pop()
    if len(rows) >= vertices + faces:
        return data
    what = f"{vertices:,} vertices and {faces:,} faces"
    faults.add(f"is cut off: {what} expected, more than its {len(lines):,} lines")
    found = min(vertices, len(rows))
    return head + b"OFF\n%d %d 0\n" % (found, len(rows) - found) + b"\n".join(rows) + b"\n"


def off_columns(data: bytes) -> tuple[Doubles | None, Doubles | None]:
    """Return normals and colours, (n, 3) each, of the vertices of an OFF file, which trimesh ignores.

    Either is None if the file lacks it. The letters before OFF list the columns after the coordinates: N normals, C
    colours.
    """
    head, _, body = re.sub(rb"#[^\n]*", b"", data).partition(b"OFF")
    lines = [line.split() for line in body.splitlines() if line.strip()]
    kinds, begin = (head.split() or [b""])[-1], 3
    found: list[Doubles | None] = []
    for letter in (b"N", b"C"):
        rows = [line[begin : begin + 3] for line in lines[1 : int(lines[0][0]) + 1]] if letter in kinds else []
        whole = len(rows) > 0 and all(len(row) == 3 for row in rows)
        found.append(np.array(rows, np.float64) if whole else None)
        begin += 3 * whole
    return found[0], found[1]


def _is_short(fields: list[bytes], is_face: bool) -> bool:
    """Whether a line of an OFF file lacks numbers of a vertex, or corners of a face.

    fields : words of the line
    """
    return len(fields) < (int(fields[0]) + 1 if is_face and fields[0].isdigit() else 3)


def is_text_stl(head: bytes, size: int) -> bool:
    """Whether an STL file is text, judged by its first bytes and its size in bytes.

    The header of a binary file may also begin with "solid"; then its count matches the size, or it contains zero bytes.
    """
    header = head[:STL_HEADER]
    return header.lstrip().startswith(b"solid") and b"\0" not in header and size != _stl_size(head)


def _stl_size(head: bytes) -> int:
    """Return the bytes of a complete binary STL file with the number of triangles that its first bytes announce."""
    return STL_HEADER + _stl_count(head) * TRIANGLE


def _stl_count(head: bytes) -> int:
    return int.from_bytes(head[STL_HEADER - 4 : STL_HEADER], "little")


def _whole_stl(data: bytes) -> bytes:
    """Return a binary STL file with its complete triangles only, and their number in the header."""
    rows = min(_stl_count(data), (len(data) - STL_HEADER) // TRIANGLE)
    return data[: STL_HEADER - 4] + rows.to_bytes(4, "little") + data[STL_HEADER : STL_HEADER + rows * TRIANGLE]


def check_stl(head: bytes, size: int, faults: Faults) -> None:
    """Compare the size of a binary STL file with its header; a difference is recorded in `faults`.

    Raise ValueError if the file is probably not STL.

    head : first bytes of the file; size : of the file in bytes
    """
    count, need = _stl_count(head), _stl_size(head)
    if need == size and size >= STL_HEADER:
        return
    message = f"is cut off: {count:,} triangles of {TRIANGLE} bytes expected, {size:,} bytes found"
    if need < size:
        message = f"is not a valid STL file: expected {count:,} triangles or {need:,} bytes, found {size:,}"
    if count == 0 or not _are_triangles(head):
        raise ValueError(message)
    there = (size - STL_HEADER) // TRIANGLE
    faults.add(message if need < size else f"{message}: {missing(count, there)}")


def _are_triangles(head: bytes) -> bool:
    """Whether the first triangles of a binary STL file have finite corners, and normals of length 1 or 0.

    head : first bytes of the file
    """
    rows = np.frombuffer(head, ROW, max(len(head) - STL_HEADER, 0) // TRIANGLE, STL_HEADER)
    with np.errstate(all="ignore"):
        lengths = np.linalg.norm(rows["normal"].astype(np.float64), axis=1)
        plausible = (np.abs(rows["corners"]) < LARGEST).all(axis=1) & ((np.abs(lengths - 1) < 0.1) | (lengths == 0))
    return len(rows) > 0 and bool(plausible.all())


def _whole_text_stl(data: bytes, faults: Faults) -> bytes:
    if re.search(rb"\bendsolid\b", data, re.IGNORECASE):
        return data
    faults.add("is cut off: endsolid not found at its end")
    ends = [found.end() for found in re.finditer(rb"\bendfacet\b", data, re.IGNORECASE)]
    return data[: ends[-1] if ends else 0] + b"\nendsolid\n"
