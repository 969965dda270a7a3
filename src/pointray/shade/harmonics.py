"""Real spherical harmonics of the bands 1 and 2, as a vector and a matrix too."""

from __future__ import annotations

from ..jit import inline
from ..kernels.vec import Vec3

BAND_0 = 0.28209479177387814  # sqrt(1 / (4 pi))
BAND_1 = 0.4886025119029199  # sqrt(3 / (4 pi)), the largest value
BAND_2 = 0.31539156525252005  # sqrt(5 / (16 pi)), half of the largest value
BAND_2_CROSS = 0.5462742152960396  # sqrt(15 / (16 pi))

Five = tuple[float, float, float, float, float]


@inline
def harmonics(d: Vec3) -> tuple[Vec3, Five]:
    """(band 1, band 2) of a unit direction, orthonormal."""
    x, y, z = d
    first = BAND_1 * y, BAND_1 * z, BAND_1 * x
    return first, (
        2.0 * BAND_2_CROSS * x * y,
        2.0 * BAND_2_CROSS * y * z,
        BAND_2 * (3.0 * z * z - 1.0),
        2.0 * BAND_2_CROSS * x * z,
        BAND_2_CROSS * (x * x - y * y),
    )


@inline
def as_vector(first: Vec3) -> Vec3:
    """The vector v whose v.d is band 1 summed up at d, over BAND_1."""
    return first[2], first[0], first[1]


@inline
def times_matrix(second: Five, d: Vec3) -> Vec3:
    """D d, of the symmetric matrix D whose d.D d is band 2 summed up at a unit d."""
    x, y, z = d
    even = BAND_2 * second[2]
    return (
        BAND_2_CROSS * (second[0] * y + second[3] * z + second[4] * x) - even * x,
        BAND_2_CROSS * (second[0] * x + second[1] * z - second[4] * y) - even * y,
        BAND_2_CROSS * (second[1] * y + second[3] * x) + 2.0 * even * z,
    )
