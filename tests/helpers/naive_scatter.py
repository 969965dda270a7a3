"""Slow reference of `scattered/classification.py` without normals: all distances, NumPy's eigenvectors, float64."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pointray.cloud.neighbors import kd_order
from pointray.surface.splats.scattered import classification as scatter, rules as scatter_rules
from pointray.surface.splats.scattered.islands import CLOSED_IN, ISLANDS, SPECKS

ISLAND_LIMITS = CLOSED_IN, SPECKS, ISLANDS


class Planes(NamedTuple):
    """Planes through neighbours: unit normals (n, 3), and numbers (n,) as in `LocalPlanes`; means (n, 3)."""

    normals: np.ndarray
    thickness: np.ndarray
    slimness: np.ndarray
    means: np.ndarray
    reach: np.ndarray


def nearest(x: np.ndarray, k: int) -> np.ndarray:
    """Rows of the k nearest of each point, itself first."""
    squares = ((x[:, None] - x) ** 2).sum(axis=2)
    return np.argsort(squares, axis=1, kind="stable")[:, :k]


def planes(x: np.ndarray, near: np.ndarray) -> Planes:
    """Planes through the neighbours of each point; the last one is the farthest."""
    rows = []
    for i, neighbors in enumerate(near):
        mean = x[neighbors].mean(axis=0)
        variances, axes = np.linalg.eigh(np.cov((x[neighbors] - mean).T, bias=True))
        thickness = np.sqrt(max(variances[0], 0))
        reach = np.linalg.norm(x[neighbors[-1]] - x[i])
        rows.append((axes[:, 0], thickness, variances[1] / variances[2], mean, reach))
    return Planes(*(np.array(column) for column in zip(*rows, strict=True)))


def bends(normals: np.ndarray, near: np.ndarray) -> np.ndarray:
    """Mean square of the sine between each point's normal and those of its neighbours."""
    return np.array([np.mean(1 - (normals[js] @ normals[i]) ** 2) for i, js in enumerate(near)])


def within(
    limits: scatter_rules.Limits, h: np.ndarray, bend: np.ndarray, thickness: np.ndarray, off: np.ndarray
) -> np.ndarray:
    """Return whether a scale is a surface, not considering slimness."""
    return (bend < limits.bend) & (thickness < limits.thickness * h) & (off < limits.offset * h)


def absorb_islands(
    surface: np.ndarray, alone: np.ndarray, near: np.ndarray, limits: tuple[float, int, int]
) -> np.ndarray:
    """Marks after small groups have followed what closes them in; limits : CLOSED_IN, SPECKS, ISLANDS."""
    n, (closed_in, specks, islands) = len(near), limits
    links = {i: set() for i in range(n)}
    for i in range(n):
        for j in near[i]:
            links[i].add(int(j))
            links[int(j)].add(i)
    out, seen = np.array(surface, np.float32), np.zeros(n, np.bool_)
    for start in range(n):
        if seen[start]:
            continue
        group, todo = set(), [start]
        while todo:
            i = todo.pop()
            if i not in group:
                group.add(i)
                todo += [j for j in links[i] if surface[j] == surface[i]]
        rows = np.array(sorted(group))
        seen[rows] = True
        inside = np.isin(near, rows)
        contacts = (~inside[rows]).sum() + np.delete(inside, rows, axis=0).sum()
        small = len(rows) < islands if surface[start] else len(rows) >= specks
        if small and contacts > closed_in * near.shape[1] * len(rows):
            out[rows] = np.where((surface[rows] > 0) | (alone[rows] == 0), 1 - surface[rows], surface[rows])
    return out


def scattered(positions: np.ndarray) -> np.ndarray:
    """Which of some different positions are scattered; at least 16 * 17 of them."""
    order, rules = kd_order(positions), scatter_rules
    x = positions[order].astype(np.float64)
    near = nearest(x, 17)

    def median(values: np.ndarray) -> np.ndarray:
        return np.median(values[near[:, :9]], axis=1)

    fine = [planes(x, near[:, 1:9]), planes(x, near[:, 1:17])]
    off = [np.abs(((x - p.means) * p.normals).sum(axis=1)) for p in fine]
    bend = [median(bends(p.normals, near[:, 1:])) for p in fine]
    coarse = []
    for step in (4, 16):
        some = x[step // 2 :: step]
        part = np.minimum(np.arange(len(x)) // step, len(some) - 1)
        p = Planes(*(column[part] for column in planes(some, nearest(some, 17))))
        heights = np.einsum("nkc,nkc->nk", x[:, None] - p.means[near[:, :9]], p.normals[near[:, :9]])
        coarse.append((p, bends(p.normals, near[:, :9]), np.median(np.abs(heights), axis=1)))
    h = rules.SPACING * median(fine[0].reach)
    wide, far = median(fine[1].reach), median(coarse[0][0].reach)
    thick = [median(p.thickness) for p, *_ in coarse]
    slim = [median(p.slimness) for p, *_ in coarse]
    line = (median(fine[0].slimness) < rules.NEAR.slimness) | (median(fine[1].slimness) < rules.WIDE.slimness)
    strip = (far > rules.STRIP_GAP * wide) & (slim[0] < rules.STRIP_SLIMNESS)
    strip &= (thick[0] > rules.STRIP_COARSE * h) & (thick[1] > rules.STRIP_COARSEST * h)
    surface = within(rules.NEAR, h, bend[0], median(fine[0].thickness), off[0])
    surface |= within(rules.WIDE, h, bend[1], median(fine[1].thickness), off[1])
    surface &= ~line & ~strip
    thin = (thick[0] < rules.LINE_COARSE * h) & (far < rules.LINE_GAP * wide)
    on = within(rules.COARSE, h, coarse[0][1], thick[0], coarse[0][2]) & (slim[0] > rules.COARSE.slimness)
    surface |= on & (thin | ~line)
    on = within(rules.COARSEST, h, coarse[1][1], thick[1], coarse[1][2]) & (slim[1] > rules.COARSEST.slimness)
    surface |= on & ((thick[1] < rules.LINE_COARSEST * h) | ~line)
    own, least = fine[0].reach * rules.SPACING, np.minimum(*off)
    alone = (own > rules.ALONE * h) & (least > rules.ALONE_OFF * h) & ((own - h) * least > rules.ALONE_BOTH * h**2)
    some = x[2::4]
    part, around = np.minimum(np.arange(len(x)) // 4, len(some) - 1), nearest(some, 17)

    def share(values: np.ndarray) -> np.ndarray:
        return np.array([values[4 * k : 4 * k + 4].mean() for k in range(len(some))])[around].mean(axis=1)[part]

    alone |= fine[0].reach > scatter.SPARSEST * share(fine[0].reach)
    surface &= ~alone
    alone |= ~surface & (fine[0].reach > scatter.SPARSE * share(fine[0].reach))
    for keep, lose in [(rules.KEEP, rules.LOSE)] * scatter.ROUNDS + [(rules.KEEP, 0)] * scatter.ROUNDS:
        votes = surface[near[:, 1:]].sum(axis=1)
        surface = np.where(votes >= keep, True, np.where(votes < lose, False, surface)) & ~alone
    close = off[1] < scatter.MOSTLY_OFF * rules.SPACING * fine[0].reach
    surface |= close & ~alone & (share(surface) >= scatter.MOSTLY)
    surface = absorb_islands(surface, alone, near[:, 1:9], ISLAND_LIMITS) > 0
    out = np.empty(len(x), np.bool_)
    out[order] = ~surface
    return out
