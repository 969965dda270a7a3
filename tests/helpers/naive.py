"""Slow reference of the tracer: f by its definition in float64, over all splats, without tree, slab or SIMD."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from pointray.engine.jit import inline, kernel, next_tile, run
from pointray.engine.kernels.tree import SCATTER, SPHERES, first_scattered
from pointray.surface.intersect.march import BORDER_SHARE
from pointray.surface.tree.scattered import scattered_of

KINDS = {"paper": 0, "imls": 1, "apss": 2}
STEPS = 40  # samples in a radius


class ReferenceHits(NamedTuple):
    """Result of the reference for each ray.

    t : (n,) float64, inf for a miss; radius : local radius at the hit
    doubtful : (n,) bool: a graze, two crossings closer than half a radius, or a hit close to a limit (trim, jump)
    """

    t: np.ndarray
    radius: np.ndarray
    doubtful: np.ndarray


@inline
def field(splats, chosen, count, x, kind):  # type: ignore[no-untyped-def]
    """(f, |x - P|, local radius, border splats' share of the weight, distance out of them) at x; NaN without support.

    splats : rows of position, normal, radius, direction out of the border, and normal if of two sheets (13 numbers)
    """
    w_sum, r_sum, b_sum, out, qn, qq = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    q, n = np.zeros(3), np.zeros(3)
    for k in range(count):
        s = splats[chosen[k]]
        d = s[:3] - x
        square = (d * d).sum()
        if square >= s[6] * s[6]:
            continue
        w = (1.0 - square / (s[6] * s[6])) ** 2
        w_sum += w
        r_sum += w * s[6] * s[6]
        if (s[7:10] != 0.0).any():
            b_sum += w
            out -= w * (d * s[7:10]).sum()
        q += w * d
        n += w * s[3:6]
        qn += w * (d * s[3:6]).sum()
        qq += w * square
    if w_sum == 0.0:
        return np.nan, np.nan, np.nan, np.nan, np.nan
    q, n, qn, qq = q / w_sum, n / w_sum, qn / w_sum, qq / w_sum
    center, plane = (q * q).sum(), (q * n).sum()
    f = -plane if kind == 0 else -qn
    if kind == 2:
        u4 = 0.5 * (qn - plane) / max(qq - center, 0.25 * qq, 1e-300)
        f = -plane - u4 * (qq - 2.0 * center)
    return f, math.sqrt(center), math.sqrt(r_sum / w_sum), b_sum / w_sum, out / max(b_sum, 1e-300)


@inline
def bisect(splats, chosen, count, ray, ends, kind):  # type: ignore[no-untyped-def]
    """t of the sign change between two t."""
    o, d = ray
    a, b = ends
    fa = field(splats, chosen, count, o + a * d, kind)[0]
    for _ in range(40):
        middle = 0.5 * (a + b)
        f = field(splats, chosen, count, o + middle * d, kind)[0]
        if (f < 0.0) == (fa < 0.0):
            a = middle
        else:
            b = middle
    return 0.5 * (a + b)


@kernel
def _walk(work, splats, origins, directions, settings, out):  # type: ignore[no-untyped-def]
    """Step along each ray; out : t, radius, doubtful."""
    kind, trim, overhang, border_share, sought_side = settings
    t_out, radius_out, doubtful = out
    chosen, near, far = np.empty(len(splats), np.int64), np.empty(len(splats)), np.empty(len(splats))
    i = next_tile(work)
    while i >= 0:
        o, d = origins[i], directions[i]
        count, smallest = 0, np.inf
        for k in range(len(splats)):
            x, y, z = splats[k, 0] - o[0], splats[k, 1] - o[1], splats[k, 2] - o[2]
            along = x * d[0] + y * d[1] + z * d[2]
            rest = splats[k, 6] ** 2 - (x * x + y * y + z * z - along * along)
            seen = sought_side * (splats[k, 10] * d[0] + splats[k, 11] * d[1] + splats[k, 12] * d[2]) <= 0.0
            if seen and rest > 0.0 and along + splats[k, 6] > 0.0:
                chosen[count] = k
                near[count], far[count] = along - math.sqrt(rest), along + math.sqrt(rest)
                smallest = min(smallest, splats[k, 6])
                count += 1
        t_out[i], radius_out[i], doubtful[i] = np.inf, 0.0, False
        order = np.argsort(near[:count])
        k, t, step = 0, 0.0, smallest / STEPS
        before, before2, last_cross = np.nan, np.nan, -np.inf
        active = np.empty(count, np.int64)
        live = 0
        found = np.inf
        while True:
            keep = 0
            for a in range(live):
                if far[active[a]] > t - 2.0 * step:
                    active[keep] = active[a]
                    keep += 1
            live = keep
            if live == 0:
                if k >= count:
                    break
                t = max(near[order[k]], t)
                before = before2 = np.nan
            while k < count and near[order[k]] <= t + step:
                active[live] = order[k]
                live += 1
                k += 1
            names = np.empty(live, np.int64)
            for a in range(live):
                names[a] = chosen[active[a]]
            f, _, radius, _, _ = field(splats, names, live, o + t * d, kind)
            if found < np.inf:
                # Behind the hit, only a second crossing closer than half a radius matters.
                if t > found + 0.5 * radius_out[i] or f != f:
                    break
                if (f < 0.0) != (before < 0.0):
                    doubtful[i] = True
                    break
            elif (f < 0.0 and before >= 0.0) or (f >= 0.0 and before < 0.0):
                at = bisect(splats, names, live, (o, d), (t - step, t), kind)
                value, offset, local, share, out = field(splats, names, live, o + at * d, kind)
                over = share > border_share and out > overhang * local
                if abs(value) > 0.01 * local or abs(offset - trim * local) < 0.02 * local:
                    doubtful[i] = True
                if share > border_share - 0.02 and out > (overhang - 0.02) * local:
                    doubtful[i] = doubtful[i] or share < border_share + 0.02 or out < (overhang + 0.02) * local
                other = sought_side != 0.0 and (f < 0.0) != (sought_side > 0.0)  # of two sheets the one not sought
                if offset <= trim * local and not over and not other and abs(value) <= 0.05 * local:
                    if at - last_cross < 0.5 * local:
                        doubtful[i] = True
                    t_out[i], radius_out[i], found = at, local, at
                else:
                    last_cross = at
            else:
                lowest = abs(before) < 0.02 * radius and abs(before) <= abs(before2) and abs(before) <= abs(f)
                if lowest or (f != f and abs(before) < 0.02 * smallest):
                    doubtful[i] = True
            before2, before = before, f
            t += step
        i = next_tile(work)
    return 0


def splats_of(model):  # type: ignore[no-untyped-def]
    """The splats of a model's surface, (n, 13) float64, as `field` takes them."""
    tree = model.tree
    used = tree.order >= 0
    used[4 * first_scattered(tree) :] = False
    splats = np.zeros((used.sum(), 13))
    splats[:, :7] = tree.blocks.reshape(-1, 7, 4).transpose(0, 2, 1).reshape(-1, 7)[used]
    splats[:, 6] = 1 / np.sqrt(splats[:, 6])
    if tree.borders.size:
        splats[:, 7:10] = tree.borders.reshape(-1, 3)[used] / 127
    if tree.facing.size:
        splats[:, 10:] = tree.facing.reshape(-1, 3)[used]
    return splats


def walk(model, origins, directions):  # type: ignore[no-untyped-def]
    """The closest hits of world rays (n, 3), with unit directions, on one model without a transform."""
    splats = splats_of(model)
    if not model.tree.facing.size:
        return _walk_one(model, splats, origins, directions, 0.0)
    toward, away = (_walk_one(model, splats, origins, directions, sought_side) for sought_side in (1.0, -1.0))
    first = (toward.t <= away.t)[:, None]
    return ReferenceHits(*(np.where(first[:, 0], a, b) for a, b in zip(toward, away, strict=True)))


def _walk_one(model, splats, origins, directions, sought_side):  # type: ignore[no-untyped-def]
    """Like `walk`, for sheets that face the ray (sought_side 1), face away (-1), or all (0)."""
    n = len(origins)
    twin = ReferenceHits(np.empty(n), np.empty(n), np.zeros(n, np.bool_))
    trims = float(model.settings.trim), float(model.settings.overhang)
    settings = (KINDS[model.surface], *trims, float(BORDER_SHARE), sought_side)
    run(_walk, n, splats, np.ascontiguousarray(origins - model.points.origin), directions, settings, tuple(twin))
    return twin


class ScatteredHits(NamedTuple):
    """The nearest scattered point on each ray.

    t : (n,) float64, inf for a miss; row : (n,), the caller's, -1 for a miss
    doubtful : (n,) bool: a ray that touches a sphere or starts on it, or hits two at the same t
    """

    t: np.ndarray
    row: np.ndarray
    doubtful: np.ndarray


def intersect_scattered(model, origins, directions, t_max=np.inf):  # type: ignore[no-untyped-def]
    """The nearest scattered points along world rays (n, 3) with unit directions, each against all in float64."""
    scattered = scattered_of(model.tree, model.radii)
    centers, radii = scattered.positions + model.points.origin, scattered.radii.astype(np.float64)
    normals = scattered.normals.astype(np.float64)
    t, row, doubtful = np.full(len(origins), np.inf), np.full(len(origins), -1), np.zeros(len(origins), np.bool_)
    for i, (o, d) in enumerate(zip(origins, directions, strict=True)):
        to = centers - o
        if model.tree.head[SCATTER] == SPHERES:
            along = to @ d
            rest = radii**2 - ((to - along[:, None] * d) ** 2).sum(axis=1)
            half = np.sqrt(np.maximum(rest, 0))
            each = np.where(along - half > 0, along - half, along + half)
            away = np.abs(np.linalg.norm(to, axis=1) / radii - 1)
            unsure = (np.abs(rest) < 1e-3 * radii**2) | (away < 0.012)
            each[(rest < 0) | (each < 0)] = np.inf
        else:
            with np.errstate(divide="ignore", invalid="ignore"):
                each = (to * normals).sum(axis=1) / (normals @ d)
                rest = radii**2 - ((to - each[:, None] * d) ** 2).sum(axis=1)
            unsure = np.abs(rest) < 1e-3 * radii**2
            each[~((rest >= 0) & (each > 0))] = np.inf
        each[each > t_max] = np.inf
        k = each.argmin()
        if each[k] < np.inf:
            t[i], row[i] = each[k], scattered.rows[k]
        doubtful[i] = (unsure & (each <= t[i] + radii)).any()
        doubtful[i] |= (each < t[i] + 1e-4 * radii[k]).sum() > 1
        doubtful[i] |= (unsure & (np.abs(to @ d) < t[i] + 2 * radii)).any()
    return ScatteredHits(t, row, doubtful)
