"""Clip planes: their validation, and the records that kernels read."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..base.arguments import unit_vector, vector
from ..base.arrays import Doubles
from ..engine.kernels.records import CLIP, CLIP_OFFSET

MOST = 16


def check_clip(point: ArrayLike, normal: ArrayLike) -> Doubles:
    """Return point and normal of a clip plane as one array, (2, 3); ValueError if they are invalid.

    normal : of any length, points to the side that is cut away
    """
    unit_vector(normal, "normal")
    return np.stack([vector(point, "point"), vector(normal, "normal")])


def check_clips(clips: Any) -> Doubles:
    """Return clip planes as a read-only array, (k, 2, 3): point and normal of each; ValueError if they are invalid.

    clips : pairs (point, normal), or rows of six numbers
    """
    shapes = "pairs (point, normal) or rows of six numbers"
    try:
        rows = np.asarray(clips)
    except (TypeError, ValueError):
        raise ValueError(f"clips must be {shapes}, all of the same length") from None
    if rows.size == 0 and rows.shape[:1] == (0,):
        rows = np.zeros((0, 2, 3))
    if rows.dtype.kind not in "iuf" or rows.shape[1:] not in ((2, 3), (6,)):
        one = ", even for one plane" if rows.shape in ((2, 3), (6,)) else ""
        raise ValueError(f"clips must be a list of {shapes}{one}, got {rows.dtype} of shape {rows.shape}")
    if len(rows) > MOST:
        raise ValueError(f"clips must be at most {MOST} planes, got {len(rows)}")
    out = np.zeros((len(rows), 2, 3))
    for k, (point, normal) in enumerate(rows.reshape(-1, 2, 3)):
        try:
            out[k] = check_clip(point, normal)
        except ValueError as error:
            raise ValueError(f"clips[{k}]: {error}") from None
    out.flags.writeable = False
    return out


def clip_records(clips: Doubles) -> Doubles:
    """Return the planes' records for kernels, (k * 4,) float64: of each the unit normal n and the offset n . point.

    clips : (k, 2, 3), point and normal of each; everything with n . x > offset is cut away
    """
    out = np.zeros((len(clips), CLIP))
    for record, (point, normal) in zip(out, clips, strict=True):
        record[:CLIP_OFFSET] = unit_vector(normal, "normal")
        record[CLIP_OFFSET] = record[:CLIP_OFFSET] @ point
    return out.reshape(-1)
