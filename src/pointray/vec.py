"""Small vector maths on triples of numbers, for kernels."""

from __future__ import annotations

import math

from .jit import inline


@inline
def dot(a, b):  # type: ignore[no-untyped-def]
    """Scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inline
def add(a, b):  # type: ignore[no-untyped-def]
    """Sum."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@inline
def sub(a, b):  # type: ignore[no-untyped-def]
    """Difference."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@inline
def scale(a, s):  # type: ignore[no-untyped-def]
    """a times a number."""
    return a[0] * s, a[1] * s, a[2] * s


@inline
def multiply(a, b):  # type: ignore[no-untyped-def]
    """Product of each component: colours."""
    return a[0] * b[0], a[1] * b[1], a[2] * b[2]


@inline
def length(a):  # type: ignore[no-untyped-def]
    """Euclidean length."""
    return math.sqrt(dot(a, a))


@inline
def unit(a):  # type: ignore[no-untyped-def]
    """The vector of length 1; a zero vector stays zero."""
    n = length(a)
    return scale(a, 1.0 / n) if n > 0.0 else scale(a, 0.0)


@inline
def triple(array, i):  # type: ignore[no-untyped-def]
    """Three neighbours of a flat array."""
    return array[i], array[i + 1], array[i + 2]


@inline
def transform(matrix, i, a):  # type: ignore[no-untyped-def]
    """The 3x3 part of a row-major 3x4 matrix at matrix[i:] times a vector."""
    return (
        matrix[i] * a[0] + matrix[i + 1] * a[1] + matrix[i + 2] * a[2],
        matrix[i + 4] * a[0] + matrix[i + 5] * a[1] + matrix[i + 6] * a[2],
        matrix[i + 8] * a[0] + matrix[i + 9] * a[1] + matrix[i + 10] * a[2],
    )


@inline
def transform_transposed(matrix, i, a):  # type: ignore[no-untyped-def]
    """The transposed 3x3 part of a row-major 3x4 matrix at matrix[i:] times a vector: normals."""
    return (
        matrix[i] * a[0] + matrix[i + 4] * a[1] + matrix[i + 8] * a[2],
        matrix[i + 1] * a[0] + matrix[i + 5] * a[1] + matrix[i + 9] * a[2],
        matrix[i + 2] * a[0] + matrix[i + 6] * a[1] + matrix[i + 10] * a[2],
    )
