"""Validation of rays, and the hits returned for them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.arguments import real_numbers
from ..base.arrays import Doubles

if TYPE_CHECKING:
    from ..cloud.points import Points

Rays = tuple[Doubles, Doubles, Doubles]  # origins and directions, (n, 3), and t_min, t_max, (n, 2)


@dataclass(frozen=True)
class Hits:
    """Closest hits of rays of leading shape (...).

    Attributes
    ----------
    t : (...) float32
        Distance in lengths of the ray's direction; inf for a miss. For a hit it is finite: values that overflow
        float32, as with a direction of length 1e-150, are the largest finite float32; values that underflow are 0.
        The other fields do not depend on it.
    position : (..., 3) float64
        World position; NaN for a miss.
    normal : (..., 3) float32
        Unit normal on the side to which the points' normals point, not flipped towards the ray; 0 for a miss. Where
        the normals of the splats cancel there is no surface and no hit.
    color : (..., 3) float32
        Linear colour, blended with the surface's weights; 0 for a miss, 1 for points without colours. If an `Attribute`
        colours the material, its colour.
    point : (...) int64
        Row, in the caller's points, of the splat of greatest weight, or of the nearest one in radii if all weights
        round to zero; -1 for a miss and for a plane.
    instance : (...) int32
        Number that `Scene.add` returned; -1 for a miss.
    attributes : dict of str to (...) or (..., k) array
        The requested attributes, blended: float32, or float64 if float32 does not represent all values of the points'
        dtype (float64, integers of 4 and 8 bytes). Categories (bools; integers with at most 32 different values and 10
        points each on average; the classes, sources and scans of `Attribute`, at most 256) are not blended: a hit has
        the value of the splat of greatest weight, in the points' dtype. For a miss, and for models without the
        attribute, floats are NaN, integers 0 and bools False.

    Examples
    --------
    >>> scene = pr.Scene()
    >>> ball = scene.add(pr.Model(pr.procedural("sphere", 1000)))
    >>> hits = scene.intersect([[0, -5, 0], [0, -5, 3]], [0, 1, 0])
    >>> hits.t.round(2).tolist(), hits.instance.tolist()
    ([4.0, inf], [0, -1])
    """

    t: NDArray[np.float32]
    position: NDArray[np.float64]
    normal: NDArray[np.float32]
    color: NDArray[np.float32]
    point: NDArray[np.int64]
    instance: NDArray[np.int32]
    attributes: dict[str, NDArray[Any]] = field(default_factory=dict)

    def to_points(self) -> Points:
        """Return the hits as points; rays that miss are left out.

        Returns
        -------
        Points
            World positions, normals and sRGB colours (none if all hits are white, as those of points without colours).
            Its attributes are `t`, `ray` (index of the ray, in the order of the flattened arrays), `point`, `instance`
            and those of the hits. One of these names gets an underscore at the end if it is that of a field.

        Raises
        ------
        ValueError
            If no ray hits anything.

        Examples
        --------
        >>> scene = pr.Scene()
        >>> ball = scene.add(pr.Model(pr.procedural("sphere", 1000)))
        >>> points = scene.intersect([[0, -5, 0], [0, -5, 3], [0, 5, 0]], [0, 1, 0], t_min=-9).to_points()
        >>> len(points), points.attributes["ray"].tolist()
        (2, [0, 2])
        """
        from .hit_tables import points_of

        return points_of(self)

    def to_pandas(self) -> Any:
        """Return the hits as a table of pandas with one row for each ray, also for those that miss.

        Returns
        -------
        pandas.DataFrame
            Columns `t`, `x`, `y`, `z`, `nx`, `ny`, `nz`, `red`, `green`, `blue` (sRGB, uint8), `point`, `instance`, and
            one for each attribute or each of its components (`name_0`, ...). The index `ray` is that of the flattened
            arrays. Rays that miss have the values that `Hits` describes: `t` inf, positions NaN, `instance` -1.

        Raises
        ------
        ImportError
            If pandas is not installed.

        Examples
        --------
        >>> scene = pr.Scene()
        >>> ball = scene.add(pr.Model(pr.procedural("sphere", 1000)))
        >>> table = scene.intersect([[0, -5, 0], [0, -5, 3]], [0, 1, 0]).to_pandas()
        >>> table.t.round(2).tolist(), table.instance.tolist()
        ([4.0, inf], [0, -1])
        """
        from .hit_tables import table_of

        return table_of(self)


def check_rays(
    origins: ArrayLike, directions: ArrayLike, t_min: ArrayLike, t_max: ArrayLike
) -> tuple[tuple[int, ...], Rays]:
    """Return the leading shape of rays, and their origins (n, 3), directions (n, 3) and limits (n, 2) after checks.

    The arguments are broadcast; the limits are t_min and t_max. The arrays are new, float64 and C-contiguous.
    """
    arrays = [real_numbers(a, name) for a, name in ((origins, "origins"), (directions, "directions"))]
    limits = [real_numbers(a, name) for a, name in ((t_min, "t_min"), (t_max, "t_max"))]
    shape = leading_shape(*arrays, *limits)
    o, d = (np.array(np.broadcast_to(a, (*shape, 3)), np.float64, order="C").reshape(-1, 3) for a in arrays)
    pair = np.stack([np.broadcast_to(a, shape).reshape(-1) for a in limits], axis=1).astype(np.float64)
    return shape, (o, d, np.ascontiguousarray(pair))


def leading_shape(origins: Any, directions: Any, t_min: Any, t_max: Any) -> tuple[int, ...]:
    """Return the leading shape of rays, to which the shapes of their arrays broadcast; ValueError if they do not.

    origins, directions : (..., 3) NumPy or Dask arrays; t_min, t_max : (...)
    """
    for array, name in ((origins, "origins"), (directions, "directions")):
        if array.ndim == 0 or array.shape[-1] != 3:
            raise ValueError(f"{name} must have the shape (..., 3), got {array.shape}")
    leading = [origins.shape[:-1], directions.shape[:-1], t_min.shape, t_max.shape]
    try:
        return np.broadcast_shapes(*leading)
    except ValueError:
        raise ValueError(f"origins, directions, t_min and t_max do not broadcast: leading shapes {leading}") from None
