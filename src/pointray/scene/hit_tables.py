"""Conversion of hits to `Points` and to tables of pandas."""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.extras import MissingPackageError
from ..cloud.points import Points
from ..image.tone import linear_to_srgb

POSITION, NORMAL, COLOR = ("x", "y", "z"), ("nx", "ny", "nz"), ("red", "green", "blue")


def points_of(hits: Any) -> Points:
    """Return `Hits` as points, see `Hits.to_points`."""
    flat = _columns_of(hits)
    rows = np.flatnonzero(flat["instance"] >= 0)
    if not len(rows):
        raise ValueError(f"no ray of {len(flat['t']):,} hits anything: there are no points")
    attributes = {"t": flat["t"][rows], "ray": rows}
    attributes |= {name: flat[name][rows] for name in ("point", "instance")}
    for name, values in hits.attributes.items():
        attributes[_free(name, attributes)] = _flat(values, hits)[rows]
    color = flat["color"][rows]
    colors = None if (color == 1).all() else _srgb(color)
    return Points(flat["position"][rows], normals=flat["normal"][rows], colors=colors, attributes=attributes)


def table_of(hits: Any) -> Any:
    """Return `Hits` as a table of pandas, see `Hits.to_pandas`."""
    pandas = require_package("pandas", "Hits.to_pandas")
    flat = _columns_of(hits)
    columns: dict[str, NDArray[Any]] = {"t": flat["t"]}
    columns |= dict(zip(POSITION, flat["position"].T, strict=True))
    columns |= dict(zip(NORMAL, flat["normal"].T, strict=True))
    columns |= dict(zip(COLOR, _srgb(flat["color"]).T, strict=True))
    columns |= {name: flat[name] for name in ("point", "instance")}
    for name, values in hits.attributes.items():
        own = _flat(values, hits)
        several = own.ndim > 1
        for k, column in enumerate(own.T if several else [own]):
            columns[_free(f"{name}_{k}" if several else name, columns)] = column
    return pandas.DataFrame(columns, index=pandas.RangeIndex(len(flat["t"]), name="ray"))


def require_package(module: str, what: str) -> Any:
    """Import and return a package that is no part of an extra; if missing, raise an error with the `pip` command.

    what : what needs it; the message begins with it
    """
    try:
        return importlib.import_module(module)
    except ImportError:
        raise MissingPackageError(f"{what} needs {module}: pip install {module}") from None


def _columns_of(hits: Any) -> dict[str, NDArray[Any]]:
    """Return the fields of hits with one row for each ray."""
    names = "t", "position", "normal", "color", "point", "instance"
    return {name: _flat(getattr(hits, name), hits) for name in names}


def _flat(values: Any, hits: Any) -> NDArray[Any]:
    array = np.asarray(values)  # of Dask too
    return array.reshape(-1, *array.shape[np.ndim(hits.t) :])


def _free(name: str, taken: dict[str, Any]) -> str:
    """Return the name of an attribute, with an underscore if a field of the hits has that name."""
    while name in taken:
        name += "_"
    return name


def _srgb(color: NDArray[Any]) -> NDArray[np.uint8]:
    return np.asarray(np.rint(255 * linear_to_srgb(color)), np.uint8)
