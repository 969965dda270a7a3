"""Intersection of rays with a snapshot of a scene."""

from __future__ import annotations

from collections.abc import Sequence

from numpy.typing import ArrayLike

from ..base.arrays import Flags
from ..surface.trace.cast import PLAIN, Pace
from .blend import blend, hit_attribute
from .paged_rays import closest_hits_paged, occlusions_paged
from .rays import Hits, Rays
from .world import Snapshot

# origins, directions, t_min and t_max, not yet checked
RayArguments = tuple[ArrayLike, ArrayLike, ArrayLike, ArrayLike]


def intersect_snapshot(
    scene: Snapshot, shape: tuple[int, ...], rays: Rays, attributes: Sequence[str] = (), pace: Pace = PLAIN
) -> Hits:
    """Return the closest hit of each ray, in arrays of the rays' leading shape.

    shape, rays : leading shape, and origins, directions (n, 3) and t_min, t_max (n, 2), as returned by `check_rays`
    attributes : names of the points' attributes to return at the hits; pace : number of threads, progress callback
    """
    forms = {name: hit_attribute(scene, name) for name in attributes}
    scene, found = closest_hits_paged(scene, shape, rays, pace)
    return Hits(
        found["t"].reshape(shape),
        found["position"].reshape(*shape, 3),
        found["normal"].reshape(*shape, 3),
        found["color"].reshape(*shape, 3),
        found["point"].reshape(shape),
        scene.numbers[found["instance"]].reshape(shape),
        {name: blend(scene, form, found, shape, pace) for name, form in forms.items()},
    )


def occluded_snapshot(scene: Snapshot, shape: tuple[int, ...], rays: Rays, pace: Pace = PLAIN) -> Flags:
    """Return whether each ray hits anything between t_min and t_max, as an array of the rays' leading shape.

    shape, rays : leading shape, and origins, directions (n, 3) and t_min, t_max (n, 2), as returned by `check_rays`
    pace : number of threads, progress callback
    """
    return occlusions_paged(scene, shape, rays, pace).reshape(shape)
