"""Tables built from a scene's lights: the distribution by which paths choose a light, and trees of lights.

Lights are chosen by emitted power (Shirley, Wang and Zimmerman 1996), mixed half and half with a uniform choice, as the
arriving power is unknown. With 50 to 5,000 lamps over a floor, choice by power alone has 9 times the noise of the
uniform one if a strong lamp is far away; uniform choice alone has 11 times the noise of choice by power if a strong
lamp is close. The mixture is within 1.4 of the better one, which is a bound.
"""

from __future__ import annotations

import numpy as np

from ..base.arrays import Doubles, Rows
from ..engine.kernels import records as rec
from ..engine.kernels.records import LightTree
from ..surface.tree.instance_bvh import build_top

FEW_LIGHTS = 8  # up to this number the choice is uniform
EVEN = 0.5  # weight of the uniform choice with more lights
TOGETHER = 4  # lights of a leaf of the tree
PAD = 1e-9  # growth of boxes, relative to their coordinates
FAR = 1e30  # limit of box coordinates
EVEN_SKY = np.pi * 0.282095  # first harmonic of the irradiance, divided by the integral of the radiance


def light_shares(lights: Doubles, sky: Doubles, sky_mean: Doubles, bounds: Doubles) -> Doubles:
    """Return the cumulative distribution by which paths choose a light, roughly by emitted power.

    Parameters
    ----------
    lights : (n * 18,) float64
        Records of the lights, see `records.LIGHT`.
    sky, sky_mean : (20,) and (27,) float64
        The environment light and its irradiance, see `records.World`; an environment image follows the last light.
    bounds : (2, 3) float64
        Bounds of the scene's models; inf and -inf without models.

    Returns
    -------
    (m + 1,) float64
        m is the number of lights, plus one for an environment image. Random numbers from shares[k] to shares[k + 1]
        choose light k; black lights are never chosen. Empty if all are black.

    Notes
    -----
    Suns and the sky have infinite power. Instead the flux through a disk is used, whose diameter is the diagonal of the
    box around all models and lights with a position, or 2 if that is zero: an upper bound of what reaches the scene.
    """
    records = lights.reshape(-1, rec.LIGHT)
    power = _powers(records, _radius(records, bounds))
    if sky[rec.SKY_KIND] == rec.PICTURE_SKY:
        power = np.append(power, _disk(_radius(records, bounds)) * _brightest(sky_mean[:3]) / EVEN_SKY)
    shines = power > 0
    if not shines.any():
        return np.zeros(0)
    power = np.minimum(power, 1e300)
    even = max(EVEN, min(1.0, FEW_LIGHTS / shines.sum()))
    share = even * shines / shines.sum() + (1.0 - even) * (power / power.max()) / (power / power.max()).sum()
    running = np.concatenate([[0.0], np.cumsum(share)])
    return np.asarray(running / running[-1])


def light_trees(lights: Doubles) -> tuple[LightTree, LightTree]:
    """Build trees over the lights that rays can hit: (area lights by their world boxes, suns with a disk by direction).

    lights : (n * 18,) float64, records of the lights, see `records.LIGHT`
    """
    records = lights.reshape(-1, rec.LIGHT)
    kind = records[:, rec.LIGHT_KIND]
    sized = np.flatnonzero((kind != rec.POINT_LIGHT) & (kind != rec.SUN_LIGHT))
    disks = np.flatnonzero((kind == rec.SUN_LIGHT) & (records[:, rec.LIGHT_RADIUS] > 0))
    return _tree(_boxes(records[sized]), sized), _tree(_caps(records[disks]), disks)


def _brightest(colors: Doubles) -> Doubles:
    return np.asarray(colors.max(axis=-1))


def _disk(radius: float) -> float:
    return float(np.pi * radius * radius)


def _powers(records: Doubles, radius: float) -> Doubles:
    """Return the power of each light, W, in its brightest channel, (n,).

    records : (n, 18), see `records.LIGHT`; radius : of a disk around the scene, through which the flux of suns is
        counted
    """
    kind, area = records[:, rec.LIGHT_KIND], records[:, rec.LIGHT_AREA]
    factor = np.select([kind == rec.POINT_LIGHT, kind == rec.SUN_LIGHT], [4.0 * np.pi, _disk(radius)], np.pi * area)
    power = _brightest(records[:, rec.LIGHT_POWER : rec.LIGHT_POWER + 3])
    with np.errstate(over="ignore", invalid="ignore"):
        return np.asarray(np.where(power > 0, np.nan_to_num(factor * power, nan=np.inf), 0.0))


def _radius(records: Doubles, bounds: Doubles) -> float:
    """Return half the diagonal of the box around all models and lights with a position; 1 if that is zero.

    records : (n, 18), see `records.LIGHT`; bounds : (2, 3), of the models
    """
    boxes = _boxes(records[records[:, rec.LIGHT_KIND] != rec.SUN_LIGHT])
    low = np.minimum(bounds[0], boxes[:, :3].min(axis=0, initial=np.inf))
    high = np.maximum(bounds[1], boxes[:, 3:].max(axis=0, initial=-np.inf))
    radius = 0.5 * float(np.linalg.norm(np.maximum(high - low, 0.0)))
    return radius if 0.0 < radius < np.inf else 1.0


def _boxes(records: Doubles) -> Doubles:
    """Return the world bounds of lights with a position, (n, 6): lo x y z, hi x y z.

    records : (n, 18), see `records.LIGHT`
    """
    kind, center = records[:, rec.LIGHT_KIND, None], records[:, rec.LIGHT_POSITION : rec.LIGHT_POSITION + 3]
    u, v = np.abs(records[:, rec.LIGHT_U : rec.LIGHT_U + 3]), np.abs(records[:, rec.LIGHT_V : rec.LIGHT_V + 3])
    with np.errstate(over="ignore"):
        aside = np.select(
            [kind == rec.SPHERE_LIGHT, kind == rec.RECT_LIGHT, kind == rec.DISK_LIGHT],
            [np.broadcast_to(records[:, rec.LIGHT_RADIUS, None], center.shape), u + v, np.hypot(u, v)],
            0.0,
        )
        aside = aside + PAD * (np.abs(center) + aside)
        return np.asarray(np.clip(np.concatenate([center - aside, center + aside], axis=1), -FAR, FAR))


def _caps(records: Doubles) -> Doubles:
    """Return boxes around the disks of suns as parts of the unit sphere, (n, 6): lo x y z, hi x y z.

    records : (n, 18), see `records.LIGHT`
    """
    middle = -records[:, rec.LIGHT_POSITION : rec.LIGHT_POSITION + 3]
    turn = np.arccos(np.clip(middle, -1.0, 1.0))
    half = (
        np.arccos(np.clip(1.0 - records[:, rec.LIGHT_RADIUS, None], -1.0, 1.0)) + 1e-7
    )  # covers the rounding of cosines
    low = np.cos(np.minimum(turn + half, np.pi))
    high = np.cos(np.maximum(turn - half, 0.0))
    return np.asarray(np.concatenate([low - PAD, high + PAD], axis=1))


def _tree(boxes: Doubles, numbers: Rows) -> LightTree:
    """Build a tree over lights for traversal without a stack: entries in depth-first order, with skip indices.

    boxes : (n, 6), lo x y z, hi x y z; numbers : (n,), indices of the lights in `World.lights`
    """
    count = len(boxes)
    if count <= TOGETHER:
        return LightTree(numbers.astype(np.int32), np.zeros(count, np.int32), np.zeros(6 * count))
    children = build_top(boxes, np.arange(count))[2].reshape(-1, 2).tolist()
    below = [0] * len(children)  # lights below each node
    for node in range(len(children) - 1, -1, -1):  # children come after their parent
        below[node] = sum(1 if k < 0 else below[k] for k in children[node])
    lights: list[int] = []
    skips: list[int] = []
    rows: list[int] = []  # indices of the lights' boxes, in the order of the tree
    spans: list[list[int]] = []  # for each node: its entry, and the range of its lights in rows
    waiting: list[tuple[int, int]] = [(0, -1)]  # stack of (node or light, -1), and of (0, span) where a span ends
    while waiting:
        k, span = waiting.pop()
        if span >= 0:
            spans[span][2], skips[spans[span][0]] = len(rows), len(lights)
        elif k < 0:
            lights.append(int(numbers[~k]))
            skips.append(0)
            rows.append(~k)
        else:
            if below[k] > TOGETHER:
                waiting.append((0, len(spans)))
                spans.append([len(lights), len(rows), 0])
                lights.append(-1)
                skips.append(0)
            waiting += [(child, -1) for child in reversed(children[k])]
    entry, first, end = np.array(spans).T
    held, ends = np.zeros((len(lights), 6)), np.stack([first, end], axis=1).ravel()
    sorted_boxes = np.concatenate([boxes[rows], boxes[:1]])  # a sentinel, so that all ends are valid indices
    held[entry, :3] = np.minimum.reduceat(sorted_boxes[:, :3], ends)[::2]
    held[entry, 3:] = np.maximum.reduceat(sorted_boxes[:, 3:], ends)[::2]
    return LightTree(np.array(lights, np.int32), np.array(skips, np.int32), held.reshape(-1))
