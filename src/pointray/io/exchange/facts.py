"""What each kind of object of other libraries holds of points: the source of a table in the documentation."""

from __future__ import annotations

from typing import NamedTuple


class ObjectFacts(NamedTuple):
    """What is taken from a kind of object, and how points become one.

    Attributes
    ----------
    name : str
        Class or kind, for users.
    normals, colors, attributes, georeference : bool
        Whether it holds normals, colours, other values with their dtypes, and the coordinate system.
    back : str
        Method that returns such an object; empty if there is none.
    lost : str
        What that method loses.
    """

    name: str
    normals: bool
    colors: bool
    attributes: bool
    georeference: bool
    back: str = ""
    lost: str = ""


SYSTEM = "coordinate system, unit, scanner positions"
OBJECTS = (
    ObjectFacts("(n, 3) array", False, False, False, False, "np.asarray(points)", f"all but world positions; {SYSTEM}"),
    ObjectFacts("`__array__` or `__dlpack__`", False, False, False, False),
    ObjectFacts("structured array", True, True, True, False, "to_structured()", SYSTEM),
    ObjectFacts("dict of columns", True, True, True, False),
    ObjectFacts("pandas.DataFrame", True, True, True, True, "to_pandas()", "nothing"),
    ObjectFacts("polars.DataFrame", True, True, True, False),
    ObjectFacts("pyarrow.Table", True, True, True, False),
    ObjectFacts(
        *("laspy.LasData", True, True, True, True, "to_laspy()"),
        "scanner positions, shapes of attributes of several columns, rows without a finite position",
    ),
    ObjectFacts("open3d.t.geometry.PointCloud", True, True, True, False, "to_open3d()", SYSTEM),
    ObjectFacts(
        "open3d.geometry.PointCloud", True, True, False, False, "to_open3d(legacy=True)", f"attributes, {SYSTEM}"
    ),
    ObjectFacts("pyvista.PolyData", True, True, True, True, "to_pyvista()", "nothing"),
    ObjectFacts("trimesh.PointCloud", False, True, False, False),
    ObjectFacts("trimesh.Trimesh", True, True, True, False),
    ObjectFacts("meshio.Mesh", True, True, True, False),
)
