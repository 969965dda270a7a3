"""Patches: the splats of a model that exchange light, and interpolation of their light to all splats."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.arrays import Floats, Indices
from ..cloud.neighbors import NeighborTree
from ..engine.jit import Array, borrow, f32, i32, inline, kernel, next_tile, run
from ..engine.kernels.tree import BLOCK, FAR, INV_R2, NX, PX, Tree, first_scattered
from ..engine.kernels.vec import Vec3

NEAR = 16  # neighbours of a patch used in smoothing
AROUND = 8  # patches blended for a splat
BLOCK_SPLATS = 4  # splats side by side in a tree
FARTHER = 64  # nearest patches searched for ones that face a splat, if none of the first AROUND does
CHUNK = 1024  # blocks
PIECE = 1 << 16  # patches or blocks per neighbour query, which bounds temporary memory
# Falloff of a patch's weight with its distance from the splat's plane, relative to the distance of the patches.
OFF_PLANE = f32(4.0)
NEAREST = f32(0.05)  # added to the squared relative distance, so that weights stay bounded near a patch
GOLDEN = 0.6180339887498949  # the fractional parts of its multiples are evenly distributed
RIDGE = 0.01  # regularization, as a fraction of a matrix's trace


class Blend(NamedTuple):
    """Interpolation of light from patches (splats that exchange light on behalf of others) to the splats of a tree.

    Splats are in the tree's order, unused slots of blocks included.

    patch_of : (slots,) int32, the patch that represents each splat; 0 in an unused slot
    around : (slots / BLOCK_SPLATS, AROUND) int32, the patches blended for the splats of a block
    weights : (slots, AROUND) uint8, their weights for each splat; the sum is not 0
    """

    patch_of: Indices
    around: Indices
    weights: NDArray[np.uint8]


class PatchSet(NamedTuple):
    """Patches of one model: splats that exchange light on behalf of their neighbours, in model space.

    positions, normals : (m, 3) float32, relative to the points' origin
    radii : (m,) float32, support radii of the splats that are patches, or diameters of scattered points; these scale
        how far above a patch the rays start that search for the surface
    near : (m, NEAR) int32, nearest other patches of each patch, padded with -1
    blends : interpolation of light to the splats of the model, then to those of each level of detail
    """

    positions: Floats
    normals: Floats
    radii: Floats
    near: Indices
    blends: list[Blend]


def splats_of(tree: Tree) -> tuple[Floats, Floats, Floats]:
    """Return positions (n, 3), normals (n, 3) and support radii (n,) of a tree's splats, in its order, float32.

    Unused slots at the end of blocks have positions beyond FAR.
    """
    rows = tree.blocks.reshape(-1, BLOCK // 4, 4)
    first = {PX: 0, NX: 3}
    x, n = (rows[:, first[k] : first[k] + 3].transpose(0, 2, 1).reshape(-1, 3) for k in (PX, NX))
    return np.ascontiguousarray(x), np.ascontiguousarray(n), rows[:, INV_R2 // 4].reshape(-1) ** np.float32(-0.5)


def choose_patches(trees: Sequence[Tree], most: int) -> PatchSet:
    """Choose at most `most` splats of a model as patches, evenly spaced in the order of its tree (a kd order).

    One splat is taken from each of equally long runs, at a varying position: splats of the two sides of a thin wall
    alternate in the order, and a constant position could leave one side without patches.

    trees : of the model, and of its levels of detail
    """
    x, n, radii = splats_of(trees[0])
    radii[BLOCK_SPLATS * first_scattered(trees[0]) :] *= np.float32(2.0)
    used = np.flatnonzero(x[:, 0] < FAR)
    count = min(most, len(used))
    places = np.arange(count) + np.arange(count) * GOLDEN % 1.0
    slots = used[(places * (len(used) / count)).astype(np.int64)]
    positions, normals, radii = x[slots], n[slots], radii[slots]
    del used, slots
    finder = NeighborTree(positions)
    blends = [blend_for(x, n, finder, positions, normals)]
    del x, n
    blends += [blend_for(*splats_of(tree)[:2], finder, positions, normals) for tree in trees[1:]]
    return PatchSet(positions, normals, radii, _neighbors_within(finder, positions), blends)


def blend_for(x: Floats, n: Floats, finder: NeighborTree, positions: Floats, normals: Floats) -> Blend:
    """Compute how light of patches is interpolated to splats: which patches are blended, and their weights.

    Patches are searched once for the four splats of a block, which takes a quarter of the time and memory. If none of
    them faces a splat, as in a thin wall, the nearest patches that face the block's splats are used instead.

    x, n : positions and normals of the splats, (slots, 3), four to a block
    finder, positions, normals : search tree, positions and normals of the patches, (m, 3)
    """
    blocks, count = x.reshape(-1, BLOCK_SPLATS, 3), min(AROUND, len(positions))
    around = np.zeros((len(blocks), AROUND), np.int32)
    for first in range(0, len(blocks), PIECE):
        part = blocks[first : first + PIECE]
        used = (part[..., :1] < FAR).astype(np.float32)
        middles = (part * used).sum(axis=1) / np.maximum(used.sum(axis=1), 1.0)
        _, around[first : first + PIECE, :count] = finder.query(AROUND, middles)
    weights, patch_of = np.zeros((len(x), AROUND), np.uint8), np.zeros(len(x), np.int32)
    tables = x.reshape(-1), n.reshape(-1), positions.reshape(-1), normals.reshape(-1)

    def weigh(rows: NDArray[np.int64]) -> None:
        tiles = -(-len(rows) // CHUNK)
        run(_blend, tiles, tables, rows, around.reshape(-1), count, weights.reshape(-1), patch_of)

    weigh(np.arange(len(blocks)))
    rows = np.unique(np.flatnonzero((patch_of < 0) & (x[:, 0] < FAR)) // BLOCK_SPLATS)
    if len(rows) and count == AROUND:
        around[rows] = _facing((x, n), finder, rows, normals)
        weigh(rows)
    patch_of[x[:, 0] >= FAR] = 0
    np.invert(patch_of, out=patch_of, where=patch_of < 0)
    return Blend(patch_of, around, weights)


def nearest_blend(
    x: Floats, n: Floats, blend: Blend, patches: tuple[Floats, Floats], count: int
) -> tuple[Indices, NDArray[np.uint8]]:
    """Reduce an interpolation of light from AROUND patches for each block of splats to one from only `count` patches.

    Kept are the patches of largest total weight in the block; those that have the largest weight at one of its splats
    take precedence.

    x, n : positions and normals of the splats, (slots, 3)
    blend : the interpolation from AROUND patches
    patches : positions and normals of the patches, (m, 3) each

    Returns
    -------
    (blocks, count) int32
        Indices of the patches of each block.
    (slots, count) uint8
        Weights of these patches for each splat, computed anew.
    """
    weights = blend.weights.astype(np.float32)
    weights /= np.maximum(weights.sum(axis=1, keepdims=True), 1.0)
    weights[np.arange(len(weights)), weights.argmax(axis=1)] += np.float32(BLOCK_SPLATS)
    order = np.argsort(-weights.reshape(-1, BLOCK_SPLATS, AROUND).sum(axis=1), axis=1, kind="stable")
    around, out = np.take_along_axis(blend.around, order, axis=1), np.zeros_like(blend.weights)
    rows, patch_of = np.arange(len(around)), np.zeros(len(x), np.int32)
    tables = x.reshape(-1), n.reshape(-1), patches[0].reshape(-1), patches[1].reshape(-1)
    used = min(count, len(patches[0]))
    run(_blend, -(-len(rows) // CHUNK), tables, rows, around.reshape(-1), used, out.reshape(-1), patch_of)
    return around[:, :count], out[:, :count]


def _facing(splats: tuple[Floats, Floats], finder: NeighborTree, blocks: NDArray[np.int64], normals: Floats) -> Indices:
    """Find the nearest patches that face the same way as splats, for blocks where the closest ones do not.

    splats : positions and normals of all splats, (slots, 3) each
    finder, normals : search tree over the patches, and their normals
    blocks : (m,) indices of the blocks

    Returns
    -------
    (m, AROUND) int32
        For each block AROUND / BLOCK_SPLATS patches for each of its splats.
    """
    x, n = splats
    slots = blocks[:, None] * BLOCK_SPLATS + np.arange(BLOCK_SPLATS)
    slots = np.where(x[slots, 0] < FAR, slots, slots[:, :1]).reshape(-1)
    out = np.empty((len(slots), AROUND // BLOCK_SPLATS), np.int32)
    for first in range(0, len(slots), PIECE):
        part = slots[first : first + PIECE]
        _, near = finder.query(FARTHER, x[part])
        away = np.einsum("nc,nkc->nk", n[part], normals[near]) <= 0.0
        nearest = np.argsort(away, axis=1, kind="stable")[:, : out.shape[1]]
        out[first : first + PIECE] = np.take_along_axis(near, nearest, axis=1)
    return out.reshape(-1, AROUND)


def _neighbors_within(finder: NeighborTree, positions: Floats) -> Indices:
    """Return the NEAR nearest other patches of each patch, (m, NEAR) int32, padded with -1. positions : (m, 3)"""
    out = np.full((len(positions), NEAR), -1, np.int32)
    for first in range(0, len(positions), PIECE):
        _, near = finder.query(NEAR + 1, positions[first : first + PIECE])
        others = near != np.arange(first, first + len(near))[:, None]
        others[others.all(axis=1), -1] = False  # a patch with many duplicates may be missing from its own neighbours
        out[first : first + PIECE, : near.shape[1] - 1] = near[others].reshape(len(near), -1)
    return out


@inline
def patch_weight(x: Array, n: Array, i: int, y: Array, m: Array, j: int, width: float) -> float:
    """Return the weight with which the light of patch j is interpolated to splat i.

    It falls with distance and off the splat's plane, and is 0 if the patch faces the opposite way.

    x, n : positions and normals of splats, flat
    y, m : positions and normals of patches, flat
    width : distance from the splat to the farthest of its patches, the length scale of the falloff
    """
    cosine = square = off = f32(0.0)
    for c in range(3):
        d = y[3 * j + c] - x[3 * i + c]
        cosine += n[3 * i + c] * m[3 * j + c]
        off += d * (n[3 * i + c] + m[3 * j + c])
        square += d * d
    if cosine <= f32(0.0):
        return f32(0.0)
    off = off * f32(0.5) / width * OFF_PLANE
    turned = cosine * cosine
    near = NEAREST + square / (width * width)
    return turned * turned / ((f32(1.0) + off * off) * near * near)


@inline
def _solve3(m: Array, b: Vec3) -> Vec3:
    """Solve M x = b for a nonsingular symmetric matrix given as xx xy xz yy yz zz."""
    xx, xy, xz, yy, yz, zz = m[0], m[1], m[2], m[3], m[4], m[5]
    first = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    second = xx * zz - xz * xz, xy * xz - xx * yz
    third = xx * yy - xy * xy
    size = 1.0 / (xx * first[0] + xy * first[1] + xz * first[2])
    return (
        size * (first[0] * b[0] + first[1] * b[1] + first[2] * b[2]),
        size * (first[1] * b[0] + second[0] * b[1] + second[1] * b[2]),
        size * (first[2] * b[0] + second[1] * b[1] + third * b[2]),
    )


@inline
def _reproduce_linear(x: Array, i: int, y: Array, around: Array, span: tuple[int, int], found: Array, m: Array) -> None:
    """Adjust interpolation weights so that the weighted mean of the patches' positions is the position of splat i.

    Light that varies linearly across the surface is then interpolated exactly (moving least squares, Lancaster and
    Salkauskas 1981).

    x, y : positions of splats and of patches, flat
    around : for each block indices of patches; span : (first index, number) of those of splat i in `around`
    found : the weights of these patches, changed in place
    m : working memory for 6 numbers
    """
    bx = by = bz = total = 0.0
    m[:] = 0.0
    for k in range(span[1]):
        j, w = 3 * around[span[0] + k], found[k] * 1.0
        dx, dy, dz = y[j] - x[3 * i] * 1.0, y[j + 1] - x[3 * i + 1] * 1.0, y[j + 2] - x[3 * i + 2] * 1.0
        bx, by, bz, total = bx + w * dx, by + w * dy, bz + w * dz, total + w
        m[0], m[1], m[2] = m[0] + w * dx * dx, m[1] + w * dx * dy, m[2] + w * dx * dz
        m[3], m[4], m[5] = m[3] + w * dy * dy, m[4] + w * dy * dz, m[5] + w * dz * dz
    ridge = RIDGE * (m[0] + m[3] + m[5])
    if not ridge > 1e-30 * total:
        return
    m[0], m[3], m[5] = m[0] + ridge, m[3] + ridge, m[5] + ridge
    a = _solve3(m, (-bx, -by, -bz))
    for k in range(span[1]):
        j = 3 * around[span[0] + k]
        lean = a[0] * (y[j] - x[3 * i]) + a[1] * (y[j + 1] - x[3 * i + 1]) + a[2] * (y[j + 2] - x[3 * i + 2])
        found[k] = found[k] * f32(max(1.0 + lean, 0.0))


@inline
def _width(x: Array, i: int, y: Array, around: Array, span: tuple[int, int]) -> float:
    """Return the distance from splat i to the farthest of the patches that are interpolated there.

    x, y : positions of splats and of patches, flat
    around : for each block indices of patches; span : (first index, number) of those of splat i in `around`
    """
    most = f32(1e-30)
    for k in range(span[1]):
        j, square = 3 * around[span[0] + k], f32(0.0)
        for c in range(3):
            square += (y[j + c] - x[3 * i + c]) ** 2
        most = max(most, square)
    return f32(np.sqrt(most))


@kernel
def _blend(
    work: Array,
    tables: tuple[Array, Array, Array, Array],
    rows: Array,
    around: Array,
    count: int,
    weights: Array,
    patch_of: Array,
) -> None:
    """Compute the weights with which light is interpolated from patches to each splat of some blocks.

    tables : (positions of splats, normals of splats, positions of patches, normals of patches), flat float32 each
    rows : (m,) int64, indices of the blocks to process
    around : for each block AROUND indices of patches, of which the first `count` are used
    weights : uint8, AROUND for each splat, written; 255 for the largest
    patch_of : int32, written, for each splat the patch of largest weight, or ~(first patch of the block), negative, if
        no patch faces the splat
    """
    x, n, y, m = borrow(tables)
    rows, around, weights, patch_of = borrow(rows), borrow(around), borrow(weights), borrow(patch_of)
    found, memory = np.zeros(AROUND, np.float32), np.zeros(6)
    tile = next_tile(work)
    while tile >= 0:
        first, end = tile * CHUNK * BLOCK_SPLATS, min((tile + 1) * CHUNK, rows.size) * BLOCK_SPLATS
        for slot in range(first, end):
            block = rows[slot // BLOCK_SPLATS]
            i, span = block * BLOCK_SPLATS + slot % BLOCK_SPLATS, (block * AROUND, count)
            width, best = _width(x, i, y, around, span), 0
            for k in range(count):
                found[k] = patch_weight(x, n, i, y, m, around[span[0] + k], width)
                if found[k] > found[best]:
                    best = k
            _reproduce_linear(x, i, y, around, span, found, memory)
            most = f32(0.0)
            for k in range(count):
                most = max(most, found[k])
            faces = most > f32(0.0)
            patch_of[i] = i32(around[span[0] + best]) if faces else i32(~around[span[0]])
            for k in range(count):
                share = found[k] / most if faces else f32(k == best)
                weights[i * AROUND + k] = np.uint8(share * f32(255.0) + f32(0.5))
        tile = next_tile(work)
