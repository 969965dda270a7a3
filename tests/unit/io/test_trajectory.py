"""Moving scanners: a point's viewpoint is the position of the trajectory at its time."""

import gzip

import numpy as np
import pytest

import pointray as pr
from pointray import Points
from pointray.cloud.georeference import SCAN, Georeference
from pointray.cloud.normals.stations import check_outside
from pointray.io.trajectory import read_trajectory

FAR = np.array([512_345.678, 5_400_000.123, 321.5])
START = 316_000.25


def street(n=6000):
    """Return two thin walls, both sides scanned by a car driving around them: points, exact normals."""
    rng = np.random.default_rng(2)
    side = rng.integers(0, 2, n)
    positions = np.column_stack([np.where(side == 0, -0.001, 0.001), rng.random(n), rng.random(n)])
    times = START + np.where(side == 0, 10.0, 30.0) * rng.random(n).round(3) * 0.3 + np.where(side == 0, 0, 20.0)
    return Points(positions + FAR, attributes={"gps_time": times}), np.column_stack([2 * side - 1, 0 * side, 0 * side])


def drive(path, header="time,x,y,z\n", separator=",", extra=""):
    """Write a trajectory of the car, which drives west at first, then east."""
    rows = [(0, -5, 0, 0.5), (10, -5, 1, 0.5), (15, 0, 5, 0.5), (20, 5, 1, 0.5), (40, 5, 0, 0.5)]
    text = [separator.join(f"{v:.6f}" for v in (START + t, *(FAR + (x, y, z)))) + extra for t, x, y, z in rows]
    path.write_text(header + "\n".join(text) + "\n")
    return path


def test_positions_of_a_known_trajectory():
    points = Points(np.zeros((3, 3)), attributes={"gps_time": [0.0, 1.0, 5.0]})
    eyes = pr.eyes_along(points, pr.Trajectory([0, 2], [(0, 0, 0), (4, 2, 0)]))
    np.testing.assert_array_equal(eyes, [(0, 0, 0), (2, 1, 0), (np.nan,) * 3])
    for times, positions, words in (
        ([0], [(0, 0, 0)], "times must be at least two"),
        ([1, 0], np.zeros((2, 3)), "times must be .* none less than the one before"),
        ([0, np.nan], np.zeros((2, 3)), "times must be at least two finite numbers"),
        ([0, 1], np.zeros((3, 3)), r"positions must be finite, of shape \(2, 3\)"),
        ([0, 1], np.full((2, 3), np.inf), "positions must be finite"),
    ):
        with pytest.raises(ValueError, match=words):
            pr.Trajectory(times, positions)


@pytest.mark.parametrize(
    ("header", "separator", "extra"),
    [("time,x,y,z\n", ",", ""), ("", " ", " 0.1 -0.2 nan"), ("gps_time;easting;northing;height\n", ";", "")],
)
def test_normals_face_the_car(tmp_path, header, separator, extra):
    points, exact = street()
    eyes = pr.eyes_along(points, drive(tmp_path / "car.txt", header, separator, extra))
    normals = pr.estimate_normals(points, viewpoint=eyes).normals
    assert (np.sum(normals * exact, axis=1) > 0).all()


def test_a_compressed_trajectory_needs_no_header(tmp_path):
    plain = drive(tmp_path / "car.txt", "", " ")
    packed = tmp_path / "car.txt.gz"
    packed.write_bytes(gzip.compress(plain.read_bytes()))
    for name in ("times", "positions"):
        assert np.array_equal(getattr(read_trajectory(packed), name), getattr(read_trajectory(plain), name))


def test_viewpoints_are_interpolated_and_unknown_outside(tmp_path):
    times = START + np.array([-1, 0, 5, 12.5, 40, 41, np.nan])
    points = Points(np.tile(FAR, (7, 1)), attributes={"gps_time": times})
    eyes = pr.eyes_along(points, drive(tmp_path / "car.csv"))
    assert np.isnan(eyes[[0, 5, 6]]).all()
    np.testing.assert_allclose(eyes[1:5] - FAR, [[-5, 0, 0.5], [-5, 0.5, 0.5], [-2.5, 3, 0.5], [5, 0, 0.5]], atol=1e-5)


def test_a_trajectory_may_be_a_cloud_file(tmp_path):
    path = drive(tmp_path / "car.csv")
    rows = read_trajectory(path)
    pr.write(tmp_path / "car.npz", Points(rows.positions, attributes={"gps_time": rows.times}))
    points, _ = street()
    np.testing.assert_allclose(pr.eyes_along(points, tmp_path / "car.npz"), pr.eyes_along(points, path), atol=1e-2)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x,y,z\n1,2,3\n2,3,4\n", "expected a column gps_time or time"),
        ("time,x,y,z\n2,0,0,0\n1,0,0,0\n", "row 2 of the trajectory has an earlier time .* sort"),
        ("time,x,y,z\n2,0,0,0\nnan,0,0,0\n", "row 2 of the trajectory has a time"),
        ("time,x,y,z\n2,0,nan,0\n3,0,0,0\n", "row 1 of the trajectory has a time"),
        ("time,x,y,z\n2,0,0,0\n", "at least two rows"),
        ("time,x,y,z\n1,0,0,0\n2,0,0,0\n", "times of points are 316000.* of the trajectory 1 to 2"),
    ],
)
def test_invalid_trajectories_are_refused(tmp_path, text, message):
    (tmp_path / "bad.csv").write_text(text)
    with pytest.raises(ValueError, match=message) as error:
        pr.eyes_along(street(200)[0], tmp_path / "bad.csv")
    assert "\n" not in str(error.value)


def test_points_without_times_are_refused(tmp_path):
    with pytest.raises(ValueError, match="the attribute gps_time of the points, which is missing: pass a viewpoint"):
        pr.eyes_along(Points(np.eye(3)), drive(tmp_path / "car.csv"))


# ------------------------------------------------------------------------------------------------- invalid places


@pytest.mark.parametrize("shift", [0.0, 0.003])
def test_a_viewpoint_in_a_wall_is_refused(shift):
    points, _ = street()
    eye = points.positions[7] + points.origin + shift
    with pytest.raises(ValueError, match="lies among the points, .* position of the scanner"):
        pr.estimate_normals(points, viewpoint=eye)


def test_lost_returns_at_the_viewpoint_are_ignored():
    ball = pr.procedural("sphere", 2000)
    check_outside(np.concatenate([ball.positions, np.zeros((5, 3), np.float32)]), np.zeros(3))
    found = pr.estimate_normals(Points(np.concatenate([ball.positions, [[0, 0, 0]]])), viewpoint=(0, 0, 0)).normals
    assert (np.sum(found[:-1] * ball.normals, axis=1) < 0).all()
    assert np.isfinite(found).all() and found[-1].any()


def test_scans_without_a_station_are_reported():
    points, exact = street()
    scan = (exact[:, 0] > 0).astype(np.int32)
    scan[::10] = 7
    told = Points(
        points.positions, attributes={SCAN: scan}, georeference=Georeference(stations=((-5, 0, 0), (5, 0, 0)))
    )
    with pytest.warns(UserWarning, match="600 of 6,000 points belong to scans such as 7, .* only for 0 to 1"):
        pr.estimate_normals(told)
