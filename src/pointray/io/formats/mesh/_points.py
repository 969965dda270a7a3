"""Meshes -> points: their vertices, each place once, or points scattered on their triangles."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...colors import GREY
from .._source import CHUNK, Chunk
from ._load import Part, places_of
from ._load import unit as _unit

SAMPLES = 200_000  # points on a mesh whose vertices do not show its surface
MESHED = 0.9  # share of the vertices of a mesh that its triangles have, at least
# The longest edges in units of the square root of the area; NEAR counts beside creases and where there is a texture.
FAR, NEAR = 1 / 6, 1 / 40
CREASE = np.cos(np.radians(30.0))  # between triangles that meet at an edge
MIXED = 0.01  # share of edges that triangles on both sides run along in one direction: they are in no order
SHARE = 0.05  # of the area, that may be covered by triangles with longer edges


def is_coarse(parts: Sequence[Part], shared: bool = False) -> bool:
    """Whether vertices are too far apart to show the surface, and fewer than the samples that would be taken instead.

    A smooth surface needs few vertices, as they have normals: a sphere, 50. Beside creases, and where there is a
    texture, their spacing shows: a cube needs 3,000. Vertices of no triangle make a point cloud, which is not sampled.
    """
    meshes, vertices = [part for part in parts if len(part.faces)], sum(len(part.positions) for part in parts)
    if vertices >= SAMPLES or sum(len(np.unique(part.faces)) for part in meshes) < MESHED * vertices:
        return False
    crosses = [_crosses(part) for part in meshes]
    areas = np.concatenate([_areas(cross) for cross in crosses])
    edges = np.concatenate([_longest_edges(part) for part in meshes]) / max(float(np.sqrt(areas.sum() / 2)), 1e-300)
    if not _covers(areas, edges > NEAR):
        return False
    textured = np.concatenate([np.full(len(part.faces), part.paint is not None) for part in meshes])
    groups = [meshes] if shared else [[part] for part in meshes]
    near = textured | np.concatenate([_beside_creases(group) for group in groups])
    return _covers(areas, edges > np.where(near, NEAR, FAR))


def _covers(areas: NDArray[np.float64], some: NDArray[np.bool_]) -> bool:
    """Whether some of the triangles have more than their share of the area."""
    total = float(areas.sum())
    return bool(0 < total < np.inf) and float(areas[some].sum()) > SHARE * total


def _beside_creases(parts: Sequence[Part]) -> NDArray[np.bool_]:
    """Whether a triangle of meshes meets another at an angle, whatever the order of their corners."""
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


def _longest_edges(part: Part) -> NDArray[np.float64]:
    """The length of each triangle's longest edge."""
    corners = part.positions[part.faces]
    with np.errstate(all="ignore"):
        return np.asarray(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1))


def vertices_of(parts: Sequence[Part], shared: bool = False) -> Chunk:
    """The vertices of all meshes; those of triangles that lie in one place are one.

    shared : whether the meshes are pieces of one, whose vertices they share
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
    """Several meshes as one."""
    starts = np.cumsum([0, *(len(part.positions) for part in parts)])
    faces = np.concatenate([part.faces + start for part, start in zip(parts, starts, strict=False)])
    normals = [part.normals for part in parts if part.normals is not None]
    whole = np.concatenate(normals) if len(normals) == len(parts) else None
    return Part(np.concatenate([part.positions for part in parts]), faces, whole, _joined(parts))


def _narrow(positions: NDArray[np.float64]) -> NDArray[Any]:
    """As float32 if that changes nothing, as in files that have it."""
    with np.errstate(over="ignore", invalid="ignore"):
        narrow = positions.astype(np.float32)
        return narrow if bool(((narrow == positions) | np.isnan(positions)).all()) else positions


def _joined(parts: Sequence[Part]) -> NDArray[Any] | None:
    """The colours of all vertices; None if no mesh has any."""
    colors = [part.colors if part.paint is None or part.uv is None else part.paint(part.uv)[:, :3] for part in parts]
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
    """The same triangles with each place once, and with normals: the file's, or those of the triangles around."""
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
    return Part(positions, faces, normals, colors, uv, part.paint)


def _normals_of(positions: NDArray[np.float64], faces: NDArray[np.int64]) -> NDArray[np.float64] | None:
    """Means of the triangles around; None if their corners run either way, so that means say nothing."""
    import trimesh

    if _is_mixed(faces, len(positions)):
        return None
    return np.array(trimesh.Trimesh(positions, faces, process=False).vertex_normals)


def _is_mixed(faces: NDArray[np.int64], vertices: int) -> bool:
    """Whether neighbouring triangles run along many of their common edges in the same direction."""
    keys = (faces * vertices + np.roll(faces, -1, axis=1)).reshape(-1)
    return len(np.unique(keys)) < (1 - MIXED) * len(keys)


def _means(normals: NDArray[np.float64], place: NDArray[np.int64], n: int) -> NDArray[np.float64]:
    """The mean direction of the rows of each place; where there is one row only, as it is."""
    sums = np.stack([np.bincount(place, column, n) for column in normals.T], axis=1).astype(np.float64)
    several = np.bincount(place, minlength=n) > 1
    lengths = np.linalg.norm(sums, axis=1, keepdims=True)
    np.divide(sums, lengths, out=sums, where=several[:, None] & (lengths > 0))
    return sums


# ------------------------------------------------------------------------------------------------------- scattering


def scatter(parts: Sequence[Part], count: int) -> Iterator[Chunk]:
    """So many points on the triangles, by area, evenly: one in each of as many equal shares of all area."""
    parts = [part for part in parts if len(part.faces)]
    crosses = [_crosses(part) for part in parts]
    areas = [_areas(cross) for cross in crosses]
    total = sum(float(area.sum()) for area in areas)
    if not 0 < total < np.inf:
        raise ValueError("has no triangles to scatter points on: read its vertices, with --sample 0")
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


def _crosses(part: Part) -> NDArray[np.float64]:
    a, b, c = (part.positions[part.faces[:, k]] for k in range(3))
    with np.errstate(all="ignore"):
        return np.cross(b - a, c - a)


def _areas(crosses: NDArray[np.float64]) -> NDArray[np.float64]:
    """Twice the triangles' areas; 0 of those that are not finite."""
    return np.nan_to_num(np.linalg.norm(crosses, axis=1), nan=0.0, posinf=0.0)


def _weights(random: np.random.Generator, n: int) -> NDArray[np.float64]:
    """Weights of the corners, even over a triangle, (n, 3)."""
    root, share = np.sqrt(random.random(n)), random.random(n)
    return np.stack([1 - root, root * (1 - share), root * share], axis=1)


def _on(
    part: Part, rows: NDArray[np.int64], weights: NDArray[np.float64], crosses: NDArray[np.float64]
) -> tuple[Any, ...]:
    """Positions, normals and colours (or None) on the triangles of a part."""
    corners = part.faces[rows]

    def blended(column: NDArray[Any]) -> NDArray[np.float64]:
        return np.einsum("nk,nkc->nc", weights, column[corners].astype(np.float64))

    normals = _unit(crosses[rows])
    if part.normals is not None:
        smooth = _unit(blended(part.normals))
        normals = np.where(np.isfinite(smooth) & smooth.any(axis=1, keepdims=True), smooth, normals)
    colors: NDArray[Any] | None = None
    if part.paint is not None and part.uv is not None:
        colors = part.paint(blended(part.uv))[:, :3]
    elif part.face_colors is not None:
        colors = part.face_colors[rows]
    elif part.colors is not None:
        mixed = blended(part.colors)
        colors = np.rint(mixed).astype(np.uint8) if part.colors.dtype == np.uint8 else mixed
    return blended(part.positions), normals.astype(np.float32), colors


def _chunk(pieces: list[tuple[Any, ...]], parts: Sequence[Part], share: float) -> Chunk:
    positions, normals, colors = zip(*pieces, strict=True)
    joined = None
    if any(part.colors is not None or part.paint is not None for part in parts):
        filled = [
            np.full(p.shape, GREY, np.uint8) if c is None else _bytes(c) for p, c in zip(positions, colors, strict=True)
        ]
        joined = np.concatenate(filled)
    return Chunk(np.concatenate(positions), np.concatenate(normals), joined, {}, share)
