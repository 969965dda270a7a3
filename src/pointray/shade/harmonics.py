"""Real spherical harmonics of the bands 1 and 2, and what a lobe about a direction keeps of them."""

from __future__ import annotations

from ..jit import inline
from ..kernels.vec import Vec3

BAND_0 = 0.28209479177387814  # sqrt(1 / (4 pi))

Five = tuple[float, float, float, float, float]


@inline
def harmonics(d: Vec3) -> tuple[Vec3, Five]:
    """(band 1, band 2) of a unit direction, orthonormal."""
    x, y, z = d
    first = 0.4886025119029199 * y, 0.4886025119029199 * z, 0.4886025119029199 * x
    return first, (
        1.0925484305920792 * x * y,
        1.0925484305920792 * y * z,
        0.31539156525252005 * (3.0 * z * z - 1.0),
        1.0925484305920792 * x * z,
        0.5462742152960396 * (x * x - y * y),
    )
