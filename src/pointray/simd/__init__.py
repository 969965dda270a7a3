"""The vector type of the kernels: 4, 8 or 16 numbers, its lanes, that one instruction handles together.

Vectors are LLVM's own (<16 x float>, <8 x float>, <4 x float>, <16 x i32>); LLVM splits them into what the processor
has. A comparison gives a mask, `bits` turns a mask into an integer whose set bits are walked with
`count_trailing_zeros`. Arithmetic with a scalar broadcasts it to all lanes.

vector : the type and its operators; lanes : operations lane by lane and across; memory : loads and stores

Begin with vector.
"""

from __future__ import annotations

from .lanes import (
    bit_fields,
    bits,
    broadcast8,
    broadcast16,
    columns,
    count_bits,
    count_trailing_zeros,
    first_quarter,
    float_bits,
    fours,
    lane,
    last_quarter,
    mask16,
    power_of_two,
    quarters,
    reduce_max,
    reduce_min,
    select,
    shift_lane,
    shift_quarter,
    sum_over_quarters,
    sums_of_fours,
    third_quarter,
    trunc,
    vabs,
    vmax,
    vmin,
    vsqrt,
)
from .memory import (
    broadcast_from,
    load8,
    load16,
    load16_int,
    move4,
    pack,
    permute16,
    prefetch,
    repeat4,
    store,
    store_packed,
)
from .vector import F8, F16, I16, INF, ONE, ZERO, Bits, Mask, Real

__all__ = [
    "Bits",
    "F16",
    "F8",
    "I16",
    "INF",
    "Mask",
    "ONE",
    "Real",
    "ZERO",
    "bit_fields",
    "bits",
    "columns",
    "count_bits",
    "float_bits",
    "first_quarter",
    "fours",
    "reduce_max",
    "lane",
    "last_quarter",
    "reduce_min",
    "load16",
    "load16_int",
    "load8",
    "permute16",
    "count_trailing_zeros",
    "mask16",
    "move4",
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
    "store",
    "store_packed",
    "sum_over_quarters",
    "sums_of_fours",
    "third_quarter",
    "vabs",
    "vmax",
    "vmin",
    "vsqrt",
    "trunc",
]
