"""One value for several points: the mean of attributes, and of categories the commonest."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..data import categories_of

KNOWN = 0.5  # share of the values that must be finite, or the mean is NaN


def attribute_averages(
    attributes: dict[str, NDArray[Any]],
    order: NDArray[np.integer[Any]],
    starts: NDArray[np.integer[Any]],
    least: float = KNOWN,
) -> dict[str, NDArray[Any]]:
    """The attributes of groups of points, with the dtypes that they have.

    Parameters
    ----------
    order : (m,) array of ints
        Rows of the points, group by group.
    starts : (g,) array of ints
        Where groups begin in `order`. None is empty.
    least : float
        Share of a group's values that must be finite; where fewer are, the mean is NaN.
    """
    return {name: _average(values, order, starts, least) for name, values in attributes.items()}


def _average(
    values: NDArray[Any], order: NDArray[np.integer[Any]], starts: NDArray[np.integer[Any]], least: float
) -> NDArray[Any]:
    if values.dtype.kind != "f" and (values.dtype == np.bool_ or categories_of(values) is not None):
        return commonest(values[order], starts)
    counts = np.diff(np.append(starts, len(order))).reshape(-1, *[1] * (values.ndim - 1))
    rows = values[order].astype(np.float64)
    if values.dtype.kind != "f":
        means = np.rint(np.add.reduceat(rows, starts, axis=0) / counts)
        limits = np.iinfo(values.dtype)
        return np.asarray(np.clip(means, limits.min, limits.max).astype(values.dtype))
    finite = np.isfinite(rows)
    known = np.add.reduceat(finite, starts, axis=0, dtype=np.float64)
    total = np.add.reduceat(np.where(finite, rows, 0.0), starts, axis=0)
    enough = (known > 0) & (known >= least * counts)
    return np.where(enough, total / np.maximum(known, 1), np.nan).astype(values.dtype)


def commonest(rows: NDArray[Any], starts: NDArray[np.integer[Any]]) -> NDArray[Any]:
    """The commonest value of each group of rows, (n,); of equally common ones the least."""
    groups = np.zeros(len(rows), np.int64)
    groups[starts[1:]] = 1
    groups = np.cumsum(groups)
    order = np.lexsort((rows, groups))
    values, owners = rows[order], groups[order]
    new = np.concatenate([[True], (values[1:] != values[:-1]) | (owners[1:] != owners[:-1])])
    first = np.flatnonzero(new)
    counts = np.diff(np.append(first, len(rows)))
    best = np.lexsort((values[first], -counts, owners[first]))
    heads = np.concatenate([[True], np.diff(owners[first][best]) > 0])
    return np.asarray(values[first][best][heads])
