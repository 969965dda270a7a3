"""Whether a view of a scene shows the sides of surfaces to which their normals point."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..rendering.camera import Camera
from ..scene.scene import Scene

ACROSS = 48  # rays in a row
BACKS = 0.25  # share of the hits


def shows_backs(scene: Scene, camera: Camera) -> bool:
    """Whether more than a quarter of what a camera sees are back faces: leaves, or normals on either side.

    Muted back faces, see `Settings`, would then make patches instead of showing holes.
    """
    width, height = camera.size
    few = replace(camera, size=(ACROSS, max(round(ACROSS * height / width), 1)))
    origins, directions = few.rays()
    hits = scene.intersect(origins, directions)
    hit = np.isfinite(hits.t)
    back = hit & ((hits.normal * directions).sum(axis=-1) > 0)
    return int(back.sum()) > BACKS * int(hit.sum())
