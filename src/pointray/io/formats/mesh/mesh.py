"""Meshes, read with trimesh: OBJ, STL, glTF and OFF. Points are the vertices, or sampled on the triangles."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....base.arrays import Doubles
from ....base.extras import require
from ....cloud.georeference import Georeference
from .._source import MAYBE, NO, SURE, Chunk, Faults, Format, Listing, Request, Source
from ..ply._header import read_header
from ._text import STL_HEADER, check_stl, is_text_stl

OBJ_LINE = re.compile(rb"(v|vn|vt|vp|f|l|p|o|g|s|mtllib|usemtl)[ \t]")
VERTEX = re.compile(rb"^\s*v[ \t]+[-+.\d]\S*[ \t]+[-+.\d]\S*[ \t]+[-+.\d]", re.MULTILINE)
BYTES = {"stl": 100, "obj": 80, "off": 80, "glb": 36, "gltf": 24, "ply": 36}  # approximate file size per vertex
FACTOR = {"stl": 14, "obj": 12, "off": 20, "glb": 22, "gltf": 22, "ply": 20}  # memory of trimesh per byte of the file

# Returns positions and triangles of a file, or None if only trimesh can read them.
Surface = Callable[[Path], "tuple[Doubles, NDArray[np.int64]] | None"]


def recognise(head: bytes, path: Path) -> int:
    """Detect mesh files: return `SURE`, `MAYBE` for a file that may be binary STL by its name, or `NO`.

    head : first bytes of the file
    """
    return SURE if kind_of(head, path) else MAYBE if _may_be_stl(head, path) else NO


def kind_of(head: bytes, path: Path) -> str:
    """Return trimesh's name of a file's format, such as "glb"; "" if it is not certain.

    head : first bytes of the file
    """
    suffix = path.suffix.lower()
    if head.startswith(b"glTF"):
        return "glb"
    start = head.lstrip(b"\xef\xbb\xbf \t\r\n")
    if start.startswith(b"{") and (suffix == ".gltf" or re.search(rb'"(asset|accessors|bufferViews)"\s*:', head)):
        return "gltf"
    if re.match(rb"(#[^\n]*\s+)*(ST)?C?N?OFF\s", start):
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
    """Reader of mesh files: the vertices, or points sampled on the triangles."""

    def __init__(self, path: Path, request: Request, kind: str = "") -> None:
        self._path, self._sample, self.faults = path, request.sample, Faults(request.strict)
        with path.open("rb") as file:
            head = file.read(1 << 12)
        self._kind = kind or kind_of(head, path) or "stl"
        size = path.stat().st_size
        if self._kind == "stl" and not is_text_stl(head, size):
            check_stl(head, size, self.faults)
        expected = request.sample or max(size // BYTES[self._kind], 1)
        self._facts: dict[str, Any] = {"kind": self._kind}
        row = 60 + size * FACTOR[self._kind] // expected
        georeference = Georeference(format="glTF" if self._kind in ("glb", "gltf") else None)
        self.listing = Listing(request.sample or None, row, expected, georeference, self._facts)

    def chunks(self) -> Iterator[Chunk]:
        from ._load import counts_of, load
        from ._points import SAMPLES, is_coarse, scatter, vertices_of

        parts = load(self._path, self._kind, self.faults)
        vertices, triangles = counts_of(parts)
        self._facts |= {"meshes": len(parts), "triangles": triangles}
        sample = self._sample
        if sample is None and is_coarse(parts, self._kind == "obj"):
            sample, self.note = SAMPLES, sampled(vertices, triangles)
        if sample:
            yield from scatter(parts, sample)
        else:
            yield vertices_of(parts, self._kind == "obj")


def sampled(vertices: int, triangles: int) -> str:
    """Return the note for the user that points were sampled on a mesh because its vertices are too sparse.

    vertices, triangles : their numbers
    """
    from ._points import SAMPLES

    return (
        f"its {vertices:,} vertices are too sparse: {SAMPLES:,} points are sampled on its "
        f"{triangles:,} triangles; --sample 0 (in Python sample=0) reads the vertices instead"
    )


def ply_source(path: Path, request: Request, surface: Surface) -> MeshSource | None:
    """Return a reader that samples points on the triangles of a PLY file; None if its vertices shall be read.

    Points are sampled if the request says so, or if the vertices are too sparse. Raise ValueError if it says so and the
    file is smaller than its header announces.

    surface : reads vertices and triangles without trimesh, whose import is slow; may return None
    """
    if request.sample is not None:
        require("trimesh", "mesh", "--sample")
        _check_elements(path)
        return MeshSource(path, request, "ply") if request.sample else None
    stamp = path.stat()
    version = stamp.st_size, stamp.st_mtime_ns
    counts = _coarse_ply(path, version, surface) if has_few_vertices(path) and has_trimesh() else None
    if counts is None:
        return None
    from ._points import SAMPLES

    source = MeshSource(path, request._replace(sample=SAMPLES), "ply")
    source.note = sampled(*counts)
    return source


def has_few_vertices(path: Path) -> bool:
    """Whether a PLY file has triangles, and fewer vertices than the 200,000 points that would be sampled on them."""
    from ._points import SAMPLES

    with path.open("rb") as file:
        header = read_header(file)
    counts = {element.name: element.rows for element in header.elements}
    return counts.get("face", 0) > 0 and 0 < counts.get("vertex", 0) < SAMPLES


def has_trimesh() -> bool:
    """Whether trimesh is installed."""
    return find_spec("trimesh") is not None


@lru_cache(maxsize=8)  # a file is opened several times
def _coarse_ply(path: Path, version: tuple[int, int], surface: Surface) -> tuple[int, int] | None:
    """Return the numbers of vertices and triangles of a PLY file whose vertices are too sparse; None for others.

    version : size and modification time of the file, as a cache key
    surface : reads vertices and triangles without trimesh; may return None
    """
    from ._load import Part, counts_of, load
    from ._points import is_coarse

    try:
        _check_elements(path)
        found = surface(path)
        parts = load(path, "ply", Faults(strict=True)) if found is None else [Part(*found)]
    except ValueError:  # its vertices may still be readable
        return None
    return counts_of(parts) if is_coarse(parts) else None


def _check_elements(path: Path) -> None:
    """Raise ValueError if a PLY file is too small for the rows of an element that its header announces."""
    with path.open("rb") as file:
        header = read_header(file)
    left = path.stat().st_size - header.size
    for element in header.elements:
        least = len(element.properties) if header.format == "ascii" else element.least_size
        if element.rows * least > left:
            raise ValueError(f"is cut off: {element.rows:,} rows of {element.name!r} expected, {left:,} bytes found")


FORMAT = Format(
    "Mesh",
    (".obj", ".stl", ".glb", ".gltf", ".off"),
    recognise,
    MeshSource,
    {
        "positions": "vertices, placed by the scene of a glTF file; coinciding vertices of triangles are merged",
        "normals": "from the file, or computed from the triangles",
        "colors": "of vertices or triangles, of a texture in the file or its folder, or of the material",
        "attributes": "none",
        "survey": "none",
        "note": "points are sampled on the triangles if the vertices are too sparse, also for PLY; "
        "--sample N samples N points, --sample 0 reads the vertices",
    },
    extra=("trimesh", "mesh"),
)
