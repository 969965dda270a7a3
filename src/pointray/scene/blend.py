"""Attributes at hits: blended with the surface's weights, or taken from the splat of greatest weight."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.arrays import Doubles
from ..engine.kernels.records import INSTANCE, KIND, MODEL, SHAPE_ROW
from ..model.model import Model
from ..surface.trace.cast import PLAIN, Pace, blend_attribute
from .paints import categories_in
from .world import Snapshot


class HitAttribute(NamedTuple):
    """An attribute of the points, prepared for its evaluation at the hits of rays.

    dtype, columns : dtype and shape of the value at one hit; the shape of a number is ()
    values : the values of each model's points, by the model's index in `Snapshot.models`; others lack the attribute
    categorical : indices of the models whose values are categories, which are not blended
    """

    dtype: np.dtype[Any]
    columns: tuple[int, ...]
    values: dict[int, NDArray[Any]]
    categorical: set[int]


def hit_attribute(scene: Snapshot, name: str) -> HitAttribute:
    """Return an attribute prepared for its evaluation at hits, with its dtype and the values of each model.

    ValueError if no model has it, or models differ in its number of columns.
    """
    having = {k: model for k, model in enumerate(scene.models) if name in model.points.attributes}
    if not having:
        known = sorted({a for m in scene.models for a in m.points.attributes})
        raise ValueError(f"attributes: no model has an attribute {name!r}; available: {', '.join(known) or 'none'}")
    values = {k: model.points.attributes[name] for k, model in having.items()}
    widths = {array.shape[1:] for array in values.values()}
    if len(widths) > 1:
        raise ValueError(f"attribute {name!r} must have the same number of columns in all models")
    # A blend of categories 2 and 6 would be another category.
    categorical = {k for k, model in having.items() if _is_categorical(model, name)}
    dtype = np.result_type(*(v.dtype if k in categorical else _blended_dtype(v) for k, v in values.items()))
    return HitAttribute(dtype, widths.pop(), values, categorical)


def blend(
    scene: Snapshot, form: HitAttribute, found: dict[str, Any], shape: tuple[int, ...], pace: Pace = PLAIN
) -> NDArray[Any]:
    """Return an attribute at hits: blended between splats, or that of the splat of most weight if it has categories.

    Misses and models without the attribute have NaN (floats), 0 (integers) or False.

    form : the attribute, from `hit_attribute`; found : arrays that describe the n hits, by name, from `closest_hits`
    shape : leading shape of the rays; pace : number of threads, progress callback
    """
    dtype = form.dtype
    out = np.full((len(found["t"]), *form.columns), np.nan if dtype.kind == "f" else 0, dtype)
    records = scene.world.instances.reshape(-1, INSTANCE)
    shapes = np.append(np.where(records[:, KIND] == MODEL, records[:, SHAPE_ROW], -1), -1)
    of_model = shapes[found["instance"]]
    floats: dict[int, Doubles] = {}  # by id: parts share their columns
    for k, values in form.values.items():
        rows = np.flatnonzero(of_model == k)
        if not len(rows):
            continue
        if k in form.categorical:
            out[rows] = values[found["point"][rows]]
            continue
        if id(values) not in floats:
            floats[id(values)] = np.ascontiguousarray(values, np.float64)
        out[rows] = blend_attribute(scene.world, found, rows, k, floats[id(values)], pace)
    return out.reshape(shape + out.shape[1:])


def _is_categorical(model: Model, name: str) -> bool:
    """Return whether an attribute of a model has categories, which are never blended."""
    values = model.points.attributes[name]
    return values.dtype == np.bool_ or (values.ndim == 1 and categories_in(model, name) is not None)


def _blended_dtype(values: NDArray[Any]) -> np.dtype[Any]:
    """Return the dtype in which values are blended: float32, or float64 if their dtype has values beyond float32."""
    return np.result_type(values.dtype, np.float32)
