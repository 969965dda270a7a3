"""Rays as callers give them, and their hits as callers get them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.arguments import real_numbers

Floats = NDArray[np.float64]
Rays = tuple[Floats, Floats, Floats]  # origins and directions, (n, 3), and t_min, t_max, (n, 2)


@dataclass(frozen=True)
class Hits:
    """What rays of the shape (...) hit first.

    Attributes
    ----------
    t : (...) float32
        In lengths of the ray's direction; inf for a miss. For a hit it is finite: where float32 is too small for it, as
        with a direction of length 1e-150, it is the greatest number of float32, and where it is too fine, 0. Whether
        and what a ray hits, and `position`, do not depend on it.
    position : (..., 3) float64
        World; NaN for a miss.
    normal : (..., 3) float32
        Unit, on the side to which the points' normals point: never turned to the ray; 0 for a miss. Where the normals
        of the splats cancel there is no surface, and no hit.
    color : (..., 3) float32
        Linear, blended with the surface's weights; 0 for a miss, 1 for points without colours. Where an `Attribute`
        colours the material, the colour that it shows.
    point : (...) int64
        Row, in the caller's points, of the splat of greatest weight (where rounding leaves no splat any weight, of the
        nearest one in radii); -1 for a miss and for a plane.
    instance : (...) int32
        What `Scene.add` returned; -1 for a miss.
    attributes : dict of str to (...) or (..., k) array
        The attributes asked for, blended: float32, or float64 where float32 does not hold all values of the points'
        dtype (float64, whole numbers of 4 and 8 bytes). Categories (bools; whole numbers, at most 32 different ones, 10
        points each on average; the classes, sources and scans of `Attribute`, at most 256) are not: a hit has the one
        of the splat of greatest weight, with the points' dtype. Where nothing is hit, and where the model has no such
        attribute, floats are NaN, whole numbers 0 and bools False.
    """

    t: NDArray[np.float32]
    position: NDArray[np.float64]
    normal: NDArray[np.float32]
    color: NDArray[np.float32]
    point: NDArray[np.int64]
    instance: NDArray[np.int32]
    attributes: dict[str, NDArray[Any]] = field(default_factory=dict)


def check_rays(
    origins: ArrayLike, directions: ArrayLike, t_min: ArrayLike, t_max: ArrayLike
) -> tuple[tuple[int, ...], Rays]:
    """The leading shape, and the rays as (n, 3), (n, 3), (n, 2) float64, C-contiguous and writable."""
    arrays = [real_numbers(a, name) for a, name in ((origins, "origins"), (directions, "directions"))]
    limits = [real_numbers(a, name) for a, name in ((t_min, "t_min"), (t_max, "t_max"))]
    shape = leading_shape(*arrays, *limits)
    o, d = (np.array(np.broadcast_to(a, (*shape, 3)), np.float64, order="C").reshape(-1, 3) for a in arrays)
    pair = np.stack([np.broadcast_to(a, shape).reshape(-1) for a in limits], axis=1).astype(np.float64)
    return shape, (o, d, np.ascontiguousarray(pair))


def leading_shape(origins: Any, directions: Any, t_min: Any, t_max: Any) -> tuple[int, ...]:
    """The leading shape of the rays of some arrays, of which only the shapes are looked at."""
    for array, name in ((origins, "origins"), (directions, "directions")):
        if array.ndim == 0 or array.shape[-1] != 3:
            raise ValueError(f"{name} must have the shape (..., 3), not {array.shape}")
    leading = [origins.shape[:-1], directions.shape[:-1], t_min.shape, t_max.shape]
    try:
        return np.broadcast_shapes(*leading)
    except ValueError:
        raise ValueError(f"origins, directions, t_min and t_max do not broadcast: leading shapes {leading}") from None
