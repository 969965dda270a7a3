"""Slow references of fits to neighbours: one point at a time, in float64, with NumPy's solvers."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

RIDGE, LEAST = 1e-4, 8  # as in `points/normals`


class Jet(NamedTuple):
    """A quadric through neighbours, its plane's normal, and variances for unit noise; slope None: a plane."""

    normal: np.ndarray
    axis: np.ndarray
    residual: float
    slope: float | None
    height: float
    spread: float


def plane(d: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Axes of the plane through neighbours (the normal first), their variances, and the weighted mean."""
    w = np.exp(-(d**2).sum(1) / (d[-1] ** 2).sum())
    mean = w @ d / w.sum()
    variances, axes = np.linalg.eigh((w[:, None] * (d - mean)).T @ (d - mean))
    return axes.T, variances, mean


def jet(d: np.ndarray, slim: float) -> Jet:
    """The quadric through neighbours, (k, 3) about the point and nearest first, by two rounds of least squares."""
    (n, u, v), variances, _ = plane(d)
    if len(d) < LEAST or variances[1] < slim * variances[2]:
        return Jet(n, n, 0.0, None, 0.0, 0.0)
    far = np.sqrt((d[-1] ** 2).sum())
    p, q, h = d @ u / far, d @ v / far, d @ n / far
    terms = np.stack([np.ones(len(d)), p, q, p * p, p * q, q * q], axis=1)
    near = np.exp(-(d**2).sum(1) / far**2)

    def solve(w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        ridge = RIDGE * w.sum() * np.diag([0, 0, 0, 1, 1, 1])
        inverse = np.linalg.inv(terms.T @ (w[:, None] * terms) + ridge)
        return inverse @ terms.T @ (w * h), inverse

    x, _ = solve(near)
    r = h - terms @ x
    w = near / (1 + r**2 / (4 * (near @ r**2) / near.sum() + 1e-12)) ** 2
    x, inverse = solve(w)
    r = h - terms @ x
    total, squares = w.sum(), (w**2).sum()
    effective = total**2 / squares
    square = w @ r**2 / total * effective / max(effective - 6, 1)
    normal = n - x[1] * u - x[2] * v
    slope = (inverse[1, 1] + inverse[2, 2]) * squares / total / far**2
    spread = inverse[0, 0] * squares / total
    return Jet(normal / np.linalg.norm(normal), n, far * np.sqrt(square), slope, far * x[0], spread)


def normal_and_plane(d: np.ndarray, sizes: list[int], noise: float) -> tuple[np.ndarray, np.ndarray, float]:
    """The normal of the size with the least error, a plane's, and the least size's residual, as `jets` has them."""
    spacing = np.sqrt((d[-1] ** 2).sum() / len(d))
    best, axis, first, least, settled = None, None, np.nan, np.inf, False
    for k in sizes:
        found = jet(d[:k], 0.2 if k < sizes[-1] else 0.05)
        if not settled:
            axis, settled = found.axis, k >= 16 and found.slope is not None
        if k == sizes[0] and found.slope is not None:
            first = found.residual / spacing
        if k < sizes[-1] and found.slope is None:
            continue
        slope = 1e30 if found.slope is None else found.slope * spacing**2
        error = slope * noise**2 + 0.15 * max((found.residual / spacing) ** 2 - noise**2, 0.0)
        if error < least:
            least, best = error, found.normal
    return best, axis, first


def to_surface(d: np.ndarray, sizes: list[int], noise: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Shift, normal, plane's normal and the two errors of a point, as `fit_surface` has them."""
    shift, normal, axis = np.zeros((3, 3))
    least, left, square = np.inf, 0.0, noise**2
    for k in sizes[::-1]:
        largest = k == sizes[-1]
        if not largest and len(d) <= k:
            continue
        if len(d) < 6 or (not largest and (d[k - 1] ** 2).sum() < 25 * square):
            break
        found = jet(d[:k], 0.05 if largest else 0.2)
        if found.slope is None:
            continue
        left = found.residual**2 if largest else left
        error = found.spread * square + 0.15 * max(found.residual**2 - 0.64 * square, 0.0)
        if error < least:
            least, normal, axis = error, found.normal, found.axis
            shift = found.height * (normal @ axis) * normal
        if least <= 1.8 * found.spread * square:
            break
    return shift, normal, axis, np.array([np.sqrt(max(left - 0.64 * square, 0.0)), np.sqrt(least)])


def _fitted(d: np.ndarray, w: np.ndarray) -> np.ndarray:
    """The plane through weighted places: normal and offset."""
    mean = w @ d / w.sum()
    n = np.linalg.eigh((w[:, None] * (d - mean)).T @ (d - mean))[1][:, 0]
    return np.append(n, -(n @ mean))


def _candidates(d: np.ndarray) -> np.ndarray:
    away, place, found = np.full(len(d), np.inf), 0, []
    for _ in range(9):
        square = ((d - d[place]) ** 2).sum(1)
        inside = square < 0.52**2
        found.append(_fitted(d[inside], (1 - square[inside] / 0.52**2) ** 2))
        away = np.minimum(away, square)
        place = int(away.argmax())
    return np.array(found)


def _solid(heights: np.ndarray, cut: float) -> float:
    """Sum of squared distances to the solid of planes."""
    return float(np.minimum(heights.max(axis=1) ** 2, cut).sum())


def _two(found: np.ndarray, judges: np.ndarray, cut: float) -> tuple[float, np.ndarray]:
    least, best = np.inf, np.array([found[0], found[0]])
    for a in range(9):
        for b in range(a):
            if abs(found[a, :3] @ found[b, :3]) > 0.9:
                continue
            for signs in ((1, 1), (-1, -1), (1, -1), (-1, 1)):
                pair = np.array([signs[0] * found[a], signs[1] * found[b]])
                square = _solid(judges @ pair.T, cut)
                if square < least:
                    least, best = square, pair
    return least, best


def _third(found: np.ndarray, pair: np.ndarray, judges: np.ndarray, cut: float) -> tuple[float, np.ndarray]:
    chosen, least = np.vstack([pair, pair[:1]]), np.inf
    for at in (2, 0, 1):
        others, best = np.delete(chosen, at, axis=0), np.inf
        for candidate in found:
            if max(abs(others[:, :3] @ candidate[:3])) > 0.9:
                continue
            for sign in (1, -1):
                square = _solid(judges @ np.vstack([others, sign * candidate]).T, cut)
                if square < best:
                    best, chosen[at] = square, sign * candidate
        least = min(least, best)
        if at == 2 and best == np.inf:
            break
    return least, chosen


def _refined(d: np.ndarray, planes: np.ndarray, sigma: float) -> np.ndarray | None:
    near, ones = np.exp(-(d**2).sum(1)), np.column_stack([d, np.ones(len(d))])
    for _ in range(4):
        heights = ones @ planes.T
        order = np.sort(heights, axis=1)
        mine = (abs(order[:, -1]) < 3 * sigma) & (order[:, -2] < -sigma)
        owner = np.where(mine, heights.argmax(axis=1), -1)
        if min((owner == a).sum() for a in range(len(planes))) < 8:
            return None
        fitted = np.array([_fitted(d[owner == a], near[owner == a]) for a in range(len(planes))])
        planes = fitted * np.where((fitted[:, :3] * planes[:, :3]).sum(1) < 0, -1, 1)[:, None]
    return planes


def crease(d: np.ndarray, sigma: float, quadric: float) -> np.ndarray | None:
    """The planes beside a point, (2 or 3, 4), as `fit_creases` has them; quadric: the error of what is fitted else."""
    far, k = np.sqrt((d[-1] ** 2).sum()), len(d)
    d, sigma, quadric = d / far, sigma / far, quadric / far
    left = jet(d, 0.05).residual ** 2
    if left < 0.9 * sigma**2:
        return None
    found, cut = _candidates(d), (3 * sigma) ** 2
    judges = np.column_stack([d, np.ones(k)])[:: max(k // 31, 1)]
    poor = 3 * sigma**2 * len(judges)
    two, pair = _two(found, judges, cut)
    if two > 2 * poor:
        return None
    three, triple = _third(found, pair, judges, cut)
    if min(two, three) > poor:
        return None
    planes = _refined(d, triple, sigma) if three < 0.75 * two else None
    planes = _refined(d, pair, sigma) if planes is None else planes
    if planes is None:
        return None
    w = np.exp(-(d**2).sum(1))
    effective = w.sum() ** 2 / (w**2).sum()
    top = (np.column_stack([d, np.ones(k)]) @ planes.T).max(axis=1)
    apart = w @ top**2 / w.sum() * effective / max(effective - 3 * len(planes), 1)
    error = 3 / effective * len(planes) * sigma**2 + 0.15 * max(apart - sigma**2, 0)
    if error >= quadric**2 or effective * (left - apart) <= 30 * sigma**2:
        return None
    return planes * [1, 1, 1, far]
