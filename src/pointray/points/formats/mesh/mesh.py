"""Meshes, through trimesh: OBJ, STL, glTF and OFF. Points are their vertices, or scattered on their triangles."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ....extras import require
from .._source import MAYBE, NO, SURE, Chunk, Format, Listing, Request, Source
from ..ply._header import read_header

STL_HEADER, TRIANGLE = 84, 50  # bytes of binary STL
OBJ_LINE = re.compile(rb"(v|vn|vt|vp|f|l|p|o|g|s|mtllib|usemtl)[ \t]")
VERTEX = re.compile(rb"^\s*v[ \t]+[-+.\d]\S*[ \t]+[-+.\d]\S*[ \t]+[-+.\d]", re.MULTILINE)
BYTES = {"stl": 100, "obj": 80, "off": 80, "glb": 36, "gltf": 24, "ply": 36}  # of a file for a vertex, about
FACTOR = {"stl": 14, "obj": 12, "off": 20, "glb": 22, "gltf": 22, "ply": 20}  # bytes that trimesh takes for one of them


def recognise(head: bytes, path: Path) -> int:
    """Whether a file is one of these."""
    return SURE if kind_of(head, path) else MAYBE if _may_be_stl(head, path) else NO


def kind_of(head: bytes, path: Path) -> str:
    """Which of them a file is for certain, in trimesh's words; "" for none."""
    suffix = path.suffix.lower()
    if head.startswith(b"glTF"):
        return "glb"
    start = head.lstrip(b"\xef\xbb\xbf \t\r\n")
    if start.startswith(b"{") and (suffix == ".gltf" or re.search(rb'"(asset|accessors|bufferViews)"\s*:', head)):
        return "gltf"
    if re.match(rb"(#[^\n]*\s+)*C?OFF\s", start):
        return "off"
    if re.match(rb"solid\b[^\n]*\s+(facet\s|endsolid)", start):
        return "stl"
    first = next((line for line in start.splitlines() if line.strip() and not line.lstrip().startswith(b"#")), b"")
    if OBJ_LINE.match(first.lstrip()) and (suffix == ".obj" or VERTEX.search(head)):
        return "obj"
    return "obj" if suffix == ".obj" and not first and start.startswith(b"#") else ""


def _may_be_stl(head: bytes, path: Path) -> bool:
    return path.suffix.lower() == ".stl" and (len(head) >= STL_HEADER or head.lstrip().startswith(b"solid"))


class MeshSource(Source):
    """The vertices of a mesh, or points on its triangles; ValueError says what is wrong with its contents."""

    def __init__(self, path: Path, request: Request, kind: str = "") -> None:
        self._path, self._sample = path, request.sample
        with path.open("rb") as file:
            head = file.read(1 << 12)
        self._kind = kind or kind_of(head, path) or "stl"
        size = path.stat().st_size
        if self._kind == "stl" and not head.lstrip().startswith(b"solid"):
            _check_stl(head, size)
        expected = request.sample or max(size // BYTES[self._kind], 1)
        self._facts: dict[str, Any] = {"kind": self._kind}
        row = 60 + size * FACTOR[self._kind] // expected
        self.listing = Listing(request.sample, row, expected, facts=self._facts)

    def chunks(self) -> Iterator[Chunk]:
        from ._load import load
        from ._points import scatter, vertices_of

        parts = load(self._path, self._kind)
        self._facts["meshes"] = len(parts)
        self._facts["triangles"] = sum(len(part.faces) for part in parts)
        if self._sample is None:
            yield vertices_of(parts)
        else:
            yield from scatter(parts, self._sample)


def _check_stl(head: bytes, size: int) -> None:
    """ValueError if a binary STL file has not as many bytes as its header says."""
    count = int.from_bytes(head[STL_HEADER - 4 : STL_HEADER], "little")
    need = STL_HEADER + count * TRIANGLE
    if size < STL_HEADER or need > size:
        raise ValueError(f"is cut off: {count:,} triangles of {TRIANGLE} bytes are announced, it has {size:,} bytes")
    if need < size:
        raise ValueError(f"is no STL file: {count:,} triangles are announced, which is {need:,} bytes, it has {size:,}")


def on_triangles(path: Path, request: Request) -> MeshSource:
    """Points on the triangles of a PLY file; ValueError if it cannot hold what its header announces."""
    require("trimesh", "mesh", "--sample")
    with path.open("rb") as file:
        header = read_header(file)
    left = path.stat().st_size - header.size
    for element, count in zip(header.elements, header.counts, strict=True):
        least = sum(1 if header.format == "ascii" else _least(p) for p in element.properties)
        if count * least > left:
            raise ValueError(f"is cut off: {count:,} rows of {element.name!r} are announced, {left:,} bytes are there")
    return MeshSource(path, request, "ply")


def _least(p: Any) -> int:
    return int(np.dtype(p.list_dtype()[0] if hasattr(p, "list_dtype") else p.dtype()).itemsize)


FORMAT = Format(
    "Mesh",
    (".obj", ".stl", ".glb", ".gltf", ".off"),
    recognise,
    MeshSource,
    {
        "positions": "vertices, where the scene of a glTF file puts them; equal ones of triangles are one",
        "normals": "those of the file, or of the triangles",
        "colors": "of vertices or triangles, of a texture in the file or in its folder, or of the material",
        "attributes": "none",
        "survey": "none",
        "note": "--sample N scatters points on the triangles instead, also on those of PLY",
    },
    extra=("trimesh", "mesh"),
)
