"""One thread's working memory: where a ray or a tile of rays keeps what it knows on its way."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .jit import borrow, inline
from .records import Array

# A tile: 16 rays that are traced together. Its rows hold one number of each ray.
LANES = 16
DIRECTION, ORIGIN = 0, 3 * LANES  # world, float64, 3 rows each: the ray as asked for
T_MIN, NEAREST = 6 * LANES, 7 * LANES  # where it begins; the nearest hit so far, at first where it ends
NORMAL, COLOR, LOCAL = 8 * LANES, 11 * LANES, 14 * LANES  # of that hit, 3 rows each
# The ray in the current model: where it begins and its unit direction, 3 rows each; the length that the direction had
# before; where it enters and leaves the bounds.
START, HEADING, SPEED, LOW, HIGH = 17 * LANES, 20 * LANES, 23 * LANES, 24 * LANES, 25 * LANES
WORLD_ROWS = 26
INSTANCE_OF, LEAF_OF = 0, LANES  # int64: of the nearest hit, -1 for none
FOUND = 2 * LANES  # leaf of the hit in the current model, -1 for none
NUMBER_ROWS = 3
# float32: the rays in the current model, see `Ray`, and what is computed of them at a leaf.
OX, OY, OZ, DX, DY, DZ, IX, IY, IZ = (k * LANES for k in range(9))
LENGTH = 9 * LANES  # where its nearest hit in this model is, at first where it ends; below 0 where it misses the bounds
NX, NY, NZ = 10 * LANES, 11 * LANES, 12 * LANES  # unit normal of that hit
ENTER, LEAVE, FIRST, LAST = 13 * LANES, 14 * LANES, 15 * LANES, 16 * LANES
END = 17 * LANES  # where it ends, whatever it hits: what is found in one leaf must not depend on what was in another
MODEL_ROWS = 18

COUNT_NEAR = 0  # blocks listed near the current ray
COUNT_NODES, COUNT_LEAVES = 1, 2  # visited
COUNT_PART = 3  # the sample of the last secant step behind the crossing, 1..3; 0: not between two of them


class Scratch(NamedTuple):
    """One thread's working memory.

    stack : (512,) int32, children still to visit; stack_near : (512,) float32, where the ray enters them
    near : (n,) int32, blocks near the ray in the current leaf; counts : (8,) int64, see COUNT_*
    lift : (1,) float32, the start rule's state, see `trace/leaf.py`
    means : (160,) float32, the weighted means at the four samples of the last secant step, 16 lanes each
    world, model, numbers : the rows of a tile, float64, float32 and int64
    """

    stack: Array
    stack_near: Array
    near: Array
    counts: Array
    lift: Array
    means: Array
    world: Array
    model: Array
    numbers: Array


@inline
def new_scratch(longest):  # type: ignore[no-untyped-def]
    """Working memory for models whose longest leaf knows `longest` blocks."""
    return Scratch(
        np.empty(512, np.int32),
        np.empty(512, np.float32),
        np.empty(longest + 16, np.int32),
        np.zeros(8, np.int64),
        np.zeros(1, np.float32),
        np.zeros(160, np.float32),
        np.zeros(WORLD_ROWS * LANES, np.float64),
        np.zeros(MODEL_ROWS * LANES, np.float32),
        np.zeros(NUMBER_ROWS * LANES, np.int64),
    )


@inline
def lend_scratch(s):  # type: ignore[no-untyped-def]
    """The working memory without references to it (see `jit.borrow`): the kernel must `keep` the original."""
    return Scratch(
        borrow(s.stack),
        borrow(s.stack_near),
        borrow(s.near),
        borrow(s.counts),
        borrow(s.lift),
        borrow(s.means),
        borrow(s.world),
        borrow(s.model),
        borrow(s.numbers),
    )
