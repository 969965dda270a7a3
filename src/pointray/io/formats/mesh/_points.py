"""Points of meshes: merged vertices, or points sampled on the triangles."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....base.arrays import Doubles, Flags
from ...colors import GREY
from .._source import CHUNK, Chunk
from ._load import Part, places_of, unit as _unit

SAMPLES = 200_000  # points sampled if the vertices are too sparse
MESHED = 0.9  # minimum fraction of the vertices that belong to triangles
# Maximum edge lengths relative to the square root of the area; NEAR applies next to creases and on textures.
FAR, NEAR = 1 / 6, 1 / 40
CREASE = np.cos(np.radians(30.0))  # angle between triangles that share an edge
MIXED = 0.01  # maximum fraction of edges that triangles on both sides traverse in the same direction
SHARE = 0.05  # maximum fraction of the area covered by triangles with longer edges


def is_coarse(parts: Sequence[Part], shared: bool = False) -> bool:
    """Whether the vertices are too sparse to represent the surface, and fewer than the points sampled instead.

    A smooth surface needs few vertices, as they have normals: 50 for a sphere. Next to creases and on textures the
    spacing becomes visible: a cube needs 3,000. If many vertices belong to no triangle, the file is a point cloud.

    shared : whether the meshes are pieces of one mesh, so that creases between them count
    """
    meshes, vertices = [part for part in parts if len(part.faces)], sum(len(part.positions) for part in parts)
    if vertices >= SAMPLES or sum(len(np.unique(part.faces)) for part in meshes) < MESHED * vertices:
        return False
    crosses = [_crosses(part) for part in meshes]
    areas = np.concatenate([_areas(cross) for cross in crosses])
    edges = np.concatenate([_longest_edges(part) for part in meshes]) / max(float(np.sqrt(areas.sum() / 2)), 1e-300)
    if not _covers(areas, edges > NEAR):
        return False
    textured = np.concatenate([np.full(len(part.faces), part.sample_texture is not None) for part in meshes])
    groups = [meshes] if shared else [[part] for part in meshes]
    near = textured | np.concatenate([_beside_creases(group) for group in groups])
    return _covers(areas, edges > np.where(near, NEAR, FAR))


def _covers(areas: Doubles, some: Flags) -> bool:
    """Whether the selected triangles cover more than 5% of the area. areas, some : (m,), area and selection of each"""
    total = float(areas.sum())
    return bool(0 < total < np.inf) and float(areas[some].sum()) > SHARE * total


def _beside_creases(parts: Sequence[Part]) -> Flags:
    """Return which of the triangles of all meshes meet another one at more than 30 degrees, (m,).

    The order of their corners does not matter. Vertices at the same place count as one.
    """
    starts = np.cumsum([0, *(len(part.positions) for part in parts)])
    corners = np.concatenate([part.faces + start for part, start in zip(parts, starts, strict=False)])
    place = places_of(np.concatenate([part.positions for part in parts]))[1][corners]
    ends = np.sort(np.stack([place, np.roll(place, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    keys = ends[:, 0] * int(starts[-1]) + ends[:, 1]
    order = np.argsort(keys, kind="stable")
    meet = np.flatnonzero(np.diff(keys[order]) == 0)
    one, other = order[meet] // 3, order[meet + 1] // 3
    with np.errstate(all="ignore"):
        normals = _unit(np.concatenate([_crosses(part) for part in parts]))
        folded = np.abs(np.einsum("ij,ij->i", normals[one], normals[other])) < CREASE
    creases = np.zeros(len(corners), np.bool_)
    creases[one[folded]] = creases[other[folded]] = True
    return creases


def _longest_edges(part: Part) -> Doubles:
    """Return the length of each triangle's longest edge, (m,)."""
    corners = part.positions[part.faces]
    with np.errstate(all="ignore"):
        return np.asarray(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1))


def vertices_of(parts: Sequence[Part], shared: bool = False) -> Chunk:
    """Return the vertices of all meshes as one chunk; coinciding vertices of triangles are merged.

    shared : whether the meshes are pieces of one mesh and share vertices
    """
    meshes = [part for part in parts if len(part.faces)]
    if shared and len(meshes) > 1:
        parts = [_united(meshes), *(part for part in parts if not len(part.faces))]
    parts = [_merged(part) if len(part.faces) else part for part in parts]
    positions = np.concatenate([part.positions for part in parts])
    normals = None
    if any(part.normals is not None for part in parts):
        normals = np.concatenate([np.zeros(p.positions.shape) if p.normals is None else p.normals for p in parts])
    return Chunk(_narrow(positions), normals if normals is None else normals.astype(np.float32), _joined(parts))


def _united(parts: Sequence[Part]) -> Part:
    """Concatenate meshes to one, which has normals if all have them."""
    starts = np.cumsum([0, *(len(part.positions) for part in parts)])
    faces = np.concatenate([part.faces + start for part, start in zip(parts, starts, strict=False)])
    normals = [part.normals for part in parts if part.normals is not None]
    whole = np.concatenate(normals) if len(normals) == len(parts) else None
    return Part(np.concatenate([part.positions for part in parts]), faces, whole, _joined(parts))


def _narrow(positions: Doubles) -> NDArray[Any]:
    """Convert to float32 if that is exact, as for files that store float32."""
    with np.errstate(over="ignore", invalid="ignore"):
        narrow = positions.astype(np.float32)
        return narrow if bool(((narrow == positions) | np.isnan(positions)).all()) else positions


def _joined(parts: Sequence[Part]) -> NDArray[Any] | None:
    """Return the colours of the vertices of all meshes, (n, 3), grey where a mesh has none; None if no mesh has any."""
    colors = [
        part.colors if part.sample_texture is None or part.uv is None else part.sample_texture(part.uv)[:, :3]
        for part in parts
    ]
    if all(column is None for column in colors):
        return None
    columns = [
        np.full(p.positions.shape, GREY, np.uint8) if c is None else c for c, p in zip(colors, parts, strict=True)
    ]
    same = len({column.dtype for column in columns}) == 1
    return np.concatenate(columns if same else [_bytes(column) for column in columns])


def _bytes(colors: NDArray[Any]) -> NDArray[np.uint8]:
    return colors if colors.dtype == np.uint8 else np.rint(np.clip(colors, 0, 1) * 255).astype(np.uint8)


def _merged(part: Part) -> Part:
    """Merge coinciding vertices of a mesh; normals are those of the file, or computed from the adjacent triangles."""
    rows = part.positions
    first, inverse = places_of(rows)
    if len(first) == len(rows):
        return part if part.normals is not None else part._replace(normals=_normals_of(part.positions, part.faces))
    order = np.argsort(first)
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    place, chosen = rank[inverse], first[order]
    positions, faces = part.positions[chosen], place[part.faces]
    normals = _normals_of(positions, faces) if part.normals is None else _means(part.normals, place, len(chosen))
    colors, uv = (None if column is None else column[chosen] for column in (part.colors, part.uv))
    return Part(positions, faces, normals, colors, uv, part.sample_texture)


def _normals_of(positions: Doubles, faces: NDArray[np.int64]) -> Doubles | None:
    """Return mean normals of the triangles at each vertex, (n, 3).

    Return None if neighbouring triangles face opposite ways, so that their normals are arbitrary.
    """
    import trimesh

    if _is_mixed(faces, len(positions)):
        return None
    return np.array(trimesh.Trimesh(positions, faces, process=False).vertex_normals)


def _is_mixed(faces: NDArray[np.int64], vertices: int) -> bool:
    """Whether neighbouring triangles are oriented differently: many traverse a shared edge in the same direction.

    faces : (m, 3) vertex indices; vertices : number of vertices
    """
    keys = (faces * vertices + np.roll(faces, -1, axis=1)).reshape(-1)
    return len(np.unique(keys)) < (1 - MIXED) * len(keys)


def _means(normals: Doubles, place: NDArray[np.int64], n: int) -> Doubles:
    """Return the mean direction of the normals at each of n places, (n, 3); a single normal is unchanged.

    normals : (m, 3); place : (m,), index of the place of each normal, from 0 to n - 1
    """
    sums = np.stack([np.bincount(place, column, n) for column in normals.T], axis=1).astype(np.float64)
    several = np.bincount(place, minlength=n) > 1
    lengths = np.linalg.norm(sums, axis=1, keepdims=True)
    np.divide(sums, lengths, out=sums, where=several[:, None] & (lengths > 0))
    return sums


# ------------------------------------------------------------------------------------------------------- scattering


def scatter(parts: Sequence[Part], count: int) -> Iterator[Chunk]:
    """Yield `count` points on the triangles by stratified sampling: one in each of `count` equal parts of the area.

    They are chunks of about 2^18 points with normals and, if the meshes have any, colours.
    """
    parts = [part for part in parts if len(part.faces)]
    crosses = [_crosses(part) for part in parts]
    areas = [_areas(cross) for cross in crosses]
    total = sum(float(area.sum()) for area in areas)
    if not 0 < total < np.inf:
        raise ValueError("has no triangles to sample: read its vertices with --sample 0")
    ends = np.cumsum(np.concatenate(areas))
    starts = np.cumsum([0, *(len(part.faces) for part in parts)])
    random = np.random.default_rng(0)
    for start in range(0, count, CHUNK):
        n = min(CHUNK, count - start)
        at = (np.arange(start, start + n) + random.random(n)) / count * ends[-1]
        triangles = np.minimum(np.searchsorted(ends, at, "right"), np.flatnonzero(np.diff(ends, prepend=0))[-1])
        weights = _weights(random, n)
        cuts = np.searchsorted(triangles, starts)
        pieces = [
            _on(part, triangles[a:b] - starts[k], weights[a:b], crosses[k])
            for k, (part, a, b) in enumerate(zip(parts, cuts, cuts[1:], strict=False))
        ]
        yield _chunk(pieces, parts, (start + n) / count)


def _crosses(part: Part) -> Doubles:
    a, b, c = (part.positions[part.faces[:, k]] for k in range(3))
    with np.errstate(all="ignore"):
        return np.cross(b - a, c - a)


def _areas(crosses: Doubles) -> Doubles:
    """Return twice the areas of triangles, (m,); 0 for those that are not finite.

    crosses : (m, 3), cross product of two edges of each triangle
    """
    return np.nan_to_num(np.linalg.norm(crosses, axis=1), nan=0.0, posinf=0.0)


def _weights(random: np.random.Generator, n: int) -> Doubles:
    """Return random barycentric weights of n points, uniformly distributed over a triangle, (n, 3)."""
    root, share = np.sqrt(random.random(n)), random.random(n)
    return np.stack([1 - root, root * (1 - share), root * share], axis=1)


def _on(part: Part, rows: NDArray[np.int64], weights: Doubles, crosses: Doubles) -> tuple[Any, ...]:
    """Return positions, normals and colours (or None), (n, 3) each, of points on the triangles of a mesh.

    rows : (n,), triangle of each point; weights : (n, 3), its barycentric coordinates
    crosses : (m, 3), cross product of two edges of each triangle
    """
    corners = part.faces[rows]

    def blended(column: NDArray[Any]) -> Doubles:
        return np.einsum("nk,nkc->nc", weights, column[corners].astype(np.float64))

    normals = _unit(crosses[rows])
    if part.normals is not None:
        smooth = _unit(blended(part.normals))
        normals = np.where(np.isfinite(smooth) & smooth.any(axis=1, keepdims=True), smooth, normals)
    colors: NDArray[Any] | None = None
    if part.sample_texture is not None and part.uv is not None:
        colors = part.sample_texture(blended(part.uv))[:, :3]
    elif part.face_colors is not None:
        colors = part.face_colors[rows]
    elif part.colors is not None:
        mixed = blended(part.colors)
        colors = np.rint(mixed).astype(np.uint8) if part.colors.dtype == np.uint8 else mixed
    return blended(part.positions), normals.astype(np.float32), colors


def _chunk(pieces: list[tuple[Any, ...]], parts: Sequence[Part], share: float) -> Chunk:
    positions, normals, colors = zip(*pieces, strict=True)
    joined = None
    if any(part.colors is not None or part.sample_texture is not None for part in parts):
        filled = [
            np.full(p.shape, GREY, np.uint8) if c is None else _bytes(c) for p, c in zip(positions, colors, strict=True)
        ]
        joined = np.concatenate(filled)
    return Chunk(np.concatenate(positions), np.concatenate(normals), joined, {}, share)
