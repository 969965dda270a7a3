"""PTX files as pointray writes them, read again by pointray, and line by line."""

import numpy as np
import pytest

import pointray as pr
from helpers.places import shared_model
from helpers.written_clouds import FAR, STATIONS, check_same, rich_cloud, with_nan, with_scans, written
from pointray.io.files import read, write_points


def blocks_of(path):
    """Columns, rows, station, (4, 4) matrix and lines of each scan."""
    lines, found = path.read_text().splitlines(), []
    while lines:
        columns, rows = int(lines[0]), int(lines[1])
        station = tuple(float(word) for word in lines[2].split())
        matrix = np.array([[float(word) for word in line.split()] for line in lines[6:10]])
        data = np.array([[float(word) for word in line.split()] for line in lines[10 : 10 + columns * rows]])
        assert len(data) == columns * rows
        found.append((columns, rows, station, matrix, data))
        lines = lines[10 + columns * rows :]
    return found


def plain_cloud(rng, **fields):
    return rich_cloud(rng, normals=None, **{"attributes": {"intensity": rng.random(400).astype(np.float32)}, **fields})


def test_several_scans_with_poses(rng, tmp_path):
    points = with_scans(plain_cloud(rng), rng)
    losses, again = written(tmp_path / "a.ptx", points)
    assert losses == ["cannot store the coordinate system"]
    check_same(points, again)
    assert again.georeference.stations == STATIONS
    blocks = blocks_of(tmp_path / "a.ptx")
    assert len(blocks) == len(STATIONS)
    for k, (columns, rows, station, matrix, data) in enumerate(blocks):
        own = points.attributes["scan"] == k
        assert (columns, rows, station) == (1, own.sum(), STATIONS[k])
        world = np.c_[data[:, :3], np.ones(len(data))] @ matrix
        np.testing.assert_allclose(world[:, :3], points.world[own], rtol=0, atol=1e-5)
        np.testing.assert_array_equal(data[:, 3].astype(np.float32), points.attributes["intensity"][own])
        np.testing.assert_array_equal(data[:, 4:], points.colors[own])


def test_a_cloud_without_a_scanner(rng, tmp_path):
    points = rich_cloud(rng, normals=None, attributes={})
    losses, again = written(tmp_path / "a.ptx", points)
    assert losses == [] and again.georeference.stations == ()
    check_same(points, again)
    assert set(again.attributes["intensity"]) == {0.5}


def test_an_unknown_scanner_stays_unknown(rng, tmp_path):
    """A scanner at 0 0 0 is one; an unknown one is -0 -0 -0, which other programs read as 0 0 0."""
    points = pr.Points(rng.random((30, 3)))  # about zero, where a scanner could be
    _, again = written(tmp_path / "a.ptx", points)
    assert again.georeference.stations == () and blocks_of(tmp_path / "a.ptx")[0][2] == (0, 0, 0)
    _, again = written(tmp_path / "b.ptx", points.changed(georeference=pr.Georeference(stations=[(-0.0, 0, -0.0)])))
    assert again.georeference.stations == ((0, 0, 0),)
    known = pr.Georeference(stations=[(0, 0, 9), (1, 2, 8)])
    points = points.changed(georeference=known, attributes={"scan": np.repeat([0, 1, -1], 10)})
    losses, again = written(tmp_path / "c.ptx", points)
    assert losses == [] and again.georeference.stations == known.stations
    np.testing.assert_array_equal(again.attributes["scan"], points.attributes["scan"])


def test_scans_without_a_grid_and_other_orders_are_reported(rng, tmp_path):
    k = np.arange(40)
    grid = {"row_index": k // 5, "column_index": k % 5}
    points = pr.Points(rng.random((40, 3)), attributes=grid)
    losses, again = written(tmp_path / "a.ptx", points)
    assert losses == ["stores the points column by column of their grid, in another order"]
    np.testing.assert_array_equal(again.positions, points.positions[np.argsort(k % 5, kind="stable")])
    known = pr.Georeference(stations=[(0, 0, 5), (1, 2, 3)])
    second = k >= 20
    grid = {"row_index": np.where(second, k, k % 4), "column_index": np.where(second, 0, k // 4)}
    losses, _ = written(
        tmp_path / "b.ptx", pr.Points(rng.random((40, 3)), None, None, grid | {"scan": second * 1}, None, known)
    )
    assert losses == ["cannot store row_index, column_index of 1 of 2 scans: not a grid"]


def test_losses_are_reported(rng, tmp_path):
    points = rich_cloud(rng, attributes={"intensity": np.arange(400, dtype=np.uint16), "class": np.arange(400)})
    losses, again = written(tmp_path / "a.ptx", with_nan(points, [0, 9]))
    assert losses == [
        "cannot store the normals",
        "cannot store class",
        "stores intensity divided by 65535",
        "stores 2 rows without a finite position as missing returns",
    ]
    assert len(again) == 398
    kept = np.delete(np.arange(400), [0, 9])
    np.testing.assert_array_equal(again.attributes["intensity"], (kept / 65535).astype(np.float32))
    assert blocks_of(tmp_path / "a.ptx")[0][4][9].tolist() == [0, 0, 0, 0.5, 0, 0, 0]


def test_points_at_the_scanner_are_reported(tmp_path):
    points = pr.Points(np.array([FAR, STATIONS[0]]), georeference=pr.Georeference(stations=[STATIONS[0]]))
    losses, again = written(tmp_path / "a.ptx", points)
    assert losses == ["stores 1 point at the scanner as missing returns: 0 0 0"]
    assert len(again) == 1
    known = pr.Georeference(stations=[(512000.1, 5400000, 300)])  # in float32 the first point is 1.5 nm beside it
    near = pr.Points.about((512000, 5400000, 300), np.array([[0.1, 0, 0], [5, 6, 7]], np.float32), georeference=known)
    losses, again = written(tmp_path / "b.ptx", near)
    assert len(again) == 1 and losses == ["stores 1 point at the scanner as missing returns: 0 0 0"]


def test_a_grid_is_restored(rng, tmp_path):
    """Points with the row and the column of their cell, in any order, become a grid with missing returns."""
    cells = np.sort(rng.permutation(30 * 20)[:400])
    index = {"row_index": (cells % 30).astype(np.int32), "column_index": (cells // 30 + 5).astype(np.uint16)}
    points = plain_cloud(rng)
    points = points.changed(attributes=points.attributes | index)
    losses, again = written(tmp_path / "a.ptx", points)
    assert losses == []
    check_same(points, again, skip=index)
    ((columns, rows, _, _, data),) = blocks_of(tmp_path / "a.ptx")
    down, across = (index["row_index"] - index["row_index"].min()), index["column_index"] - 5
    assert (columns, rows) == (across.max() + 1, down.max() + 1)
    there = across * rows + down
    np.testing.assert_array_equal((data[there, :3] - points.origin).astype(np.float32), points.positions)
    missing = np.setdiff1d(np.arange(len(data)), there)
    assert (data[missing] == [0, 0, 0, 0.5, 0, 0, 0]).all()
    shuffled = points.select(rng.permutation(400))
    written(tmp_path / "b.ptx", shuffled)
    assert (tmp_path / "b.ptx").read_bytes() == (tmp_path / "a.ptx").read_bytes()


@pytest.mark.parametrize("case", ["twice", "sparse", "floats"])
def test_indices_that_give_no_grid(rng, tmp_path, case):
    points = plain_cloud(rng)
    rows, columns = np.arange(400) % 20, np.arange(400) // 20
    if case == "twice":
        rows[0], columns[0] = rows[1], columns[1]
    if case == "sparse":
        rows[0], columns[0] = 10**6, 10**6
    index = {"row_index": rows * 1.0 if case == "floats" else rows, "column_index": columns}
    losses, again = written(tmp_path / "a.ptx", points.changed(attributes=points.attributes | index))
    assert losses == ["cannot store row_index, column_index"]
    check_same(points, again)
    assert blocks_of(tmp_path / "a.ptx")[0][:2] == (1, 400)


@pytest.mark.scans
def test_a_real_scan_is_restored(tmp_path):
    points = read(shared_model("points/tls_pumpA_rgb.ply"), every=5)
    write_points(tmp_path / "a.ptx", points)
    again = read(tmp_path / "a.ptx")
    np.testing.assert_array_equal(again.world, points.world)
    np.testing.assert_array_equal(again.colors, points.colors)
