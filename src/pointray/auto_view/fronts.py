"""Test whether a view shows back faces of surfaces."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..rendering.camera import Camera
from ..scene.scene import Scene

ACROSS = 48  # rays per row
BACKS = 0.25  # share of the hits


def shows_backs(scene: Scene, camera: Camera) -> bool:
    """Return whether more than 25% of a camera's hits are back faces, as for leaves and unoriented normals.

    Marking holes by desaturated back faces (`Settings.backfaces`) would then only produce patches.
    """
    width, height = camera.size
    few = replace(camera, size=(ACROSS, max(round(ACROSS * height / width), 1)))
    origins, directions = few.rays()
    hits = scene.intersect(origins, directions)
    hit = np.isfinite(hits.t)
    back = hit & ((hits.normal * directions).sum(axis=-1) > 0)
    return int(back.sum()) > BACKS * int(hit.sum())
