"""LZF, by which PCL packs PCD files: runs of literal bytes, and copies of what was unpacked before."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....engine.jit import Array, i64, kernel

LARGEST_RATIO = 88  # three bytes stand for at most 264
CUT_OFF, TOO_LONG, BEFORE_START = -1, -2, -3
WRONG = {
    CUT_OFF: "ends within a run",
    TOO_LONG: "holds more than it announces",
    BEFORE_START: "refers to what is before its beginning",
}


@kernel
def _unpack(packed: Array, out: Array) -> tuple[int, int]:
    """Returns (bytes unpacked, bytes read), or (CUT_OFF, TOO_LONG or BEFORE_START, where in `packed`).

    packed, out : (n,) uint8
    """
    at, filled = 0, 0
    while at < len(packed):
        control = i64(packed[at])
        at += 1
        if control < 32:
            length = control + 1
            if length > len(packed) - at:
                return CUT_OFF, at
            if length > len(out) - filled:
                return TOO_LONG, at
            for k in range(length):
                out[filled + k] = packed[at + k]
            at += length
        else:
            length = control >> 5
            more = 2 if length == 7 else 1
            if more > len(packed) - at:
                return CUT_OFF, at
            if length == 7:
                length += i64(packed[at])
            back = ((control & 31) << 8 | i64(packed[at + more - 1])) + 1
            at += more
            length += 2
            if back > filled:
                return BEFORE_START, at
            if length > len(out) - filled:
                return TOO_LONG, at
            for k in range(filled, filled + length):  # one after the other: a copy may overlap what it copies
                out[k] = out[k - back]
        filled += length
    return filled, at


def unpack(packed: NDArray[np.uint8], size: int, start: int) -> NDArray[Any]:
    """What is packed, (size,) uint8; ValueError if that is damaged.

    start : where it begins in the file, for messages
    """
    if size > LARGEST_RATIO * len(packed):
        raise ValueError(f"is damaged at byte {start:,}: {len(packed):,} packed bytes cannot hold {size:,}")
    out = np.empty(size, np.uint8)
    filled, at = _unpack(packed, out)
    if filled < 0:
        raise ValueError(f"is damaged at byte {start + at:,}: the packed data {WRONG[filled]}")
    if filled < size:
        raise ValueError(f"is damaged: {size:,} unpacked bytes are announced, {filled:,} are there")
    return out
