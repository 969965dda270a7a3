"""Vector arithmetic on triples of numbers, for kernels."""

from __future__ import annotations

import math
from typing import TypeAlias

from ..jit import Array, i64, inline

Vec3: TypeAlias = tuple[float, float, float]
Six: TypeAlias = tuple[float, float, float, float, float, float]  # a symmetric matrix: xx xy xz yy yz zz
Matrix3: TypeAlias = tuple[Vec3, Vec3, Vec3]  # rows

BLACK, WHITE = (0.0, 0.0, 0.0), (1.0, 1.0, 1.0)
LUMINANCE = (0.2126, 0.7152, 0.0722)  # of linear sRGB


@inline
def dot(a: Vec3, b: Vec3) -> float:
    """Return the scalar product of two vectors."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inline
def add(a: Vec3, b: Vec3) -> Vec3:
    """Return the sum of two vectors, a + b."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@inline
def sub(a: Vec3, b: Vec3) -> Vec3:
    """Return the difference of two vectors, a - b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@inline
def scale(a: Vec3, s: float) -> Vec3:
    """Return the vector a times the number s."""
    return a[0] * s, a[1] * s, a[2] * s


@inline
def multiply(a: Vec3, b: Vec3) -> Vec3:
    """Multiply component by component, as for colours."""
    return a[0] * b[0], a[1] * b[1], a[2] * b[2]


@inline
def luminance(a: Vec3) -> float:
    """Return the luminance of a linear RGB colour, with the weights of sRGB primaries."""
    return LUMINANCE[0] * a[0] + LUMINANCE[1] * a[1] + LUMINANCE[2] * a[2]


@inline
def cross(a: Vec3, b: Vec3) -> Vec3:
    """Return the cross product of two vectors, a x b."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@inline
def length(a: Vec3) -> float:
    """Return the Euclidean length of a vector."""
    return math.sqrt(dot(a, a))


@inline
def unit(a: Vec3) -> Vec3:
    """Normalize a vector; a zero vector stays zero."""
    n = length(a)
    return scale(a, 1.0 / n) if n > 0.0 else scale(a, 0.0)


@inline
def load3_flat(array: Array, i: int) -> Vec3:
    """Load array[i : i + 3] of a flat array as a vector."""
    return array[i], array[i + 1], array[i + 2]


@inline
def either(first: bool, a: Vec3, b: Vec3) -> Vec3:
    """Return a if `first`, else b; selected component by component, without a branch, so that loops are vectorized."""
    return a[0] if first else b[0], a[1] if first else b[1], a[2] if first else b[2]


@inline
def transform(matrix: Matrix3, a: Vec3) -> Vec3:
    """Multiply a vector by a 3x3 matrix, given as rows."""
    return dot(matrix[0], a), dot(matrix[1], a), dot(matrix[2], a)


@inline
def transform_transposed(matrix: Matrix3, a: Vec3) -> Vec3:
    """Multiply a vector by the transpose of a 3x3 matrix, given as rows, as for normals."""
    return (
        matrix[0][0] * a[0] + matrix[1][0] * a[1] + matrix[2][0] * a[2],
        matrix[0][1] * a[0] + matrix[1][1] * a[1] + matrix[2][1] * a[2],
        matrix[0][2] * a[0] + matrix[1][2] * a[1] + matrix[2][2] * a[2],
    )


@inline
def tangents(n: Vec3) -> tuple[Vec3, Vec3]:
    """Return two unit vectors perpendicular to a unit vector and to each other (Duff et al. 2017)."""
    sign = 1.0 if n[2] >= 0.0 else -1.0
    a = -1.0 / (sign + n[2])
    b = n[0] * n[1] * a
    return (1.0 + sign * n[0] * n[0] * a, sign * b, -sign * n[0]), (b, sign + n[1] * n[1] * a, -n[1])


@inline
def turned(v: Vec3, frame: tuple[Vec3, Vec3, Vec3]) -> Vec3:
    """Transform a vector's coordinates from a local frame to the outer one, in which the frame's axes are given.

    frame : the three axes of the local frame
    """
    return add(scale(frame[2], v[2]), add(scale(frame[0], v[0]), scale(frame[1], v[1])))


@inline
def _times(m: Six, v: Vec3) -> Vec3:
    """Multiply a symmetric matrix, xx xy xz yy yz zz, by a vector."""
    return (
        m[0] * v[0] + m[1] * v[1] + m[2] * v[2],
        m[1] * v[0] + m[3] * v[1] + m[4] * v[2],
        m[2] * v[0] + m[4] * v[1] + m[5] * v[2],
    )


@inline
def turned_matrix(m: Six, frame: tuple[Vec3, Vec3, Vec3]) -> Six:
    """Transform a symmetric matrix from a local frame to the outer one, in which the frame's axes are given.

    m : entries xx xy xz yy yz zz, as in the result; frame : the three axes of the local frame
    """
    a, b, c = frame
    x, y, z = (a[0], b[0], c[0]), (a[1], b[1], c[1]), (a[2], b[2], c[2])
    first, second = _times(m, x), _times(m, y)
    return dot(first, x), dot(first, y), dot(first, z), dot(second, y), dot(second, z), dot(_times(m, z), z)


@inline
def mirrored(a: Vec3, n: Vec3) -> Vec3:
    """Reflect the direction a, which points away from the surface, about a unit normal n."""
    return sub(scale(n, 2.0 * dot(n, a)), a)


@inline
def on_circle(turn: float) -> tuple[float, float]:
    """Return the cosine and the sine of 2 pi `turn`, to 1e-15. turn : position on the circle, at least -1/8

    It is a Taylor series after reduction to an eighth of a circle. libm's sincos took 5% of the time of a path.
    """
    quarter = i64(4.0 * turn + 0.5)
    x = (4.0 * turn - quarter) * (0.5 * math.pi)
    square = x * x
    cosine = sine = 1.0
    for k in range(16, 0, -2):
        cosine = 1.0 - cosine * square / ((k - 1) * k)
        sine = 1.0 - sine * square / (k * (k + 1))
    sine, which = sine * x, quarter & 3
    a, b = (sine, cosine) if which & 1 != 0 else (cosine, sine)
    return (-a if which == 1 or which == 2 else a), (-b if which >= 2 else b)


@inline
def around(axis: Vec3, cosine: float, turn: float) -> Vec3:
    """Return a unit vector at a given angle from a unit axis.

    cosine : of the angle; turn : 0 to 1, position on the circle around the axis
    """
    s, t = tangents(axis)
    sine, (x, y) = math.sqrt(max(1.0 - cosine * cosine, 0.0)), on_circle(turn)
    return turned((sine * x, sine * y, cosine), (s, t, axis))


@inline
def along_curve(k: int) -> tuple[int, int]:
    """Return (x, y) of point k of a Morton curve, each 0 to 255: the even and the odd bits of k."""
    return _even_bits(k), _even_bits(k >> 1)


@inline
def _even_bits(k: int) -> int:
    k = k & 0x5555
    k = (k | k >> 1) & 0x3333
    k = (k | k >> 2) & 0x0F0F
    return (k | k >> 4) & 0x00FF
