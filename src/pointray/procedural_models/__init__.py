"""Procedural models: a sculpted bust, a sphere, a torus and a lattice, with exact signed distances.

They need no file and no network, and hits of rays with their points can be compared with the exact surface:

    points = pr.procedural("statue", 1_000_000)
    error = pr.procedural_distance("statue", hits.position)

clay, strokes, cells : solids made of strokes; sculpture : the statue, from head, bust and reliefs
solids : field and signed distance of every solid; smooth : smooth minimum and step
meshing, creases, scatter : a mesh, its refinement in creases, and points spread over it; paint : their colours

Begin with `sample` below, then solids.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.arguments import check_choice, check_numbers, check_whole
from ..engine.jit import Array, borrow, f64, kernel, next_tile, run
from . import solids
from .clay import COLUMNS, Solid
from .creases import areas, edges_of, quarter, refine_creases, settled
from .meshing import mesh_solid
from .paint import color
from .scatter import scatter
from .sculpture import statue

if TYPE_CHECKING:
    from ..cloud.points import Points

NAMES = ("statue", "sphere", "torus", "lattice")
MOST = 100_000_000

_CHUNK = 4096
_MESH_CELL = {"statue": 0.006, "sphere": 0.012, "torus": 0.012, "lattice": 0.008}


def _check_name(name: str) -> None:
    check_choice(name, "name", NAMES)


@cache
def solid(name: str) -> Solid:
    """Return the solid with the name of a procedural model, in the form that kernels take; computed once."""
    if name == "statue":
        return statue()
    kind = {"sphere": solids.SPHERE, "torus": solids.TORUS, "lattice": solids.LATTICE}[name]
    starts = np.zeros(2, np.int32)
    return Solid(kind, np.zeros((0, COLUMNS)), np.zeros((1, 1, 1), np.int32), starts, starts[:0], np.zeros(3), 1.0)


def _bounds(name: str) -> NDArray[np.float64]:
    """Return a box that contains the surface of a procedural model with a margin, (2, 3)."""
    if name == "statue":
        body = solid(name)
        return np.stack([body.origin, body.origin + np.array(body.lists.shape) * body.cell])
    ring = solids.TORUS_MAJOR + solids.TORUS_MINOR
    end = solids.LATTICE_END + solids.LATTICE_KNOB + 0.01
    half = {"sphere": (1.0, 1.0, 1.0), "torus": (ring, ring, solids.TORUS_MINOR), "lattice": (end, end, end)}[name]
    return np.outer([-1, 1], np.array(half) + 3 * _MESH_CELL[name])


@cache
def mesh(name: str) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Return a closed triangle mesh near the surface of a procedural model: vertices, (v, 3), and faces, (f, 3).

    It is computed once.
    """
    low, high = _bounds(name)
    return mesh_solid(solid(name), low, high, _MESH_CELL[name])


@cache
def area(name: str) -> float:
    """Return the area of the surface of a procedural model, to about a thousandth; computed once.

    A mesh is refined once, its new vertices are moved onto the surface, and the error, proportional to the square of
    the edge length, is removed by extrapolation.
    """
    _check_name(name)
    vertices, faces = mesh(name)
    coarse = float(areas(vertices[faces]).sum())
    ends, sides = edges_of(faces, len(vertices))
    middles = settled(solid(name), 0.5 * (vertices[ends[:, 0]] + vertices[ends[:, 1]]))
    four = quarter(faces, sides + len(vertices))
    fine = float(areas(np.concatenate([vertices, middles])[four]).sum())
    return (4 * fine - coarse) / 3


@kernel
def _finish(work: Array, solid: Solid, positions: Array, normals: Array, colors: Array) -> None:
    """Move points, (n, 3) float32, onto the exact surface of a solid, and write the normals and colours there.

    positions : changed in place; normals : (n, 3) float32, unit, written; colors : (n, 3) uint8, written
    """
    solid = borrow(solid)
    t = next_tile(work)
    while t >= 0:
        for i in range(t * _CHUNK, min((t + 1) * _CHUNK, positions.shape[0])):
            x, y, z = f64(positions[i, 0]), f64(positions[i, 1]), f64(positions[i, 2])
            x, y, z, f = solids.settle(solid, x, y, z, 8, solids.SINGLE)
            gx, gy, gz = solids.slope_from(solid, x, y, z, f, solids.SHORT)
            length = np.sqrt(gx * gx + gy * gy + gz * gz)
            positions[i, 0], positions[i, 1], positions[i, 2] = x, y, z
            normals[i, 0], normals[i, 1], normals[i, 2] = gx / length, gy / length, gz / length
            red, green, blue = color(solid, x, y, z)
            colors[i, 0] = int(min(max(red, 0.0), 1.0) * 255.0 + 0.5)
            colors[i, 1] = int(min(max(green, 0.0), 1.0) * 255.0 + 0.5)
            colors[i, 2] = int(min(max(blue, 0.0), 1.0) * 255.0 + 0.5)
        t = next_tile(work)


def sample(name: str, n: int, seed: int = 0) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.uint8]]:
    """Sample a procedural model: blue noise on its exact surface, as arrays.

    Parameters
    ----------
    name : {"statue", "sphere", "torus", "lattice"}
    n : int
        Number of points.
    seed : int
        Seed of the random numbers.

    Returns
    -------
    positions : (n, 3) float32
    normals : (n, 3) float32
        Exact, unit length.
    colors : (n, 3) uint8
        sRGB.
    """
    _check_name(name)
    n, seed = check_whole(n, "n", 1, MOST), check_whole(seed, "seed", 0, 2**63 - 1)
    vertices, faces = mesh(name)
    positions = scatter(refine_creases(solid(name), vertices, faces, n), n, seed)
    normals, colors = np.empty_like(positions), np.empty(positions.shape, np.uint8)
    run(_finish, -(-n // _CHUNK), solid(name), positions, normals, colors)
    return positions, normals, colors


def procedural(name: str, n: int, seed: int = 0) -> Points:
    """Sample a procedural model: blue noise on the exact surface, with exact normals, and colours.

    Parameters
    ----------
    name : str
        "statue" (a bust on a plinth, about 2 high, standing on z = 0 and facing -y), "sphere" (radius 1),
        "torus" (radii 1 and 0.4, axis z) or "lattice" (thin struts, filleted).
    n : int
        Number of points, exactly; 1 to 100 million.
    seed : int
        Seed of the random numbers; other seeds give other points of the same surface.

    Returns
    -------
    Points
        Positions, unit normals and colours, n rows each.

    Raises
    ------
    TypeError
        If an argument has the wrong type.
    ValueError
        If the name is unknown, or n or the seed is out of its range.

    Examples
    --------
    >>> points = pr.procedural("sphere", 1000)
    >>> points.positions.shape, points.colors.dtype
    ((1000, 3), dtype('uint8'))
    >>> bool(abs(np.linalg.norm(points.positions, axis=1) - 1).max() < 1e-6)
    True
    """
    from ..cloud.points import Points

    positions, normals, colors = sample(name, n, seed)
    return Points(positions, normals=normals, colors=colors)


def procedural_distance(name: str, x: ArrayLike) -> Any:
    """Return the signed distance to the exact surface of a procedural model, negative inside.

    Parameters
    ----------
    name : {"statue", "sphere", "torus", "lattice"}
        Name of the model, as for `procedural`.
    x : (..., 3) array_like of float
        Positions.

    Returns
    -------
    (...) float64
        Distance in the unit of the positions.

    Raises
    ------
    TypeError
        If an argument has the wrong type.
    ValueError
        If the name is unknown, or the last axis of x does not have length 3.

    Notes
    -----
    The sphere and the torus have closed formulas. The lattice and the statue are blends of shapes, the zero set of a
    smooth function f, whose nearest surface point is found iteratively: the result is f / norm(grad f) within 1e-6 of
    the surface, the Euclidean distance to 1% within 0.03 of it, and to 2% within 0.1, as measured (a relief has many
    locally nearest points). Its size is never less than that of the exact distance.

    Examples
    --------
    >>> pr.procedural_distance("sphere", [[0, 0, 0], [2, 0, 0]])
    array([-1.,  1.])
    """
    _check_name(name)
    x = check_numbers(x, "x").astype(np.float64)
    if x.shape[-1:] != (3,):
        raise ValueError(f"x must have the shape (..., 3), not {x.shape}")
    flat = np.ascontiguousarray(x.reshape(-1, 3))
    out = np.empty(len(flat))
    run(solids.distances, -(-len(flat) // 256), solid(name), flat, out, 256)
    return out.reshape(x.shape[:-1])
