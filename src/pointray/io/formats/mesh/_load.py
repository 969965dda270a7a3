"""Meshes read with trimesh: checks before reading, and conversion of the result."""

from __future__ import annotations

import io
import logging
import re
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from ....base.arrays import Doubles
from ....base.memory import check_memory
from ....cloud.points import check_count
from ...colors import ColorRange, to_shades
from .._source import Faults
from ._gltf import UnsupportedError, readable
from ._text import absolute, is_text_stl, off_columns, whole_text

USED = re.compile(rb"^[ \t]*usemtl[ \t]+(.*?)[ \t]*\r?$", re.MULTILINE)


class Part(NamedTuple):
    """A mesh, or points without triangles.

    Attributes
    ----------
    positions : (n, 3) float64
    faces : (m, 3) int64
        Vertex indices of triangles.
    normals : (n, 3) float64 or None
        Normals stored in the file.
    colors : (n, 3) uint8 or floats, or None
        Colours of the vertices.
    uv : (n, 2) float64 or None
        Texture coordinates of the vertices.
    sample_texture : callable or None
        Texture lookup: (k, 2) texture coordinates -> (k, 4) uint8 colours.
    face_colors : (m, 3) uint8 or None
        Colours of the triangles; `colors` are then their means.
    """

    positions: Doubles
    faces: NDArray[np.int64]
    normals: Doubles | None = None
    colors: NDArray[Any] | None = None
    uv: Doubles | None = None
    sample_texture: Callable[[Doubles], NDArray[np.uint8]] | None = None
    face_colors: NDArray[np.uint8] | None = None


def counts_of(parts: list[Part]) -> tuple[int, int]:
    """Return the numbers of vertices and triangles of all meshes together."""
    return sum(len(part.positions) for part in parts), sum(len(part.faces) for part in parts)


def load(path: Path, kind: str, faults: Faults) -> list[Part]:
    """Read the meshes of a file with trimesh, placed by its scene graph; raise ValueError if it is damaged.

    kind : format of the file in trimesh's words, such as "glb"; faults : records what is cut off or missing
    """
    logging.getLogger("trimesh").addHandler(logging.NullHandler())  # otherwise its log goes to stderr
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            beside = _resolver_of(path)
            parts = _load_obj(path, beside, faults) if kind == "obj" else _load_scene(path, kind, beside, faults)
    except UnsupportedError:
        raise
    except ValueError as error:
        raise ValueError(f"is damaged or not a valid {kind} file: {_words(error)}") from error
    except Exception as error:
        raise ValueError(f"is damaged: {_words(error)}") from error
    if not any(len(part.positions) for part in parts):
        raise ValueError("contains no vertices")
    if beside.absent:
        names = ", ".join(repr(name[:80]) for name in dict.fromkeys(beside.absent))
        faults.add(f"refers to {names}, not found in its folder: colors may be missing")
    return parts


def _words(error: Exception) -> str:
    if isinstance(error, ModuleNotFoundError):  # trimesh would guess the encoding of a text with another package
        return "it is neither text nor valid binary data"
    text = " ".join(str(error).split())[:160]
    return text if isinstance(error, ValueError) and text else f"{type(error).__name__} {text}".strip()


def _load_obj(path: Path, beside: Any, faults: Faults) -> list[Part]:
    """Read an OBJ file: its meshes, and the points that are not vertices of any.

    With several materials trimesh makes several meshes, each with only the vertices it uses.

    beside : trimesh's resolver of references to other files
    """
    data = absolute(whole_text(_bytes_of(path, "obj"), "obj", faults))
    if not re.search(rb"^[ \t]*[fl][ \t]", data, re.MULTILINE):
        return [_obj_points(data)]
    if len(set(USED.findall(data))) < 2:
        return _parts_of(data, beside, "obj", maintain_order=True)
    parts = _parts_of(data, beside, "obj")
    return [*parts, _unused_points(_obj_points(data), parts)]


def _obj_points(data: bytes) -> Part:
    """Return all vertices of an OBJ file as points without triangles; trimesh's own reader of them drops normals.

    data : the file
    """
    from trimesh.exchange.obj import load_obj

    lines = re.sub(rb"^[ \t]*[fl][ \t].*$", b"", data.replace(b"\\\n", b""), flags=re.MULTILINE)
    found = load_obj(io.BytesIO(lines), skip_materials=True)
    vertices = np.asarray(found.get("vertices", np.empty((0, 3))), np.float64)
    announced = len(re.findall(rb"^[ \t]*v[ \t]", data, re.MULTILINE))
    if vertices.shape != (announced, 3):
        raise ValueError(f"{announced:,} lines begin with v, but only {len(vertices):,} of them contain a point")
    normals, colors = (
        column if column is not None and column.shape == vertices.shape else None
        for column in (found.get("vertex_normals"), found.get("vertex_colors"))
    )
    return Part(vertices, np.empty((0, 3), np.int64), normals, colors)


def _unused_points(points: Part, parts: list[Part]) -> Part:
    """Return the points that are not vertices of the meshes in `parts`."""
    rows = np.concatenate([part.positions for part in (*parts, points)])
    first, place = places_of(rows)
    used = len(rows) - len(points.positions)
    loose = first[place[used:]] >= used
    normals, colors = (None if column is None else column[loose] for column in (points.normals, points.colors))
    return Part(points.positions[loose], points.faces, normals, colors)


def _bytes_of(path: Path, kind: str) -> bytes:
    """Read a file and return it with all text in UTF-8, as trimesh requires. kind : format in trimesh's words"""
    data = path.read_bytes()
    if kind == "ply":
        end = data.find(b"end_header")
        return bytes(c if c < 128 else 63 for c in data[:end]) + data[end:]
    is_text = kind in ("obj", "off") or (kind == "stl" and is_text_stl(data, len(data)))
    if is_text and not data.isascii():
        try:
            data.decode()
        except UnicodeDecodeError:
            return data.decode("latin-1").encode()
    return data


def _load_scene(path: Path, kind: str, beside: Any, faults: Faults) -> list[Part]:
    """Read the meshes of a file other than OBJ.

    kind : format in trimesh's words; beside : trimesh's resolver of references to other files
    """
    data = _bytes_of(path, kind)
    if kind in ("glb", "gltf"):
        data = readable(data, kind, beside.get, faults)
    return _parts_of(whole_text(data, kind, faults), beside, kind)


def _parts_of(data: bytes, beside: Any, kind: str, **options: Any) -> list[Part]:
    """Return the meshes that trimesh finds in a file, transformed to world coordinates.

    beside : trimesh's resolver of references to other files; kind : format in trimesh's words; options : for its reader
    """
    import trimesh

    scene = trimesh.load_scene(
        io.BytesIO(data), file_type=kind, resolver=beside, allow_remote=False, process=False, **options
    )
    nodes: list[Any] = [scene.graph[name] for name in scene.graph.nodes_geometry]
    placed: list[tuple[Any, Any]] = [(matrix, scene.geometry[name]) for matrix, name in nodes]
    placed = [(matrix, shape) for matrix, shape in placed if np.shape(shape.vertices)[1:] == (3,)]
    count = sum(len(shape.vertices) for _, shape in placed)
    check_count(count)
    check_memory(200 * count, f"for {count:,} vertices")
    parts = [_part(shape, np.asarray(matrix, np.float64)) for matrix, shape in placed]
    if kind != "off":
        return parts
    normals, colors = off_columns(data)
    shades = None if colors is None else to_shades(colors, ColorRange.of([colors]).scale(colors.dtype))
    return [part._replace(normals=normals, colors=shades) for part in parts]


def _resolver_of(path: Path) -> Any:
    """Return a resolver for trimesh of references to other files, which must lie below the folder of `path`.

    Its attribute `absent` lists the names of those not found.
    """
    from trimesh.resolvers import Resolver

    folder = path.resolve().parent

    class FolderResolver(Resolver):
        def __init__(self) -> None:
            self.absent: list[str] = []

        def get(self, name: str) -> bytes:
            file = (folder / unquote(name.strip())).resolve()
            if folder not in file.parents or not file.is_file():
                self.absent.append(name)
                raise FileNotFoundError(f"refers to the file {name[:80]!r}, which is not in its folder")
            return file.read_bytes()

        def keys(self) -> list[str]:
            return []

        def write(self, name: str, data: Any) -> None:
            raise OSError("only reads")

        def namespaced(self, namespace: str) -> Any:
            return self

    return FolderResolver()


def _part(shape: Any, matrix: Doubles) -> Part:
    """Convert a mesh or a point cloud of trimesh, transformed by a (4, 4) matrix."""
    positions = np.asarray(shape.vertices, np.float64)
    faces = np.asarray(getattr(shape, "faces", np.empty((0, 3))), np.int64).reshape(-1, 3)
    if len(faces) and not (0 <= faces.min() and faces.max() < len(positions)):
        raise ValueError(f"a triangle refers to vertex {faces.max():,} of {len(positions):,}")
    normals = np.asarray(shape.vertex_normals, np.float64) if "vertex_normals" in shape._cache else None
    if normals is not None and normals.shape != positions.shape:
        normals = None
    if (matrix != np.eye(4)).any():
        positions = positions @ matrix[:3, :3].T + matrix[:3, 3]
        if normals is not None:
            normals = unit(normals @ _cofactors(matrix[:3, :3]).T)
        if np.linalg.det(matrix[:3, :3]) < 0:  # a reflection reverses the order of corners
            faces = faces[:, ::-1]
    visual: Any = getattr(shape, "visual", None)
    of_faces = np.asarray(visual.face_colors)[:, :3] if getattr(visual, "kind", None) == "face" else None
    return Part(positions, faces, normals, *_colors(shape), of_faces)


def _cofactors(matrix: Doubles) -> Doubles:
    """Return the matrix that transforms normals where the (3, 3) `matrix` transforms points.

    It consists of the cofactors, which also exist for a singular matrix, times the sign of the determinant. So a
    reflection leaves normals on their side of the surface.
    """
    x, y, z = matrix
    return np.stack([np.cross(y, z), np.cross(z, x), np.cross(x, y)]) * (np.sign(np.linalg.det(matrix)) or 1.0)


def unit(vectors: Doubles) -> Doubles:
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.divide(vectors, lengths, out=np.zeros_like(vectors), where=lengths > 0)


def _colors(shape: Any) -> tuple[Any, Any, Any]:
    """Return the colours of the vertices, (n, 3), their texture coordinates, (n, 2), and the texture lookup.

    What a shape lacks is None; it has either colours or a texture.

    shape : mesh or point cloud of trimesh
    """
    visual: Any = getattr(shape, "visual", None)
    kind, n = getattr(visual, "kind", None), len(shape.vertices)
    if kind in ("vertex", "face"):
        colors = np.asarray(shape.colors if kind == "vertex" and not hasattr(shape, "faces") else visual.vertex_colors)
        return (colors[:, :3], None, None) if colors.shape[:1] == (n,) else (None, None, None)
    if kind != "texture":
        return None, None, None
    material, uv = visual.material, visual.uv
    image = getattr(material, "image", None) or getattr(material, "baseColorTexture", None)
    if getattr(image, "format", None) is None:  # trimesh's placeholder rather than an image file
        image = None
    if image is not None and uv is not None and len(uv) == n:
        return None, np.asarray(uv, np.float64)[:, :2], material.to_color
    plain = getattr(material, "baseColorFactor", None)
    if plain is None and "kd" in getattr(material, "kwargs", {}):  # otherwise main_color is trimesh's default grey
        plain = material.main_color
    own = getattr(visual, "vertex_attributes", {}).get("color")
    if own is not None and len(own) == n and own.ndim == 2 and own.shape[1] > 2:
        return _tinted(own[:, :3], plain), None, None
    return None if plain is None else np.tile(np.asarray(plain)[:3], (n, 1)), None, None


def _tinted(colors: NDArray[Any], plain: Any) -> NDArray[np.uint8]:
    """Multiply colours of vertices, 8-bit or from 0 to 1, by the colour of the material.

    plain : 8-bit colour of the material; None: white
    """
    shades = colors / 255 if colors.dtype.kind in "iu" else colors
    factor = 255 if plain is None else np.asarray(plain, np.float64)[:3]
    return np.rint(np.clip(np.nan_to_num(shades * factor), 0, 255)).astype(np.uint8)


def places_of(rows: Doubles) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Find rows of (n, 3) with equal coordinates: return the first row at each place, and the place of each row.

    The first are (k,) row numbers, the second (n,) indices into them. Hashing is ten times as fast as unique rows.
    """
    bits = np.ascontiguousarray(rows + 0.0).view(np.uint64)  # -0 is 0
    keys = np.zeros(len(rows), np.uint64)
    for k in range(3):
        keys = (keys ^ bits[:, k]) * np.uint64(0x9E3779B97F4A7C15)
        keys ^= keys >> np.uint64(29)
    _, first, inverse = np.unique(keys, return_index=True, return_inverse=True)
    if not (bits[first][inverse] == bits).all():  # a hash collision
        _, first, inverse = np.unique(bits.view("V24")[:, 0], return_index=True, return_inverse=True)
    return first, inverse
