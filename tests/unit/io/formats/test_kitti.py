import numpy as np
import pytest

from helpers.kitti_files import REFLECTANCE, RINGS, XYZ, N, save
from pointray.io.files import read
from pointray.io.formats import kitti


@pytest.mark.parametrize("rows", [1 << 20, 7])
def test_kitti_sweeps_have_points_and_reflectance(tmp_path, monkeypatch, rows):
    monkeypatch.setattr(kitti, "CHUNK", rows)
    points = read(save(tmp_path / "000001.bin", XYZ, REFLECTANCE))
    np.testing.assert_array_equal(points.positions, XYZ)
    assert list(points.attributes) == ["reflectance"]
    np.testing.assert_array_equal(points.attributes["reflectance"], REFLECTANCE[:, 0])
    assert points.attributes["reflectance"].dtype == np.float32
    assert points.georeference.stations == ((0.0, 0.0, 0.0),)


@pytest.mark.parametrize("name", ["a.pcd.bin", "a.bin", "A.PCD.BIN"])
@pytest.mark.parametrize("n", [N, N - 1])
def test_nuscenes_sweeps_have_intensity_and_rings(tmp_path, name, n):
    points = read(save(tmp_path / name, XYZ[:n], REFLECTANCE[:n] * 255, RINGS[:n]))
    np.testing.assert_array_equal(points.positions, XYZ[:n])
    np.testing.assert_array_equal(points.attributes["intensity"], REFLECTANCE[:n, 0] * 255)
    np.testing.assert_array_equal(points.attributes["ring"], RINGS[:n, 0])


@pytest.mark.parametrize("most", [1, 255])
@pytest.mark.parametrize("n", [N, N - 1])
def test_colours_behind_the_coordinates(rng, tmp_path, most, n):
    """80 rows of six numbers have the size of 120 rows of four, and of 96 of five."""
    colors = rng.integers(0, 256, (n, 3)).astype(np.uint8)
    points = read(save(tmp_path / "a.bin", XYZ[:n], (colors / 255 * most).astype(np.float32)))
    np.testing.assert_array_equal(points.positions, XYZ[:n])
    np.testing.assert_array_equal(points.colors, colors)


def test_unknown_row_layouts_need_columns(tmp_path):
    save(tmp_path / "xyz.bin", XYZ)
    with pytest.raises(ValueError, match="fit no known lidar sweep; name each float32 of a row with --columns x,y,z"):
        read(tmp_path / "xyz.bin")
    points = read(tmp_path / "xyz.bin", columns="x,y,z")
    np.testing.assert_array_equal(points.positions, XYZ)
    more = np.stack([np.arange(N)] * 4, axis=1).astype(np.float32)
    save(tmp_path / "long.bin", more[:, :1], XYZ, more)
    points = read(tmp_path / "long.bin", columns="-,x,y,z,time,-,-,label")
    np.testing.assert_array_equal(points.positions, XYZ)
    assert sorted(points.attributes) == ["label", "time"]
    for columns, message in (
        ("x,y,z,a,a,-,-,-", "duplicate column name 'a'"),
        ("x,y,z,a,b,c,d", "its 2,560 bytes are not a multiple of 7 float32: x,y,z,a,b,c,d"),
    ):
        with pytest.raises(ValueError, match=message):
            read(tmp_path / "long.bin", columns=columns)


def test_a_cut_off_sweep_is_not_recognised_as_another_layout(tmp_path):
    data = save(tmp_path / "a.bin", XYZ, REFLECTANCE).read_bytes()
    for left in (24 * 31, 20 * 31, 12 * 31):  # rows of six, five and three numbers
        (tmp_path / "a.bin").write_bytes(data[:left])
        with pytest.raises(ValueError, match="cut off|known lidar sweep"):
            read(tmp_path / "a.bin", strict=True)


def test_rows_that_are_not_finite_are_kept(tmp_path):
    xyz = np.tile(XYZ, (10, 1))
    xyz[-3] = np.nan
    points = read(save(tmp_path / "a.bin", xyz, np.tile(REFLECTANCE, (10, 1))))
    np.testing.assert_array_equal(points.positions, xyz)


@pytest.mark.parametrize("name", ["a.bin", "a.pcd.bin"])
def test_a_file_that_is_cut_off_is_refused(tmp_path, name):
    data = save(tmp_path / name, XYZ, REFLECTANCE, RINGS).read_bytes()
    (tmp_path / name).write_bytes(data[:-3])
    with pytest.raises(ValueError, match=r"cut off, or not a lidar sweep: its 1,597 bytes are not a multiple of"):
        read(tmp_path / name, strict=True)


@pytest.mark.parametrize(
    "data",
    [
        bytes(1600),
        np.float32(5).tobytes() + np.arange(1, 400, dtype="<i4").tobytes(),
        np.full(400, 1e6, "<f4").tobytes(),
        np.full(400, np.nan, "<f4").tobytes(),
        b"some text that is no sweep of a laser scanner " * 32,
        np.random.default_rng(11).bytes(1600),
        b"\x7fELF" + bytes(range(12)) * 100,
    ],
)
def test_other_files_of_this_extension_are_refused(tmp_path, data):
    (tmp_path / "a.bin").write_bytes(data)
    with pytest.raises(ValueError, match="invalid COLMAP or KITTI, nuScenes file"):
        read(tmp_path / "a.bin")


def test_the_extension_is_needed(tmp_path):
    with pytest.raises(ValueError, match="unsupported file type"):
        read(save(tmp_path / "a.data", XYZ, REFLECTANCE))


def test_mutated_files_are_read_or_refused(rng, tmp_path):
    data = save(tmp_path / "a.bin", XYZ, REFLECTANCE).read_bytes()
    for _ in range(60):
        changed = bytearray(data)
        at = int(rng.integers(0, len(data)))
        changed[at] = int(rng.integers(0, 256))
        if rng.random() < 0.5:
            del changed[at:]
        (tmp_path / "a.bin").write_bytes(changed)
        try:
            found = len(read(tmp_path / "a.bin", strict=True))
        except ValueError as error:
            assert "\n" not in str(error)
        else:
            assert found in (len(changed) // 16, len(changed) // 20, len(changed) // 24)
