"""Intersection of rays in Dask arrays with a scene, when the arrays are computed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..base.arrays import Rows
from ..scene.blend import hit_attribute
from ..scene.casting import RayArguments, intersect_snapshot, occluded_snapshot
from ..scene.ownership import Shares, held_scene
from ..scene.rays import Hits, check_rays, leading_shape
from ..scene.world import Snapshot
from ..surface.trace.cast import Pace
from .dask_arrays import ArrayForm, Distribution, check_chunks, chunked_like
from .recipe import SceneLike
from .serialized_scene import homes_for

ALONG = "along"  # key of distances in float64, which compare hits of several workers


def intersect_chunks(scene: SceneLike, given: RayArguments, attributes: Sequence[str], spread: bool = False) -> Hits:
    """Return the closest hits of rays in Dask arrays, as Dask arrays: `Scene.intersect`, computed on demand.

    given : origins, directions, t_min and t_max; attributes : names of attributes to blend at the hits
    spread : whether each worker opens only some parts of models on disk
    """
    arrays = _check(given)
    now = scene.snapshot()
    blended = {name: hit_attribute(now, name) for name in attributes}
    number, vector = (), (3,)
    forms = {
        "t": ArrayForm(np.dtype(np.float32), number),
        "position": ArrayForm(np.dtype(np.float64), vector),
        "normal": ArrayForm(np.dtype(np.float32), vector),
        "color": ArrayForm(np.dtype(np.float32), vector),
        "point": ArrayForm(np.dtype(np.int64), number),
        "instance": ArrayForm(np.dtype(np.int32), number),
        **{_key(name): ArrayForm(form.dtype, form.columns) for name, form in blended.items()},
    }
    if spread:
        shared = Distribution(_homes(scene, now), _nearest)
        made = chunked_like(scene, (_intersect_held, tuple(attributes)), arrays, forms, shared)
    else:
        made = chunked_like(scene, (_intersect, tuple(attributes)), arrays, forms)
    found = {name: made.pop(_key(name)) for name in attributes}
    return Hits(**made, attributes=found)


def occluded_chunks(scene: SceneLike, given: RayArguments, spread: bool = False) -> Any:
    """Return whether rays in Dask arrays are blocked, as a Dask array of bool: `Scene.occluded`, computed on demand.

    given : origins, directions, t_min and t_max; spread : whether each worker opens only some parts of models on disk
    """
    arrays, forms = _check(given), {"occluded": ArrayForm(np.dtype(np.bool_), ())}
    if spread:
        shared = Distribution(_homes(scene, scene.snapshot()), _any)
        return chunked_like(scene, (_occlude_held,), arrays, forms, shared)["occluded"]
    return chunked_like(scene, (_occlude,), arrays, forms)["occluded"]


def _check(given: RayArguments) -> list[Any]:
    """Return origins, directions, t_min and t_max after checks of dtypes and shapes. Dask arrays are not computed."""
    arrays = check_chunks(dict(zip(("origins", "directions", "t_min", "t_max"), given, strict=True)))
    leading_shape(*arrays)
    return arrays


def _key(attribute: str) -> str:
    """Return the key of an attribute in a dict of the arrays of `Hits`, beside its fields: "attributes NAME"."""
    return f"attributes {attribute}"


def _intersect(
    scene: Snapshot, names: tuple[str, ...], rays: RayArguments, threads: int | None, check: Any
) -> dict[str, Any]:
    """Return the closest hits of a chunk of rays: the arrays of `Hits` by field, attributes as "attributes NAME".

    names : names of the attributes; rays : origins, directions, t_min and t_max
    threads, check : number of threads and progress callback; may be None
    """
    hits = vars(intersect_snapshot(scene, *check_rays(*rays), names, Pace(threads, check)))
    return {**hits, **{_key(name): values for name, values in hits["attributes"].items()}}


def _occlude(scene: Snapshot, rays: RayArguments, threads: int | None, check: Any) -> dict[str, Any]:
    """Return whether the rays of a chunk are blocked: {"occluded": bool array}.

    rays : origins, directions, t_min and t_max
    threads, check : number of threads and progress callback; may be None
    """
    return {"occluded": occluded_snapshot(scene, *check_rays(*rays), Pace(threads, check))}


def _homes(scene: SceneLike, now: Snapshot) -> dict[str, Rows]:
    """Return for each worker of the default client, by address, the rows of the instances whose parts it opens.

    now : snapshot of the scene
    """
    shares = Shares(now, homes_for(scene.models))
    return {holder: shares.of(holder) for holder in shares.holders}


def _intersect_held(
    scene: Snapshot, names: tuple[str, ...], rows: Rows, rays: RayArguments, threads: int | None, check: Any
) -> dict[str, Any]:
    """Return the closest hits of a chunk of rays with the instances that one worker holds: a dict of arrays by name.

    The distances along the rays, "along" in float64, decide between the hits of several workers.

    names : names of attributes; rows : rows of these instances in the scene
    rays : origins, directions, t_min and t_max; threads, check : number of threads and progress callback or None
    """
    found = _intersect(held_scene(scene, rows), names, rays, threads, check)
    del found["attributes"]  # contained one by one
    origins, directions = np.asarray(rays[0], np.float64), np.asarray(rays[1], np.float64)
    with np.errstate(all="ignore"):
        return {**found, ALONG: ((found["position"] - origins) * directions).sum(axis=-1)}


def _occlude_held(scene: Snapshot, rows: Rows, rays: RayArguments, threads: int | None, check: Any) -> dict[str, Any]:
    """Return whether the rays of a chunk are blocked by the instances that one worker holds: {"occluded": bool array}.

    rows : rows of these instances in the scene; rays : origins, directions, t_min and t_max
    threads, check : number of threads and progress callback or None
    """
    return _occlude(held_scene(scene, rows), rays, threads, check)


def _nearest(found: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the nearest hit of each ray among those of several workers, which hold different instances.

    found : for each worker the arrays of its hits by name, as from `_intersect_held`; the result has the same names
    """
    best = dict(found[0])
    for other in found[1:]:
        nearer, same = np.zeros(best["t"].shape, np.bool_), np.ones(best["t"].shape, np.bool_)
        for name in ("t", ALONG, "instance", "point"):  # ties go to the first instance and part
            nearer |= same & (other[name] < best[name])
            same &= other[name] == best[name]
        for name, values in other.items():
            columns = values.ndim - nearer.ndim
            best[name] = np.where(nearer.reshape(nearer.shape + (1,) * columns), values, best[name])
    return best


def _any(found: list[dict[str, Any]]) -> dict[str, Any]:
    """Return whether rays are blocked by the instances of any worker. found : {"occluded": bool array} of each"""
    return {"occluded": np.logical_or.reduce([some["occluded"] for some in found])}
