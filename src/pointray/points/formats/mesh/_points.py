"""Meshes -> points: their vertices, each place once, or points scattered on their triangles."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._source import CHUNK, Chunk
from ._load import Part

GREY = 128  # sRGB of a mesh without colours, beside meshes that have


def vertices_of(parts: Sequence[Part]) -> Chunk:
    """The vertices of all meshes; those of triangles that lie in one place are one."""
    parts = [_merged(part) if len(part.faces) else part for part in parts]
    positions = np.concatenate([part.positions for part in parts])
    normals = None
    if any(part.normals is not None for part in parts):
        normals = np.concatenate([np.zeros(p.positions.shape) if p.normals is None else p.normals for p in parts])
    colors = [part.colors if part.paint is None or part.uv is None else part.paint(part.uv)[:, :3] for part in parts]
    return Chunk(_narrow(positions), normals if normals is None else normals.astype(np.float32), _joined(colors, parts))


def _narrow(positions: NDArray[np.float64]) -> NDArray[Any]:
    """As float32 if that changes nothing, as in files that have it."""
    with np.errstate(over="ignore", invalid="ignore"):
        narrow = positions.astype(np.float32)
        return narrow if bool(((narrow == positions) | np.isnan(positions)).all()) else positions


def _joined(colors: Sequence[NDArray[Any] | None], parts: Sequence[Part]) -> NDArray[Any] | None:
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
    rows = part.positions + 0.0  # -0 is 0
    first, inverse = _places(rows)
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


def _places(rows: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The first row of each place, and the place of each row, through a hash: rows as such take ten times as long."""
    bits = np.ascontiguousarray(rows).view(np.uint64)
    keys = np.zeros(len(rows), np.uint64)
    for k in range(3):
        keys = (keys ^ bits[:, k]) * np.uint64(0x9E3779B97F4A7C15)
        keys ^= keys >> np.uint64(29)
    _, first, inverse = np.unique(keys, return_index=True, return_inverse=True)
    if not (bits[first][inverse] == bits).all():  # two places with one hash
        _, first, inverse = np.unique(bits.view("V24")[:, 0], return_index=True, return_inverse=True)
    return first, inverse


def _normals_of(positions: NDArray[np.float64], faces: NDArray[np.int64]) -> NDArray[np.float64]:
    import trimesh

    return np.array(trimesh.Trimesh(positions, faces, process=False).vertex_normals)


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
    areas = [np.nan_to_num(np.linalg.norm(cross, axis=1), nan=0.0, posinf=0.0) for cross in crosses]
    total = sum(float(area.sum()) for area in areas)
    if not 0 < total < np.inf:
        raise ValueError("has no triangles to scatter points on: read its vertices, without --sample")
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

    normals = _lengthened(crosses[rows])
    if part.normals is not None:
        smooth = _lengthened(blended(part.normals))
        normals = np.where(np.isfinite(smooth) & smooth.any(axis=1, keepdims=True), smooth, normals)
    colors: NDArray[Any] | None = None
    if part.paint is not None and part.uv is not None:
        colors = part.paint(blended(part.uv))[:, :3]
    elif part.colors is not None:
        mixed = blended(part.colors)
        colors = np.rint(mixed).astype(np.uint8) if part.colors.dtype == np.uint8 else mixed
    return blended(part.positions), normals.astype(np.float32), colors


def _lengthened(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.divide(vectors, lengths, out=np.zeros_like(vectors), where=lengths > 0)


def _chunk(pieces: list[tuple[Any, ...]], parts: Sequence[Part], share: float) -> Chunk:
    positions, normals, colors = zip(*pieces, strict=True)
    joined = None
    if any(part.colors is not None or part.paint is not None for part in parts):
        filled = [
            np.full(p.shape, GREY, np.uint8) if c is None else _bytes(c) for p, c in zip(positions, colors, strict=True)
        ]
        joined = np.concatenate(filled)
    return Chunk(np.concatenate(positions), np.concatenate(normals), joined, {}, share)
