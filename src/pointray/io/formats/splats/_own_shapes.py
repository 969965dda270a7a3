"""Shapes of Gaussian splats that were read from a file: their scales and rotations, checked for the writers."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....base.arrays import Flags, Floats
from ._common import unit_quaternions

THICKNESS = 0.05  # of a flat splat, as a share of its width
LEAST = np.finfo(np.float32).tiny  # written for scales of 0, whose logarithm is not finite
ELONGATED = 1.1  # least ratio of the longer two axes that is reported if it is lost
CONJUGATE = np.array([1, -1, -1, -1], np.float32)  # factor of a quaternion
SMALL_W = 0.45  # below it a stored x, y, z determines w badly


def scales_of(values: NDArray[Any] | None) -> Floats | None:
    """Return the standard deviations along the three axes, (n, 3) float32; 0 in rows that are invalid.

    None if the attribute has another shape or no row is valid.

    values : (n, 3), or (n, 2) of splats without a thickness, which is then THICKNESS of the shorter axis
    """
    if values is None or values.ndim != 2 or values.shape[1] not in (2, 3):
        return None
    with np.errstate(over="ignore", under="ignore", invalid="ignore"):
        scales = values.astype(np.float32)
        if scales.shape[1] == 2:
            scales = np.column_stack([scales, np.float32(THICKNESS) * scales.min(axis=1)])
        valid = (scales >= 0).all(axis=1) & (scales < np.inf).all(axis=1) & scales.any(axis=1)
    scales = np.maximum(scales, LEAST)
    scales[~valid] = 0
    return scales if valid.any() else None


def turns_of(values: NDArray[Any] | None) -> tuple[Floats, int] | None:
    """Return unit quaternions w, x, y, z, (n, 4) float32, and how many rows are invalid: these are not turned.

    None unless the attribute has four columns.
    """
    if values is None or values.ndim != 2 or values.shape[1] != 4:
        return None
    turns = unit_quaternions(values)
    invalid = ~turns.any(axis=1)
    turns[invalid, 0] = 1
    return turns, int(invalid.sum())


def round_discs(scales: Floats) -> Floats:
    """Return the geometric mean of the longer two scales and the shortest one, (n, 2) float32. scales : (n, 3)"""
    ordered = np.sort(scales, axis=1).astype(np.float64)
    return np.stack([np.sqrt(ordered[:, 1] * ordered[:, 2]), ordered[:, 0]], axis=1).astype(np.float32)


def are_elongated(scales: Floats) -> Flags:
    """Return whether the longer two of three scales differ, (n,) bool. scales : (n, 3)"""
    ordered = np.sort(scales, axis=1).astype(np.float64)
    return ordered[:, 2] > ELONGATED * ordered[:, 1]


def with_large_w(scales: Floats, turns: Floats) -> tuple[Floats, Floats]:
    """Return equal Gaussians whose quaternions have a w of at least SMALL_W, for formats that store x, y and z only.

    Other orders and signs of an ellipsoid's axes describe the same ellipsoid: of the 24 the one with the largest w, at
    least 0.85, is chosen where w is small.

    scales : (m, 3) standard deviations; turns : (m, 4) unit quaternions w, x, y, z
    """
    turns = np.where(turns[:, :1] < 0, -turns, turns)
    rows = np.flatnonzero(turns[:, 0] < SMALL_W)
    if not len(rows):
        return scales, turns
    scales, before = scales.copy(), turns[rows]
    # w of the product q g of two quaternions is the dot product of q and the conjugate of g
    best = np.abs(before @ (CUBE * CONJUGATE).T).argmax(axis=1)
    after = _products(before, CUBE[best])
    turns[rows] = np.where(after[:, :1] < 0, -after, after)
    scales[rows] = np.take_along_axis(scales[rows], ORDERS[best], axis=1)
    return scales, turns


def _products(q: Floats, g: Floats) -> Floats:
    """Return the products of quaternions w, x, y, z, (m, 4): the rotation g, then q."""
    w, v = q[:, :1], q[:, 1:]
    real = w * g[:, :1] - (v * g[:, 1:]).sum(axis=1, keepdims=True)
    return np.concatenate([real, w * g[:, 1:] + g[:, :1] * v + np.cross(v, g[:, 1:])], axis=1)


def _cube() -> tuple[Floats, NDArray[np.intp]]:
    """Return the rotations of a cube, (24, 4), and the axis, up to its sign, to which each turns x, y, z, (24, 3)."""
    signs = [q for q in product((0, 1, -1), repeat=4) if sum(map(abs, q)) in (1, 2, 4) and next(filter(None, q)) > 0]
    turns = unit_quaternions(np.array(signs))
    units = [np.array([0, *row], np.float32) for row in np.eye(3)]
    back = turns * CONJUGATE
    turned = [_products(_products(turns, np.broadcast_to(e, turns.shape)), back)[:, 1:] for e in units]
    return turns, np.stack([np.abs(axis).argmax(axis=1) for axis in turned], axis=1)


CUBE, ORDERS = _cube()
