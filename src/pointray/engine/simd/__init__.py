"""Vector types of the kernels: 4, 8 or 16 numbers (lanes) that one instruction processes together.

The types are LLVM vectors (<16 x float>, <8 x float>, <4 x float>, <8 x double>, <16 x i32>, <8 x i32>), which LLVM
splits into registers of the processor. A comparison returns a mask; `bits` converts it to an integer, whose set bits
are iterated with `count_trailing_zeros`. Arithmetic with a scalar broadcasts it to all lanes.

vector : types and operators; lanes : operations per lane and across lanes; doubles : float64;
memory : loads and stores; gather : loads from 16 places

Begin with vector.
"""

from __future__ import annotations

import importlib
import re
from pathlib import Path
from typing import Any

import numpy as np

from ..jit import later
from ..jit.decorators import Later

LATER = "doubles", "gather", "lanes", "memory", "vector"
ZERO, ONE, INF = np.float32(0.0), np.float32(1.0), np.float32(np.inf)
Bits, Mask, Real = int, object, object  # occur in annotations only, see `__init__.pyi`


class _ByWidth(Later):
    """Placeholder of one of several device functions, chosen by the lanes of a register when a kernel is compiled."""

    def __init__(self, by_lanes: dict[int, Any]) -> None:
        self._by_lanes = by_lanes

    @property
    def real(self) -> Any:
        return self._by_lanes[importlib.import_module(f"{__name__}.memory").WIDTH]


def by_width(whole: Any, halves: Any, quarters: Any) -> Any:
    """Return a device function that is `whole` where a register holds 16 float32, `halves` for 8, `quarters` for 4.

    All three have the same parameters and results. Loops whose vectors fill more registers than a processor has are
    written for any number of lanes, and called for parts of 16 lanes.
    """
    return _ByWidth({16: whole, 8: halves, 4: quarters})


_STUB = Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8")
_NAMES = dict.fromkeys(re.findall(r"^(?:def|class) (?!_|Mask|by_width)(\w+)", _STUB, re.MULTILINE))
globals().update(zip(_NAMES, later(__name__, LATER, *_NAMES), strict=True))
