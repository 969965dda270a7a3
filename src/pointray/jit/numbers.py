"""Numbers in kernels, with so many bits. For mypy they are int and float, as arithmetic makes of them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]  # of a kernel: what its numbers mean is said where the record is defined that holds it

if TYPE_CHECKING:

    def f32(value: float, /) -> float: ...
    def f64(value: float, /) -> float: ...
    def i32(value: float, /) -> int: ...
    def i64(value: float, /) -> int: ...
    def u64(value: float, /) -> int: ...

else:
    f32, f64, i32, i64, u64 = np.float32, np.float64, np.int32, np.int64, np.uint64
