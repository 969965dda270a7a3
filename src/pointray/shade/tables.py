"""What is built once from a scene's lights: the table by which paths choose a light, and trees to find lights.

A path chooses by emitted power (Shirley, Wang and Zimmerman 1996), without knowing how much of it arrives: so a share
of the choices is uniform. With 50 to 5,000 lamps over a floor, one strong lamp far off costs 9 times the noise of the
uniform choice if all choices are by power, and one strong lamp close by costs 11 times the noise of the choice by
power if all are uniform; half and half is within 1.4 of the better one, which is a bound.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..engine.kernels.records import (
    DISK_LIGHT,
    LIGHT,
    LIGHT_AREA,
    LIGHT_KIND,
    LIGHT_POSITION,
    LIGHT_POWER,
    LIGHT_RADIUS,
    LIGHT_U,
    LIGHT_V,
    PICTURE_SKY,
    POINT_LIGHT,
    RECT_LIGHT,
    SKY_KIND,
    SPHERE_LIGHT,
    SUN_LIGHT,
    LightTree,
)
from ..surface.tree.instance_bvh import build_top

Floats = NDArray[np.float64]

FEW_LIGHTS = 8  # up to this number all lights that shine are equally likely
EVEN = 0.5  # the share of uniform choices among many lights
TOGETHER = 4  # this many lights are tested without a box around them
PAD = 1e-9  # share of their coordinates by which boxes grow
FAR = 1e30  # boxes extend no farther
EVEN_SKY = np.pi * 0.282095  # its irradiance's first harmonic over the sum of its radiance


def light_shares(lights: Floats, sky: Floats, sky_mean: Floats, bounds: Floats) -> Floats:
    """The table by which paths choose a light: cumulative shares, from 0 to 1.

    Parameters
    ----------
    lights : (n * 18,) float64
        See `records.LIGHT`.
    sky, sky_mean : (20,) and (27,) float64
        See `records.World`; a picture of the sky is the last of the lights.
    bounds : (2, 3) float64
        Bounds of the scene's models; infinite the wrong way round if there are none.

    Returns
    -------
    (m + 1,) float64
        m : the number of lights, plus one if the sky is a picture. Numbers from shares[k] to shares[k + 1] choose
        light k; no number chooses a light that does not shine. Empty if none shines.

    Notes
    -----
    Suns and the sky have no finite power. They count with the light that they send through a disk as wide as the
    diagonal of the box around all models and lights with a position, or of radius 1 if that has no size: this is more
    than meets the scene.
    """
    records = lights.reshape(-1, LIGHT)
    power = _powers(records, _radius(records, bounds))
    if sky[SKY_KIND] == PICTURE_SKY:
        power = np.append(power, _disk(_radius(records, bounds)) * _brightest(sky_mean[:3]) / EVEN_SKY)
    shines = power > 0
    if not shines.any():
        return np.zeros(0)
    power = np.minimum(power, 1e300)
    even = max(EVEN, min(1.0, FEW_LIGHTS / shines.sum()))
    share = even * shines / shines.sum() + (1.0 - even) * (power / power.max()) / (power / power.max()).sum()
    running = np.concatenate([[0.0], np.cumsum(share)])
    return np.asarray(running / running[-1])


def light_trees(lights: Floats) -> tuple[LightTree, LightTree]:
    """The lights that rays can meet: those with a size, in the world, and suns with a disk, among unit directions."""
    records = lights.reshape(-1, LIGHT)
    kind = records[:, LIGHT_KIND]
    sized = np.flatnonzero((kind != POINT_LIGHT) & (kind != SUN_LIGHT))
    disks = np.flatnonzero((kind == SUN_LIGHT) & (records[:, LIGHT_RADIUS] > 0))
    return _tree(_boxes(records[sized]), sized), _tree(_caps(records[disks]), disks)


def _brightest(colors: Floats) -> Floats:
    return np.asarray(colors.max(axis=-1))


def _disk(radius: float) -> float:
    return float(np.pi * radius * radius)


def _powers(records: Floats, radius: float) -> Floats:
    """The power of each light, W, in its brightest channel. radius : for suns"""
    kind, area = records[:, LIGHT_KIND], records[:, LIGHT_AREA]
    factor = np.select([kind == POINT_LIGHT, kind == SUN_LIGHT], [4.0 * np.pi, _disk(radius)], np.pi * area)
    power = _brightest(records[:, LIGHT_POWER : LIGHT_POWER + 3])
    with np.errstate(over="ignore", invalid="ignore"):
        return np.asarray(np.where(power > 0, np.nan_to_num(factor * power, nan=np.inf), 0.0))


def _radius(records: Floats, bounds: Floats) -> float:
    """Half the diagonal of the box around all models and lights with a position; 1 if it has no size."""
    boxes = _boxes(records[records[:, LIGHT_KIND] != SUN_LIGHT])
    low = np.minimum(bounds[0], boxes[:, :3].min(axis=0, initial=np.inf))
    high = np.maximum(bounds[1], boxes[:, 3:].max(axis=0, initial=-np.inf))
    radius = 0.5 * float(np.linalg.norm(np.maximum(high - low, 0.0)))
    return radius if 0.0 < radius < np.inf else 1.0


def _boxes(records: Floats) -> Floats:
    """The world boxes of lights with a position, (n, 6)."""
    kind, center = records[:, LIGHT_KIND, None], records[:, LIGHT_POSITION : LIGHT_POSITION + 3]
    u, v = np.abs(records[:, LIGHT_U : LIGHT_U + 3]), np.abs(records[:, LIGHT_V : LIGHT_V + 3])
    with np.errstate(over="ignore"):
        aside = np.select(
            [kind == SPHERE_LIGHT, kind == RECT_LIGHT, kind == DISK_LIGHT],
            [np.broadcast_to(records[:, LIGHT_RADIUS, None], center.shape), u + v, np.hypot(u, v)],
            0.0,
        )
        aside = aside + PAD * (np.abs(center) + aside)
        return np.asarray(np.clip(np.concatenate([center - aside, center + aside], axis=1), -FAR, FAR))


def _caps(records: Floats) -> Floats:
    """The boxes around suns' disks on the unit sphere, (n, 6)."""
    middle = -records[:, LIGHT_POSITION : LIGHT_POSITION + 3]
    turn = np.arccos(np.clip(middle, -1.0, 1.0))
    half = np.arccos(np.clip(1.0 - records[:, LIGHT_RADIUS, None], -1.0, 1.0)) + 1e-7  # plus the rounding of a cosine
    low = np.cos(np.minimum(turn + half, np.pi))
    high = np.cos(np.maximum(turn - half, 0.0))
    return np.asarray(np.concatenate([low - PAD, high + PAD], axis=1))


def _tree(boxes: Floats, numbers: NDArray[np.int64]) -> LightTree:
    """Lights in a tree that is traversed from its first entry to its last, see `records.LightTree`."""
    count = len(boxes)
    if count <= TOGETHER:
        return LightTree(numbers.astype(np.int32), np.zeros(count, np.int32), np.zeros(6 * count))
    children = build_top(boxes, np.arange(count))[2].reshape(-1, 2).tolist()
    below = [0] * len(children)  # lights below each node
    for node in range(len(children) - 1, -1, -1):  # children come after their parent
        below[node] = sum(1 if k < 0 else below[k] for k in children[node])
    lights: list[int] = []
    skips: list[int] = []
    rows: list[int] = []  # the lights alone, in this order: indices of boxes
    spans: list[list[int]] = []  # for each box its entry, and in these rows its first light and the one after its last
    waiting: list[tuple[int, int]] = [(0, -1)]  # nodes and lights; after the last one below a span, the span that ends
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
    sorted_boxes = np.concatenate([boxes[rows], boxes[:1]])  # the last one: an end that is no light
    held[entry, :3] = np.minimum.reduceat(sorted_boxes[:, :3], ends)[::2]
    held[entry, 3:] = np.maximum.reduceat(sorted_boxes[:, 3:], ends)[::2]
    return LightTree(np.array(lights, np.int32), np.array(skips, np.int32), held.reshape(-1))
