"""Selection of splats: greedily by newly covered area, then relaxed to fewer globally (Wu and Kobbelt 2004).

The relaxation removes a splat and splats next to it, and covers the bare points again with no more splats than before.
It keeps the new splats even if their number is equal: splats push each other apart until one becomes unnecessary.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ...engine.jit import Array, cancelled, f32, f64, i32, inline, kernel, routine, run, u64
from .grow import Cloud, Splats
from .priority_queue import pop, push

CROWD = 6  # splats removed at once: 10 and 16 give no improvement
NOISE = 0.1  # maximum random increase of a gain, relative: 0.05 gives the same result, 0.3 a worse one
PASSES = 8  # over all splats: 13.4% fewer splats on the statue; four passes: 10.7%

Over: TypeAlias = tuple[Array, Array]  # the splats over each point: heads and owners, see `_invert`
Cover: TypeAlias = tuple[Array, Array]  # number of chosen splats over each point; mask of chosen splats
Seen: TypeAlias = tuple[Array, int]  # last mark of each splat; mark of this traversal


@kernel
def _choose(work: Array, splats: Splats, area: Array, times: Array) -> Array:
    """Choose the splat that newly covers the largest area, until all points are covered; return the chosen rows.

    splats : candidates, and the points that each covers; area : (n,) area that each point represents
    times : (n,) number of chosen splats over each point, updated
    """
    keys, rows = np.empty(len(splats.seeds), np.float32), np.empty(len(splats.seeds), np.int32)
    size = number = 0
    for s in range(len(splats.seeds)):
        size = push(keys, rows, size, -_gain(splats, s, area, times), i32(s))
    chosen = np.empty(len(splats.seeds), np.int32)
    while size > 0 and not cancelled(work):
        s = rows[0]
        size = pop(keys, rows, size)
        key = -_gain(splats, s, area, times)
        if key < 0.0 and (size == 0 or key <= keys[0]):
            chosen[number] = s
            number += 1
            _count(splats, s, times, 1)
        elif key < 0.0:
            size = push(keys, rows, size, key, s)
    return chosen[:number].copy()


@inline
def _gain(splats: Splats, s: int, area: Array, times: Array) -> float:
    """Return the area that splat s would newly cover.

    area : (n,) area that each point represents; times : (n,) number of chosen splats over each point
    """
    gain = f32(0.0)
    for k in range(splats.starts[s], splats.starts[s + 1]):
        gain += area[splats.members[k]] if times[splats.members[k]] == 0 else f32(0.0)
    return gain


@inline
def _count(splats: Splats, s: int, times: Array, change: int) -> None:
    """Add `change` (1 or -1) to `times`, the number of chosen splats over each point, where splat s covers it."""
    for k in range(splats.starts[s], splats.starts[s + 1]):
        times[splats.members[k]] += change


def choose(pool: Splats, cloud: Cloud, times: NDArray[np.int32]) -> NDArray[np.int32]:
    """Choose splats of a pool greedily, by newly covered area, until each point is covered; return their rows.

    times : (n,) number of splats over each point, 0 where a splat is needed; updated with the chosen splats
    """
    return np.asarray(run(_choose, 1, pool, cloud.area, times)[0])


@kernel
def _invert(work: Array, splats: Splats, heads: Array, owners: Array) -> None:
    """List the splats over each point p in owners[heads[p] : heads[p + 1]]. heads : (n + 2,), initially zero"""
    n = len(heads) - 2
    for p in splats.members:
        heads[p + 2] += 1
    for p in range(n):
        heads[p + 2] += heads[p + 1]
    for s in range(len(splats.seeds)):
        for k in range(splats.starts[s], splats.starts[s + 1]):
            p = splats.members[k] + 1
            owners[heads[p]] = s
            heads[p] += 1


@inline
def _random(state: Array) -> float:
    """Return a random number from 0 to 1 (xorshift). state : (1,) uint64, updated"""
    x = state[0]
    x ^= x << u64(13)
    x ^= x >> u64(7)
    x ^= x << u64(17)
    state[0] = x
    return f32(f64(x >> u64(11)) * 2.0**-53)


@routine
def _take_away(
    splats: Splats, over: Over, s: int, cover: Cover, seen: Seen, crowd: Array, bare: Array
) -> tuple[int, int]:
    """Remove the chosen splat s and up to 5 chosen splats that share points with it, to cover their points anew.

    over : the splats that cover each point: start of each point's splats in a list, and this list of rows
    cover : number of chosen splats over each point, and mask of chosen splats; both are updated
    seen : for each splat the number of the last search that visited it, updated; and the number of this search
    crowd, bare : outputs, rows of the removed splats, and of the points left uncovered

    Returns the number of splats removed and the number of uncovered points.
    """
    times, on = cover
    met, mark = seen
    crowd[0], number = s, 1
    met[s] = mark
    for k in range(splats.starts[s], splats.starts[s + 1]):
        p = splats.members[k]
        for t in range(over[0][p], over[0][p + 1]):
            q = over[1][t]
            if on[q] and met[q] != mark and number < CROWD:
                met[q] = mark
                crowd[number] = q
                number += 1
    count = 0
    for r in range(number):
        on[crowd[r]] = False
        for k in range(splats.starts[crowd[r]], splats.starts[crowd[r] + 1]):
            p = splats.members[k]
            times[p] -= 1
            if times[p] == 0:
                bare[count] = p
                count += 1
    return number, count


@routine
def _gains(over: Over, area: Array, bare: Array, seen: Seen, gain: Array, found: Array) -> int:
    """List in `found` the splats that cover any of the uncovered points `bare`; return their number.

    over : the splats that cover each point: start of each point's splats in a list, and this list of rows
    area : (n,) area that each point represents
    seen : for each splat the number of the last search that visited it, updated; and the number of this search
    gain : output, the area of these points that each listed splat would cover
    """
    met, mark = seen
    count = 0
    for p in bare:
        for t in range(over[0][p], over[0][p + 1]):
            q = over[1][t]
            if met[q] != mark:
                met[q], gain[q], found[count] = mark, 0.0, q
                count += 1
            gain[q] += area[p]
    return count


@routine
def _best(gain: Array, found: Array, count: int, state: Array) -> tuple[int, int]:
    """Return the splat with the largest gain, -1 if none has a gain, and the number of candidates that have one.

    gain : area that each splat would newly cover; a random increase of up to 10% varies the choice
    found : rows of the candidates, the first `count`; those without a gain are removed
    state : of the random numbers, updated
    """
    best, most, left = -1, f32(0.0), 0
    for t in range(count):
        q = found[t]
        if gain[q] > f32(1e-30):
            found[left] = q
            left += 1
            g = gain[q] * (f32(1.0) + f32(NOISE) * _random(state))
            if g > most:
                best, most = q, g
    return best, left


@routine
def _cover_again(
    splats: Splats,
    over: Over,
    area: Array,
    cover: Cover,
    gain: Array,
    found: Array,
    room: tuple[int, int, int, Array, Array],
) -> tuple[int, int]:
    """Choose splats greedily for the uncovered points, no more than were removed before.

    over : the splats that cover each point: start of each point's splats in a list, and this list of rows
    area : (n,) area that each point represents
    cover : number of chosen splats over each point, and mask of chosen splats; both are updated
    gain : area that each splat would newly cover, updated
    found : rows of the candidates, updated
    room : number of candidates, number of uncovered points, number of splats removed, state of the random numbers, and
        an output for the rows of the splats added

    Returns the number of splats added and the number of points still uncovered.
    """
    times, on = cover
    count, left, most, state, added = room
    number = 0
    while left > 0 and number < most:
        best, count = _best(gain, found, count, state)
        if best < 0:
            break
        added[number], on[best] = best, True
        number += 1
        for k in range(splats.starts[best], splats.starts[best + 1]):
            p = splats.members[k]
            if times[p] == 0:
                left -= 1
                for t in range(over[0][p], over[0][p + 1]):
                    gain[over[1][t]] -= area[p]
            times[p] += 1
        gain[best] = 0.0
    return number, left


@kernel
def _relax(
    work: Array, splats: Splats, over: Over, area: Array, cover: Cover, order: Array, most: int, seed: int
) -> int:
    """Remove a few splats around each splat of `order` and cover their points again, with fewer if possible.

    splats : candidates, and the points that each covers
    over : the splats that cover each point: start of each point's splats in a list, and this list of rows
    area : (n,) area that each point represents
    cover : number of chosen splats over each point, and mask of chosen splats; both are updated
    order : rows of chosen splats
    most : number of splats saved at which to stop
    seed : of random numbers

    Returns the number of splats saved.
    """
    times, on = cover
    met = np.full(len(on), -1, np.int32)
    gain, found = np.zeros(len(on), np.float32), np.empty(len(on), np.int32)
    crowd, added, bare = np.empty(CROWD, np.int32), np.empty(CROWD, np.int32), np.empty(len(times), np.int32)
    state = np.full(1, seed, np.uint64)
    won = 0
    for step in range(len(order)):
        if won >= most or cancelled(work):
            break
        if not on[order[step]]:
            continue
        number, count = _take_away(splats, over, order[step], cover, (met, i32(2 * step)), crowd, bare)
        listed = _gains(over, area, bare[:count], (met, i32(2 * step + 1)), gain, found)
        room = (listed, count, number, state, added)
        new, left = _cover_again(splats, over, area, cover, gain, found, room)
        if left == 0 and won + number - new <= most:
            won += number - new
        else:
            for r in range(new):
                on[added[r]] = False
                _count(splats, added[r], times, -1)
            for r in range(number):
                on[crowd[r]] = True
                _count(splats, crowd[r], times, 1)
    return won


def relax(
    pool: Splats, cloud: Cloud, rows: NDArray[Any], goal: int = 0, passes: int = PASSES, progress: Any = None
) -> NDArray[np.int64]:
    """Return the rows of fewer splats of a pool that together cover the same points as those in `rows`.

    pool : candidates, and the points of the cloud that each covers
    goal : number of splats at which to stop
    passes : maximum number of passes over all splats, which end when no splat is saved

    Each pass removes splats with their neighbours and covers the points again (Wu and Kobbelt 2004).
    """
    n, number = len(cloud.positions), len(rows)
    over = np.zeros(n + 2, np.int64), np.empty(len(pool.members), np.int32)
    run(_invert, 1, pool, *over)
    on = np.zeros(len(pool.seeds), np.bool_)
    on[rows] = True
    times = np.bincount(pool.pick(rows).members, minlength=n).astype(np.int32)
    draw = np.random.default_rng(number)
    for k in range(passes):
        if progress is not None:
            progress("relaxation", k / passes)
        order, seed = draw.permutation(np.flatnonzero(on)), np.uint64(draw.integers(1, 2**63))
        won = run(_relax, 1, pool, over, cloud.area, (times, on), order, number - goal, seed)[0]
        number -= won
        if number <= goal or won == 0:
            break
    return np.flatnonzero(on)
