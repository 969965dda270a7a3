"""Planes fitted to each point's nearest neighbours, 16 points at a time, and the agreement of neighbouring planes."""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ...base.arrays import Floats
from ...cloud.normals.axes import principal_axes
from ...cloud.normals.fit_batch import Triple, inner, zeros
from ...engine.jit import Array, borrow, f32, inline, kernel, next_tile, run
from ...engine.simd import F16, ONE, ZERO, broadcast16, gather16, load16, select, store, vabs, vmax, vsqrt

LANES = 16
CHUNK = 2048  # points per tile
PARALLEL, IN_PLANE = 0.95, 0.1  # least cosine of normals, and largest height over distance, of points in one plane
TINIEST = 1e-18  # lower limit of a reach that is divided by; its square is within float32

Xyz: TypeAlias = tuple[Array, Array, Array]  # x, y and z of each point


class LocalPlanes(NamedTuple):
    """Planes fitted to the neighbours of n points, (n,) float32 each.

    x, y, z : unit normal, of either sign
    thickness : standard deviation of the neighbours' distances from the plane
    slimness : second largest variance of the neighbours over the largest: 0 on a line
    offset : signed distance of the point from the plane
    reach : distance of the farthest neighbour
    """

    x: Floats
    y: Floats
    z: Floats
    thickness: Floats
    slimness: Floats
    offset: Floats
    reach: Floats


@inline
def load_triple(xyz: Xyz, at: int) -> Triple:
    """Load the vectors of 16 consecutive points, from point `at`. xyz : x, y and z of all points, an array each"""
    return load16(xyz[0], at), load16(xyz[1], at), load16(xyz[2], at)


@inline
def gather_triple(xyz: Xyz, near: Array, start: int, width: int) -> Triple:
    """Gather the vectors of one neighbour of each of 16 points.

    xyz : x, y and z of all points, an array each; near : flat rows of neighbours, `width` for each point
    start : index in `near` of the first point's neighbour
    """
    return (
        gather16(xyz[0], near, start, width),
        gather16(xyz[1], near, start, width),
        gather16(xyz[2], near, start, width),
    )


@inline
def difference(a: Triple, b: Triple) -> Triple:
    """Return a - b for vectors of 16 points."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@kernel
def _fit(work: Array, xyz: Xyz, near: Array, width: int, columns: tuple[int, int], out: tuple[Array, ...]) -> None:
    """Fit a plane to some neighbours of each point; write its normal, and how well it fits, to `out`.

    xyz : x, y and z of all points; near : flat rows of neighbours, `width` for each point
    columns : first and end of the range of neighbours to use
    out : x, y, z of the normals, thickness, slimness, offset and reach, the arrays of `LocalPlanes`
    """
    xyz, near, out = borrow(xyz), borrow(near), borrow(out)
    first, end = columns
    tile = next_tile(work)
    while tile >= 0:
        for begin in range(tile * CHUNK, min((tile + 1) * CHUNK, len(out[0])), LANES):
            at = min(begin, len(out[0]) - LANES)
            own = load_triple(xyz, at)
            far = difference(gather_triple(xyz, near, at * width + end - 1, width), own)
            reach = vsqrt(inner(far, far))
            inverse = ONE / vmax(reach, broadcast16(f32(TINIEST)))
            x = y = z = xx = xy = xz = yy = yz = zz = zeros()
            for j in range(first, end):
                p, q, r = difference(gather_triple(xyz, near, at * width + j, width), own)
                p, q, r = p * inverse, q * inverse, r * inverse
                x, y, z = x + p, y + q, z + r
                xx, xy, xz = xx + p * p, xy + p * q, xz + p * r
                yy, yz, zz = yy + q * q, yz + q * r, zz + r * r
            share = f32(1.0 / (end - first))
            x, y, z = x * share, y * share, z * share
            xx, xy, xz = xx * share - x * x, xy * share - x * y, xz * share - x * z
            yy, yz, zz = yy * share - y * y, yz * share - y * z, zz * share - z * z
            n, _, _, slimness = principal_axes((xx, xy, xz, yy, yz, zz))
            a, b, c = (
                xx * n[0] + xy * n[1] + xz * n[2],
                xy * n[0] + yy * n[1] + yz * n[2],
                xz * n[0] + yz * n[1] + zz * n[2],
            )
            store(out[0], at, n[0])
            store(out[1], at, n[1])
            store(out[2], at, n[2])
            store(out[3], at, reach * vsqrt(vmax(a * n[0] + b * n[1] + c * n[2], zeros())))
            store(out[4], at, vmax(slimness, zeros()))
            store(out[5], at, zeros() - reach * inner(n, (x, y, z)))
            store(out[6], at, reach)
        tile = next_tile(work)


@kernel
def _disagree(work: Array, normals: Xyz, near: Array, width: int, columns: tuple[int, int], out: Array) -> None:
    """Write the mean squared sine between each point's normal and those of some of its neighbours.

    normals : x, y and z of all points; near : flat rows of neighbours, `width` for each point
    columns : first and end of the range of neighbours to use; out : (n,) output
    """
    normals, near, out = borrow(normals), borrow(near), borrow(out)
    first, end = columns
    tile = next_tile(work)
    while tile >= 0:
        for begin in range(tile * CHUNK, min((tile + 1) * CHUNK, len(out)), LANES):
            at = min(begin, len(out) - LANES)
            own, total = load_triple(normals, at), zeros()
            for j in range(first, end):
                cosine = inner(own, gather_triple(normals, near, at * width + j, width))
                total = total + cosine * cosine
            store(out, at, vmax(ONE - total * f32(1.0 / (end - first)), zeros()))
        tile = next_tile(work)


@inline
def _bend(own: Triple, normal: Triple, place: Triple, other: Triple) -> tuple[F16, F16, F16, F16]:
    """Compare 16 points with a neighbour each, to see whether their normals follow the surface's curvature.

    own, normal : positions and normals of the points
    place, other : positions and normals of the neighbours

    Returns for each point:
        how far the neighbour is off an arc perpendicular to both normals, divided by the distance of both
        how far the neighbour is off the point's plane, divided by the same distance
        1 if the neighbour faces the same way; otherwise the first three results are 0
        1 if point and neighbour lie in one plane according to their normals, else 0
    """
    away = difference(place, own)
    size = vmax(vsqrt(inner(away, away)), broadcast16(f32(TINIEST)))
    plane, back, cosine = inner(away, normal) / size, inner(away, other) / size, inner(normal, other)
    faces, one, none = cosine > ZERO, zeros() + ONE, zeros()
    in_plane = (cosine > f32(PARALLEL)) & (vmax(vabs(plane), vabs(back)) < f32(IN_PLANE))
    return (
        select(faces, vabs(plane + back) * 0.5, none),
        select(faces, vabs(plane), none),
        select(faces, one, none),
        select(in_plane, one, none),
    )


@kernel
def _off_arcs(work: Array, xyz: Xyz, normals: Xyz, near: Array, width: int, columns: tuple[int, int], out: Xyz) -> None:
    """Write how far some neighbours of each point are off arcs perpendicular to both normals, and off its plane.

    xyz, normals : x, y and z of all points; near : flat rows of neighbours, `width` for each point
    columns : first and end of the range of neighbours to use
    out : three outputs, (n,) each:
        mean deviation from the arcs, divided by the neighbours' distances; 1 if no neighbour faces the same way
        mean deviation from the point's plane, divided likewise
        number of neighbours that lie in one plane with the point according to both normals
    """
    xyz, normals, near, out = borrow(xyz), borrow(normals), borrow(near), borrow(out)
    first, end = columns
    tile = next_tile(work)
    while tile >= 0:
        for begin in range(tile * CHUNK, min((tile + 1) * CHUNK, len(out[0])), LANES):
            at = min(begin, len(out[0]) - LANES)
            own, normal, arc, plane = load_triple(xyz, at), load_triple(normals, at), zeros(), zeros()
            count = same = zeros()
            for j in range(first, end):
                start = at * width + j
                place, other = gather_triple(xyz, near, start, width), gather_triple(normals, near, start, width)
                off = _bend(own, normal, place, other)
                arc, plane, count, same = arc + off[0], plane + off[1], count + off[2], same + off[3]
            some, share = count > ZERO, ONE / vmax(count, broadcast16(ONE))
            store(out[0], at, select(some, arc * share, zeros() + ONE))
            store(out[1], at, select(some, plane * share, zeros() + ONE))
            store(out[2], at, same)
        tile = next_tile(work)


def columns_of(rows: Floats) -> tuple[Floats, Floats, Floats]:
    """Split an (n, 3) array into its columns x, y and z, contiguous float32."""
    x, y, z = (np.ascontiguousarray(rows[:, c], np.float32) for c in range(3))
    return x, y, z


def fit_planes(
    xyz: tuple[Floats, ...], near: NDArray[np.int32], columns: tuple[int, int], threads: int | None = None
) -> LocalPlanes:
    """Fit a plane to neighbours of each point; return its normal, thickness and other properties.

    Parameters
    ----------
    xyz : three of (n,) float32
        Coordinates of at least 16 points.
    near : (n, k) int32
        Rows of neighbours, nearest first.
    columns : (first, end)
        Range of columns of `near` to use; the last one is the farthest neighbour.
    """
    out = LocalPlanes(*np.empty((len(LocalPlanes._fields), len(near)), np.float32))
    run(_fit, -(-len(near) // CHUNK), xyz, near.reshape(-1), near.shape[1], columns, tuple(out), threads=threads)
    return out


def disagreement(
    normals: tuple[Floats, ...], near: NDArray[np.int32], columns: tuple[int, int], threads: int | None = None
) -> Floats:
    """Return the mean squared sine between each normal and those of its neighbours, (n,); 2/3 for random normals.

    normals : x, y and z; near : (n, k) rows of neighbours; columns : range (first, end) of columns of `near` to use
    """
    out = np.empty(len(near), np.float32)
    run(_disagree, -(-len(out) // CHUNK), normals, near.reshape(-1), near.shape[1], columns, out, threads=threads)
    return out


def off_arcs(
    xyz: tuple[Floats, ...],
    normals: tuple[Floats, ...],
    near: NDArray[np.int32],
    columns: tuple[int, int],
    threads: int | None = None,
) -> tuple[Floats, Floats, Floats]:
    """Measure how far neighbours are from circular arcs perpendicular to both normals, and from each point's plane.

    The first two results, (n,) each, are the mean deviations from arcs and from the plane, divided by the distances of
    the neighbours. On a curved surface with true normals the first is much smaller than the second; for normals fitted
    to scattered points they are similar. Neighbours that face the other way do not count. The third result, (n,), is
    the number of neighbours that lie in one plane with the point according to both normals.

    xyz, normals : x, y and z of each point; near : (n, k) rows of neighbours
    columns : range (first, end) of columns of `near` to use
    """
    arc, plane, same = np.empty((3, len(near)), np.float32)
    run(
        _off_arcs,
        -(-len(arc) // CHUNK),
        *(xyz, normals, near.reshape(-1), near.shape[1], columns, (arc, plane, same)),
        threads=threads,
    )
    return arc, plane, same
