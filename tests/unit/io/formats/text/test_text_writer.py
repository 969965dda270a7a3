"""Text files as pointray writes them, read again by pointray and NumPy."""

from dataclasses import replace

import laspy
import numpy as np
import pytest

import pointray as pr
from helpers.places import shared_model
from helpers.written_clouds import FAR, check_same, rich_cloud, with_nan, written
from pointray.io.files import read, write_points

ENDINGS = ("xyz", "txt", "asc", "csv", "tsv")


@pytest.mark.parametrize("ending", ENDINGS)
def test_all_values_are_restored(rng, tmp_path, ending):
    points = with_nan(rich_cloud(rng), [3, 77])
    losses, again = written(tmp_path / f"a.{ending}", points)
    assert losses == []
    check_same(points, again, skip=points.attributes)
    for name, values in points.attributes.items():  # the types are those that the values need
        restored = again.attributes[name].astype(values.dtype) if values.dtype.kind == "f" else again.attributes[name]
        np.testing.assert_array_equal(restored, values, err_msg=name)


def test_numpy_reads_the_same(rng, tmp_path):
    points = rich_cloud(rng)
    write_points(tmp_path / "a.xyz", points)
    rows = np.loadtxt(tmp_path / "a.xyz")
    np.testing.assert_array_equal((rows[:, :3] - points.origin).astype(np.float32), points.positions)
    np.testing.assert_array_equal(rows[:, 6:9], points.colors)
    write_points(tmp_path / "a.csv", points)
    table = np.genfromtxt(tmp_path / "a.csv", delimiter=",", names=True)
    assert table.dtype.names[:4] == ("x", "y", "z", "nx")
    np.testing.assert_array_equal(table["in_f8"], points.attributes["in_f8"])


@pytest.mark.long
def test_open3d_and_polars_read_the_same(rng, tmp_path):
    o3d = pytest.importorskip("open3d", exc_type=ImportError)
    polars = pytest.importorskip("polars")
    points = rich_cloud(rng)
    write_points(tmp_path / "a.xyz", points)
    xyz = np.asarray(o3d.io.read_point_cloud(str(tmp_path / "a.xyz")).points)
    np.testing.assert_array_equal((xyz - points.origin).astype(np.float32), points.positions)
    write_points(tmp_path / "a.csv", points)
    table = polars.read_csv(tmp_path / "a.csv")
    np.testing.assert_array_equal(table["in_i8"], points.attributes["in_i8"])
    np.testing.assert_array_equal(table["in_f8"], points.attributes["in_f8"])


def test_positions_alone_have_no_header(tmp_path):
    write_points(tmp_path / "a.xyz", pr.Points([[1, 2, 3], [0.1, -2.5, 1e-3]]))
    assert (tmp_path / "a.xyz").read_text() == "1 2 3\n0.1 -2.5 0.001\n"


def test_coordinates_of_a_grid_keep_its_decimals(rng, tmp_path):
    """A LAS file with millimetres becomes a text with three decimals, which float32 would not give."""
    header = laspy.LasHeader(version="1.4", point_format=6)
    header.scales, header.offsets = np.full(3, 0.001), np.array(FAR)
    las = laspy.LasData(header)
    las.X, las.Y, las.Z = rng.integers(-(2**30), 2**30, (3, 300), np.int32)
    las.write(tmp_path / "a.las")
    points = read(tmp_path / "a.las")
    write_points(tmp_path / "a.csv", points.changed(attributes={"grid_residual": points.attributes["grid_residual"]}))
    lines = (tmp_path / "a.csv").read_text().splitlines()
    assert lines[0] == "x,y,z"
    xyz = las.xyz
    for k, line in enumerate(lines[1:]):
        assert line == ",".join(f"{x:.3f}".rstrip("0").rstrip(".") for x in xyz[k])


def test_names_that_readers_mistake_are_changed(rng, tmp_path):
    names = ["red", "Intensity", "gps time", "x", "2nd", "a,b", "intensity"]
    points = pr.Points(rng.random((30, 3)), attributes={name: np.arange(30) + k for k, name in enumerate(names)})
    losses, again = written(tmp_path / "a.csv", points)
    columns = ["red_2", "intensity", "gps_time", "x_2", "column_2nd", "a_b", "intensity_2"]
    for k, name in enumerate(columns):
        np.testing.assert_array_equal(again.attributes[name], np.arange(30) + k, err_msg=name)
    assert losses[:3] == [
        "stores red as the column red_2",
        "stores Intensity as the column Intensity, which is read as intensity",
        "stores gps time as the column gps_time",
    ]


@pytest.mark.parametrize("ending", ["xyz", "csv"])
def test_every_other_name_is_reported(rng, tmp_path, ending):
    """Names that the reader shortens, replaces or does not distinguish: what is read again is what is reported."""
    long = "z" * 199
    names = [long + "a", long + "ab", long + "b" * 200, "\u0130" * 150, "\u0130" * 151, "alpha", "a", "GpsTime", "//"]
    names += ["_", "nan", "-", "plain", "longitude", "latitude", "height", "normal_x", "A", "a_2", "#", "\u65e5\u672c"]
    points = pr.Points(rng.random((30, 3)), attributes={name: np.arange(30) + k for k, name in enumerate(names)})
    losses, again = written(tmp_path / f"a.{ending}", points)
    assert len(again.attributes) == len(names)
    for (read_name, values), (name, wanted) in zip(again.attributes.items(), points.attributes.items(), strict=True):
        np.testing.assert_array_equal(values, wanted, err_msg=name)
        told = [text for text in losses if text.startswith(f"stores {name} as the column ")]
        assert bool(told) == (read_name != name), name
        assert not told or told[0].endswith((f" {read_name}", f" column {read_name}")), name


def test_separated_columns_are_reported(rng, tmp_path):
    wide = {"features": rng.random((30, 2)), "one": rng.random((30, 1)), "empty": np.zeros((30, 0))}
    losses, again = written(tmp_path / "a.csv", pr.Points(rng.random((30, 3)), attributes=wide))
    assert losses == [
        "stores the 2 columns of features separately, as features_0 and so on",
        "cannot store empty: it has no columns",
    ]
    assert list(again.attributes) == ["features_0", "features_1", "one"]


def test_attributes_with_several_columns(rng, tmp_path):
    wide = rng.random((30, 3)).astype(np.float32)
    _, again = written(tmp_path / "a.txt", pr.Points(rng.random((30, 3)), attributes={"wide": wide}))
    for k in range(3):
        np.testing.assert_array_equal(again.attributes[f"wide_{k}"].astype(np.float32), wide[:, k])


def test_the_georeference_is_reported(rng, tmp_path):
    known = pr.Georeference(crs="EPSG:25832", unit="metre", stations=[FAR])
    losses, _ = written(tmp_path / "a.xyz", rich_cloud(rng, georeference=known))
    assert losses == ["cannot store the coordinate system", "cannot store the scanner positions"]
    losses, _ = written(tmp_path / "a.xyz", rich_cloud(rng, georeference=pr.Georeference(unit="foot")))
    assert losses == ["cannot store the unit foot"]
    assert written(tmp_path / "a.xyz", rich_cloud(rng, georeference=pr.Georeference(unit="metre")))[0] == []


def test_several_blocks(rng, tmp_path, monkeypatch):
    from pointray.io.formats.text import _write

    points = rich_cloud(rng)
    write_points(tmp_path / "a.csv", points)
    monkeypatch.setattr(_write, "BLOCK", 33)
    shares = []
    write_points(tmp_path / "b.csv", points, shares.append)
    check_same(read(tmp_path / "a.csv"), read(tmp_path / "b.csv"))
    assert shares == sorted(shares) and len(shares) == 13 and shares[-1] == 1


@pytest.mark.scans
@pytest.mark.parametrize("ending", ["xyz", "csv"])
def test_a_real_scan_is_restored(tmp_path, ending):
    points = read(shared_model("points/autzen_stadium_crop_rgb.ply"), every=10)
    losses, again = written(tmp_path / f"a.{ending}", points)
    assert losses == []
    check_same(points, again)


@pytest.mark.parametrize("ending", ["csv", "pcd", "ptx", "copc.laz", "e57"])
def test_degrees_are_written_again(rng, tmp_path, ending):
    """Points that were read from longitudes and latitudes are in metres, and files of all formats in degrees."""
    if ending == "e57":
        pytest.importorskip("pye57")
    degrees = np.round(rng.random((200, 3)) * [0.01, 0.01, 20] + [8, 50, 100], 9)
    rows = ["longitude,latitude,height", *(",".join(f"{x:.9f}" for x in row) for row in degrees)]
    (tmp_path / "a.csv").write_text("\n".join(rows))
    with pytest.warns(UserWarning, match="longitude and latitude"):
        points = read(tmp_path / "a.csv")
    points = points.changed(georeference=replace(points.georeference, crs="EPSG:4326"))
    _, again = written(tmp_path / f"b.{ending}", points)
    order = np.lexsort(again.world.T), np.lexsort(points.world.T)  # COPC has an order of its own
    np.testing.assert_allclose(again.world[order[0]], points.world[order[1]], rtol=0, atol=2e-3)
    assert again.georeference.projection is not None
