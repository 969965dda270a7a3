"""Rays in arrays of Dask, cast at a scene when the arrays are computed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..scene.blend import blended_form
from ..scene.casting import Given, intersect_snapshot, occluded_snapshot
from ..scene.ownership import Rows, Shares, held_scene
from ..scene.rays import Hits, check_rays, leading_shape
from ..scene.world import Snapshot
from ..surface.trace.cast import Pace
from .dask_arrays import Form, Shared, check_chunks, chunked_like
from .recipe import Stage
from .serialized_scene import homes_for

ALONG = "along"  # what hits are compared by, beside the fields of `Hits`


def intersect_chunks(scene: Stage, given: Given, attributes: Sequence[str], spread: bool = False) -> Hits:
    """Return the hits of rays in Dask arrays, see `Scene.intersect`. spread : each worker opens only some parts"""
    arrays = _check(given)
    now = scene.snapshot()
    blended = {name: blended_form(now, name) for name in attributes}
    number, vector = (), (3,)
    forms = {
        "t": Form(np.dtype(np.float32), number),
        "position": Form(np.dtype(np.float64), vector),
        "normal": Form(np.dtype(np.float32), vector),
        "color": Form(np.dtype(np.float32), vector),
        "point": Form(np.dtype(np.int64), number),
        "instance": Form(np.dtype(np.int32), number),
        **{_key(name): Form(form.dtype, form.columns) for name, form in blended.items()},
    }
    if spread:
        shared = Shared(_homes(scene, now), _nearest)
        made = chunked_like(scene, (_intersect_held, tuple(attributes)), arrays, forms, shared)
    else:
        made = chunked_like(scene, (_intersect, tuple(attributes)), arrays, forms)
    found = {name: made.pop(_key(name)) for name in attributes}
    return Hits(**made, attributes=found)


def occluded_chunks(scene: Stage, given: Given, spread: bool = False) -> Any:
    """Return whether rays in Dask arrays are blocked, see `Scene.occluded`."""
    arrays, forms = _check(given), {"occluded": Form(np.dtype(np.bool_), ())}
    if spread:
        shared = Shared(_homes(scene, scene.snapshot()), _any)
        return chunked_like(scene, (_occlude_held,), arrays, forms, shared)["occluded"]
    return chunked_like(scene, (_occlude,), arrays, forms)["occluded"]


def _check(given: Given) -> list[Any]:
    """Checked arrays, some of which are Dask's; nothing of them is computed."""
    arrays = check_chunks(dict(zip(("origins", "directions", "t_min", "t_max"), given, strict=True)))
    leading_shape(*arrays)
    return arrays


def _key(attribute: str) -> str:
    """What an attribute is called beside the fields of `Hits`."""
    return f"attributes {attribute}"


def _intersect(scene: Snapshot, names: tuple[str, ...], rays: Given, threads: int | None, check: Any) -> dict[str, Any]:
    """The hits of a chunk."""
    hits = vars(intersect_snapshot(scene, *check_rays(*rays), names, Pace(threads, check)))
    return {**hits, **{_key(name): values for name, values in hits["attributes"].items()}}


def _occlude(scene: Snapshot, rays: Given, threads: int | None, check: Any) -> dict[str, Any]:
    """What is in the way of the rays of a chunk."""
    return {"occluded": occluded_snapshot(scene, *check_rays(*rays), Pace(threads, check))}


def _homes(scene: Stage, now: Snapshot) -> dict[str, Rows]:
    """The rows of instances that each worker holds."""
    shares = Shares(now, homes_for(scene.models))
    return {holder: shares.of(holder) for holder in shares.holders}


def _intersect_held(
    scene: Snapshot, names: tuple[str, ...], rows: Rows, rays: Given, threads: int | None, check: Any
) -> dict[str, Any]:
    """The hits of a chunk in what one worker holds, and how far along the rays they lie, which t tells less exactly."""
    found = _intersect(held_scene(scene, rows), names, rays, threads, check)
    del found["attributes"]  # they are there one by one
    origins, directions = np.asarray(rays[0], np.float64), np.asarray(rays[1], np.float64)
    with np.errstate(all="ignore"):
        return {**found, ALONG: ((found["position"] - origins) * directions).sum(axis=-1)}


def _occlude_held(scene: Snapshot, rows: Rows, rays: Given, threads: int | None, check: Any) -> dict[str, Any]:
    """What is in the way of the rays of a chunk, of what one worker holds."""
    return _occlude(held_scene(scene, rows), rays, threads, check)


def _nearest(found: list[dict[str, Any]]) -> dict[str, Any]:
    """The nearest hits of those that several workers have found."""
    best = dict(found[0])
    for other in found[1:]:
        nearer, same = np.zeros(best["t"].shape, np.bool_), np.ones(best["t"].shape, np.bool_)
        for name in ("t", ALONG, "instance", "point"):  # of hits at the same place the first instance's, and part's
            nearer |= same & (other[name] < best[name])
            same &= other[name] == best[name]
        for name, values in other.items():
            columns = values.ndim - nearer.ndim
            best[name] = np.where(nearer.reshape(nearer.shape + (1,) * columns), values, best[name])
    return best


def _any(found: list[dict[str, Any]]) -> dict[str, Any]:
    """Whether any of several workers has found something in the way."""
    return {"occluded": np.logical_or.reduce([some["occluded"] for some in found])}
