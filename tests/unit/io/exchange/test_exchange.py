"""Objects of other libraries, real ones, as points and back."""

from __future__ import annotations

import subprocess
import sys
import warnings

import numpy as np
import pytest

import pointray as pr
from helpers.places import shared_model

ORIGIN = np.array([512000.0, 5400000.0, 320.0])
DTYPES = {"class": np.uint8, "ring": np.int8, "intensity": np.uint16, "step": np.int16, "id": np.uint32}
DTYPES |= {"shift": np.int32, "key": np.uint64, "code": np.int64, "range": np.float32, "gps_time": np.float64}


def library(name):
    return pytest.importorskip(name, exc_type=ImportError)


def values_of(rng, dtype, n):
    if np.issubdtype(dtype, np.integer):
        facts = np.iinfo(dtype)
        return rng.integers(facts.min, facts.max, n, dtype, endpoint=True)
    return rng.random(n).astype(dtype)


@pytest.fixture
def cloud(rng):
    """Points far from zero, with normals, colours, attributes of all dtypes and a georeference."""
    n = 300
    attributes = {name: values_of(rng, dtype, n) for name, dtype in DTYPES.items()}
    attributes |= {"hit": rng.random(n) > 0.5, "features": rng.random((n, 4)).astype(np.float32)}
    return pr.Points(
        rng.random((n, 3)) * 40 + ORIGIN,
        rng.standard_normal((n, 3)),
        rng.integers(0, 256, (n, 3)).astype(np.uint8),
        attributes,
        georeference=pr.Georeference(crs="EPSG:25832", unit="metre", stations=[(512000.0, 5400000.0, 322.0)]),
    )


def same(points, cloud, *, attributes=True, georeference=True):
    np.testing.assert_array_equal(points.world, cloud.world)
    np.testing.assert_array_equal(points.normals, cloud.normals)
    np.testing.assert_array_equal(points.colors, cloud.colors)
    if attributes:
        assert points.attributes.keys() == cloud.attributes.keys()
        for name, values in cloud.attributes.items():
            assert points.attributes[name].dtype == values.dtype, name
            np.testing.assert_array_equal(points.attributes[name], values, name)
    if georeference:
        assert points.georeference == cloud.georeference


# ------------------------------------------------------------------------------------------------- there and back


def test_open3d_holds_all_but_the_georeference(cloud):
    open3d = library("open3d")
    with pytest.warns(UserWarning, match="^to_open3d: cannot store the coordinate system and the unit and the scanner"):
        made = cloud.to_open3d()
    assert isinstance(made, open3d.t.geometry.PointCloud) and made.point.positions.dtype == open3d.core.float64
    same(pr.as_points(made), cloud, georeference=False)


def test_an_older_open3d_cloud_holds_no_attributes(cloud):
    open3d = library("open3d")
    with pytest.warns(UserWarning, match="cannot store the attributes class, .*legacy=False keeps them"):
        made = cloud.to_open3d(legacy=True)
    assert isinstance(made, open3d.geometry.PointCloud)
    np.testing.assert_array_equal(np.asarray(made.points), cloud.world)
    same(pr.as_points(made), cloud, attributes=False, georeference=False)


def test_open3d_positions_near_zero_are_shared(rng):
    open3d = library("open3d")
    cloud = pr.Points((rng.integers(-99, 99, (50, 3)) / 8).astype(np.float32))
    made = cloud.to_open3d()
    assert made.point.positions.dtype == open3d.core.float32
    assert np.shares_memory(made.point.positions.numpy(), cloud.positions)
    assert np.shares_memory(pr.as_points(made).positions, cloud.positions)


def test_pyvista_holds_all(cloud):
    pyvista = library("pyvista")
    made = cloud.to_pyvista()
    assert isinstance(made, pyvista.PolyData) and made.n_verts == len(cloud)
    same(pr.as_points(made), cloud)


def test_other_pyvista_datasets_give_their_points(rng):
    pyvista = library("pyvista")
    ball = pyvista.Sphere()
    points = pr.as_points(ball)
    np.testing.assert_array_equal(points.world, ball.points)
    assert abs(np.einsum("ij,ij->i", points.normals, ball.points / 0.5) - 1).max() < 0.1
    grid = pyvista.ImageData(dimensions=(3, 4, 5))
    grid["heat"] = np.arange(60.0)
    assert pr.as_points(grid).attributes["heat"].tolist() == list(range(60))


def test_laspy_holds_what_las_files_hold(cloud, tmp_path):
    laspy = library("laspy")
    with pytest.warns(UserWarning, match="^to_laspy: .*cannot store the scanner positions"):
        made = cloud.to_laspy()
    assert isinstance(made, laspy.LasData) and made.header.parse_crs() is not None
    made.write(tmp_path / "a.las")
    there, file = pr.as_points(made), pr.read(tmp_path / "a.las")
    np.testing.assert_allclose(there.world, cloud.world, rtol=0, atol=1e-6)
    same(there, file)
    np.testing.assert_array_equal(there.normals, cloud.normals)
    assert there.georeference.crs == "EPSG:25832" or "25832" in there.georeference.crs
    for name in DTYPES:
        np.testing.assert_array_equal(there.attributes[name], cloud.attributes[name])


def test_rows_of_laspy_that_were_changed_in_memory(rng):
    laspy = library("laspy")
    header = laspy.LasHeader(version="1.4", point_format=7)
    header.scales, header.offsets = [0.001] * 3, ORIGIN
    data = laspy.LasData(header)
    world = np.round(rng.random((1000, 3)) * 100, 3) + ORIGIN
    data.x, data.y, data.z = world.T
    data.red = data.green = data.blue = rng.integers(0, 65536, 1000).astype(np.uint16)
    data.add_extra_dim(laspy.ExtraBytesParams("height", np.float32))
    data.height = rng.random(1000).astype(np.float32)
    points = pr.as_points(data[data.red > 1000])
    chosen = np.asarray(data.red) > 1000
    np.testing.assert_allclose(points.world, world[chosen], rtol=0, atol=1e-5)
    np.testing.assert_array_equal(points.attributes["height"], np.asarray(data.height)[chosen])
    assert points.colors[:, 0].tolist() == np.rint(np.asarray(data.red)[chosen] / 257).astype(int).tolist()


def test_pandas_holds_all(cloud):
    pandas = library("pandas")
    made = cloud.to_pandas()
    assert isinstance(made, pandas.DataFrame) and made["x"].dtype == np.float64
    assert {"nx", "red", "features_3"} <= set(made.columns)
    same(pr.as_points(made), cloud)
    assert len(pr.as_points(made[made["red"] > 100])) == (cloud.colors[:, 0] > 100).sum()


def test_structured_arrays_hold_all_but_the_georeference(cloud):
    with pytest.warns(UserWarning, match="^to_structured: cannot store"):
        made = cloud.to_structured()
    assert made.dtype["x"] == np.float64 and made.dtype["red"] == np.uint8
    same(pr.as_points(made), cloud, georeference=False)


def test_points_are_arrays_of_world_coordinates(cloud):
    world = np.asarray(cloud)
    assert world.dtype == np.float64 and np.array_equal(world, cloud.world)
    assert np.asarray(cloud, np.float32).dtype == np.float32
    with pytest.raises(ValueError, match="copy"):
        np.asarray(cloud, copy=False)


def test_attributes_named_like_columns_are_renamed(rng):
    cloud = pr.Points(rng.random((20, 3)), attributes={"x": np.arange(20), "Normals": np.ones(20)})
    with pytest.warns(UserWarning, match="attribute 'x' is called 'x_2'"):
        table = cloud.to_pandas()
    assert table["x_2"].tolist() == list(range(20))
    library("pyvista")
    with pytest.warns(UserWarning, match="attribute 'Normals' is called 'Normals_2'"):
        assert cloud.to_pyvista().point_data["Normals_2"].tolist() == [1] * 20


# ------------------------------------------------------------------------------------------------------ only there


COLUMNS = {"X": "x", "Y": "y", "Z": "z", "NormalX": "nx", "NormalY": "ny", "NormalZ": "nz", "Red": "red"}
COLUMNS |= {"Green": "green", "Blue": "blue", "Intensity": "intensity"}


def rows_of(rng, n=100):
    """A structured array as PDAL returns it."""
    rows = np.zeros(
        n, [(name, np.uint16 if name in ("Red", "Green", "Blue", "Intensity") else float) for name in COLUMNS]
    )
    for name in rows.dtype.names:
        rows[name] = rng.integers(0, 65536, n) if rows.dtype[name] == np.uint16 else rng.random(n) + 4e6
    rows["Red"][0] = 65535
    return rows


def check_rows(points, rows):
    np.testing.assert_allclose(points.world, np.stack([rows[a] for a in "XYZ"], axis=1), rtol=0, atol=1e-7)
    np.testing.assert_array_equal(points.normals[:, 1], rows["NormalY"].astype(np.float32))
    assert points.colors[0, 0] == 255 and points.attributes["Intensity"].tolist() == rows["Intensity"].tolist()


@pytest.mark.parametrize("kind", ["structured", "recarray", "dict", "pandas", "nullable", "polars", "arrow", "batch"])
def test_columns_by_name(rng, kind):
    rows = rows_of(rng)
    columns = {name: np.ascontiguousarray(rows[name]) for name in rows.dtype.names}
    if kind in ("pandas", "nullable"):
        table = library("pandas").DataFrame(columns)
        made = table.convert_dtypes() if kind == "nullable" else table
    elif kind == "polars":
        made = library("polars").DataFrame(columns)
    elif kind in ("arrow", "batch"):
        arrow = library("pyarrow")
        made = (arrow.table if kind == "arrow" else arrow.RecordBatch.from_pydict)(columns)
    else:
        made = {"structured": rows, "recarray": rows.view(np.recarray), "dict": columns}[kind]
    check_rows(pr.as_points(made), rows)


def test_missing_integers_become_nan(rng):
    table = library("polars").DataFrame({"x": [0.0, 1.0], "y": [0.0, 0.0], "z": [0.0, 0.0], "ring": [3, None]})
    ring = pr.as_points(table).attributes["ring"]
    assert ring[0] == 3 and np.isnan(ring[1])
    table = library("pandas").DataFrame({"x": [0.0, 1.0], "y": 0.0, "z": 0.0})
    table["ring"] = library("pandas").array([3, None], dtype="Int32")
    ring = pr.as_points(table).attributes["ring"]
    assert ring[0] == 3 and np.isnan(ring[1])


def test_columns_without_numbers_are_left_out_with_one_warning():
    table = library("pandas").DataFrame({"x": [0.0, 1.0], "y": 0.0, "z": 0.0, "name": ["a", "b"], "when": ["c", "d"]})
    with pytest.warns(UserWarning, match=r"^DataFrame: left out, as they are no columns of numbers: name .*, when"):
        assert pr.as_points(table).attributes == {}


def test_vertices_of_trimesh(rng):
    trimesh = library("trimesh")
    ball = trimesh.creation.icosphere(2, 3.0)
    points = pr.as_points(ball)
    np.testing.assert_allclose(points.world, ball.vertices)
    assert points.colors is None and np.einsum("ij,ij->i", points.normals, ball.vertices / 3).min() > 0.99
    colors = rng.integers(0, 256, (len(ball.vertices), 4)).astype(np.uint8)
    cloud = pr.as_points(trimesh.PointCloud(ball.vertices, colors))
    np.testing.assert_array_equal(cloud.colors, colors[:, :3])
    ball.visual.vertex_colors = colors
    np.testing.assert_array_equal(pr.as_points(ball).colors, colors[:, :3])


def test_vertices_of_meshio(rng):
    meshio = library("meshio")
    positions, heat = rng.random((30, 3)), rng.random(30)
    mesh = meshio.Mesh(positions, [("triangle", [[0, 1, 2]])], point_data={"heat": heat, "Normals": positions})
    points = pr.as_points(mesh)
    np.testing.assert_array_equal(points.attributes["heat"], heat)
    np.testing.assert_array_equal(points.normals, positions.astype(np.float32))
    flat = pr.as_points(meshio.Mesh(positions[:, :2], []))
    assert (flat.world[:, 2] == 0).all()


def test_tensors_share_memory(rng):
    array = (rng.integers(-99, 99, (40, 3)) / 8).astype(np.float32)

    class Tensor:
        """Like a tensor of PyTorch or JAX, known by its protocol only."""

        def __dlpack__(self, **options):
            return array.__dlpack__(**options)

        def __dlpack_device__(self):
            return array.__dlpack_device__()

    assert np.shares_memory(pr.as_points(Tensor()).positions, array)


def test_paths_are_read(tmp_path, rng):
    cloud = pr.Points(rng.random((30, 3)))
    files = [str(tmp_path / "a.ply"), tmp_path / "b.ply"]
    for file in files:
        pr.write(file, cloud)
    assert len(pr.as_points(files[0])) == 30 and len(pr.as_points(files)) == 60
    assert pr.as_points(cloud) is cloud


# ---------------------------------------------------------------------------------------------- used by functions


def test_functions_take_what_as_points_accepts(tmp_path, rng):
    ball = pr.procedural("sphere", 600)
    rows = ball.to_structured()
    model = pr.Model(rows)
    np.testing.assert_array_equal(model.points.positions, pr.Model(ball).points.positions)
    pr.write(tmp_path / "a.ply", rows)
    assert len(pr.Model(tmp_path / "a.ply").points) == 600
    bare = {axis: rows[axis] for axis in "xyz"}
    assert pr.estimate_normals(bare).normals is not None
    assert len(pr.smooth(rows)) == len(pr.clean(rows)) == len(pr.merge_layers(bare)) == 600
    assert not pr.find_flaws(bare).outliers.any() and not pr.check_normals(rows).wrong
    assert pr.find_strays(rows).any.sum() < 60
    assert len(pr.subsample(rows, count=200)[0]) == 200


# ------------------------------------------------------------------------------------------------ unusual objects


def test_clouds_of_every_byte_order_become_open3d_clouds(tmp_path, rng):
    library("open3d")
    cloud = pr.Points(rng.random((30, 3)), rng.random((30, 3)), attributes={"w": rng.random(30)})
    pr.write(tmp_path / "a.ply", cloud)  # its rows are little-endian by name
    there = pr.read(tmp_path / "a.ply")
    assert {there.positions.dtype.byteorder, there.normals.dtype.byteorder} == {"="}
    same_rows = pr.as_points(there.to_open3d())
    np.testing.assert_array_equal(same_rows.attributes["w"], cloud.attributes["w"])
    swapped = pr.as_points({"x": np.arange(3, dtype=">f8"), "y": np.zeros(3, ">f4"), "z": np.zeros(3, ">i2")})
    assert swapped.world[:, 0].tolist() == [0, 1, 2]


@pytest.fixture
def geographic(tmp_path, rng):
    """A cloud of 3 m x 5 m, read from a file in degrees."""
    degrees = rng.random((200, 3)) * [5e-5, 5e-5, 3] + [13.4, 52.5, 30]
    known = pr.Georeference("EPSG:4326")
    cloud = pr.Points(degrees, attributes={"ring": rng.integers(0, 9, 200)}, georeference=known)
    pr.write(tmp_path / "a.npz", cloud)
    with pytest.warns(UserWarning, match="in metres east and north of"):
        return pr.read(tmp_path / "a.npz")


def test_clouds_of_degrees_stay_in_metres(geographic, tmp_path):
    assert geographic.georeference.projection is not None and np.ptp(geographic.world, axis=0).max() < 7
    library("pandas"), library("pyvista")
    for again in (pr.as_points(geographic.to_pandas()), pr.as_points(geographic.to_pyvista())):
        np.testing.assert_array_equal(again.world, geographic.world)
        assert again.georeference == geographic.georeference
    pr.prepare(geographic, tmp_path / "half.npz", every=2)
    with pytest.warns(UserWarning, match="in metres east and north of"):
        half = pr.read(tmp_path / "half.npz")
    assert len(half) == 100 and half.crs == "EPSG:4326"
    np.testing.assert_allclose(np.ptp(half.world, axis=0), np.ptp(geographic.world[::2], axis=0), rtol=0, atol=1e-4)


def las_data(rng, **options):
    laspy = library("laspy")
    header = laspy.LasHeader(version="1.4", point_format=6)
    header.scales, header.offsets = [0.001] * 3, [100, 200, 0]
    data = laspy.LasData(header)
    data.x, data.y, data.z = np.round(rng.random(40), 2) + [[100], [200], [0]]
    return data


def test_rows_of_laspy_may_have_another_scale_than_the_header(rng):
    data, other = las_data(rng), las_data(rng)
    other.change_scaling(scales=[0.01] * 3, offsets=[0, 0, 0])
    data.points = other.points
    limits = data.header.maxs.copy()
    np.testing.assert_allclose(pr.as_points(data).world, data.xyz, rtol=0, atol=1e-6)
    np.testing.assert_array_equal(data.header.maxs, limits)  # the caller's header is left as it is


def test_records_behind_the_rows_of_laspy_are_read(tmp_path, rng):
    laspy = library("laspy")
    data = las_data(rng)
    wkt = laspy.vlrs.known.WktCoordinateSystemVlr(
        'PROJCS["ETRS89 / UTM zone 32N",GEOGCS["ETRS89",DATUM["a",SPHEROID["b",6378137,298]]]]'
    )
    data.header.global_encoding.wkt = True
    data.evlrs = laspy.vlrs.vlrlist.VLRList([wkt])
    data.write(tmp_path / "a.las")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        there = pr.as_points(laspy.read(tmp_path / "a.las"))
        assert "UTM zone 32N" in there.crs == pr.read(tmp_path / "a.las").crs
        assert pr.as_points(las_data(rng)).crs is None


def test_uncoloured_clouds_of_trimesh(rng):
    trimesh = library("trimesh")
    assert pr.as_points(trimesh.PointCloud(rng.random((30, 3)))).colors is None


def test_colours_of_open3d_lie_from_0_to_1(rng):
    open3d = library("open3d")
    made = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(rng.random((30, 3))))
    colors = rng.random((30, 3)) * 2.5 - 0.1
    made.colors = open3d.utility.Vector3dVector(colors)
    with pytest.warns(UserWarning, match="colours outside 0 to 1 are clipped"):
        points = pr.as_points(made)
    np.testing.assert_allclose(points.colors, np.clip(colors, 0, 1) * 255, atol=0.51)
    tensors = open3d.t.geometry.PointCloud(open3d.core.Tensor.from_numpy(rng.random((30, 3))))
    tensors.point["colors"] = open3d.core.Tensor.from_numpy(rng.random((30, 1)))
    with pytest.raises(ValueError, match="colors must be numbers of the shape"):
        pr.as_points(tensors)


def test_names_that_differ_only_in_case(rng):
    floats, whole = rng.random((3, 20)), rng.integers(0, 99, (3, 20))
    points = pr.as_points(
        dict(zip("XxyYzZ", [whole[0], floats[0], floats[1], whole[1], floats[2], whole[2]], strict=True))
    )
    np.testing.assert_allclose(points.world, floats.T, atol=1e-6)
    assert points.attributes["X"].tolist() == whole[0].tolist()


def test_attributes_with_special_names_are_renamed(rng):
    library("pandas")
    cloud = pr.Points(rng.random((20, 3)), attributes={"X": np.arange(20), "rgb": np.ones((20, 3), np.uint8)})
    for convert in (cloud.to_pandas, cloud.to_structured):
        with pytest.warns(UserWarning, match="attribute 'X' is called 'X_2'"):
            again = pr.as_points(convert())
        np.testing.assert_array_equal(again.world, cloud.world)
        assert again.colors is None and again.attributes["X_2"].tolist() == list(range(20))


def test_masked_values_are_missing(rng):
    xyz = np.ma.masked_less(rng.random((30, 3)), 0.1)
    points = pr.as_points(xyz)
    np.testing.assert_array_equal(np.isnan(points.positions), xyz.mask)
    ring = np.ma.masked_equal(np.arange(30), 7)
    table = pr.as_points({"x": np.arange(30.0), "y": np.zeros(30), "z": np.zeros(30), "ring": ring})
    assert np.flatnonzero(np.isnan(table.attributes["ring"])).tolist() == [7]


def test_equal_names_of_columns_are_refused(rng):
    pandas, arrow = library("pandas"), library("pyarrow")
    table = pandas.DataFrame(rng.random((5, 4)), columns=["x", "y", "z", "x"])
    with pytest.raises(ValueError, match="DataFrame: several columns are called 'x'"):
        pr.as_points(table)
    with pytest.raises(ValueError, match="Arrow table: several columns are called 'x'"):
        pr.as_points(arrow.Table.from_arrays([arrow.array([1.0])] * 4, ["x", "y", "z", "x"]))


def test_lists_of_arrow_are_rows_of_numbers(rng):
    arrow = library("pyarrow")
    xyz = rng.random((10, 3)).astype(np.float32)
    rows = arrow.FixedSizeListArray.from_arrays(arrow.array(xyz.ravel()), 3)
    np.testing.assert_array_equal(pr.as_points(arrow.table({"xyz": rows})).world, xyz)


@pytest.mark.parametrize(
    "attrs", [{"pointray": 3}, {"pointray": {"georeference": {"foo": 1}}}, {"crs": 25832}, {"a": []}]
)
def test_attrs_of_others_are_ignored(attrs):
    table = library("pandas").DataFrame({"x": [0.0, 1.0], "y": 0.0, "z": 0.0})
    table.attrs = attrs
    assert pr.as_points(table).georeference == pr.Georeference()


def test_blocks_of_pyvista_are_combined():
    pyvista = library("pyvista")
    blocks = pyvista.MultiBlock([pyvista.Sphere(), pyvista.Cube()])
    assert len(pr.as_points(blocks)) == blocks[0].n_points + blocks[1].n_points


# ------------------------------------------------------------------------------------------------------ refusals


@pytest.mark.parametrize("thing", [None, 3, 2.5, object(), b"abc", {1, 2}, iter([1]), len])
def test_other_objects_are_refused_with_the_supported_kinds(thing):
    with pytest.raises(TypeError, match=r"^x must be Points, a path or list of paths, .*Open3D.*, not "):
        pr.as_points(thing)


@pytest.mark.parametrize(
    ("thing", "text"),
    [
        ([[1, 2], [3, 4]], r"x: .*\(n, 3\)"),
        ([[1, 2, 3], [4, 5]], "x: "),
        ([], "x: "),
        (np.zeros((0, 3)), "no points"),
        (np.full((4, 3), np.nan), "finite"),
        (np.array([["a", "b", "c"]]), "ints or floats"),
        (np.zeros(3, [("x", float), ("y", float)]), "columns x, y, z not found; available: x, y"),
        ({"x": [1.0], "y": [1.0, 2.0], "z": [1.0]}, "different lengths: z has 1 rows, y has 2 rows"),
        ({"x": [1.0, 2.0], "y": [1.0, 2.0], "z": [1.0, 2.0], "class": [1]}, "class has 1 rows"),
        ({}, "columns x, y, z not found"),
    ],
)
def test_wrong_values_are_named(thing, text):
    with pytest.raises(ValueError, match=text):
        pr.as_points(thing)


def test_empty_objects_are_refused():
    open3d = library("open3d")
    for empty in (open3d.geometry.PointCloud(), open3d.t.geometry.PointCloud(), library("pyvista").PolyData()):
        with pytest.raises(ValueError, match="no points"):
            pr.as_points(empty)
    with pytest.raises(ValueError, match="columns x, y, z not found; available: none"):
        pr.as_points(library("pandas").DataFrame())


def test_a_missing_library_is_named_with_the_command(monkeypatch, rng):
    cloud = pr.Points(rng.random((10, 3)))
    for name, convert in (("open3d", cloud.to_open3d), ("pyvista", cloud.to_pyvista), ("pandas", cloud.to_pandas)):
        monkeypatch.setitem(sys.modules, name, None)
        with pytest.raises(ImportError, match=f"needs {name}: pip install {name}"):
            convert()


def test_no_library_is_imported():
    code = """
import sys, numpy as np, pointray as pr
points = pr.as_points(np.zeros((4, 3)))
pr.as_points({"x": [0.0], "y": [0.0], "z": [0.0]}).to_structured()
names = "open3d pyvista trimesh meshio pandas polars pyarrow xarray torch".split()
print([name for name in names if name in sys.modules])
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n", done.stderr


def test_names_that_are_no_text_are_names_all_the_same(rng):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        table = library("pandas").DataFrame(np.column_stack([rng.random((5, 3)), np.arange(5)]), columns=[*"xyz", 7])
        assert pr.as_points(table).attributes["7"].tolist() == [0, 1, 2, 3, 4]


@pytest.mark.scans
@pytest.mark.parametrize("name", ["points/autzen_stadium_crop_rgb.ply", "points/stanford_bunny.ply"])
def test_real_scans_convert_and_return(name):
    points = pr.read(shared_model(name), max_points=20_000)
    library("pandas")
    library("pyvista")
    for again in (pr.as_points(points.to_pandas()), pr.as_points(points.to_pyvista())):
        assert again.georeference == points.georeference and again.attributes.keys() == points.attributes.keys()
        np.testing.assert_array_equal(again.world, points.world)
