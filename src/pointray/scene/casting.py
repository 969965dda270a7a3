"""Rays cast at a scene as it was at one moment."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..surface.trace.cast import PLAIN, Pace
from .blend import blend, blended_form
from .paged_rays import closest_reached, occluded_reached
from .rays import Hits, Rays
from .world import Snapshot

Given = tuple[ArrayLike, ArrayLike, ArrayLike, ArrayLike]  # origins, directions, t_min and t_max, as callers give them


def intersect_snapshot(
    scene: Snapshot, shape: tuple[int, ...], rays: Rays, attributes: Sequence[str] = (), pace: Pace = PLAIN
) -> Hits:
    """The closest hits of checked rays, see `Scene.intersect`. shape : the leading shape"""
    forms = {name: blended_form(scene, name) for name in attributes}
    scene, found = closest_reached(scene, shape, rays, pace)
    return Hits(
        found["t"].reshape(shape),
        found["position"].reshape(*shape, 3),
        found["normal"].reshape(*shape, 3),
        found["color"].reshape(*shape, 3),
        found["point"].reshape(shape),
        scene.numbers[found["instance"]].reshape(shape),
        {name: blend(scene, form, found, shape, pace) for name, form in forms.items()},
    )


def occluded_snapshot(scene: Snapshot, shape: tuple[int, ...], rays: Rays, pace: Pace = PLAIN) -> NDArray[np.bool_]:
    """Whether checked rays meet anything, see `Scene.occluded`."""
    return occluded_reached(scene, shape, rays, pace).reshape(shape)
