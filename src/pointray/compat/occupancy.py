"""Decision which positions are inside of closed surfaces, by the number of crossings of rays."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..base.arguments import check_whole, wrong
from ..base.arrays import Doubles, Flags
from ..scene.crossings import find_crossings
from ..scene.world import Snapshot

LEAST = 3  # rays that are cast even if fewer are requested: of single rays 1 of 6,000 is wrong (statue, 200,000 points)
RETRIES = 3  # other directions for a ray whose number of crossings contradicts the first one
GREATEST = 99_999  # rays


def check_samples(nsamples: Any) -> int:
    """Return a number of rays, odd and at least three; raise an error that names it if it is invalid."""
    count = check_whole(nsamples, "nsamples", 1, GREATEST)
    if count % 2 == 0:
        raise wrong("nsamples", "odd", nsamples)
    return max(count, LEAST)


def directions_of(count: int) -> Doubles:
    """Return directions of rays, (count, 3); those of a smaller count are the first ones of a greater count."""
    return np.random.default_rng(0).normal(size=(count, 3))


def is_inside(scene: Snapshot, x: Doubles, count: int, threads: int | None) -> Flags:
    """Return which positions, (n, 3), are inside of closed surfaces; those that are not finite are outside.

    count : number of rays for each position, odd; the majority decides
    """
    votes, known = np.zeros(len(x), np.int64), np.flatnonzero(np.isfinite(x).all(axis=1))
    directions = directions_of(count + RETRIES)
    for k in range(count):
        left, inside = known, np.zeros(len(x), np.bool_)
        for turn in range(RETRIES + 1):
            inside[left], agrees = _parity(scene, x[left], directions[k + turn], threads)
            left = left[~agrees]
            if not len(left):
                break
        votes += inside
    return np.asarray(2 * votes > count)


def _parity(scene: Snapshot, x: Doubles, direction: Doubles, threads: int | None) -> tuple[Flags, Flags]:
    """Return whether rays in one direction cross surfaces an odd number of times, and whether the first side agrees."""
    rays = x, np.tile(direction, (len(x), 1)), np.tile([0.0, np.inf], (len(x), 1))
    found = find_crossings(scene, (len(x),), rays, threads=threads)
    odd = np.bincount(found.ray, minlength=len(x)) % 2 == 1
    first = np.flatnonzero(np.diff(found.ray, prepend=-1))
    from_behind = np.zeros(len(x), np.bool_)
    from_behind[found.ray[first]] = ~found.entering[first]
    return odd, odd == from_behind
