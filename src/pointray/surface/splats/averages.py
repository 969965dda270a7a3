"""Averages over groups of points: means of attributes; for bools, labels and other categories the most common value."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...base.arrays import Doubles
from ...cloud.points import FEWEST_ROWS, MOST_LABELS, categories_of, is_label

KNOWN = 0.5  # share of a group's values that must be finite; otherwise the mean is NaN


def attribute_averages(
    attributes: dict[str, NDArray[Any]],
    order: NDArray[np.integer[Any]],
    starts: NDArray[np.integer[Any]],
    least: float = KNOWN,
    categories: Collection[str] | None = None,
) -> dict[str, NDArray[Any]]:
    """Average attributes over groups of points: means, or the most common value of categories such as classes.

    Returns arrays (g, ...) by the same names, with the same dtypes; means of integers are rounded.

    Parameters
    ----------
    attributes : dict
        Arrays (n, ...), one row per point, by name.
    order : (m,) array of ints
        Rows of the points, group by group.
    starts : (g,) array of ints
        Start of each group in `order`. No group is empty.
    least : float
        Share of a group's values that must be finite; otherwise the mean is NaN.
    categories : collection of str, optional
        Names of the categorical attributes. Default: detected from the values.
    """
    averages = {}
    for name, values in attributes.items():
        whole = has_categories(name, values) if categories is None else name in categories
        averages[name] = commonest(values[order], starts) if whole else _means(values, order, starts, least)
    return averages


def have_categories(name: str, chunks: Iterable[NDArray[Any]]) -> bool:
    """Return whether an attribute holds categories, such as classes, so that its mean is meaningless.

    name : of the attribute; chunks : its values, array by array, which need not fit into memory together
    """
    rows, found = 0, None
    for chunk in chunks:
        if chunk.ndim != 1 or (chunk.dtype.kind != "f" and is_label(name)):
            return chunk.ndim == 1
        rows += len(chunk)
        found = np.unique(chunk if found is None else np.append(found, np.unique(chunk)))
        if len(found) > MOST_LABELS:
            return False
    return found is not None and has_categories(name, np.resize(found, min(rows, FEWEST_ROWS * len(found))))


def has_categories(name: str, values: NDArray[Any]) -> bool:
    """Return whether values are categorical, so that their mean is meaningless: classes, or station numbers.

    values : (n, ...) of an attribute; name : of this attribute; integers in "classification", say, are categories
    """
    if values.ndim == 1 and values.dtype.kind != "f" and is_label(name):
        return True
    return categories_of(values, name) is not None


def _means(
    values: NDArray[Any], order: NDArray[np.integer[Any]], starts: NDArray[np.integer[Any]], least: float
) -> NDArray[Any]:
    if values.dtype == np.bool_:
        return _means(values.view(np.uint8), order, starts, least).astype(np.bool_)
    rows = values[order]
    finite = np.isfinite(rows)
    known = np.add.reduceat(finite, starts, axis=0, dtype=np.float64)
    mean = np.add.reduceat(np.where(finite, rows, 0), starts, axis=0, dtype=np.float64) / np.maximum(known, 1)
    if values.dtype.kind != "f":
        limits = np.minimum.reduceat(rows, starts, axis=0), np.maximum.reduceat(rows, starts, axis=0)
        return _between(np.rint(mean), *limits)
    low = np.minimum.reduceat(np.where(finite, rows, np.inf), starts, axis=0)
    high = np.maximum.reduceat(np.where(finite, rows, -np.inf), starts, axis=0)
    counts = np.diff(np.append(starts, len(order))).reshape(-1, *[1] * (values.ndim - 1))
    enough = (known > 0) & (known >= least * counts)
    return np.where(enough, _between(mean, low, high), np.nan).astype(values.dtype)


def _between(mean: Doubles, low: NDArray[Any], high: NDArray[Any]) -> NDArray[Any]:
    """Convert means to the dtype of `low` and `high`, the extremes of the averaged values, and clip them to these."""
    inside = (mean > low) & (mean < high)
    return np.where(inside, np.where(inside, mean, 0).astype(low.dtype), np.where(mean <= low, low, high))


def commonest(rows: NDArray[Any], starts: NDArray[np.integer[Any]]) -> NDArray[Any]:
    """Return the most common value of each group of rows, (g,); the least of equally common ones.

    rows : (n,) values, group by group; starts : (g,) start of each group
    """
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
