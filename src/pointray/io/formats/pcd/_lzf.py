"""LZF, the compression of PCD files: runs of literal bytes, and copies of earlier output."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....engine.jit import Array, i64, kernel

LARGEST_RATIO = 88  # three bytes expand to at most 264
CUT_OFF, TOO_LONG, BEFORE_START = -1, -2, -3
WRONG = {
    CUT_OFF: "end within a run",
    TOO_LONG: "contain more than announced",
    BEFORE_START: "refer to bytes before their beginning",
}


@kernel
def _unpack(packed: Array, out: Array) -> tuple[int, int]:
    """Decompress LZF; return (bytes unpacked, bytes read), or an error and its offset in `packed`.

    The error is CUT_OFF, TOO_LONG or BEFORE_START, negative numbers.

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
            for k in range(filled, filled + length):  # byte by byte: source and target may overlap
                out[k] = out[k - back]
        filled += length
    return filled, at


def unpack(packed: NDArray[np.uint8], size: int, start: int) -> NDArray[Any]:
    """Decompress LZF, (n,) uint8, to (size,) uint8; raise ValueError if the data are damaged.

    start : offset of the data in the file, for messages
    """
    if size > LARGEST_RATIO * len(packed):
        raise ValueError(f"is damaged at byte {start:,}: {len(packed):,} compressed bytes cannot contain {size:,}")
    out = np.empty(size, np.uint8)
    filled, at = _unpack(packed, out)
    if filled < 0:
        raise ValueError(f"is damaged at byte {start + at:,}: the compressed data {WRONG[filled]}")
    if filled < size:
        raise ValueError(f"is damaged: {size:,} decompressed bytes expected, {filled:,} found")
    return out
