"""Real spherical harmonics of bands 1 and 2, also in the form of a vector and a matrix."""

from __future__ import annotations

from ..engine.jit import inline
from ..engine.kernels.vec import Six, Vec3

BAND_0 = 0.28209479177387814  # sqrt(1 / (4 pi))
BAND_1 = 0.4886025119029199  # sqrt(3 / (4 pi)), the largest value
BAND_2 = 0.31539156525252005  # sqrt(5 / (16 pi)), half of the largest value
BAND_2_CROSS = 0.5462742152960396  # sqrt(15 / (16 pi))

Five = tuple[float, float, float, float, float]


@inline
def band_1(v: Vec3) -> Vec3:
    """Return the three real spherical harmonics of band 1 at a unit direction v, in the order y, z, x.

    They are linear in v: for the sum of light times direction, they are the harmonics of the light.
    """
    return BAND_1 * v[1], BAND_1 * v[2], BAND_1 * v[0]


@inline
def band_2(outer: Six) -> Five:
    """Return the five real spherical harmonics of band 2 at a unit direction d, given the products d d^T.

    They are linear in these: for the sum of light times d d^T, they are the harmonics of the light.

    outer : xx, xy, xz, yy, yz, zz
    """
    xx, xy, xz, yy, yz, zz = outer
    return (
        2.0 * BAND_2_CROSS * xy,
        2.0 * BAND_2_CROSS * yz,
        BAND_2 * (2.0 * zz - xx - yy),
        2.0 * BAND_2_CROSS * xz,
        BAND_2_CROSS * (xx - yy),
    )


@inline
def as_vector(first: Vec3) -> Vec3:
    """Return the vector v by which a function of band 1 is evaluated at unit directions d: BAND_1 v.d.

    first : coefficients of the function, in the order of `band_1`
    """
    return first[2], first[0], first[1]


@inline
def times_matrix(second: Five, d: Vec3) -> Vec3:
    """Return D d, for the symmetric matrix D by which d.D d is the function with coefficients `second` of band 2.

    d : unit direction
    """
    x, y, z = d
    even = BAND_2 * second[2]
    return (
        BAND_2_CROSS * (second[0] * y + second[3] * z + second[4] * x) - even * x,
        BAND_2_CROSS * (second[0] * x + second[1] * z - second[4] * y) - even * y,
        BAND_2_CROSS * (second[1] * y + second[3] * x) + 2.0 * even * z,
    )
