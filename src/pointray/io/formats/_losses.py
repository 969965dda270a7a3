"""What a format cannot store, as texts for a warning; and the names of the columns of a file that is written."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...cloud.georeference import RESIDUAL
from ...cloud.points import Points

Losses = list[str]


def georeference_losses(points: Points, kept: Sequence[str] = ()) -> Losses:
    """Return texts about the fields of the georeference that a format cannot store.

    kept : fields that it stores: "crs", "unit", "stations"
    """
    known = points.georeference
    fields = {"crs": "the coordinate system", "unit": f"the unit {known.unit}", "stations": "the scanner positions"}
    lost = [name for name in fields if getattr(known, name) and name not in kept]
    if "unit" in lost and (known.crs or is_metre(known.unit)):  # the coordinate system states it, or it is usual
        lost.remove("unit")
    return [f"cannot store {fields[name]}" for name in lost]


def is_metre(unit: str | None) -> bool:
    """Whether the name of a unit means metres."""
    return unit is not None and unit.lower() in ("metre", "meter", "m")


def column_losses(points: Points, normals: bool, attributes: Iterable[str]) -> Losses:
    """Return texts about columns that a format cannot store: the normals, and the attributes by name.

    normals : whether the format stores normals; attributes : those that it stores
    """
    losses = ["cannot store the normals"] if points.normals is not None and not normals else []
    lost = [name for name in points.attributes if name not in (*attributes, RESIDUAL)]
    return [*losses, f"cannot store {', '.join(lost)}"] if lost else losses


def rows_left_out(points: Points) -> Losses:
    """Return a text about rows without a finite position, for formats that leave them out."""
    missing = len(points) - int(np.count_nonzero(points.finite))
    return [f"leaves out {missing:,} row{'s' * (missing > 1)} without a finite position"] if missing else []


def unused_name(name: str, taken: set[str], losses: Losses, what: str, original: str) -> str:
    """Return `name`, with a number appended if it is taken.

    taken : names that are in use, in lower case, to which the result is added
    losses : receives a text if the result differs from `original`, the name of the attribute
    what : kind of the name, for the text, such as "the field"
    """
    free, number = name, 1
    while free.lower() in taken:
        number += 1
        free = f"{name}_{number}"
    if free != original:
        losses.append(f"stores {original} as {what} {free}")
    taken.add(free.lower())
    return free


def separate_columns(name: str, values: NDArray[Any], losses: Losses, most: int = 1) -> dict[str, NDArray[Any]]:
    """Return an attribute as columns by name: (n,) if it has one column, otherwise (n, k) with up to `most` columns.

    An attribute with more columns is separated into (n,) arrays, named with the number of the column.

    values : (n,) or (n, k); losses : receives a text if the attribute is separated, or has no columns
    """
    width = 1 if values.ndim == 1 else values.shape[1]
    if width == 0:
        losses.append(f"cannot store {name}: it has no columns")
        return {}
    if width == 1:
        return {name: values.reshape(-1)}
    if width <= most:
        return {name: values}
    losses.append(f"stores the {width} columns of {name} separately, as {name}_0 and so on")
    return {f"{name}_{k}": values[:, k] for k in range(width)}
