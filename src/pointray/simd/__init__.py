"""The vector type of the kernels: `lanes` numbers that one instruction handles together.

Vectors are LLVM's own (<16 x float>, <8 x float>, <4 x float>, <16 x i32>); LLVM splits them into what the processor
has. A comparison gives a mask, `bits` turns a mask into an integer whose set bits are walked with `lowest`.
Arithmetic with a scalar spreads the scalar over all lanes.
"""

from __future__ import annotations

from .lanes import (
    bits,
    count_bits,
    first_quarter,
    float_bits,
    fours,
    greatest,
    lane,
    last_quarter,
    least,
    lowest,
    mask16,
    quarters,
    select,
    shift_lane,
    shift_quarter,
    spread8,
    spread16,
    sum_over_quarters,
    vabs,
    vmax,
    vmin,
    vsqrt,
    whole,
)
from .memory import (
    load8,
    load16,
    look_up16,
    move4,
    pack,
    prefetch,
    repeat4,
    spread_from,
    store,
    store_packed,
)

__all__ = [
    "bits",
    "count_bits",
    "float_bits",
    "first_quarter",
    "fours",
    "greatest",
    "lane",
    "last_quarter",
    "least",
    "load16",
    "load8",
    "look_up16",
    "lowest",
    "mask16",
    "move4",
    "pack",
    "prefetch",
    "quarters",
    "repeat4",
    "select",
    "shift_lane",
    "shift_quarter",
    "spread16",
    "spread8",
    "spread_from",
    "store",
    "store_packed",
    "sum_over_quarters",
    "vabs",
    "vmax",
    "vmin",
    "vsqrt",
    "whole",
]
