"""Vector types of the kernels: 4, 8 or 16 numbers (lanes) that one instruction processes together.

The types are LLVM vectors (<16 x float>, <8 x float>, <4 x float>, <8 x double>, <16 x i32>, <8 x i32>), which LLVM
splits into registers of the processor. A comparison returns a mask; `bits` converts it to an integer, whose set bits
are iterated with `count_trailing_zeros`. Arithmetic with a scalar broadcasts it to all lanes.

vector : types and operators; lanes : operations per lane and across lanes; doubles : float64;
memory : loads and stores; gather : loads from 16 places

Begin with vector.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from ..jit import later

LATER = "doubles", "gather", "lanes", "memory", "vector"
ZERO, ONE, INF = np.float32(0.0), np.float32(1.0), np.float32(np.inf)
Bits, Mask, Real = int, object, object  # occur in annotations only, see `__init__.pyi`

_STUB = Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8")
_NAMES = dict.fromkeys(re.findall(r"^(?:def|class) (?!_|Mask)(\w+)", _STUB, re.MULTILINE))
globals().update(zip(_NAMES, later(__name__, LATER, *_NAMES), strict=True))
