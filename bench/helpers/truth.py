"""Exact reference surfaces: shapes defined by formulas, and meshes ray traced by Embree.

Both kinds provide points for a model, random samples of the surface, the distance of a point to the surface and the
normal there, and the depth of a ray inside the solid.
"""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

import pointray as pr
from pointray.engine.jit import borrow, inline, kernel, next_tile, run
from pointray.procedural_models import area, mesh, solid
from pointray.procedural_models.creases import areas, refine_creases, settled
from pointray.procedural_models.solids import SETTLED, STENCIL, field, settle, slope

Floats = NDArray[np.float64]

DEEP = 0.5  # spacings: a ray that was so far inside the solid must have hit
MESHES = ("bunny", "dragon")
FOLDER = Path(__file__).resolve().parents[3] / "shared" / "models" / "meshes"
ABSENT = "meshes as truth need trimesh and embreex: pip install 'pointray[dev]'"
_TILE = 256


class Truth(Protocol):
    """A surface known exactly."""

    name: str
    area: float

    def points(self, n: int, sampling: str, seed: int) -> tuple[Floats, Floats]:
        """Positions and exact normals, (n, 3) each: "even" (blue noise), "random", or a mesh's vertices."""

    def surface_samples(self, n: int, seed: int) -> Floats:
        """Random points of the surface, uniform in area, (n, 3)."""

    def compare(self, x: Floats) -> tuple[Floats, Floats]:
        """Unsigned distance to the surface, (m,), and the unit normal at its nearest point, (m, 3)."""

    def depth(self, origins: Floats, directions: Floats, ends: Floats, h: float) -> Floats:
        """How deep inside the solid rays get before `ends`, (m,): exact if more than h / 3, else a value below."""


def scattered(corners: Floats, n: int, seed: int) -> Floats:
    """Independent uniform random points of triangles (t, 3, 3): (n, 3)."""
    rng = np.random.default_rng(seed)
    total = np.cumsum(areas(corners))
    a, b, c = corners[np.searchsorted(total, rng.random(n) * total[-1])].transpose(1, 0, 2)
    u, v = np.sqrt(rng.random((n, 1))), rng.random((n, 1))
    return np.asarray((1 - u) * a + u * (1 - v) * b + u * v * c)


# ------------------------------------------------------------------------------------------------- shapes by formula


@kernel
def _normals(work, solid, x, normals):  # type: ignore[no-untyped-def]
    """Exact normals at the surface next to each x, which is moved along the gradient of the field first."""
    t = next_tile(work)
    while t >= 0:
        for i in range(t * _TILE, min((t + 1) * _TILE, x.shape[0])):
            p, q, r, _ = settle(solid, x[i, 0], x[i, 1], x[i, 2], 8, SETTLED)
            u, v, w = slope(solid, p, q, r, STENCIL)
            length = max(np.sqrt(u * u + v * v + w * w), 1e-300)
            normals[i, 0], normals[i, 1], normals[i, 2] = u / length, v / length, w / length
        t = next_tile(work)


@kernel
def _march(work, solid, rays, spans, floor, where):  # type: ignore[no-untyped-def]
    """Find the least value of the field along rays (origins, directions) within spans (n, 2); where : t, value."""
    origins, directions = rays
    t = next_tile(work)
    while t >= 0:
        for i in range(t * _TILE, min((t + 1) * _TILE, spans.shape[0])):
            s, least, at = spans[i, 0], np.inf, 0.0
            while s < spans[i, 1]:
                x, y, z = origins[i, 0], origins[i, 1], origins[i, 2]
                f = field(solid, x + s * directions[i, 0], y + s * directions[i, 1], z + s * directions[i, 2])
                if f < least:
                    least, at = f, s
                s += max(0.7 * abs(f), floor)
            where[i, 0], where[i, 1] = at, least
        t = next_tile(work)


class Shape:
    """A shape by formula: sphere, torus, lattice or statue."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.area = {"sphere": 4 * np.pi, "torus": 1.6 * np.pi**2}.get(name) or area(name)
        self._solid = solid(name)
        vertices = mesh(name)[0]
        self._box = np.stack([vertices.min(axis=0), vertices.max(axis=0)])

    def points(self, n: int, sampling: str, seed: int) -> tuple[Floats, Floats]:
        """Even points are those of `pr.procedural`, random ones those of `surface_samples`."""
        if sampling == "even":
            positions = pr.procedural(self.name, n, seed).positions.astype(np.float64)
        else:
            positions = self.surface_samples(n, seed)
        return positions, self._normals(positions)

    def surface_samples(self, n: int, seed: int) -> Floats:
        """Random points of the mesh that even points are chosen from, moved onto the surface."""
        return settled(self._solid, scattered(refine_creases(self._solid, *mesh(self.name), n), n, seed))

    def compare(self, x: Floats) -> tuple[Floats, Floats]:
        """The distance is `pr.procedural_distance`, the normal the gradient of the field."""
        return np.abs(pr.procedural_distance(self.name, x)), self._normals(x)

    def depth(self, origins: Floats, directions: Floats, ends: Floats, h: float) -> Floats:
        """Rays march by 0.7 of the field's value; the exact distance is evaluated around its minimum."""
        with np.errstate(divide="ignore", invalid="ignore"):
            sides = (self._box[:, None] - origins) / directions
        spans = np.stack([np.fmin(*sides).max(axis=1), np.minimum(np.fmax(*sides).min(axis=1), ends)], axis=1)
        where = np.empty_like(spans)
        run(_march, -(-len(ends) // _TILE), self._solid, (origins, directions), spans, 0.15 * h, where)
        depth = np.zeros(len(ends))
        some = np.flatnonzero(where[:, 1] < -DEEP / 1.5 * h)
        if len(some):
            t = where[some, :1] + h * np.array([-0.5, -0.25, 0, 0.25, 0.5])
            t = np.minimum(t, ends[some, None])
            x = origins[some, None] + t[..., None] * directions[some, None]
            depth[some] = -pr.procedural_distance(self.name, x).min(axis=1)
        return depth

    def _normals(self, x: Floats) -> Floats:
        normals = np.empty(x.shape)
        run(_normals, -(-len(x) // _TILE), self._solid, np.ascontiguousarray(x), normals)
        return normals


# ------------------------------------------------------------------------------------------------------------ meshes


@inline
def _dot(a, b):  # type: ignore[no-untyped-def]
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inline
def _on_triangle(corners, x):  # type: ignore[no-untyped-def]
    """Weights of the second and third corner at the triangle's point nearest to x (Ericson 2005, 5.1.5)."""
    a = (corners[0, 0], corners[0, 1], corners[0, 2])
    ab = (corners[1, 0] - a[0], corners[1, 1] - a[1], corners[1, 2] - a[2])
    ac = (corners[2, 0] - a[0], corners[2, 1] - a[1], corners[2, 2] - a[2])
    ap = (x[0] - a[0], x[1] - a[1], x[2] - a[2])
    d1, d2 = _dot(ab, ap), _dot(ac, ap)
    if d1 <= 0.0 and d2 <= 0.0:
        return 0.0, 0.0
    bp = (ap[0] - ab[0], ap[1] - ab[1], ap[2] - ab[2])
    d3, d4 = _dot(ab, bp), _dot(ac, bp)
    if d3 >= 0.0 and d4 <= d3:
        return 1.0, 0.0
    if d1 * d4 - d3 * d2 <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        return d1 / (d1 - d3), 0.0
    cp = (ap[0] - ac[0], ap[1] - ac[1], ap[2] - ac[2])
    d5, d6 = _dot(ab, cp), _dot(ac, cp)
    if d6 >= 0.0 and d5 <= d6:
        return 0.0, 1.0
    if d5 * d2 - d1 * d6 <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        return 0.0, d2 / (d2 - d6)
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    if va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        return 1.0 - w, w
    return vb / (va + vb + vc), vc / (va + vb + vc)


@kernel
def _closest(work, triangles, x, spans, candidates, out):  # type: ignore[no-untyped-def]
    """The nearest point on each x's candidates[spans[i] : spans[i + 1]]; out : distance, weights, triangle."""
    distance, weights, which = out
    triangles = borrow(triangles)  # scalars, because a view of each triangle would count references
    t = next_tile(work)
    while t >= 0:
        for i in range(t * _TILE, min((t + 1) * _TILE, x.shape[0])):
            best = np.inf
            for k in range(spans[i], spans[i + 1]):
                corners = triangles[candidates[k]]
                v, w = _on_triangle(corners, (x[i, 0], x[i, 1], x[i, 2]))
                square = 0.0
                for c in range(3):
                    a = corners[0, c]
                    gap = x[i, c] - a - v * (corners[1, c] - a) - w * (corners[2, c] - a)
                    square += gap * gap
                if square < best:
                    best, which[i] = square, candidates[k]
                    weights[i, 0], weights[i, 1], weights[i, 2] = 1.0 - v - w, v, w
            distance[i] = np.sqrt(best)
        t = next_tile(work)


class Mesh:
    """A triangle mesh. Its vertices are the points, its interpolated vertex normals the exact normals."""

    def __init__(self, name: str, folder: Path = FOLDER) -> None:
        try:
            import embreex  # noqa: F401  # trimesh would silently take its own slow rays
            import trimesh
        except ImportError:
            raise ValueError(ABSENT) from None
        path = folder / f"stanford_{name}_mesh.ply"
        if not path.exists():
            raise ValueError(f"mesh {path.name} not found in {folder}")
        self.name = name
        self._mesh: Any = trimesh.load(path, process=False)
        self.area = float(self._mesh.area)
        self._triangles = np.ascontiguousarray(self._mesh.triangles, np.float64)
        self._corner_normals = np.asarray(self._mesh.vertex_normals)[self._mesh.faces]

    def points(self, n: int, sampling: str, seed: int) -> tuple[Floats, Floats]:
        """All vertices, for any n and sampling."""
        return np.array(self._mesh.vertices, np.float64), np.array(self._mesh.vertex_normals, np.float64)

    def surface_samples(self, n: int, seed: int) -> Floats:
        """Random points of the triangles."""
        return scattered(self._triangles, n, seed)

    @cached_property
    def _finder(self) -> tuple[Any, NDArray[np.int64], float]:
        """A kd-tree over centers of triangles, the triangle of each, and a bound on a center's distance to corners.

        Triangles that are long beside the others are cut into pieces, each with a center of its own.
        """
        centers, owners, pieces = [], [], self._triangles
        owner = np.arange(len(pieces))
        longest = 2 * float(np.median(_edges(pieces)))
        while len(pieces):
            done = _edges(pieces).max(axis=1) <= longest
            centers.append(pieces[done].mean(axis=1))
            owners.append(owner[done])
            pieces, owner = _halved(pieces[~done]), np.repeat(owner[~done], 2)
        return cKDTree(np.concatenate(centers)), np.concatenate(owners), longest / np.sqrt(3)

    def compare(self, x: Floats) -> tuple[Floats, Floats]:
        """Search the triangles of the 12 closest centers, or of all that may be nearer if 12 are too few."""
        tree, owners, radius = self._finder
        distance, weights, which = np.empty(len(x)), np.empty((len(x), 3)), np.zeros(len(x), np.int64)
        apart, near = tree.query(x, k=12)
        found = self._search(x, np.arange(len(x) + 1) * near.shape[1], owners[near.reshape(-1)])
        distance[:], weights[:], which[:] = found
        unsure = np.flatnonzero(apart[:, -1] < distance + radius)
        for rows in np.array_split(unsure, len(unsure) // 4096 + 1):
            lists = tree.query_ball_point(x[rows], distance[rows] + radius)
            spans = np.concatenate([[0], np.cumsum([len(items) for items in lists])])
            candidates = owners[np.concatenate([np.asarray(items, np.int64) for items in lists] or [owners[:0]])]
            distance[rows], weights[rows], which[rows] = self._search(x[rows], spans, candidates)
        normals = np.einsum("nk,nkc->nc", weights, self._corner_normals[which])
        return distance, normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)

    def _search(self, x: Floats, spans: NDArray[np.int64], candidates: NDArray[np.int64]) -> tuple[Any, Any, Any]:
        out = np.empty(len(x)), np.empty((len(x), 3)), np.zeros(len(x), np.int64)
        run(_closest, -(-len(x) // _TILE), self._triangles, np.ascontiguousarray(x), spans, candidates, out)
        return out

    def depth(self, origins: Floats, directions: Floats, ends: Floats, h: float) -> Floats:
        """Greatest distance to the surface at nine points between where Embree sees a ray enter and leave.

        A ray through a hole of the mesh does not enter: it counts as outside up to the next front face.
        """
        depth = np.zeros(len(ends))
        faces, rays, crossings = self._mesh.ray.intersects_id(origins, directions, return_locations=True)
        t = ((crossings - origins[rays]) * directions[rays]).sum(axis=1)
        order = np.lexsort((t, rays))
        faces, rays, t = faces[order], rays[order], t[order]
        enters = (self._mesh.face_normals[faces] * directions[rays]).sum(axis=1) < 0
        stay = np.flatnonzero(enters[:-1] & ~enters[1:] & (rays[:-1] == rays[1:]))
        stay = stay[t[stay] < ends[rays[stay]]]
        if len(stay):
            ray, first, last = rays[stay], t[stay], np.minimum(t[stay + 1], ends[rays[stay]])
            share = np.linspace(0.1, 0.9, 9)
            x = (
                origins[ray, None]
                + (first[:, None] + share * (last - first)[:, None])[..., None] * directions[ray, None]
            )
            np.maximum.at(depth, ray, self.compare(x.reshape(-1, 3))[0].reshape(-1, 9).max(axis=1))
        return depth


def _edges(triangles: Floats) -> Floats:
    """Lengths of the edges opposite each corner, (t, 3)."""
    return np.asarray(np.linalg.norm(triangles[:, [2, 0, 1]] - triangles[:, [1, 2, 0]], axis=2))


def _halved(triangles: Floats) -> Floats:
    """Each triangle cut at the middle of its longest edge, the halves one after the other."""
    rows = np.arange(len(triangles))
    top = _edges(triangles).argmax(axis=1)
    a, b, c = triangles[rows, top], triangles[rows, (top + 1) % 3], triangles[rows, (top + 2) % 3]
    middle = 0.5 * (b + c)
    return np.stack([a, b, middle, a, middle, c], axis=1).reshape(-1, 3, 3)


def truth(name: str, folder: Path = FOLDER) -> Truth:
    """The shape or mesh of a name. Raises a ValueError if a file or package is missing."""
    return Mesh(name, folder) if name in MESHES else Shape(name)
