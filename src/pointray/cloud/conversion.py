"""Objects of other libraries as points; the conversions themselves are in `io/exchange/`."""

from __future__ import annotations

from typing import Any, TypeAlias

from ..base.registered import registered
from .points import Points

PointsLike: TypeAlias = Any  # Points, or anything else that `as_points` accepts


def as_points(x: PointsLike) -> Points:
    """Return an object of another library, an array, or the points of files as `Points`.

    No other library is imported. Arrays of the right dtype and layout are shared, not copied: do not modify them
    afterwards.

    Parameters
    ----------
    x : object
        - `Points`, which are returned unchanged,
        - a path, or a list of paths, which are read as one cloud (see `read`),
        - an (n, 3) array_like of world coordinates, or anything with ``__array__`` or ``__dlpack__``: PyTorch, JAX,
        - columns by name: a structured array, a dict of arrays, or a DataFrame or Table of pandas, polars or pyarrow,
        - `laspy.LasData`,
        - Open3D's `geometry.PointCloud` and `t.geometry.PointCloud`,
        - a dataset of PyVista such as `pyvista.PolyData`,
        - the vertices of `trimesh.PointCloud`, `trimesh.Trimesh` or `meshio.Mesh`.

        Columns are found by name, in any case: x, y, z; nx, ny, nz or NormalX, ...; red, green, blue or r, g, b. All
        other columns of numbers become attributes with their dtypes.

    Returns
    -------
    Points

    Raises
    ------
    TypeError
        If the object is of no supported kind.
    OSError
        If a file cannot be opened.
    ValueError
        If there are no positions, or a shape, dtype or value is wrong.

    Examples
    --------
    >>> points = pr.as_points({"X": [0.0, 1.0], "Y": [0.0, 0.0], "Z": [2.0, 2.0], "Intensity": [7, 9]})
    >>> len(points), points.attributes["Intensity"].tolist()
    (2, [7, 9])
    """
    return check_points(x, "x")


def check_points(value: PointsLike, name: str = "points") -> Points:
    """Return the value of a parameter as points, see `as_points`. name : of the parameter, in messages"""
    return value if isinstance(value, Points) else registered("exchange").as_points(value, name)
