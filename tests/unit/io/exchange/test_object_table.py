"""Each row of the table of objects in the documentation, with the real library."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

import pointray as pr
from pointray.io.exchange.facts import OBJECTS

N = 60


def library(name):
    return pytest.importorskip(name, exc_type=ImportError)


@pytest.fixture
def cloud(rng):
    return pr.Points(
        np.round(rng.random((N, 3)) * 40, 3) + [512000.0, 5400000.0, 320.0],
        rng.standard_normal((N, 3)),
        rng.integers(0, 256, (N, 3)).astype(np.uint8),
        {"intensity": rng.integers(0, 65536, N).astype(np.uint16)},
        georeference=pr.Georeference(crs="EPSG:25832", unit="metre", stations=[(512000.0, 5400000.0, 322.0)]),
    )


def columns_of(cloud):
    rows = cloud.to_structured()
    return {name: np.ascontiguousarray(rows[name]) for name in rows.dtype.names}


class Foreign:
    """An array of another library."""

    def __init__(self, array):
        self._array = array

    def __array__(self, dtype=None, copy=None):
        return self._array


def triangles(cloud):
    mesh = library("trimesh").Trimesh(cloud.world, [[0, 1, 2], [2, 1, 3]], vertex_normals=cloud.normals, process=False)
    mesh.visual.vertex_colors = cloud.colors
    mesh.vertex_attributes["intensity"] = cloud.attributes["intensity"]
    return mesh


def mesh_of(cloud):
    data = {"Normals": cloud.normals, "RGB": cloud.colors, "intensity": cloud.attributes["intensity"]}
    return library("meshio").Mesh(cloud.world, [("vertex", np.arange(N)[:, None])], point_data=data)


MADE = {
    "(n, 3) array": lambda cloud: np.asarray(cloud),
    "`__array__` or `__dlpack__`": lambda cloud: Foreign(cloud.world),
    "structured array": lambda cloud: cloud.to_structured(),
    "dict of columns": columns_of,
    "pandas.DataFrame": lambda cloud: cloud.to_pandas(),
    "polars.DataFrame": lambda cloud: library("polars").DataFrame(columns_of(cloud)),
    "pyarrow.Table": lambda cloud: library("pyarrow").table(columns_of(cloud)),
    "laspy.LasData": lambda cloud: cloud.to_laspy(),
    "open3d.t.geometry.PointCloud": lambda cloud: cloud.to_open3d(),
    "open3d.geometry.PointCloud": lambda cloud: cloud.to_open3d(legacy=True),
    "pyvista.PolyData": lambda cloud: cloud.to_pyvista(),
    "trimesh.PointCloud": lambda cloud: library("trimesh").PointCloud(cloud.world, cloud.colors),
    "trimesh.Trimesh": triangles,
    "meshio.Mesh": mesh_of,
}


def test_every_row_has_an_example():
    assert list(MADE) == [facts.name for facts in OBJECTS]


@pytest.mark.parametrize("facts", OBJECTS, ids=lambda facts: facts.name)
def test_objects_hold_what_the_table_says(cloud, facts):
    library(facts.name.split(".")[0]) if "." in facts.name else None
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        made = MADE[facts.name](cloud)
    messages = [str(warning.message) for warning in caught if str(warning.message).startswith("to_")]
    assert bool(messages) == (facts.back.startswith("to_") and facts.lost != "nothing") or facts.back == ""
    assert len(messages) <= 1
    points = pr.as_points(made)
    np.testing.assert_allclose(points.world, cloud.world, rtol=0, atol=2e-6)
    assert (points.normals is not None) == facts.normals and (points.colors is not None) == facts.colors
    if facts.normals:
        np.testing.assert_allclose(points.normals, cloud.normals, atol=1e-6)
    if facts.colors:
        np.testing.assert_array_equal(points.colors, cloud.colors)
    assert ("intensity" in points.attributes) == facts.attributes
    if facts.attributes:
        values = points.attributes["intensity"]
        assert values.dtype == np.uint16 and values.tolist() == cloud.attributes["intensity"].tolist()
    assert (points.crs is not None and "25832" in points.crs) == facts.georeference
    stations = facts.georeference and facts.lost == "nothing"
    assert (points.georeference.stations == cloud.georeference.stations) == stations
