"""Clouds in degrees of longitude and latitude are converted to metres, and written in degrees again."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from plyfile import PlyData

import pointray as pr
from helpers.places import case_file
from pointray.cloud.geographic import PLANE, PROJ, LocalFrame, is_geographic, projected
from pointray.cloud.georeference import Georeference
from pointray.io.trajectory import eyes_along

WGS84 = 'GEOGCS["WGS 84",DATUM["WGS_1984",SPHEROID["WGS 84",6378137,298.257223563]],UNIT["degree",0.0174532925199433]]'
UTM = 'PROJCS["WGS 84 / UTM 32N",GEOGCS["WGS 84"],PROJECTION["Transverse_Mercator"],UNIT["metre",1]]'


def geocentric(degrees):
    """Return geocentric coordinates, metres."""
    (longitude, latitude), height = np.radians(degrees[:, :2].T), degrees[:, 2]
    e2 = 0.00669437999014
    n = 6378137 / np.sqrt(1 - e2 * np.sin(latitude) ** 2)
    flat = (n + height) * np.cos(latitude)
    up = (n * (1 - e2) + height) * np.sin(latitude)
    return np.stack([flat * np.cos(longitude), flat * np.sin(longitude), up], axis=1)


@pytest.mark.parametrize(("method", "error"), [(PROJ, 1e-6), (PLANE, 5e-4)])
@pytest.mark.parametrize("place", [(11.5, 48.1), (-70.2, -33.4), (179.999, 0.001), (25.0, 78.2)])
def test_metres_are_those_on_the_ellipsoid(method, error, place, rng):
    frame = LocalFrame(place[1], place[0], method)
    degrees = np.column_stack([np.array(place) + rng.uniform(-0.005, 0.005, (300, 2)), rng.uniform(-1, 1, 300)])
    local = frame.to_local(degrees)
    expected = np.linalg.norm(geocentric(degrees) - geocentric(degrees[:1]), axis=1)
    np.testing.assert_allclose(np.linalg.norm(local - local[0], axis=1), expected, rtol=error, atol=error)
    np.testing.assert_allclose(frame.to_degrees(local), degrees, rtol=0, atol=1e-12)
    step = frame.to_local(np.array([[*place, 0.0], [place[0] + 1e-4, place[1], 0], [place[0], place[1] + 1e-4, 0]]))
    assert abs(step[0]).max() < 1e-6 and step[1, 0] > 1 and step[2, 1] > 10  # east and north


def test_local_frames_are_parsed_from_projections():
    frame = LocalFrame(48.1, -11.5, PROJ)
    assert LocalFrame.of(Georeference(projection=str(frame))) == frame
    assert LocalFrame.of(Georeference()) is None
    for wrong in ("+proj=pipeline +step +proj=tmerc", "+proj=tmerc +lat_0=95.0 +lon_0=1.0 +ellps=WGS84 +units=m"):
        with pytest.raises(ValueError, match="invalid projection"):
            LocalFrame.of(Georeference(projection=wrong))


@pytest.mark.parametrize(
    ("crs", "expected"),
    [
        *((WGS84, True), (UTM, False), ("EPSG:4326", True), ("EPSG:25832", False), ("EPSG:4978", False), (None, False)),
        (f'COMPD_CS["both",{WGS84},VERT_CS["EGM96"]]', True),
        (f'COMPD_CS["both",{UTM},VERT_CS["EGM96"]]', False),
        ('GEOGCRS["WGS 84",DATUM["x"]]', True),
        ('GEOCCS["WGS 84",DATUM["x"]]', False),
    ],
)
def test_coordinate_systems_in_degrees_are_recognised(crs, expected):
    assert is_geographic(Georeference(crs)) == expected


def test_models_that_stand_somewhere_are_no_maps(rng):
    """Clouds in metres whose numbers could be degrees."""
    ball = rng.normal(size=(500, 3))
    for rows in (ball, ball * (0.05, 0.05, 5) + (13, 52, 0), ball * 0.1 + (13, 52, 30), ball * (1e-3, 1e-3, 1)):
        assert projected(Georeference(), rows) == Georeference()
    stated = Georeference("EPSG:4326")
    assert projected(stated, ball * 30000) == stated  # whatever the file declares, these are not degrees
    assert projected(stated, ball[:0]) == stated


def written(path, rng):
    """Return a text file in degrees, and its rows."""
    rows = (11.5, 48.1, 500.0) + rng.uniform(-1, 1, (400, 3)) * (4e-4, 3e-4, 20)
    np.savetxt(path, rows, "%.9f", ",", header="longitude,latitude,height", comments="")
    return path, np.loadtxt(path, delimiter=",", skiprows=1)


def stored(path):
    """Return the coordinates in a file, as other programs read them."""
    if path.suffix == ".las":
        return pytest.importorskip("laspy").read(path).xyz
    if path.suffix == ".npz":
        return np.load(path)["positions"]
    rows = np.load(path) if path.suffix == ".npy" else PlyData.read(path)["vertex"].data
    return np.stack([rows[axis] for axis in "xyz"], axis=1)


@pytest.mark.parametrize("is_installed", [True, False])
@pytest.mark.parametrize("suffix", ["las", "ply", "npz", "npy"])
@pytest.mark.filterwarnings("ignore:.*cannot store")
def test_files_are_written_in_degrees(tmp_path, rng, monkeypatch, suffix, is_installed):
    if not is_installed:
        monkeypatch.setitem(sys.modules, "pyproj", None)
    path, rows = written(tmp_path / "a.csv", rng)
    with pytest.warns(UserWarning, match="longitude and latitude in degrees: shown in metres east and north of 4"):
        points = pr.read(path)
    assert points.crs == "EPSG:4326" and points.georeference.unit == "metre"
    assert points.georeference.projection.startswith(PROJ if is_installed else PLANE)
    size = np.ptp(points.world, axis=0)
    np.testing.assert_allclose(size, np.ptp(rows, axis=0) * (74_600, 111_200, 1), rtol=0.02)
    pr.write(tmp_path / f"b.{suffix}", points)
    wrong = np.abs(stored(tmp_path / f"b.{suffix}") - rows).max(axis=0)
    assert (wrong < (2e-10, 2e-10, 4e-5)).all()  # float32 of 500 m


def test_integer_coordinates_of_las_are_written_unchanged(tmp_path):
    laspy = pytest.importorskip("laspy")
    path = case_file("las_degrees.las")
    with pytest.warns(UserWarning, match="x and y look like longitude and latitude in degrees"):
        points = pr.read(path)
    assert np.abs(points.bounds[:, :2]).max() < 5 and points.bounds[0, 2] > 498
    pr.write(tmp_path / "a.las", points)
    before, after = laspy.read(path), laspy.read(tmp_path / "a.las")
    for axis in "XYZ":
        np.testing.assert_array_equal(before[axis], after[axis])


def test_a_trajectory_has_the_degrees_of_the_file(tmp_path, rng):
    path, rows = written(tmp_path / "a.csv", rng)
    with pytest.warns(UserWarning, match="shown in metres"):
        points = pr.read(path)
    times = np.arange(len(points), dtype=float)
    points = pr.Points.about(points.origin, points.positions, None, None, {"gps_time": times}, points.georeference)
    text = "".join(f"{t},{x:.9f},{y:.9f},{z:.3f}\n" for t, (x, y, z) in zip(times, rows, strict=True))
    (tmp_path / "path.csv").write_text("time,x,y,z\n" + text)
    with pytest.warns(UserWarning, match="look like longitude and latitude"):
        eyes = eyes_along(points, tmp_path / "path.csv")
    np.testing.assert_allclose(eyes, points.world, rtol=0, atol=1e-3)


def test_a_saved_model_keeps_its_projection(tmp_path, rng):
    path, _ = written(tmp_path / "a.csv", rng)
    with pytest.warns(UserWarning, match="shown in metres"):
        points = pr.read(path)
    pr.Model(points).save(tmp_path / "a.pointray")
    assert pr.Model.load(tmp_path / "a.pointray").points.georeference == points.georeference
