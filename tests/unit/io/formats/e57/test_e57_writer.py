"""E57 files as pointray writes them, read again by pointray and pye57."""

import laspy
import numpy as np
import pytest

import pointray as pr
from helpers.places import shared_model
from helpers.written_clouds import FAR, STATIONS, check_same, rich_cloud, with_nan, with_scans, written
from pointray.io.files import read, write_points

pye57 = pytest.importorskip("pye57")

SIGNED = {"in_u8": np.int64}  # E57 has no unsigned integers of 64 bits


def test_everything_is_restored(rng, tmp_path):
    points = rich_cloud(rng, georeference=pr.Georeference(crs="EPSG:25832"))
    losses, again = written(tmp_path / "a.e57", points)
    assert losses == []
    check_same(points, again, dtypes=SIGNED)
    assert again.georeference.crs == "EPSG:25832" and again.georeference.stations == ()


def test_several_scans_with_poses(rng, tmp_path):
    """Stations and the number of the scan are restored; pye57 finds each scan at its place."""
    points = with_scans(rich_cloud(rng), rng)
    losses, again = written(tmp_path / "a.e57", points)
    assert losses == []
    check_same(points, again, dtypes=SIGNED)
    assert again.georeference.stations == STATIONS
    with pye57.E57(str(tmp_path / "a.e57")) as file:
        assert file.scan_count == len(STATIONS)
        for k, station in enumerate(STATIONS):
            own = points.attributes["scan"] == k
            scan = file.read_scan(k, intensity=True, colors=True, ignore_missing_fields=True)
            xyz = np.stack([scan[f"cartesian{axis}"] for axis in "XYZ"], axis=1)
            np.testing.assert_allclose(xyz, points.world[own], rtol=0, atol=2e-9)
            np.testing.assert_array_equal(scan["intensity"], points.attributes["intensity"][own])
            for c, name in enumerate(("Red", "Green", "Blue")):
                np.testing.assert_array_equal(scan[f"color{name}"], points.colors[own, c])
            header = file.get_header(k)
            assert tuple(header.translation) == station and header.rotation.tolist() == [1, 0, 0, 0]
            assert header.xMaximum == pytest.approx((points.world[own] - station)[:, 0].max())


def test_rows_of_mixed_scans_are_sorted(rng, tmp_path):
    points = with_scans(rich_cloud(rng), rng)
    number = rng.integers(-1, 2, len(points)).astype(np.int32)  # none of the last station, some of unknown ones
    points = points.changed(attributes=points.attributes | {"scan": number})
    losses, again = written(tmp_path / "a.e57", points)
    assert losses == [
        "stores the points scan by scan, in another order",
        "cannot store 1 scanner position without points",
    ]
    order = np.argsort(np.where(number < 0, 2, number), kind="stable")
    check_same(points, again, skip=["scan"], rows=order, dtypes=SIGNED)
    np.testing.assert_array_equal(again.attributes["scan"], number[order])
    assert again.georeference.stations == STATIONS[:2]


def test_numbers_of_scans_without_a_scanner_are_kept(rng, tmp_path):
    """They divide no points: they are a column like others, whatever their type."""
    number = np.arange(40) % 2 + 7
    for values in (number, number * 1.5, (number == 7), number[:, None], number - 8):
        points = pr.Points(rng.random((40, 3)), attributes={"scan": values})
        losses, again = written(tmp_path / "a.e57", points)
        assert losses == []
        np.testing.assert_array_equal(again.attributes["scan"], values.reshape(-1))
    points = points.changed(attributes={"scan": np.stack([number, number], axis=1)})
    losses, again = written(tmp_path / "b.e57", points.changed(georeference=pr.Georeference(stations=STATIONS)))
    assert losses == [
        "cannot store the scanner positions: no attribute scan assigns points to them",
        "stores the 2 columns of scan separately, as scan_0 and so on",
    ]
    np.testing.assert_array_equal(again.attributes["scan_1"], number)


@pytest.mark.parametrize("ending", ["e57", "ptx"])
def test_other_numbers_of_scans_are_reported(rng, tmp_path, ending):
    known = pr.Georeference(stations=[(0, 0, 9), (1, 2, 8), (5, 5, 7)])
    cases = {
        "values": ([0, 0, 1, 2], [], [0, 0, 1, 2]),
        "floats": ([0.0, 1.0, 2.0, 2.0], [], [0, 1, 2, 2]),
        "not a number": ([0.0, 1.0, 2.0, np.nan], ["renumbers the attribute scan"], [0, 1, 2, -1]),
        "beyond": ([0, 1, 2, 5], ["renumbers the attribute scan"], [0, 1, 2, -1]),
        "gap": (
            [0, 0, 2, 2],
            ["renumbers the attribute scan", "cannot store 1 scanner position without points"],
            [0, 0, 1, 1],
        ),
        "one": (
            [1, 1, 1, 1],
            ["renumbers the attribute scan", "cannot store 2 scanner positions without points"],
            None,
        ),
    }
    for number, texts, wanted in cases.values():
        attributes = {"scan": np.array(number), "intensity": np.ones(4, np.float32)}
        points = pr.Points(rng.random((4, 3)), attributes=attributes, georeference=known)
        losses, again = written(tmp_path / f"a.{ending}", points)
        assert losses == texts
        assert again.attributes.get("scan", np.array(None)).tolist() == wanted
        places = [known.stations[k] for k in range(3) if k in number]
        assert list(again.georeference.stations) == places
    beyond = points.changed(attributes=attributes | {"scan": np.array([3, 4, 5, 6])})
    losses, again = written(tmp_path / f"a.{ending}", beyond)
    assert "cannot store 3 scanner positions without points" in losses and again.georeference.stations == ()
    assert ("cannot store scan" in losses) == (ending == "ptx")
    assert ending == "ptx" or again.attributes["scan"].tolist() == [3, 4, 5, 6]


def test_files_of_unknown_scans_are_joined(rng, tmp_path):
    """Points of unknown scanners do not get one of another file."""
    for k, name in enumerate(("a", "b")):
        known = pr.Georeference(stations=[(k, 0, 9), (k, 2, 8)])
        points = pr.Points(rng.random((6, 3)), attributes={"scan": np.array([0, 0, 1, 1, -1, -1])}, georeference=known)
        write_points(tmp_path / f"{name}.e57", points)
    both = pr.read([tmp_path / "a.e57", tmp_path / "b.e57"])
    assert both.attributes["scan"].tolist() == [0, 0, 1, 1, -1, -1, 2, 2, 3, 3, -1, -1]
    assert len(both.georeference.stations) == 4


@pytest.mark.parametrize("n", [1, 500])
def test_equal_integer_coordinates(tmp_path, n):
    """Columns of one value take no bits, and libE57 cannot read scans without any bits."""
    known = pr.Georeference(scale=(0.5,) * 3, offset=(0, 0, 0))
    points = pr.Points(np.full((n, 3), (1.5, 2, 3)), georeference=known)
    losses, again = written(tmp_path / "a.e57", points)
    assert losses == []
    np.testing.assert_array_equal(again.world, points.world)
    with pye57.E57(str(tmp_path / "a.e57")) as file:
        assert file.read_scan_raw(0)["cartesianX"].tolist() == [1.5] * n


def test_blocks_without_finite_integer_coordinates(rng, tmp_path, monkeypatch):
    from pointray.io.formats.e57 import _fields, _write as writer

    monkeypatch.setattr(_fields, "CHUNK", 100)
    monkeypatch.setattr(writer, "CHUNK", 100)
    known = pr.Georeference(scale=(0.25,) * 3, offset=(0, 0, 0))
    points = pr.Points(rng.integers(1000, 2000, (250, 3)) * 0.25, georeference=known)
    points = with_nan(points, slice(0, 100))
    losses, again = written(tmp_path / "a.e57", points)
    assert losses == ["marks 100 rows without a finite position as invalid"]
    np.testing.assert_array_equal(again.world, points.world[100:])
    assert again.georeference.scale == (0.25,) * 3


def test_control_characters_of_the_coordinate_system(rng, tmp_path):
    known = pr.Georeference(crs="a\x01b]]>&<\x00\u00fc\U0001f600")
    losses, again = written(tmp_path / "a.e57", pr.Points(rng.random((5, 3)), georeference=known))
    assert losses == ["leaves out control characters of the coordinate system"]
    assert again.georeference.crs == "ab]]>&<\u00fc\U0001f600"


def test_stations_without_numbers_of_scans_are_lost(rng, tmp_path):
    points = rich_cloud(rng, georeference=pr.Georeference(stations=STATIONS))
    losses, again = written(tmp_path / "a.e57", points)
    assert losses == ["cannot store the scanner positions: no attribute scan assigns points to them"]
    assert again.georeference.stations == ()


def test_invalid_rows_are_marked(rng, tmp_path):
    points = with_nan(with_scans(rich_cloud(rng), rng), [0, 5, -1])
    losses, again = written(tmp_path / "a.e57", points)
    assert losses == ["marks 3 rows without a finite position as invalid"]
    check_same(points, again, rows=points.finite, dtypes=SIGNED)
    with pye57.E57(str(tmp_path / "a.e57")) as file:
        assert file.read_scan_raw(0, ignore_unsupported_fields=True)["cartesianInvalidState"].sum() == 2 * 2


def test_values_that_are_not_finite(rng, tmp_path):
    points = rich_cloud(rng)
    normals, values = points.normals.copy(), rng.normal(size=len(points))
    normals[4], values[:3] = np.nan, (np.nan, np.inf, -np.inf)
    points = points.changed(normals=normals, attributes={"intensity": values, "other": values.astype(np.float32)})
    losses, again = written(tmp_path / "a.e57", points)
    assert losses == []
    check_same(points, again)


def test_integer_coordinates_are_restored(rng, tmp_path):
    """The integers of a LAS file become scaled integers, of which all digits are kept, without and with a pose."""
    header = laspy.LasHeader(version="1.4", point_format=6)
    header.scales, header.offsets = np.full(3, 0.001), np.array(FAR)
    las = laspy.LasData(header)
    las.X, las.Y, las.Z = rng.integers(-(2**30), 2**30, (3, 300), np.int32)
    las.write(tmp_path / "a.las")
    points, rows = read(tmp_path / "a.las"), las.xyz
    points = points.changed(attributes={"grid_residual": points.attributes["grid_residual"]})
    losses, again = written(tmp_path / "b.e57", points)
    assert losses == []
    check_same(points, again)
    assert (again.georeference.scale, again.georeference.offset) == (points.georeference.scale, FAR)
    with pye57.E57(str(tmp_path / "b.e57")) as file:
        raw = file.read_scan_raw(0)
    np.testing.assert_allclose(raw["cartesianX"], rows[:, 0], rtol=0, atol=1e-9)
    known = pr.Georeference(scale=points.georeference.scale, offset=FAR, stations=[STATIONS[0]])
    _, again = written(tmp_path / "c.e57", points.changed(georeference=known))
    np.testing.assert_array_equal(again.positions, points.positions)


def test_positions_off_the_grid_stay_floats(rng, tmp_path):
    """Points that were moved after reading are not rounded to the steps of their old file."""
    points = rich_cloud(rng, georeference=pr.Georeference(scale=(10.0, 10.0, 10.0), offset=FAR))
    losses, again = written(tmp_path / "a.e57", points)
    assert losses == []
    check_same(points, again, dtypes=SIGNED)
    assert again.georeference.scale is None


def test_numbers_beyond_signed_integers(rng, tmp_path):
    points = rich_cloud(rng, attributes={"huge": np.full(400, 2**64 - 1, np.uint64), "Own Name": np.arange(400)})
    losses, again = written(tmp_path / "a.e57", points)
    assert losses == [
        "stores huge as 64-bit floats, which round its largest numbers",
        "stores Own Name as the column Own_Name",
    ]
    assert again.attributes["huge"][0] == 2.0**64
    np.testing.assert_array_equal(again.attributes["Own_Name"], np.arange(400))


def test_other_units_are_reported(rng, tmp_path):
    losses, _ = written(tmp_path / "a.e57", rich_cloud(rng, georeference=pr.Georeference(unit="foot")))
    assert losses == ["cannot store the unit foot: coordinates in E57 files are metres"]


def test_equal_points_make_equal_files(rng, tmp_path):
    points = with_scans(rich_cloud(rng), rng)
    for name in ("a.e57", "b.e57"):
        write_points(tmp_path / name, points)
    assert (tmp_path / "a.e57").read_bytes() == (tmp_path / "b.e57").read_bytes()


def test_progress_can_stop_the_writer(rng, tmp_path):
    (tmp_path / "a.e57").write_bytes(b"old")

    def stop(share):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_points(tmp_path / "a.e57", rich_cloud(rng), stop)
    assert [(p.name, p.read_bytes()) for p in tmp_path.iterdir()] == [("a.e57", b"old")]


@pytest.mark.scans
@pytest.mark.parametrize("name", ["points/tls_pumpA_rgb.ply", "raw/bunnyFloat.e57"])
def test_a_real_scan_is_restored(tmp_path, name):
    points = read(shared_model(name))
    losses, again = written(tmp_path / "a.e57", points)
    assert losses == []
    check_same(points, again)
