"""Edges: points near creases move to the mean of the positions predicted by their neighbours' planes.

No quadric fits a crease, and fits so small that they hide it are uncertain. Planes are fitted at every other point
whose quadric leaves much more than noise. A single fit may be wrong, so points nearby combine several of them.

Edges are rounded, because splats cannot represent sharp ones: discs of one face stick out where the other has a gap.
On a cube of exact points and normals, 99.9% of the hits near edges are within 1.1 spacings; with edges rounded by 0.75
spacings 0.28, by 1.5 spacings 0.44.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ...base.arrays import Floats, Rows
from ...engine.jit import Array, borrow, f64, inline, kernel, next_tile, routine, run
from ...engine.kernels.vec import Vec3
from ..neighbors import NeighborTree
from .creases import MODEL, fit_creases

ROUNDING = 0.7  # radius of edges, in spacings
MUCH = 0.4  # noise in spacings above which creases cannot be told from noise
# What a quadric leaves beyond the noise, in spacings, above which planes are fitted, and above which a point uses those
# of others: 0.24 at nine of ten points within 3 spacings of a right angle (noise 0.3).
BENT, USES = 0.2, 0.12
BEYOND = 0.6  # the same in standard deviations of the noise: plane surfaces exceed it at 4% of their points
SHARE = 2  # planes are fitted at rows divisible by this, so that a part of a cloud uses the same rows
# Planes that are combined, and their least number: with 3, which must agree to 0.9, a tower's mortar had specks.
COMBINED, FEW = 8, 6
AROUND = 3.0  # greatest distance of these planes, in spacings
AGREE = 0.95  # least length of their mean normal
WIDE, GOOD = 128, 0.6  # neighbours tried where planes were found; least weight of the result
TURNS = 30  # iterations of Hildreth's method: planes at right angles take two
CHUNK = 512
PART = 1 << 16  # rows at a time


@inline
def _over(model: Array, a: int, x: Vec3) -> float:
    """Return the signed distance of x from plane `a` of an edge or corner, positive outside the solid.

    model : number of planes, then x, y, z of the outward normal, and the offset, of each
    x : relative to the point that the planes were fitted at
    """
    at = 1 + 4 * a
    return f64(model[at]) * x[0] + f64(model[at + 1]) * x[1] + f64(model[at + 2]) * x[2] + f64(model[at + 3])


@routine
def onto(model: Array, x: Vec3, rounding: float, shares: Array) -> tuple[Vec3, Vec3]:
    """Return the point of a convex solid with rounded edges that is nearest to x, and the outward normal there.

    Hildreth's method finds the nearest point of the solid shrunk by the rounding.

    model : planes of the solid: their number, then x, y, z of the outward normal, and the offset, of each
    x : relative to the point that the planes were fitted at, as is the result
    rounding : radius of the edges
    shares : memory for one float per plane
    """
    count, top, which = int(model[0]), -np.inf, 0
    for a in range(count):
        shares[a] = 0.0
        if _over(model, a, x) > top:
            top, which = _over(model, a, x), a
    y = x
    for _ in range(TURNS):
        moved = 0.0
        for a in range(count):
            share = max(shares[a] + _over(model, a, y) + rounding, 0.0)
            step, at = share - shares[a], 1 + 4 * a
            shares[a], moved = share, max(moved, abs(step))
            y = (y[0] - step * model[at], y[1] - step * model[at + 1], y[2] - step * model[at + 2])
        if moved < 1e-5 * rounding:
            break
    at = 1 + 4 * which
    n = (f64(model[at]), f64(model[at + 1]), f64(model[at + 2]))
    v = (x[0] - y[0], x[1] - y[1], x[2] - y[2])
    length = math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    if length < 0.01 * rounding:  # far inside
        return (x[0] - top * n[0], x[1] - top * n[1], x[2] - top * n[2]), n
    n = (v[0] / length, v[1] / length, v[2] / length)
    return (y[0] + rounding * n[0], y[1] + rounding * n[1], y[2] + rounding * n[2]), n


@inline
def _side(model: Array, normals: Array, row: int) -> float:
    """Return 1 if the normal of a row faces out of the solid that planes bound, else -1.

    The plane most parallel to the normal decides.

    model : number of planes, then x, y, z of the outward normal, and the offset, of each
    """
    most = 0.0
    for a in range(int(model[0])):
        at, along = 1 + 4 * a, 0.0
        for c in range(3):
            along += f64(model[at + c]) * f64(normals[row, c])
        if abs(along) > abs(most):
            most = along
    return -1.0 if most < 0.0 else 1.0


@kernel
def _settle(
    work: Array,
    positions: Array,
    normals: Array,
    rows: Array,
    near: Array,
    fitted_rows: Array,
    models: Array,
    out: Array,
) -> None:
    """Compute how points near edges and corners move: by the mean of their moves onto the rounded edges fitted nearby.

    work : gives each thread its next tile, 512 rows
    positions, normals : (n, 3), of all points
    rows : (m,) the points to move
    near : (m, k) nearby entries of `fitted_rows`, or -1
    fitted_rows : (c,) rows at which planes were fitted
    models : (c, 14) number of these planes; x, y, z of the normal and the offset of each of three; weight in the mean
    out : (m, 8) receives x, y, z of the move and of the normal after it, and 1 (left at 0 if there is no edge); its
        last column holds the distance between neighbouring points, in proportion to which edges are rounded
    """
    positions, normals, near = borrow(positions), borrow(normals), borrow(near)
    models, out = borrow(models), borrow(out)
    shares = np.empty(3)
    tile = next_tile(work)
    while tile >= 0:
        for i in range(tile * CHUNK, min((tile + 1) * CHUNK, len(out))):
            row, yes = rows[i], 0
            p = (f64(positions[row, 0]), f64(positions[row, 1]), f64(positions[row, 2]))
            s0 = s1 = s2 = n0 = n1 = n2 = 0.0
            total = 0.0
            for j in range(near.shape[1]):
                slot = near[i, j]
                if slot < 0 or models[slot, 0] < 2:
                    continue
                other = fitted_rows[slot]
                q = (p[0] - positions[other, 0], p[1] - positions[other, 1], p[2] - positions[other, 2])
                y, n = onto(models[slot], q, ROUNDING * out[i, 7], shares)
                sign = _side(models[slot], normals, row)
                w = f64(models[slot, MODEL - 1])
                yes, total = yes + 1, total + w
                s0, s1, s2 = s0 + w * (y[0] - q[0]), s1 + w * (y[1] - q[1]), s2 + w * (y[2] - q[2])
                n0, n1, n2 = n0 + sign * w * n[0], n1 + sign * w * n[1], n2 + sign * w * n[2]
            length = math.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
            if yes >= FEW and length > AGREE * total:
                out[i, 0], out[i, 1], out[i, 2] = s0 / total, s1 / total, s2 / total
                out[i, 3], out[i, 4], out[i, 5], out[i, 6] = n0 / length, n1 / length, n2 / length, 1.0
        tile = next_tile(work)


class Edges:
    """Points near edges of a noisy surface, and planes fitted there, from which `find_moves` computes rounded edges.

    A quadric, by which other points are smoothed, fits no edge.

    Parameters
    ----------
    positions : (n, 3) float32
        All points in kd order. `add` is called for one part of the rows after another.
    """

    def __init__(self, positions: Floats) -> None:
        self._positions = positions
        self._rows: list[Rows] = []
        self._spacing: list[Floats] = []
        self._fitted_rows: list[Rows] = []
        self._models: list[Floats] = []
        self._errors: list[Floats] = []

    def add(self, rows: Rows, near: NDArray[np.int32], noise: Floats, errors: Floats, spacing: Floats) -> None:
        """Collect those of some rows that a quadric does not fit, and fit planes at the worst of them.

        rows : (m,) the rows, one part of all
        near : (m, k) their nearest neighbours
        noise, spacing : (m,) standard deviation from the surface, and distance between neighbouring points, in the
            points' unit
        errors : (m, 2) residual, beyond the noise, of the quadric fitted to each row, and the quadric's estimated error
        """
        beyond = np.where((noise > 0) & (noise < MUCH * spacing), errors[:, 0], 0.0)
        some = np.flatnonzero(beyond > USES * spacing)
        self._rows.append(rows[some])
        self._spacing.append(spacing[some].astype(np.float32))
        fitted_rows = np.flatnonzero((beyond > BENT * spacing) & (beyond > BEYOND * noise) & (rows % SHARE == 0))
        known = np.stack([noise[fitted_rows], errors[fitted_rows, 1]], axis=1)
        models = fit_creases(self._positions, rows[fitted_rows], near[fitted_rows], known)
        found = models[:, 0] > 0
        self._fitted_rows.append(rows[fitted_rows[found]])
        self._models.append(models[found])
        self._errors.append(known[found])

    def find_moves(self, normals: Floats) -> tuple[Rows, Floats, Floats]:
        """Compute how the collected points near edges move onto them, rounded; call it once after all parts are added.

        Returns (r,) rows near edges; (r, 3) moves from their positions; (r, 3) unit normals there.

        normals : (n, 3) normals of the fitted quadrics, which show the side that the new ones face
        """
        if sum(map(len, self._fitted_rows)) < COMBINED:
            return np.zeros(0, np.int64), normals[:0], normals[:0]
        rows, fitted_rows, models = (
            np.concatenate(self._rows),
            np.concatenate(self._fitted_rows),
            np.concatenate(self._models),
        )
        out = np.zeros((len(rows), 8), np.float32)
        self._widen(fitted_rows, models)
        out[:, 7] = np.concatenate(self._spacing)
        away, near = NeighborTree(self._positions[fitted_rows]).query(COMBINED, self._positions[rows])
        near[away > AROUND * out[:, 7:]] = -1
        run(_settle, -(-len(rows) // CHUNK), self._positions, normals, rows, near, fitted_rows, models, out)
        some = out[:, 6] > 0
        return rows[some], out[some, :3], out[some, 3:6]

    def _widen(self, fitted_rows: Rows, models: Floats) -> None:
        """Fit the planes again, to 128 neighbours, and keep the new ones where they fit well; in place.

        fitted_rows : (c,) rows at which planes were fitted
        models : (c, 14) the planes, as returned by `fit_creases`
        """
        tree, errors = NeighborTree(self._positions, in_order=True), np.concatenate(self._errors)
        for start in range(0, len(fitted_rows), PART):
            part = slice(start, start + PART)
            near = tree.query(WIDE, self._positions[fitted_rows[part]])[1]
            wide = fit_creases(self._positions, fitted_rows[part], near, errors[part])
            fits = wide[:, -1] > GOOD
            models[part][fits] = wide[fits]
