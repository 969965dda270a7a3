"""PCD files as pointray writes them, read again by pointray, Open3D and pypcd4."""

import io
import re
from dataclasses import replace

import numpy as np
import pytest

import pointray as pr
from helpers.places import shared_model
from helpers.written_clouds import FAR, check_same, rich_cloud, with_nan, with_scans, written
from pointray.cloud.geographic import in_file
from pointray.io.files import read, write_points
from pointray.io.formats.pcd import _write


def write_compressed(path, points):
    return write_points(path, points, compressed=True)


def test_everything_is_restored(rng, tmp_path):
    points = with_nan(rich_cloud(rng), [3, 77])
    wide = {"rgb_like": rng.random((len(points), 3)).astype(np.float32), "three": rng.integers(0, 9, (len(points), 3))}
    points = points.changed(attributes=points.attributes | wide)
    losses, again = written(tmp_path / "a.pcd", points)
    assert losses == []
    check_same(points, again)


def test_compressed_files_are_restored(rng, tmp_path, monkeypatch):
    pytest.importorskip("lzf", exc_type=ImportError)
    points = with_nan(rich_cloud(rng), [0])
    points = points.changed(attributes=points.attributes | {"same": np.zeros(len(points), np.int64)})
    for block in (1 << 20, 100, 3):  # of several blocks, some are too short to become smaller
        monkeypatch.setattr(_write, "BLOCK", block)
        assert write_compressed(tmp_path / "a.pcd", points) == []
        check_same(points, read(tmp_path / "a.pcd"))


def test_small_clouds_about_zero_are_float32(rng, tmp_path):
    points = pr.Points(rng.random((50, 3)).astype(np.float32))
    written(tmp_path / "a.pcd", points)
    assert b"SIZE 4 4 4\n" in (tmp_path / "a.pcd").read_bytes()
    check_same(points, read(tmp_path / "a.pcd"))


def test_one_scanner_is_the_viewpoint(rng, tmp_path):
    one = pr.Georeference(stations=[(512_340.1, 5.25, -1e-7)])
    losses, again = written(tmp_path / "a.pcd", rich_cloud(rng, georeference=one))
    assert losses == [] and again.georeference.stations == one.stations
    losses, again = written(tmp_path / "b.pcd", with_scans(rich_cloud(rng), rng))
    assert losses == ["cannot store the coordinate system", "cannot store the scanner positions"]
    assert again.georeference.stations == ()


def test_names_that_fields_cannot_have_are_changed(rng, tmp_path):
    n = 20
    names = {"return number": np.arange(n), "Y": np.arange(n) + 1, "return_number": np.arange(n) + 2, "_": np.arange(n)}
    losses, again = written(tmp_path / "a.pcd", pr.Points(rng.random((n, 3)), attributes=names))
    fields = ["return_number", "Y_2", "return_number_2", "__2"]
    for k, (name, old) in enumerate(zip(fields, names, strict=True)):
        np.testing.assert_array_equal(again.attributes[name], names[old])
        assert losses[k] == f"stores {old} as the field {name}"


@pytest.mark.parametrize(
    "names",
    [
        ("r", "g", "b"),
        ("red", "Green", "blue"),
        ("nx", "ny", "nz"),
        ("normal_x", "normal_y", "normal_z"),
        ("NormalX", "NormalY", "NormalZ"),
        ("positions",),
        ("Normals",),
        ("colors",),
    ],
)
def test_attributes_named_like_columns_of_points_stay_attributes(rng, tmp_path, names):
    shape = (20, 3) if len(names) == 1 else 20
    attributes = {name: rng.integers(0, 200, shape).astype(np.uint8) for name in names}
    bare = pr.Points(rng.random((20, 3)), attributes=attributes)
    full = bare.changed(normals=rng.normal(size=(20, 3)), colors=rng.integers(0, 256, (20, 3), np.uint8))
    for points in (bare, full):
        losses, again = written(tmp_path / "a.pcd", points)
        check_same(points, again, skip=names)
        for name in names:
            new = name if name in again.attributes else f"{name}_2"
            np.testing.assert_array_equal(again.attributes[new], attributes[name])
            assert (f"stores {name} as the field {new}" in losses) == (new != name)
    write_points(tmp_path / "a.pcd", bare.changed(attributes={"r": attributes[names[0]]}))
    assert "r" in read(tmp_path / "a.pcd").attributes  # one channel is no colour


def test_a_scanner_at_zero_is_known(rng, tmp_path):
    for stations in ((), ((0.0, 0.0, 0.0),)):
        points = pr.Points(rng.random((9, 3)), georeference=pr.Georeference(stations=stations))
        losses, again = written(tmp_path / "a.pcd", points)
        assert losses == [] and again.georeference.stations == stations


def test_the_viewpoint_is_in_degrees_like_the_points(rng, tmp_path):
    degrees = rng.random((50, 3)) * [0.01, 0.01, 20] + [8, 50, 100]
    rows = ["longitude,latitude,height", *(",".join(f"{x:.9f}" for x in row) for row in degrees)]
    (tmp_path / "a.csv").write_text("\n".join(rows))
    with pytest.warns(UserWarning, match="longitude and latitude"):
        points = read(tmp_path / "a.csv")
    known = replace(points.georeference, crs="EPSG:4326", stations=((10.0, 20.0, 3.0),))
    losses, again = written(tmp_path / "a.pcd", points.changed(georeference=known))
    assert losses == ["cannot store the coordinate system"]
    place = np.loadtxt(io.BytesIO(re.search(rb"VIEWPOINT (.*)", (tmp_path / "a.pcd").read_bytes())[1]))
    np.testing.assert_allclose(place[:2], in_file(known, np.array(known.stations))[0, :2], rtol=0, atol=1e-12)
    assert abs(place[0] - 8) < 0.1 and abs(place[1] - 50) < 0.1


@pytest.mark.long
def test_open3d_reads_the_same(rng, tmp_path):
    o3d = pytest.importorskip("open3d", exc_type=ImportError)
    points = rich_cloud(rng)
    pytest.importorskip("lzf", exc_type=ImportError)
    write_points(tmp_path / "a.pcd", points)
    write_compressed(tmp_path / "b.pcd", points)
    for file in (tmp_path / "a.pcd", tmp_path / "b.pcd"):
        cloud = o3d.t.io.read_point_cloud(str(file))
        np.testing.assert_array_equal(cloud.point.positions.numpy(), points.world)
        np.testing.assert_array_equal(cloud.point.colors.numpy(), points.colors)
        np.testing.assert_array_equal(cloud.point.normals.numpy().astype(np.float32), points.normals)
        np.testing.assert_array_equal(cloud.point.in_i8.numpy()[:, 0], points.attributes["in_i8"])


def test_pypcd4_reads_the_same(rng, tmp_path):
    pypcd4 = pytest.importorskip("pypcd4", exc_type=ImportError)
    points = rich_cloud(rng)
    write_points(tmp_path / "a.pcd", points)
    cloud = pypcd4.PointCloud.from_path(tmp_path / "a.pcd")
    np.testing.assert_array_equal(np.stack([cloud.pc_data[axis] for axis in "xyz"], axis=1), points.world)
    np.testing.assert_array_equal(cloud.decode_rgb(cloud.pc_data["rgb"]).reshape(-1, 3), points.colors)
    np.testing.assert_array_equal(cloud.pc_data["in_u4"], points.attributes["in_u4"])


@pytest.mark.scans
@pytest.mark.parametrize("name", ["points/potree_lion_takanawa_rgb.ply", "raw/pcl_samp11_utm.pcd"])
def test_a_real_scan_is_restored(tmp_path, name):
    points = read(shared_model(name))
    losses, again = written(tmp_path / "a.pcd", points)
    assert losses == []
    check_same(points, again)


def test_too_many_bytes_for_compression(rng, tmp_path, monkeypatch):
    pytest.importorskip("lzf", exc_type=ImportError)
    monkeypatch.setattr(_write, "LARGEST", 1000)
    with pytest.raises(ValueError, match="cannot be compressed: .* bytes of points"):
        write_compressed(tmp_path / "a.pcd", rich_cloud(rng, at=FAR))
    noise = pr.Points(rng.random((1000, 3)).astype(np.float32))
    monkeypatch.setattr(_write, "LARGEST", 12_000)  # the points have as many bytes, before they grow by 1/32
    with pytest.raises(ValueError, match=r"a\.pcd: cannot be compressed: 12,\d\d\d bytes of points"):
        write_compressed(tmp_path / "a.pcd", noise)
    assert list(tmp_path.iterdir()) == []
