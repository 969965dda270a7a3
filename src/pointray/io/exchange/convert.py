"""`as_points`: detects the kind of an object by its class and module, without importing its library."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from ...base.arguments import wrong_type
from ...cloud.points import Points
from ..files import read
from ..remote.remote_file import RemoteFile
from . import meshes, open3d_clouds, pyvista_data, tables
from .arrays import array_of, points_of_array, to_structured
from .columns import points_of_columns
from .laspy_data import points_of_las, to_laspy
from .open3d_clouds import to_open3d
from .pyvista_data import to_pyvista
from .tables import to_pandas

__all__ = ["as_points", "to_laspy", "to_open3d", "to_pandas", "to_pyvista", "to_structured"]


class Kind(NamedTuple):
    """A class of another library, and the function that converts its objects.

    package : first part of its module's name; parts : further parts that the module's name contains
    """

    package: str
    name: str
    convert: Callable[[Any], Points]
    parts: tuple[str, ...] = ()


# Subclasses are converted like these classes. The first match wins.
KINDS = (
    Kind("open3d", "PointCloud", open3d_clouds.points_of_tensors, ("t",)),
    Kind("open3d", "PointCloud", open3d_clouds.points_of_legacy),
    Kind("laspy", "LasData", points_of_las),
    Kind("pyvista", "DataSet", pyvista_data.points_of_dataset),
    Kind("pyvista", "MultiBlock", pyvista_data.points_of_blocks),
    Kind("trimesh", "PointCloud", meshes.points_of_trimesh),
    Kind("trimesh", "Trimesh", meshes.points_of_trimesh),
    Kind("meshio", "Mesh", meshes.points_of_meshio),
    Kind("pandas", "DataFrame", tables.points_of_pandas),
    Kind("polars", "DataFrame", tables.points_of_polars),
    Kind("pyarrow", "Table", tables.points_of_arrow),
    Kind("pyarrow", "RecordBatch", tables.points_of_arrow),
)
SUPPORTED = (
    "Points, a path or list of paths, an (n, 3) array, a structured array, a dict of columns, a laspy.LasData, an "
    "Open3D PointCloud, pyvista.PolyData, trimesh.PointCloud, trimesh.Trimesh, meshio.Mesh, a table of pandas, polars "
    "or Arrow, or an object with __dlpack__ or __array__"
)


def as_points(x: Any, name: str = "points", wanted: str = SUPPORTED) -> Points:
    """Return an object of another library, an array, or the points of files as `Points`.

    name : of the parameter, in messages; wanted : the supported kinds, in messages

    Raises
    ------
    TypeError
        If the object is of no supported kind.
    OSError
        If a file cannot be opened.
    ValueError
        If it holds no positions, or wrong shapes, dtypes or values.
    """
    if is_path(x) or is_paths(x):
        return read(x)
    convert = converter_of(x)
    if convert is None:
        raise wrong_type(name, wanted, x)
    try:
        return convert(x)
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None


def is_path(x: Any) -> bool:
    """Return whether an object is a path: a str, also a URL, a `pathlib.Path` or the like, or a `RemoteFile`."""
    return isinstance(x, str | os.PathLike | RemoteFile)


def is_paths(x: Any) -> bool:
    """Return whether an object is a list of paths."""
    return isinstance(x, list | tuple) and len(x) > 0 and all(map(is_path, x))


def converter_of(x: Any) -> Callable[[Any], Points] | None:
    """Return the function that converts an object that is no path; None if there is none."""
    for one in type(x).__mro__:
        parts = str(one.__module__).split(".")
        for kind in KINDS:
            if parts[0] == kind.package and one.__name__ == kind.name and set(kind.parts) <= set(parts):
                return kind.convert
    if isinstance(x, Mapping):
        return _points_of_dict
    is_sequence = isinstance(x, Sequence) and not isinstance(x, str | bytes | bytearray)
    if is_sequence or hasattr(x, "__array__") or hasattr(x, "__dlpack__"):
        return points_of_array
    return None


def _points_of_dict(columns: Mapping[Any, Any]) -> Points:
    return points_of_columns({name: array_of(values) for name, values in columns.items()}, "dict")
