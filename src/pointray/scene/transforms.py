"""Transforms: the size, rotation and position of an instance."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.arguments import check_number, check_numbers, unit_vector, vector


def transform(
    translate: ArrayLike = (0, 0, 0), rotate: float = 0.0, axis: ArrayLike = (0, 0, 1), scale: ArrayLike = 1.0
) -> NDArray[np.float64]:
    """Return a transform for `Scene.add` that scales, then rotates, then translates.

    Parameters
    ----------
    translate : (3,) array_like
        World position of the model's origin.
    rotate : float
        Angle in degrees about an axis through the origin, counter-clockwise if the axis points at the viewer.
    axis : (3,) array_like
        Axis of the rotation, of any length.
    scale : float or (3,) array_like
        Factor, or one for each axis; nonzero; negative values mirror.

    Returns
    -------
    (4, 4) float64
        Transforms column vectors.

    Raises
    ------
    TypeError
        If an argument has the wrong type.
    ValueError
        If a number is not finite, or axis or scale is zero.

    Examples
    --------
    >>> pr.transform(translate=(2, 0, 0), scale=1.5)
    array([[1.5, 0. , 0. , 2. ],
           [0. , 1.5, 0. , 0. ],
           [0. , 0. , 1.5, 0. ],
           [0. , 0. , 0. , 1. ]])
    """
    angle = np.radians(check_number(rotate, "rotate", "a finite number of degrees"))
    x, y, z = unit_vector(axis, "axis")
    sizes = check_numbers(scale, "scale")
    sizes = vector(np.full(3, sizes) if sizes.ndim == 0 else scale, "scale")
    if (sizes == 0).any():
        raise ValueError(f"scale must not be zero, got {scale!r}")
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    out = np.eye(4)
    turned = np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross  # Rodrigues
    out[:3, :3], out[:3, 3] = turned * sizes, vector(translate, "translate")
    return out
