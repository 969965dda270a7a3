"""Attributes at hits: blended with the surface's weights, or those of the splat of greatest weight."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..engine.kernels.records import INSTANCE, KIND, MODEL, SHAPE_ROW
from ..model.model import Model
from ..surface.trace.cast import PLAIN, Pace, blend_attribute
from .paints import categories_in
from .world import Snapshot


class Blended(NamedTuple):
    """An attribute as hits have it.

    dtype, columns : of a hit's value; columns is empty where it is a number
    values : of the points, by the rows of models
    whole : the rows of models whose values are not blended
    """

    dtype: np.dtype[Any]
    columns: tuple[int, ...]
    values: dict[int, NDArray[Any]]
    whole: set[int]


def blended_form(scene: Snapshot, name: str) -> Blended:
    """What hits will have of an attribute; ValueError if no model has it, or one has other columns than another."""
    having = {k: model for k, model in enumerate(scene.models) if name in model.points.attributes}
    if not having:
        known = sorted({a for m in scene.models for a in m.points.attributes})
        raise ValueError(f"attributes: no model has an attribute {name!r}; there are: {', '.join(known) or 'none'}")
    values = {k: model.points.attributes[name] for k, model in having.items()}
    widths = {array.shape[1:] for array in values.values()}
    if len(widths) > 1:
        raise ValueError(f"attribute {name!r} has not the same number of columns in all models")
    # Values between categories 2 and 6 would be no categories.
    whole = {k for k, model in having.items() if _is_whole(model, name)}
    dtype = np.result_type(*(v.dtype if k in whole else _blended_dtype(v) for k, v in values.items()))
    return Blended(dtype, widths.pop(), values, whole)


def blend(
    scene: Snapshot, form: Blended, found: dict[str, Any], shape: tuple[int, ...], pace: Pace = PLAIN
) -> NDArray[Any]:
    """An attribute at hits, blended unless it has categories; see `Hits` for what is where there is none."""
    dtype = form.dtype
    out = np.full((len(found["t"]), *form.columns), np.nan if dtype.kind == "f" else 0, dtype)
    records = scene.world.instances.reshape(-1, INSTANCE)
    shapes = np.append(np.where(records[:, KIND] == MODEL, records[:, SHAPE_ROW], -1), -1)
    of_model = shapes[found["instance"]]
    floats: dict[int, NDArray[np.float64]] = {}  # parts share their columns, each of which is converted once
    for k, values in form.values.items():
        rows = np.flatnonzero(of_model == k)
        if not len(rows):
            continue
        if k in form.whole:
            out[rows] = values[found["point"][rows]]
            continue
        if id(values) not in floats:
            floats[id(values)] = np.ascontiguousarray(values, np.float64)
        out[rows] = blend_attribute(scene.world, found, rows, k, floats[id(values)], pace)
    return out.reshape(shape + out.shape[1:])


def _is_whole(model: Model, name: str) -> bool:
    """Whether an attribute is never blended."""
    values = model.points.attributes[name]
    return values.dtype == np.bool_ or (values.ndim == 1 and categories_in(model, name) is not None)


def _blended_dtype(values: NDArray[Any]) -> np.dtype[Any]:
    """float32, or float64 where float32 does not hold all values of the dtype."""
    return np.result_type(values.dtype, np.float32)
