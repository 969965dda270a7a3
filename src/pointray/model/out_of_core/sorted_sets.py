"""Sets of numbers of cells, as ascending arrays.

`np.unique` and `np.isin` put such numbers into a hash table where many meet: they take 20 to 40 times as long.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Numbers = NDArray[np.int64]


def distinct_numbers(numbers: Numbers) -> Numbers:
    """Numbers, ascending, each once."""
    ordered = np.sort(numbers)
    return ordered[np.append(True, ordered[1:] != ordered[:-1])] if len(ordered) else ordered


def among(known: Numbers, numbers: Numbers) -> NDArray[np.bool_]:
    """Which numbers are known. known : ascending, at least one"""
    return np.asarray(known[np.minimum(np.searchsorted(known, numbers), len(known) - 1)] == numbers)
