"""Numbers of fixed width in kernels. For mypy they are int and float, as the results of arithmetic are."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]  # an array in a kernel; the record that holds it defines its contents

if TYPE_CHECKING:

    def f32(value: float, /) -> float: ...
    def f64(value: float, /) -> float: ...
    def i32(value: float, /) -> int: ...
    def i64(value: float, /) -> int: ...
    def u64(value: float, /) -> int: ...

else:
    f32, f64, i32, i64, u64 = np.float32, np.float64, np.int32, np.int64, np.uint64
