"""Wide nodes: the binary kd-tree is collapsed so that a ray is tested against the eight boxes of a node at once."""

from __future__ import annotations

import numpy as np

from ...engine.jit import Array, inline, kernel
from ...engine.kernels.tree import NO_CHILD, NODE, WIDTH


@inline
def _area(box: Array) -> float:
    """Return half the surface area of a box, or -1 for an empty one."""
    x, y, z = box[3] - box[0], box[4] - box[1], box[5] - box[2]
    if not (x >= 0.0 and y >= 0.0 and z >= 0.0):
        return -1.0
    return x * y + y * z + z * x


@kernel
def enclose(children: Array, leaf_of: Array, tight: Array, boxes: Array) -> None:
    """Compute the boxes of all nodes of a binary tree, bottom-up from the boxes of its leaves; write them to `boxes`.

    children : (nodes, 2), the children of each node, -1 for a leaf
    leaf_of : (nodes,), number of the leaf at a leaf node
    tight : (leaves, 6), boxes of the leaves
    boxes : output, (nodes, 6) float64, lo x y z, hi x y z
    """
    for node in range(len(children) - 1, -1, -1):
        box = boxes[node]
        if children[node, 0] < 0:
            box[:] = tight[leaf_of[node]]
            continue
        a, b = boxes[children[node, 0]], boxes[children[node, 1]]
        for c in range(3):
            box[c] = min(a[c], b[c])
            box[3 + c] = max(a[3 + c], b[3 + c])


@kernel
def collapse(children: Array, leaf_of: Array, boxes: Array, out: tuple[Array, Array]) -> int:
    """Collapse a binary tree into nodes of eight children; return the number of these wide nodes.

    A wide node starts with one binary node; the member with the largest surface area is replaced by its two children
    until there are eight.

    children : (nodes, 2), the children of each binary node, -1 for a leaf
    leaf_of : (nodes,), number of the leaf at a leaf node; boxes : (nodes, 6), boxes of the binary nodes
    out : (boxes, children), 48 numbers (the children's boxes) and 8 numbers (the children) for each wide node
    """
    wide_boxes, wide_children = out
    pending = np.empty(len(children) + 1, np.int32)  # the binary node of each wide node
    pending[0] = 0
    total, node = 1, 0
    members = np.empty(WIDTH, np.int32)
    while node < total:
        members[0] = pending[node]
        count = 1
        while count < WIDTH:
            best, largest = -1, -1.0
            for k in range(count):
                if children[members[k], 0] >= 0 and _area(boxes[members[k]]) > largest:
                    best, largest = k, _area(boxes[members[k]])
            if best < 0:
                break
            opened = members[best]
            members[best] = children[opened, 0]
            members[count] = children[opened, 1]
            count += 1
        for k in range(WIDTH):
            empty = k >= count or _area(boxes[members[k]]) < 0.0
            for c in range(3):
                wide_boxes[node * NODE + c * WIDTH + k] = np.inf if empty else boxes[members[k], c]
                wide_boxes[node * NODE + (3 + c) * WIDTH + k] = -np.inf if empty else boxes[members[k], 3 + c]
            if empty:
                wide_children[node * WIDTH + k] = NO_CHILD
            elif children[members[k], 0] < 0:
                wide_children[node * WIDTH + k] = ~leaf_of[members[k]]
            else:
                wide_children[node * WIDTH + k] = total
                pending[total] = members[k]
                total += 1
        node += 1
    return total
