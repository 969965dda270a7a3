"""COPC files as pointray writes them, read again by pointray, laspy and copclib."""

import sys

import laspy
import numpy as np
import pytest

import pointray as pr
from helpers.places import shared_model
from helpers.written_clouds import FAR, rich_cloud, with_nan, written
from pointray.io.files import read, write_points
from pointray.io.formats.las import _octree, copc

ROW = "row"  # attribute with the row number of each point, because the file has another order


@pytest.fixture
def small_nodes(monkeypatch):
    """Octrees of many nodes for few points."""
    monkeypatch.setattr(_octree, "LEAF", 20)
    monkeypatch.setattr(_octree, "LARGEST_SAMPLE", 60)
    monkeypatch.setattr(copc, "BATCH", 150)


def numbered(points):
    return points.changed(attributes=points.attributes | {ROW: np.arange(len(points))})


def surface(rng, n):
    """Points on a wavy surface, twice as long as wide, far from zero."""
    x, y = rng.random((2, n)) * [[200], [100]]
    return pr.Points(np.stack([x, y, 5 * np.sin(x / 20)], axis=1) + FAR)


def test_everything_is_restored(rng, tmp_path, small_nodes):
    """Values are those of the LAS writer, to the last bit, in the order of the octree."""
    points = numbered(with_nan(rich_cloud(rng, 1000, georeference=pr.Georeference(crs="EPSG:25832")), [3, 500]))
    losses, again = written(tmp_path / "a.copc.laz", points)
    assert losses == ["leaves out 2 rows without a finite position"]
    _, plain = written(tmp_path / "a.las", points)
    order = again.attributes[ROW]
    assert sorted(order) == np.flatnonzero(points.finite).tolist() and not (np.diff(order) > 0).all()
    rows = np.searchsorted(plain.attributes[ROW], order)
    np.testing.assert_array_equal(again.world, plain.world[rows])
    np.testing.assert_array_equal(again.colors, points.colors[order])
    np.testing.assert_array_equal(again.normals, points.normals[order])
    for name, values in points.attributes.items():
        np.testing.assert_array_equal(again.attributes[name], values[order], err_msg=name)
        assert again.attributes[name].dtype == plain.attributes[name].dtype


def test_a_code_becomes_well_known_text(rng, tmp_path, monkeypatch):
    pyproj = pytest.importorskip("pyproj")
    points = rich_cloud(rng, attributes={}, georeference=pr.Georeference(crs="EPSG:25832"))
    _, again = written(tmp_path / "a.copc.laz", points)
    assert pyproj.CRS.from_wkt(again.georeference.crs).to_epsg() == 25832
    monkeypatch.setitem(sys.modules, "pyproj", None)
    losses, again = written(tmp_path / "b.copc.laz", points)
    assert losses == ["cannot store the coordinate system EPSG:25832: install pyproj"]
    assert again.georeference.crs is None


def check_octree(path, points):
    """Check the file with copclib, and its nodes."""
    copclib = pytest.importorskip("copclib")
    reader = copclib.FileReader(str(path))
    header, nodes = reader.copc_config.las_header, reader.GetAllNodes()
    assert reader.ValidateSpatialBounds()
    assert header.point_count == sum(node.point_count for node in nodes) == len(points)
    keys = {(node.key.d, node.key.x, node.key.y, node.key.z) for node in nodes}
    for d, x, y, z in keys:
        assert d == 0 or (d - 1, x // 2, y // 2, z // 2) in keys
    info = reader.copc_config.copc_info
    for node in nodes:
        spacing = info.spacing / 2**node.key.d
        own = reader.GetPoints(node)
        xyz = np.array([own.x, own.y, own.z]).T - [info.center_x, info.center_y, info.center_z] + info.halfsize
        cells = np.unique((xyz / spacing).astype(int), axis=0)
        assert len(own.x) <= max(len(cells) * 1.01, _octree.LEAF)  # one in a cell, but for rounding
    return reader


@pytest.mark.parametrize("n", [1, 300, pytest.param(6000, marks=pytest.mark.long)])
def test_copclib_accepts_the_octree(rng, tmp_path, small_nodes, n):
    points = surface(rng, n)
    write_points(tmp_path / "a.copc.laz", points)
    reader = check_octree(tmp_path / "a.copc.laz", points)
    assert (reader.GetMaxDepth() > 0) == (n > 20)


@pytest.mark.parametrize("step", [0.01, 1 / 3, 0.07])
def test_points_on_the_sides_of_nodes(rng, tmp_path, small_nodes, step):
    """Coordinates at which the octree divides space belong to one of both nodes, in spite of rounding."""
    rows = rng.integers(0, 65, (500, 3))
    rows[:2] = np.array([[0], [64]])
    known = pr.Georeference(scale=(step,) * 3, offset=FAR)
    points = pr.Points(rows * step + FAR, georeference=known)
    write_points(tmp_path / "a.copc.laz", points)
    assert check_octree(tmp_path / "a.copc.laz", points).GetMaxDepth() > 1


def test_coinciding_points_end_in_one_node(tmp_path, small_nodes):
    points = pr.Points(np.concatenate([np.zeros((100, 3)), np.ones((1, 3))]) + FAR)
    write_points(tmp_path / "a.copc.laz", points)
    np.testing.assert_allclose(read(tmp_path / "a.copc.laz").world.sum(axis=0), points.world.sum(axis=0))


def test_bounds_and_resolution_read_a_part(rng, tmp_path, small_nodes):
    points = numbered(surface(rng, 2000))
    write_points(tmp_path / "a.copc.laz", points)
    whole = read(tmp_path / "a.copc.laz")
    box = np.array([whole.bounds[0] - 1, whole.bounds.mean(axis=0) + [0, 0, 1e3]])
    inside = ((whole.world >= box[0]) & (whole.world <= box[1])).all(axis=1)
    some = read(tmp_path / "a.copc.laz", bounds=box)
    assert set(some.attributes[ROW]) == set(whole.attributes[ROW][inside])
    sizes = [len(read(tmp_path / "a.copc.laz", resolution=r)) for r in (100.0, 20.0, 5.0, 1e-3)]
    assert sizes == sorted(sizes) and 0 < sizes[0] < sizes[1] < sizes[2] <= sizes[3] == 2000


def test_laspy_reads_nodes_by_level_and_place(rng, tmp_path, small_nodes):
    points = numbered(surface(rng, 2000))
    write_points(tmp_path / "a.copc.laz", points)
    with laspy.CopcReader.open(tmp_path / "a.copc.laz") as reader:
        whole = reader.query()
        order = np.asarray(whole[ROW])
        assert len(reader.query(level=0)) == len(read(tmp_path / "a.copc.laz", resolution=1e3))
    assert sorted(order) == list(range(2000))
    np.testing.assert_allclose(np.array([whole.x, whole.y, whole.z]).T, points.world[order], rtol=0, atol=1e-4)


def test_limits_of_times_are_stated(rng, tmp_path):
    points = surface(rng, 30).changed(attributes={"gps_time": np.linspace(3e8, 4e8, 30)})
    write_points(tmp_path / "a.copc.laz", points)
    with laspy.CopcReader.open(tmp_path / "a.copc.laz") as reader:
        assert (reader.copc_info.gps_min, reader.copc_info.gps_max) == (3e8, 4e8)


@pytest.mark.parametrize("missing", [3, 30])
def test_missing_times_have_no_limits(rng, tmp_path, missing, monkeypatch):
    monkeypatch.setattr(copc, "BATCH", 2)
    monkeypatch.setattr(_octree, "LEAF", 2)
    time = np.linspace(3e8, 4e8, 30)
    time[:missing] = np.nan
    write_points(tmp_path / "a.copc.laz", surface(rng, 30).changed(attributes={"gps_time": time}))
    with laspy.CopcReader.open(tmp_path / "a.copc.laz") as reader:
        info = reader.copc_info
        assert (info.gps_min, info.gps_max) == ((time[3], 4e8) if missing == 3 else (0, 0))


@pytest.mark.parametrize("n", [1, 40])
@pytest.mark.parametrize("at", [0.0, 1e-30, 5.0, FAR])
def test_coinciding_points_have_an_octree(tmp_path, small_nodes, n, at):
    points = pr.Points(np.zeros((n, 3)) + at)
    write_points(tmp_path / "a.copc.laz", points)
    np.testing.assert_allclose(read(tmp_path / "a.copc.laz").world, points.world, rtol=0, atol=1e-4)
    assert len(read(tmp_path / "a.copc.laz", bounds=[points.world[0] - 1, points.world[0] + 1])) == n
    copclib = pytest.importorskip("copclib")
    reader = copclib.FileReader(str(tmp_path / "a.copc.laz"))
    assert reader.ValidateSpatialBounds() and reader.copc_config.copc_info.spacing > 0


@pytest.mark.parametrize("code", [4979, 9518])
def test_coordinate_systems_that_need_the_new_text(rng, tmp_path, code):
    pyproj = pytest.importorskip("pyproj")
    points = pr.Points(rng.random((20, 3)), georeference=pr.Georeference(crs=f"EPSG:{code}"))
    losses, again = written(tmp_path / "a.copc.laz", points)
    assert losses == [] and pyproj.CRS.from_wkt(again.georeference.crs).to_epsg() == code


def test_unknown_codes_are_reported(rng, tmp_path):
    pytest.importorskip("pyproj")
    points = pr.Points(rng.random((20, 3)), georeference=pr.Georeference(crs="EPSG:1500"))
    losses, _ = written(tmp_path / "a.copc.laz", points)
    assert losses == ["cannot store the coordinate system EPSG:1500: pyproj does not know it"]


def test_the_name_chooses_the_octree(rng, tmp_path):
    points = surface(rng, 50)
    for name, octree in (("a.laz", False), ("A.COPC.LAZ", True), ("copc.laz", False)):
        write_points(tmp_path / name, points)
        assert (b"copc" in (tmp_path / name).read_bytes()[375:440]) == octree, name


@pytest.mark.scans
def test_a_real_scan_is_restored(tmp_path):
    points = numbered(read(shared_model("points/autzen_stadium_crop_rgb.ply"), every=5))
    losses, again = written(tmp_path / "a.copc.laz", points)
    order = again.attributes[ROW]
    assert losses == []
    np.testing.assert_allclose(again.world, points.world[order], rtol=0, atol=1e-5)
    np.testing.assert_array_equal(again.colors, points.colors[order])
    check_octree(tmp_path / "a.copc.laz", points)


def test_units_without_a_coordinate_system(rng, tmp_path):
    for unit, losses in (("foot", ["cannot store the unit foot"]), ("metre", [])):
        points = surface(rng, 30).changed(georeference=pr.Georeference(unit=unit))
        assert written(tmp_path / "a.copc.laz", points)[0] == losses
