"""Table of powers of ten for `_number_kernel`."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from ._number_kernel import HIGHEST, LOWEST


@cache
def powers_of_ten() -> NDArray[np.uint64]:
    """Return the leading 128 bits of 10^q, q from -342 to 308, as pairs of uint64 in one array.

    They are rounded down for q >= 0, up for q < 0.
    """
    rows = []
    for q in range(LOWEST, HIGHEST + 1):
        five = 5 ** abs(q)
        if q >= 0:
            value = five << 128 >> five.bit_length()
        else:
            bits = (five - 1).bit_length()
            value = (1 << (bits + 127 if q >= -27 else 2 * bits + 128)) // five + 1
        value >>= max(value.bit_length() - 128, 0)
        rows += [value >> 64, value & (2**64 - 1)]
    return np.array(rows, np.uint64)
