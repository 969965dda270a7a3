"""Construction of the tree from splats: all steps in one file."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.arrays import Flags, Floats
from ...base.choices import SURFACES, number_of
from ...cloud.neighbors import kd_order
from ...cloud.statistics import quantize
from ...engine.jit import run
from ...engine.kernels import tree as tr
from ...engine.kernels.tree import Tree
from .blocks import make_blocks
from .leaves import fill_groups, fill_leaves, limits_of, longest_step
from .settings import TreeSettings
from .subtrees import build_cells
from .top import Top, cut_top, groups_of
from .wide import collapse, enclose


class Splats(NamedTuple):
    """Splats from which a tree is built: points with normals and support radii.

    positions : (n, 3) float32, relative to the points' origin
    normals : (n, 3) float32, unit
    radii : (n,) float32, support radii, in the unit of the positions
    rows : (n,) int32, the caller's row of each splat
    colors : (n, 3) uint8, sRGB, or None
    borders : (n, 3) float32, outward direction for splats on an open border, else zero; None if all are zero
    sheets : (n,) int8, 1 for splats with an opposite sheet close by, else 0; None if all are zero
    noise : (n,) float32, standard deviation of the noise that was smoothed away, at most the radius; None if none was
    """

    positions: Floats
    normals: Floats
    radii: Floats
    rows: NDArray[np.int32]
    colors: NDArray[np.uint8] | None
    borders: Floats | None = None
    sheets: NDArray[np.int8] | None = None
    noise: Floats | None = None


class WholeModel(NamedTuple):
    """Parameters of the whole model for the tree of a part, so that rays get the same hits as in the whole tree.

    top : the nodes above the part's voxels, cut as in the whole tree; groups of blocks are numbered within the part
    bounds : (6,) float32, box around all supports, lo x y z, hi x y z; t is measured from where a ray enters it
    reference : 2% quantile of the support radii of the model; the sample distance of each leaf is that for this radius
        times a power of two
    """

    top: Top
    bounds: Floats
    reference: float


def build_tree(
    splats: Splats,
    settings: TreeSettings,
    threads: int | None = None,
    progress: Callable[[float], None] | None = None,
    in_order: bool = False,
    whole: WholeModel | None = None,
) -> Tree:
    """Build the tree of a model (paper, parts III and IV).

    Four splats make a block. Space is cut into voxels that list every block with a splat over them. In each voxel a
    conservative test bounds where the surface can be, for the whole voxel and for each column. The tight boxes of the
    voxels are gathered into nodes of eight.

    Parameters
    ----------
    splats : Splats
    settings : TreeSettings
        Kind of surface, samples along rays, how far hits may be from splats, width of voxels.
    threads : int, optional
    progress : callable, optional
        Called with the fraction completed, 0 to 1.
    in_order : bool
        Whether the splats are already in `kd_order` or in another order that keeps neighbours together.
    whole : WholeModel, optional
        Parameters of the whole model if the splats are only a part of it. The splats must be in kd order, in whole
        groups of 256 (64 blocks), as `whole.top` refers to these by number. None: the splats are the whole model.
    """
    report = progress or (lambda share: None)
    n = len(splats.radii)
    order = np.arange(n, dtype=np.int32) if in_order else kd_order(splats.positions, threads)
    report(0.3)
    blocks, bounds = make_blocks(splats.positions, splats.normals, splats.radii, order, threads)
    report(0.4)
    step = longest_step(settings.samples)
    if whole is None:
        top = cut_top(groups_of(blocks, bounds, threads), step)
        whole = WholeModel(top, bounds_of(splats), reference_of(splats.radii))
    cells = build_cells(blocks, whole.top, settings.leaf_width, step, threads)
    report(0.7)

    nodes = np.flatnonzero(cells.children[:, 0] < 0).astype(np.int32)
    leaves = np.zeros(len(nodes) * tr.LEAF, np.float32)
    tight = np.empty((len(nodes), 6))
    patches = np.empty(len(nodes) * tr.PATCH, np.float32)
    chosen = (limits_of(settings.surface, settings.trim), settings.samples, whole.reference, int(settings.cut))
    marks = _borders(order, splats.borders, len(bounds)), _facing(order, splats, len(bounds))
    out = nodes, leaves, patches, tight
    run(fill_leaves, -(-len(nodes) // 64), cells, blocks, marks, chosen, out, threads=threads)
    full = tight[:, 0] <= tight[:, 3]
    report(0.9)

    counts = np.where(full, -(-np.diff(cells.spans[nodes], axis=1)[:, 0] // 16), 0)
    spans = np.empty((len(nodes), 2), np.int32)
    spans[:, 0], spans[:, 1] = np.cumsum(counts) - counts, counts
    groups = int(counts.sum())
    spheres, refs = np.empty(groups * tr.GROUP, np.float32), np.empty(groups * 16, np.int32)
    run(fill_groups, -(-len(nodes) // 64), cells, nodes, bounds, (spans.reshape(-1), spheres, refs), threads=threads)

    leaf_of = np.full(len(cells.children), -1, np.int32)
    leaf_of[nodes] = np.arange(len(nodes))
    node_boxes = np.empty((len(cells.children), 6))
    enclose(cells.children, leaf_of, tight, node_boxes)
    room = len(cells.children)
    wide_boxes, wide_children = np.empty(room * tr.NODE, np.float32), np.empty(room * tr.WIDTH, np.int32)
    wide = collapse(cells.children, leaf_of, node_boxes, (wide_boxes, wide_children))

    head = np.zeros(tr.HEAD, np.float32)
    # Bounds of supports, not boxes: the sample lattice starts where a ray enters them, independently of the tree.
    head[tr.BOUNDS : tr.BOUNDS + 6] = whole.bounds
    head[tr.SURFACE], head[tr.REFINE], head[tr.TRIM] = (
        number_of(SURFACES, settings.surface),
        settings.refine,
        settings.trim,
    )
    head[tr.OVERHANG] = settings.overhang
    head[tr.LONGEST] = leaves.reshape(-1, tr.LEAF)[:, tr.STEP].max(initial=0.0)
    report(1.0)
    return Tree(
        head,
        wide_boxes[: wide * tr.NODE].copy(),
        wide_children[: wide * tr.WIDTH].copy(),
        leaves,
        patches,
        spans.reshape(-1),
        spheres,
        refs,
        blocks,
        rows_of_slots(order, splats.rows, len(bounds)),
        *marks,
        packed_colors(order, splats.colors, len(bounds)),
        _noise(order, splats.noise, len(bounds)),
    )


def bounds_of(splats: Splats) -> Floats:
    """Return the box around the supports of all splats, (6,) lo x y z, hi x y z."""
    out = np.empty(6, np.float32)
    for c, column in enumerate(splats.positions.T):  # 8 times as fast as over rows of three
        out[c], out[3 + c] = (column - splats.radii).min(), (column + splats.radii).max()
    return out


def reference_of(radii: Floats) -> float:
    """Return the reference radius of a model: a leaf's sample distance is that for this radius times a power of two.

    It is the 2% quantile of the support radii, rounded down to few bits.
    """
    return quantize(float(np.partition(radii, len(radii) // 50)[len(radii) // 50]), is_limit=True)


def _facing(order: NDArray[np.int32], splats: Splats, slots: int) -> NDArray[np.int8]:
    """Return for each slot the splat's normal in 127ths if another sheet is close by, else zero: (3 * slots,).

    The result has length 0 if no sheets are close together.

    order : row of the splat in each slot; slots : number of slots, four per block
    """
    if splats.sheets is None or not splats.sheets.any():
        return np.zeros(0, np.int8)
    return _directions(order, splats.sheets != 0, splats.normals, slots)


def _borders(order: NDArray[np.int32], borders: Floats | None, slots: int) -> NDArray[np.int8]:
    """Return for each slot the splat's outward direction in 127ths if it is on an open border, else zero: (3 * slots,).

    The result has length 0 if no splat is on a border.

    order : row of the splat in each slot; slots : number of slots, four per block
    borders : (n, 3), outward direction (unit) for splats on an open border, else zero; None if all are zero
    """
    if borders is None or not borders.any():
        return np.zeros(0, np.int8)
    x, y, z = borders.T
    return _directions(order, (x != 0) | (y != 0) | (z != 0), borders, slots)


def _directions(order: NDArray[np.int32], chosen: Flags, directions: Floats, slots: int) -> NDArray[np.int8]:
    """Return for each slot the splat's direction in 127ths if the splat is chosen, else zero: (3 * slots,).

    order : row of the splat in each slot; slots : number of slots, four per block
    chosen : (n,), True for splats whose direction is returned
    directions : (n, 3), a unit vector for each chosen splat
    """
    out = np.zeros((slots, 3), np.int8)
    at = np.flatnonzero(chosen[order])
    out[at] = np.rint(127 * directions[order[at]])
    return out.reshape(-1)


def rows_of_slots(order: NDArray[np.int32], rows: NDArray[np.int32], slots: int) -> NDArray[np.int32]:
    """Return for each slot the caller's row of its splat, (slots,); -1 for empty slots at the end.

    order : index in `rows` of the splat in each slot; rows : (n,) the caller's row of each splat
    slots : number of slots, four per block
    """
    out = np.full(slots, -1, np.int32)
    out[: len(order)] = rows[order]
    return out


def packed_colors(order: NDArray[np.int32], colors: NDArray[np.uint8] | None, slots: int) -> NDArray[np.int32]:
    """Return the colour of each slot, (slots,) int32: r + 256 g + 65536 b; empty if the points have no colours.

    order : row of the splat in each slot; colors : (n, 3) sRGB; slots : number of slots, four per block
    """
    if colors is None:
        return np.zeros(0, np.int32)
    out = np.zeros((slots, 4), np.uint8)
    out[: len(order), :3] = colors[order]
    return out.reshape(-1).view("<i4").astype(np.int32, copy=False)


def unpacked_colors(colors: NDArray[np.int32]) -> NDArray[np.uint8]:
    """Unpack colours r + 256 g + 65536 b, (n,), to (n, 3) uint8."""
    return np.ascontiguousarray(colors.astype("<i4").view(np.uint8).reshape(-1, 4)[:, :3])


def _noise(order: NDArray[np.int32], noise: Floats | None, slots: int) -> Floats:
    """Return the largest noise of the splats in each block of four, (slots / 4,); length 0 if nothing was smoothed.

    order : row of the splat in each slot; slots : number of slots
    noise : (n,), standard deviation of the noise that was smoothed away at each splat
    """
    if noise is None or not noise.any():
        return np.zeros(0, np.float32)
    out = np.zeros(slots, np.float32)
    out[: len(order)] = noise[order]
    return np.maximum(np.maximum(out[::4], out[1::4]), np.maximum(out[2::4], out[3::4]))
