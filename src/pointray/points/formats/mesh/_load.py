"""Meshes as trimesh reads them: what is checked before, and what comes of it."""

from __future__ import annotations

import io
import json
import logging
import re
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from ....data import check_count
from ....memory import check_memory

GLB_HEADER = 20  # bytes before the JSON of a .glb file
PACKERS = re.compile(r"draco|meshopt", re.IGNORECASE)
SIZES = {5120: 1, 5121: 1, 5122: 2, 5123: 2, 5125: 4, 5126: 4}  # bytes of glTF's types
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}


NUMBER = rb"[ \t]+[-+]?(?:\d+\.?\d*|\.\d+|nan|inf)(?:e[-+]?\d+)?"
BAD_LINE = re.compile(
    rb"^[ \t]*(?:vn?(?!(?:" + NUMBER + rb"){3,8}[ \t]*(?:#.*)?\r?$)"
    rb"|f(?!(?:[ \t]+-?\d+(?:/-?\d*){0,2})+[ \t]*(?:#.*)?\r?$))[ \t]",
    re.MULTILINE | re.IGNORECASE,
)


class Part(NamedTuple):
    """A mesh, or points without triangles.

    Attributes
    ----------
    positions : (n, 3) float64
    faces : (m, 3) int64
        Corners of triangles.
    normals : (n, 3) float64 or None
        Those of the file.
    colors : (n, 3) uint8 or floats, or None
    uv : (n, 2) float64 or None
    paint : callable or None
        (k, 2) coordinates of a texture -> (k, 4) uint8 colours.
    """

    positions: NDArray[np.float64]
    faces: NDArray[np.int64]
    normals: NDArray[np.float64] | None = None
    colors: NDArray[Any] | None = None
    uv: NDArray[np.float64] | None = None
    paint: Callable[[NDArray[np.float64]], NDArray[np.uint8]] | None = None


def load(path: Path, kind: str) -> list[Part]:
    """The meshes of a file, each where its scene puts it; ValueError says that it is damaged."""
    logging.getLogger("trimesh").addHandler(logging.NullHandler())  # else what it logs goes to stderr
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            parts = _load_obj(path) if kind == "obj" else _load_scene(path, kind)
    except ValueError as error:
        raise ValueError(f"is damaged or no {kind} file: {_words(error)}") from error
    except Exception as error:
        raise ValueError(f"is damaged: {_words(error)}") from error
    if not any(len(part.positions) for part in parts):
        raise ValueError("holds no vertices")
    return parts


def _words(error: Exception) -> str:
    if isinstance(error, ModuleNotFoundError):  # trimesh would guess the letters of a text with another package
        return "it is neither text nor binary data of its kind"
    text = " ".join(str(error).split())[:160]
    return text if isinstance(error, ValueError) and text else f"{type(error).__name__} {text}".strip()


def _load_obj(path: Path) -> list[Part]:
    """An OBJ file; one without faces is read directly, as a point cloud of trimesh has no normals."""
    from trimesh.exchange.obj import load_obj

    data = _bytes_of(path, "obj")
    _check_lines(data)
    if re.search(rb"^[ \t]*[fl][ \t]", data, re.MULTILINE):
        return _load_scene(path, "obj")
    found = load_obj(io.BytesIO(data), skip_materials=True)
    vertices = np.asarray(found.get("vertices", np.empty((0, 3))), np.float64)
    announced = len(re.findall(rb"^[ \t]*v[ \t]", data, re.MULTILINE))
    if vertices.shape != (announced, 3):
        raise ValueError(f"{announced:,} lines begin with v, {len(vertices):,} of which give a point")
    normals, colors = (
        column if column is not None and column.shape == vertices.shape else None
        for column in (found.get("vertex_normals"), found.get("vertex_colors"))
    )
    return [Part(vertices, np.empty((0, 3), np.int64), normals, colors)]


def _check_lines(data: bytes) -> None:
    """ValueError for the first line of an OBJ file that has not the numbers it should have."""
    bad = None if b"\\\n" in data else BAD_LINE.search(data)  # a line that goes on in the next one is let pass
    if bad is not None:
        line = data[bad.start() :].split(b"\n", 1)[0].strip()[:60].decode("latin-1")
        number = data.count(b"\n", 0, bad.start()) + 1
        raise ValueError(f"line {number:,} is {line!r}")


def _check_off(data: bytes) -> None:
    """ValueError for fewer lines than an OFF file announces: trimesh takes those that are there."""
    lines = [line for line in re.sub(rb"#[^\n]*", b"", data).partition(b"OFF")[2].splitlines() if line.strip()]
    vertices, faces = (int(word) for word in (lines[0] if lines else b"").split()[:2])
    if len(lines) <= vertices + faces:
        what = f"{vertices:,} vertices and {faces:,} faces"
        raise ValueError(f"is cut off: {what} are announced, which is more than {len(lines):,} lines")


def _bytes_of(path: Path, kind: str) -> bytes:
    """The file, with letters beyond ASCII as trimesh wants them: it reads UTF-8 only."""
    data = path.read_bytes()
    if kind == "ply":
        end = data.find(b"end_header")
        return bytes(c if c < 128 else 63 for c in data[:end]) + data[end:]
    is_text = kind in ("obj", "off") or (kind == "stl" and data.lstrip().startswith(b"solid") and b"\0" not in data)
    if is_text and not data.isascii():
        try:
            data.decode()
        except UnicodeDecodeError:
            return data.decode("latin-1").encode()
    return data


def _load_scene(path: Path, kind: str) -> list[Part]:
    import trimesh

    if kind in ("glb", "gltf"):
        _check_gltf(path, kind)
    options: dict[str, Any] = {"process": False} | ({"maintain_order": True} if kind == "obj" else {})
    data = _bytes_of(path, kind)
    if kind == "off":
        _check_off(data)
    file = io.BytesIO(data)
    scene = trimesh.load_scene(file, file_type=kind, resolver=_beside(path), allow_remote=False, **options)
    nodes: list[Any] = [scene.graph[name] for name in scene.graph.nodes_geometry]
    placed: list[tuple[Any, Any]] = [(matrix, scene.geometry[name]) for matrix, name in nodes]
    placed = [(matrix, shape) for matrix, shape in placed if np.shape(shape.vertices)[1:] == (3,)]
    count = sum(len(shape.vertices) for _, shape in placed)
    check_count(count)
    check_memory(200 * count, f"for {count:,} vertices")
    return [_part(shape, np.asarray(matrix, np.float64)) for matrix, shape in placed]


def _beside(path: Path) -> Any:
    """What finds the files that a file names: only below its own folder."""
    from trimesh.resolvers import Resolver

    folder = path.resolve().parent

    class Beside(Resolver):
        def __init__(self) -> None:
            pass

        def get(self, name: str) -> bytes:
            file = (folder / unquote(name.strip())).resolve()
            if folder not in file.parents or not file.is_file():
                raise FileNotFoundError(f"names the file {name[:80]!r}, which is not in its folder")
            return file.read_bytes()

        def keys(self) -> list[str]:
            return []

        def write(self, name: str, data: Any) -> None:
            raise OSError("only reads")

        def namespaced(self, namespace: str) -> Any:
            return self

    return Beside()


def _part(shape: Any, matrix: NDArray[np.float64]) -> Part:
    """A mesh of trimesh, placed by a matrix."""
    positions = np.asarray(shape.vertices, np.float64)
    faces = np.asarray(getattr(shape, "faces", np.empty((0, 3))), np.int64).reshape(-1, 3)
    if len(faces) and not (0 <= faces.min() and faces.max() < len(positions)):
        raise ValueError(f"a triangle names vertex {faces.max():,} of {len(positions):,}")
    normals = np.asarray(shape.vertex_normals, np.float64) if "vertex_normals" in shape._cache else None
    if normals is not None and normals.shape != positions.shape:
        normals = None
    if (matrix != np.eye(4)).any():
        positions = positions @ matrix[:3, :3].T + matrix[:3, 3]
        if normals is not None:
            normals = _unit(normals @ _cofactors(matrix[:3, :3]).T)
        if np.linalg.det(matrix[:3, :3]) < 0:  # a mirror turns the triangles round
            faces = faces[:, ::-1]
    return Part(positions, faces, normals, *_colors(shape))


def _cofactors(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """What turns normals: the inverse transposed, times the determinant, so that a flat matrix will do."""
    x, y, z = matrix
    return np.stack([np.cross(y, z), np.cross(z, x), np.cross(x, y)]) * (np.sign(np.linalg.det(matrix)) or 1.0)


def _unit(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.divide(vectors, lengths, out=np.zeros_like(vectors), where=lengths > 0)


def _colors(shape: Any) -> tuple[Any, Any, Any]:
    """Colours of the vertices; else coordinates of a texture and what looks it up."""
    visual: Any = getattr(shape, "visual", None)
    kind, n = getattr(visual, "kind", None), len(shape.vertices)
    if kind in ("vertex", "face"):
        colors = np.asarray(shape.colors if kind == "vertex" and not hasattr(shape, "faces") else visual.vertex_colors)
        return (colors[:, :3], None, None) if colors.shape[:1] == (n,) else (None, None, None)
    if kind != "texture":
        return None, None, None
    material, uv = visual.material, visual.uv
    image = getattr(material, "image", None) or getattr(material, "baseColorTexture", None)
    if image is not None and uv is not None and len(uv) == n:
        return None, np.asarray(uv, np.float64)[:, :2], material.to_color
    plain = getattr(material, "baseColorFactor", None)
    plain = material.main_color if plain is None and hasattr(material, "diffuse") else plain
    return None if plain is None else np.tile(np.asarray(plain)[:3], (n, 1)), None, None


def _check_gltf(path: Path, kind: str) -> None:
    """ValueError for what would be read as zeros, or would take more memory than the file has bytes."""
    data = path.read_bytes()
    if kind == "glb":
        length = int.from_bytes(data[12:16], "little")
        announced = int.from_bytes(data[8:12], "little")
        if announced > len(data) or length > len(data) - GLB_HEADER:
            raise ValueError(f"is cut off: the header says {max(announced, length):,} bytes, it has {len(data):,}")
        data = data[GLB_HEADER : GLB_HEADER + length]
    tree = json.loads(data)
    packed = [name for name in tree.get("extensionsRequired", ()) if PACKERS.search(name)]
    if packed:
        raise ValueError(f"it is compressed by {packed[0]}: save it without")
    for number, accessor in enumerate(tree.get("accessors", ())):
        need = int(accessor["count"]) * SIZES[accessor["componentType"]] * WIDTHS[accessor["type"]]
        if need < 0 or ("bufferView" not in accessor and need > len(data)):
            raise ValueError(f"accessor {number} is said to have {accessor['count']:,} rows, which are nowhere")
