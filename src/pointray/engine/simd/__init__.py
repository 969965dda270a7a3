"""Vector types of the kernels: 4, 8 or 16 numbers (lanes) that one instruction processes together.

The types are LLVM vectors (<16 x float>, <8 x float>, <4 x float>, <8 x double>, <16 x i32>, <8 x i32>), which LLVM
splits into registers of the processor. A comparison returns a mask; `bits` converts it to an integer, whose set bits
are iterated with `count_trailing_zeros`. Arithmetic with a scalar broadcasts it to all lanes.

vector : types and operators; lanes : operations per lane and across lanes; doubles : float64;
memory : loads and stores; gather : loads from 16 places

Begin with vector.
"""

from __future__ import annotations

import numpy as np

from ..jit import later

LATER = "doubles", "gather", "lanes", "memory", "vector"
ZERO, ONE, INF = np.float32(0.0), np.float32(1.0), np.float32(np.inf)

__all__ = [
    "Bits",
    "D8",
    "F16",
    "F8",
    "I16",
    "I8",
    "INF",
    "Mask",
    "ONE",
    "Real",
    "ZERO",
    "bit_fields",
    "bits",
    "columns",
    "count_bits",
    "count_where",
    "float_bits",
    "first_quarter",
    "fours",
    "join2",
    "join4",
    "gather16",
    "gather_rows8",
    "reduce_max",
    "lane",
    "last_quarter",
    "reduce_min",
    "load16",
    "load16_int",
    "load4",
    "load_apart16",
    "load8",
    "load8_double",
    "permute16",
    "count_trailing_zeros",
    "mask16",
    "move4",
    "narrow",
    "one_bit",
    "pack",
    "power_of_two",
    "prefetch",
    "quarters",
    "repeat4",
    "select",
    "shift_lane",
    "shift_quarter",
    "broadcast16",
    "broadcast8",
    "broadcast_from",
    "square_sum",
    "store",
    "store_packed",
    "sum_over_lanes",
    "sum_over_quarters",
    "sums_of_fours",
    "third_quarter",
    "vabs",
    "vmax",
    "vmin",
    "vsqrt",
    "trunc",
    "widen_high",
    "widen_low",
    "zeros16",
    "zeros8",
]

_VALUES = "ZERO", "ONE", "INF", "Bits", "Mask", "Real"  # the last three occur in annotations only, see `__init__.pyi`
_NAMES = [name for name in __all__ if name not in _VALUES]
globals().update(zip(_NAMES, later(__name__, LATER, *_NAMES), strict=True))
Bits, Mask, Real = int, object, object
