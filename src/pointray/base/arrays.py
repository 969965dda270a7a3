"""Names of array types, used in annotations throughout the package."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]
Rows = NDArray[np.int64]  # row numbers of points, or other integers
Indices = NDArray[np.int32]
Flags = NDArray[np.bool_]
