"""Sets of cell numbers, as sorted arrays.

`np.unique` and `np.isin` hash such numbers with many collisions, which takes 20 to 40 times as long.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...base.arrays import Flags

Numbers = NDArray[np.int64]


def distinct_numbers(numbers: Numbers) -> Numbers:
    """Return the distinct numbers, ascending; much faster than `np.unique` for numbers of grid cells."""
    ordered = np.sort(numbers)
    return ordered[np.append(True, ordered[1:] != ordered[:-1])] if len(ordered) else ordered


def isin_sorted(known: Numbers, numbers: Numbers) -> Flags:
    """Return which numbers are in `known`, which is ascending and not empty; much faster than `np.isin`."""
    return np.asarray(known[np.minimum(np.searchsorted(known, numbers), len(known) - 1)] == numbers)
