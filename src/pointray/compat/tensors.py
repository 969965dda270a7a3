"""Arrays of callers: NumPy's, and tensors of other libraries, without importing these."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.arguments import check_numbers, wrong
from ..base.arrays import Doubles


def as_array(value: Any, name: str, wanted: str = "an array or tensor of numbers") -> NDArray[Any]:
    """Return an array or tensor of numbers as a NumPy array; raise an error that names it if it is none.

    Tensors in the memory of a GPU are copied. name : the argument, for the message; wanted : description for it
    """
    if hasattr(value, "detach"):  # PyTorch: without gradients, and not on a GPU
        value = value.detach()
    if not isinstance(value, np.ndarray) and callable(getattr(value, "cpu", None)):
        value = value.cpu()
    if callable(getattr(value, "numpy", None)):
        value = value.numpy()
    elif hasattr(value, "__dlpack__") and not isinstance(value, np.ndarray) and not hasattr(value, "__array__"):
        value = np.from_dlpack(value)
    return check_numbers(value, name, wanted)


def as_rows(value: Any, name: str, width: int, least_axes: int = 1) -> Doubles:
    """Return an argument as (..., width) float64; raise an error that names it if its shape is another.

    least_axes : smallest valid number of axes
    """
    wanted = f"{', '.join(['...'] * (least_axes > 1) or ['...'])}, {width}"
    array = as_array(value, name)
    if array.ndim < least_axes or array.shape[-1] != width:
        raise ValueError(f"{name} must have the shape ({wanted}), got {array.shape}")
    return np.ascontiguousarray(array, np.float64)


def as_matrix(value: Any, name: str, shape: tuple[int, ...]) -> Doubles:
    """Return an argument as an array of finite numbers of a given shape; raise an error that names it if it is none."""
    array = as_array(value, name).astype(np.float64)
    if array.shape != shape:
        raise ValueError(f"{name} must have the shape {shape}, got {array.shape}")
    if not np.isfinite(array).all():
        raise wrong(name, "finite numbers", value)
    return array
