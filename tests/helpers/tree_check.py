"""Check of all invariants of a tree, see `engine/kernels/tree.py`; slow and simple, with NumPy."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from pointray.engine.jit import uncompiled
from pointray.engine.kernels import tree as tr
from pointray.engine.kernels.tree import Tree, first_scattered
from pointray.surface.tree.columns import across
from pointray.surface.tree.indices import check_lengths

Floats = NDArray[np.float32]


def check_tree(tree: Tree, positions: int = 20_000, seed: int = 0) -> list[str]:
    """Return descriptions of what is wrong with a tree; an empty list if it is valid.

    Parameters
    ----------
    positions : int
        Number of random positions near splats at which the leaves are checked.
    seed : int
        Seed of these random positions.
    """
    problems = check_lengths(tree)
    if problems:
        return problems
    rows = tree.order[tree.order >= 0]
    if len(np.unique(rows)) != len(rows):
        return ["a row of the points occurs in two slots"]
    boxes, parents, problems = _check_nodes(tree)
    if problems:
        return problems
    if not first_scattered(tree):
        return []
    return problems + _check_spheres(tree) + _check_positions(tree, boxes, parents, positions, seed)


def _check_nodes(tree: Tree) -> tuple[Floats, NDArray[np.int64], list[str]]:
    """Check that each node and leaf is reached once, and that boxes enclose those below them.

    Returns the boxes of the leaves (leaves, 6), empty if not reached; how often each is reached; what is wrong.
    """
    children = tree.children.reshape(-1, tr.WIDTH)
    rows = tree.boxes.reshape(-1, 6, tr.WIDTH)
    leaves = tree.leaves.size // tr.LEAF
    boxes = np.tile(np.array([np.inf] * 3 + [-np.inf] * 3, np.float32), (leaves, 1))
    seen_nodes, seen_leaves = np.zeros(len(children), int), np.zeros(leaves, int)
    seen_nodes[0] = 1
    problems: list[str] = []
    for node, kids in enumerate(children):
        for k, child in enumerate(kids):
            box = rows[node, :, k]
            if child == tr.NO_CHILD:
                if (box[:3] <= box[3:]).all():
                    problems.append(f"node {node}: an empty child has a box")
            elif child < 0 and tr.SCATTERED <= ~child < tr.SCATTERED + tree.blocks.size // tr.BLOCK:
                problems += _check_scattered(tree, ~int(child) - tr.SCATTERED, box)
            elif child >= len(children) or ~child >= leaves:
                problems.append(f"node {node}: child {child} does not exist")
            elif child >= 0:
                seen_nodes[child] += 1
                inner = rows[child]
                if (inner[:3].min(axis=1) < box[:3]).any() or (inner[3:].max(axis=1) > box[3:]).any():
                    problems.append(f"node {node}: the box of child {child} does not enclose it")
            else:
                seen_leaves[~child] += 1
                boxes[~child] = box
    if (seen_nodes != 1).any() or (seen_leaves > 1).any():
        problems.append("a node or leaf is not reached exactly once")
    if (seen_leaves[tree.spans[1::2] > 0] == 0).any():
        problems.append("a leaf with splats is never reached")
    if (seen_leaves[tree.spans[1::2] == 0] > 0).any():
        problems.append("a leaf without splats is reached")
    return boxes, seen_leaves, problems


def _check_scattered(tree: Tree, block: int, box: Floats) -> list[str]:
    """Check that the box of a leaf of scattered points encloses their spheres; return what is wrong.

    block : its first block; box : lo x y z, hi x y z
    """
    end = block + tr.LEAF_BLOCKS
    rows = np.concatenate(list(tree.blocks[block * tr.BLOCK : end * tr.BLOCK].reshape(-1, 7, 4)), axis=1)
    rows = rows[:, tree.order[4 * block : 4 * end] >= 0]
    x, radius = rows[:3], 1 / np.sqrt(rows[6])
    inside = (x - radius >= box[:3, None]).all() and (x + radius <= box[3:, None]).all()
    return [] if inside else [f"block {block}: the box of its leaf does not enclose its spheres"]


def _splats(tree: Tree) -> tuple[Floats, NDArray[np.int64]]:
    """Return rows x y z nx ny nz r of the surface's splats (n, 7), and the block of each splat (n,)."""
    used = np.flatnonzero(tree.order[: 4 * first_scattered(tree)] >= 0)
    rows = tree.blocks.reshape(-1, 7, 4).transpose(0, 2, 1).reshape(-1, 7)[used].copy()
    rows[:, 6] = 1 / np.sqrt(rows[:, 6])
    return rows, used // 4


def _check_spheres(tree: Tree) -> list[str]:
    """Check that the bounding spheres that leaves store enclose the supports of their blocks; return what is wrong."""
    rows, block = _splats(tree)
    spheres = tree.spheres.reshape(-1, 4, 16).transpose(0, 2, 1).reshape(-1, 4)
    listed = spheres[:, 3] > 0
    order = np.argsort(block, kind="stable")
    start = np.searchsorted(block[order], tree.refs[listed])
    problems = []
    for k in range(4):
        at = np.minimum(start + k, len(order) - 1)
        mine = block[order[at]] == tree.refs[listed]
        splat = rows[order[at[mine]]]
        sphere = spheres[listed][mine]
        needed = np.linalg.norm(splat[:, :3] - sphere[:, :3], axis=1) + splat[:, 6]
        if (needed > sphere[:, 3] * (1 + 1e-5)).any():
            problems.append("a bounding sphere does not enclose its block")
    return problems


def _check_positions(tree: Tree, boxes: Floats, reached: NDArray[np.int64], positions: int, seed: int) -> list[str]:
    """Check that each random position under splats is in one voxel, and that its leaf lists every splat over it.

    boxes : (leaves, 6); reached : (leaves,), how often the leaf is reached from the root; positions : their number

    Returns what is wrong, there and at positions on the surface.
    """
    rows, block = _splats(tree)
    rng = np.random.default_rng(seed)
    chosen = rows[rng.integers(len(rows), size=positions)].astype(np.float64)
    x = chosen[:, :3] + chosen[:, 6:] * rng.uniform(-0.5, 0.5, (positions, 3))
    query, splat = _over(x, rows[:, :3], rows[:, 6] * (1 - 1e-5))
    leaf, crowded, lost = _voxel_of(tree, x)
    known = np.unique(_codes(tree))
    codes = leaf[query] * (tree.blocks.size // tr.BLOCK) + block[splat]
    asked = (leaf[query] >= 0) & (tree.spans[2 * leaf[query] + 1] > 0)
    missing = len(np.unique(leaf[query][asked & ~np.isin(codes, known)]))
    problems = []
    if lost[query].any():
        problems.append(f"{len(np.unique(query[lost[query]]))} of {positions} positions under splats are in no voxel")
    if crowded.any():
        problems.append(f"{crowded.sum()} of {positions} positions are in more than one voxel")
    if missing:
        problems.append(f"{missing} leaves do not list every splat over a position in them")
    if int(tree.head[tr.SURFACE]) == tr.DISC:
        return problems
    return problems + _check_surface(tree, boxes, reached, _onto_surface(tree, rows, x))


def _check_surface(tree: Tree, boxes: Floats, reached: NDArray[np.int64], x: NDArray[np.float64]) -> list[str]:
    """Check that positions x (n, 3) on the surface are in a non-empty leaf, in its slab and in its tight box.

    boxes : (leaves, 6); reached : (leaves,), how often the leaf is reached from the root

    Returns what is wrong.
    """
    leaf, _, _ = _voxel_of(tree, x)
    x, leaf = x[leaf >= 0], leaf[leaf >= 0]
    records, box = tree.leaves.reshape(-1, tr.LEAF)[leaf].astype(np.float64), boxes[leaf]
    slack = 1e-4 * records[:, tr.RADIUS]  # a tenth of the padding of slabs and boxes
    height = np.einsum("ij,ij->i", records[:, tr.SLAB : tr.SLAB + 3], x)
    slab = (height < records[:, tr.SLAB_LO] - slack) | (height > records[:, tr.SLAB_HI] + slack)
    cut = ((x < box[:, :3] - slack[:, None]) | (x > box[:, 3:] + slack[:, None])).any(axis=1)
    full = (tree.spans[2 * leaf + 1] > 0) & (reached[leaf] == 1)
    patch = _out_of_patch(tree, leaf, x, slack)
    problems = []
    for wrong, what in (
        (~full, "in an empty leaf"),
        (full & slab, "outside of the slab"),
        (full & cut, "outside of the box"),
        (full & patch, "outside of the slab of their column"),
    ):
        if wrong.any():
            problems.append(f"{wrong.sum()} of {len(x)} positions on the surface are {what}, such as {x[wrong][0]}")
    return problems


def _out_of_patch(
    tree: Tree, leaf: NDArray[np.int64], x: NDArray[np.float64], slack: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Return which positions are outside of the slab of their column, (n,).

    leaf : (n,) leaf of each; x : (n, 3); slack : (n,) tolerance
    """
    records = tree.leaves.reshape(-1, tr.LEAF)
    axes = np.array([uncompiled(across)(*record[tr.SLAB : tr.SLAB + 3]) for record in records])[leaf]
    cell = records[leaf, tr.CELL : tr.CELL + 6].astype(np.float64)
    position = np.take_along_axis(x - cell[:, :3], axes, axis=1)
    width = np.take_along_axis(cell[:, 3:] - cell[:, :3], axes, axis=1)[:, :2] / tr.COLUMNS
    u, v = (position[:, :2] / width).T
    i, j = (np.clip(np.floor(at).astype(np.int64), 0, tr.COLUMNS - 1) for at in (u, v))
    patch = tree.patches.reshape(-1, tr.PATCH)[leaf].astype(np.float64)
    b, c, low, high = (
        np.take_along_axis(patch, (row + tr.COLUMNS * i + j)[:, None], axis=1)[:, 0]
        for row in (tr.PATCH_B, tr.PATCH_C, tr.PATCH_LOW, tr.PATCH_HIGH)
    )
    height = position[:, 2] + b * u + c * v
    out: NDArray[np.bool_] = (height < low - slack) | (height > high + slack)
    return out


def _codes(tree: Tree) -> NDArray[np.int64]:
    """Return leaf * blocks + block for every block that a leaf lists, (m,)."""
    count = 16 * tree.spans[1::2].astype(np.int64)
    leaf = np.repeat(np.arange(len(count)), count)
    start = np.repeat(16 * tree.spans[::2].astype(np.int64) - (np.cumsum(count) - count), count)
    slot = start + np.arange(len(leaf))
    listed = tree.spheres.reshape(-1, 4, 16)[:, 3].reshape(-1)[slot] > 0
    return leaf[listed] * (tree.blocks.size // tr.BLOCK) + tree.refs[slot[listed]]


def _over(
    x: NDArray[np.float64], centers: NDArray[Any], radii: NDArray[Any]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return all pairs (position, ball) with the position in the ball, as two arrays of indices.

    x : (n, 3) positions; centers, radii : of the balls, (m, 3) and (m,)
    """
    found = cKDTree(x).query_ball_point(centers, radii)
    lengths = np.fromiter(map(len, found), np.int64, len(found))
    queries = np.fromiter((p for some in found for p in some), np.int64, int(lengths.sum()))
    return queries, np.repeat(np.arange(len(found)), lengths)


def _voxel_of(tree: Tree, x: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.bool_], NDArray[np.bool_]]:
    """Return the leaf whose voxel strictly contains each position, or -1; where several do; where no voxel touches it.

    x : (n, 3) positions; all results are (n,)
    """
    cells = tree.leaves.reshape(-1, tr.LEAF)[:, tr.CELL : tr.CELL + 6].astype(np.float64)
    real = np.flatnonzero((cells[:, :3] <= cells[:, 3:]).all(axis=1))
    low, high = cells[real, :3], cells[real, 3:]
    query, voxel = _over(x, (low + high) / 2, np.linalg.norm(high - low, axis=1) * 0.5001)
    touched = ((low[voxel] <= x[query]) & (x[query] <= high[voxel])).all(axis=1)
    rim = 1e-6 * np.abs(x).max(initial=0.0)
    inside = ((low[voxel] + rim < x[query]) & (x[query] < high[voxel] - rim)).all(axis=1)
    leaf = np.full(len(x), -1)
    leaf[query[inside]] = real[voxel[inside]]
    crowded = np.bincount(query[inside], minlength=len(x)) > 1
    return leaf, crowded, np.bincount(query[touched], minlength=len(x)) == 0


def _onto_surface(tree: Tree, rows: Floats, x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Move positions onto the surface with Newton steps along the mean normal; return those that converge to f = 0.

    rows : (n, 7) splats, x y z nx ny nz r; x : (m, 3) positions
    """
    f = radius = away = np.full(len(x), np.nan)
    for _ in range(6):
        f, normal, away, radius = _field(rows, x, int(tree.head[tr.SURFACE]))
        step = np.clip(f / radius, -0.25, 0.25) * radius
        moved = x - step[:, None] * normal
        x = np.where(np.isfinite(moved), moved, x)
    f, _, away, radius = _field(rows, x, int(tree.head[tr.SURFACE]))
    return x[(np.abs(f) < 1e-5 * radius) & (away < float(tree.head[tr.TRIM]) * radius)]


def _field(rows: Floats, x: NDArray[np.float64], surface: int) -> tuple[NDArray[np.float64], ...]:
    """Return f, the unit mean normal, the distance from the mean centre of the splats, and their mean radius, at x.

    rows : (n, 7) splats, x y z nx ny nz r; x : (m, 3) positions; surface : kind, such as APSS

    All four are NaN where no support reaches.
    """
    query, splat = _over(x, rows[:, :3], rows[:, 6])
    p, n, r = np.split(rows[splat].astype(np.float64), [3, 6], axis=1)
    q = p - x[query]
    square = (q * q).sum(axis=1)
    weight = np.maximum(1 - square / r[:, 0] ** 2, 0) ** 2
    with np.errstate(invalid="ignore", divide="ignore"):
        share = weight / np.bincount(query, weight, len(x))[query]

        def mean(values: NDArray[np.float64]) -> NDArray[np.float64]:
            return np.where(
                np.bincount(query, minlength=len(x)) > 0, np.bincount(query, share * values, len(x)), np.nan
            )

        middle = np.stack([mean(q[:, c]) for c in range(3)], axis=1)
        normal = np.stack([mean(n[:, c]) for c in range(3)], axis=1)
        plane, qn, qq = (middle * normal).sum(axis=1), mean((q * n).sum(axis=1)), mean(square)
        center = (middle * middle).sum(axis=1)
        bend = 0.5 * (qn - plane) / np.maximum(qq - center, 0.25 * qq)
        f = {tr.PAPER: -plane, tr.IMLS: -qn}.get(surface, -plane - bend * (qq - 2 * center))
        return f, normal / np.linalg.norm(normal, axis=1, keepdims=True), np.sqrt(center), mean(r[:, 0])
