"""Search for the k nearest points of a single query: the tree is traversed nearest box first."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np

from ...engine.jit import Array, f32, f64, i64, inline, routine
from ...engine.simd import ZERO, bits, broadcast16, count_trailing_zeros, load16, square_sum, store, vmax
from .sites import BLOCK, LANES, NODE

AT_PLACE = 16  # blocks examined at least, even if k points at the query's position are known
STACK = 16 * LANES  # capacity for nodes; a tree of 2^31 points needs 7 levels of 15
LESS, MORE = 1.0 - 1e-6, 1.0 + 1e-6  # a float32 square times these is surely below, and above, the exact value

Query: TypeAlias = tuple[float, float, float]  # float32, scaled like the points
Tree: TypeAlias = tuple[Array, Array, Array, Array]  # blocks, numbers, nodes, starts: see `Blocks` and `Boxes`
Best: TypeAlias = tuple[Array, Array, Array, Array]  # squares, numbers, squares of boxes on the stack, 16 lanes


@inline
def _push(tree: Tree, level: int, j: int, q: Query, limit: float, depth: int, stack: Array, best: Best) -> int:
    """Push the children of a tree node whose boxes are within a limit of query q, nearest last; return the stack depth.

    tree : blocks of 16 points, their numbers, nodes of bounding boxes, first node of each level
    level, j : level of the node, 0 for the lowest, and its index there
    limit : squared distance
    stack : (m, 2) receives level and index of the children; level -1 is a block of points
    best : its third array receives their squared distances
    """
    nodes, starts, squares, lanes = tree[2], tree[3], best[2], best[3]
    at, none = (starts[level] + j) * NODE, broadcast16(ZERO)
    x = vmax(vmax(load16(nodes, at) - q[0], q[0] - load16(nodes, at + 48)), none)
    y = vmax(vmax(load16(nodes, at + 16) - q[1], q[1] - load16(nodes, at + 64)), none)
    z = vmax(vmax(load16(nodes, at + 32) - q[2], q[2] - load16(nodes, at + 80)), none)
    square = x * x + y * y + z * z
    store(lanes, 0, square)
    near, begin = bits(square <= f32(min(limit * MORE, 3e38))), depth
    while near != 0:
        c = count_trailing_zeros(near)
        near &= near - 1
        k, value = depth, f64(lanes[c]) * LESS
        while k > begin and squares[k - 1] < value:
            squares[k], stack[k, 0], stack[k, 1] = squares[k - 1], stack[k - 1, 0], stack[k - 1, 1]
            k -= 1
        squares[k], stack[k, 0], stack[k, 1] = value, level - 1, j * LANES + c
        depth += 1
    return depth


@inline
def _insert(square: float, number: int, count: int, k: int, best: Best) -> int:
    """Insert a point into the list of the k nearest if it belongs there; return the list's length.

    square, number : the point's squared distance and its number, which decides between equal distances
    count : length of the list so far
    best : its first two arrays hold squared distances and numbers, nearest first
    """
    squares, numbers = best[0], best[1]
    if count == k:
        if square > squares[k - 1] or (square == squares[k - 1] and number > numbers[k - 1]):
            return count
        count -= 1
    i = count
    while i > 0 and (squares[i - 1] > square or (squares[i - 1] == square and numbers[i - 1] > number)):
        squares[i], numbers[i] = squares[i - 1], numbers[i - 1]
        i -= 1
    squares[i], numbers[i] = square, number
    return count + 1


@routine
def search_alone(tree: Tree, q: Query, k: int, stack: Array, best: Best) -> float:
    """Write the k nearest points of query q to `best`, nearest first; return the squared distance of the farthest.

    There must be at least k points. If hundreds coincide with the query, only some of them are examined, in any order.

    tree : blocks of 16 points, their numbers, nodes of bounding boxes, first node of each level
    stack : memory for nodes
    best : receives squared distances and numbers; the rest is memory for the search
    """
    blocks, numbers = tree[0], tree[1]
    stack[0, 0], stack[0, 1], best[2][0] = len(tree[3]) - 2, 0, 0.0
    depth, count, worst, examined = 1, 0, np.inf, 0
    while depth > 0:
        depth -= 1
        if best[2][depth] > worst or (worst == 0.0 and examined >= AT_PLACE):
            continue
        level, j = stack[depth, 0], stack[depth, 1]
        if level >= 0:
            depth = _push(tree, level, j, q, worst, depth, stack, best)
            continue
        at, examined = j * BLOCK, examined + 1
        x, y, z = load16(blocks, at) - q[0], load16(blocks, at + 16) - q[1], load16(blocks, at + 32) - q[2]
        near = bits(x * x + y * y + z * z <= f32(min(worst * MORE, 3e38)))
        while near != 0:
            c = count_trailing_zeros(near)
            near &= near - 1
            a, b, d = f64(blocks[at + c]), f64(blocks[at + 16 + c]), f64(blocks[at + 32 + c])
            square = square_sum(a - f64(q[0]), b - f64(q[1]), d - f64(q[2]))
            count = _insert(square, i64(numbers[j * LANES + c]), count, k, best)
            if count == k:
                worst = best[0][k - 1]
    return worst
