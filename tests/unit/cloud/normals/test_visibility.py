"""Stations are used only if most of their points are visible from them."""

import re

import numpy as np
import pytest

import pointray as pr
from helpers.places import shared_model
from helpers.prepared_parts import prepared
from helpers.stations import seen_torus
from pointray import Georeference, Points, estimate_normals
from pointray.cloud.georeference import SCAN
from pointray.cloud.normals.estimate import repair_normals
from pointray.cloud.normals.stations import eyes_of
from pointray.cloud.normals.visibility import HIDDEN, hidden_share, ignored_stations

EYE = np.array([0.0, 0.0, 1.6])
NOTE = "not (a )?scanner positions?: ignored for normals"


def first_hits(directions, balls, boxes, floor):
    """Return distances from EYE to balls (centre, radius), boxes (low, high) and a floor; inf for a miss."""
    found = np.full(len(directions), np.inf)
    with np.errstate(divide="ignore", invalid="ignore"):
        if floor:
            down = -EYE[2] / directions[:, 2]
            found = np.where((down > 0) & (down < 60), down, found)
        for low, high in boxes:
            slabs = np.stack([(low - EYE) / directions, (high - EYE) / directions])
            enter, leave = slabs.min(axis=0).max(axis=1), slabs.max(axis=0).min(axis=1)
            found = np.where((enter < leave) & (enter > 0), np.minimum(found, enter), found)
        for centre, radius in balls:
            along = directions @ (centre - EYE)
            square = along**2 - ((centre - EYE) @ (centre - EYE) - radius**2)
            found = np.where((square > 0) & (along > 0), np.minimum(found, along - np.sqrt(square)), found)
    return found


def shapes_of(kind, rng):
    """Return balls, boxes, and whether there is a floor."""
    if kind == "object":
        return [(np.array([4, 0, 1]) + rng.normal(size=3) * 0.4, 0.3) for _ in range(12)], [], False
    if kind == "tree":
        return [(np.array([8, 0, 4]) + rng.normal(size=3) * 1.2, 0.05) for _ in range(1000)], [], False
    corners = [np.append(corner, 0.0) for corner in rng.uniform(-10, 10, (30, 2)) if np.abs(corner).max() > 1.5]
    wide = kind == "street"
    boxes = [(at, at + (rng.uniform(0.3, 1.2, 3) if wide else (0.15, 0.15, 4))) for at in corners]
    return [], [*boxes, (np.array([-20, 18, 0]), np.array([20, 19, 12]))], True


def scanned(kind, rng, rows=100):
    """Return a scan from EYE with noise, a fifth of it missing."""
    elevation, azimuth = np.meshgrid(np.linspace(-1.2, 1.2, rows), np.linspace(-np.pi, np.pi, 2 * rows, endpoint=False))
    if kind in ("object", "tree"):
        elevation, azimuth = elevation / 4 + (0.2 if kind == "tree" else -0.1), azimuth / 7
    level = np.cos(elevation)
    directions = np.stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)], axis=-1).reshape(-1, 3)
    ranges = first_hits(directions, *shapes_of(kind, rng)) + rng.normal(size=len(directions)) * 0.003
    kept = np.isfinite(ranges) & (rng.random(len(ranges)) > 0.2)
    return Points(EYE + directions[kept] * ranges[kept, None], georeference=Georeference(stations=(tuple(EYE),)))


def moved(points, station, **more):
    """Return the same points with another station."""
    return Points(points.world, points.normals, georeference=Georeference(stations=(tuple(station),)), **more)


@pytest.mark.parametrize("kind", ["object", "street", "poles", "tree"])
@pytest.mark.parametrize("seed", range(10))
def test_true_stations_are_accepted(kind, seed):
    points = scanned(kind, np.random.default_rng(seed))
    assert hidden_share(points.positions, EYE) < 0.7 * HIDDEN
    assert not ignored_stations(points) and (eyes_of(points) == EYE).all()


@pytest.mark.parametrize("station", [(5, 2, 1.5), (2, 0.4, 0.2), (500_000, 5_400_000, 0), (0, 0, -3)])
@pytest.mark.parametrize("name", ["torus", "sphere"])
def test_a_body_seen_from_all_sides_has_no_station(name, station):
    points = pr.procedural(name, 9000)
    assert ignored_stations(moved(points, station)) == (0,)


def test_a_merged_cloud_is_oriented_without_its_station():
    torus = pr.procedural("torus", 6000)
    merged = Points(torus.world, georeference=Georeference(stations=((5.0, 2.0, 1.5),)))
    with pytest.warns(UserWarning, match=NOTE):
        found = estimate_normals(merged)
    np.testing.assert_array_equal(found.normals, estimate_normals(Points(torus.world)).normals)
    assert found.georeference.stations == ((5.0, 2.0, 1.5),)
    towards = estimate_normals(merged, viewpoint=(5, 2, 1.5))
    assert (np.einsum("ij,ij->i", towards.normals, (5, 2, 1.5) - torus.world) > 0).mean() > 0.99


def test_signs_of_merged_normals_are_set_anew_without_a_station(rng):
    torus = pr.procedural("torus", 6000)
    given = torus.normals * rng.choice([-1, 1], (len(torus), 1))
    with pytest.warns(UserWarning, match=NOTE):
        repaired, output = repair_normals(
            Points(torus.world, given, georeference=Georeference(stations=((5.0, 2.0, 1.5),)))
        )
    assert (np.einsum("ij,ij->i", repaired.normals, torus.normals) > 0).all() and "signs recomputed" in output


def test_each_station_is_judged_by_its_points():
    torus, scan, _ = seen_torus()
    far = scanned("object", np.random.default_rng(3))
    positions = np.concatenate([far.world, torus.world + [50, 0, 0]])
    scans = np.repeat([0, 1, 2], [len(far), len(torus) - 1000, 1000])
    points = Points(
        positions, attributes={SCAN: scans}, georeference=Georeference(stations=(tuple(EYE), (0, 9, 0), (9, 9, 9)))
    )
    assert ignored_stations(points) == (1, 2)
    eyes = eyes_of(points)
    assert (eyes[scans == 0] == EYE).all() and np.isnan(eyes[scans > 0]).all()
    with pytest.warns(UserWarning, match="2 of 3 viewpoints of the file are not scanner positions"):
        estimate_normals(points)


def test_few_points_and_no_points_are_no_evidence(rng):
    for count in (0, 1, 3, 99):
        assert hidden_share(rng.normal(size=(count, 3)).astype(np.float32), np.zeros(3)) == 0
    assert hidden_share(np.zeros((500, 3), np.float32), np.zeros(3)) == 0
    assert hidden_share(rng.normal(size=(500, 3)).astype(np.float32), np.full(3, 1e300)) == 0
    bad = Points(np.where(rng.random((3000, 1)) < 0.9, np.nan, rng.normal(size=(3000, 3))))
    assert ignored_stations(moved(bad, (9, 9, 9))) == ()


@pytest.mark.scans
@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("points/tls_pumpA_rgb.ply", {}),
        ("points/rgbd_kinect_chair_rgb.ply", {}),
        ("raw/small_gicp_target.ply", {}),
        ("raw/pcl_mosd_learn0.pcd", {}),
        ("raw/depth_7scenes_000300.png", {"intrinsics": (585, 585, 320, 240)}),
    ],
)
def test_real_scans_keep_the_place_of_their_scanner(name, options):
    points = pr.read(shared_model(name), **options)
    assert hidden_share(points.positions, -points.origin) < 0.3 * HIDDEN


@pytest.mark.scans
@pytest.mark.parametrize("name", ["stanford_dragon", "potree_lion_takanawa_rgb", "autzen_stadium_crop_rgb"])
def test_real_merged_scans_have_no_station(name):
    points = pr.read(shared_model(f"points/{name}.ply"))
    assert hidden_share(points.positions, -points.origin) > 1.5 * HIDDEN


@pytest.mark.parametrize("signs", [False, True])
@pytest.mark.parametrize("stations", [((5.0, 2.0, 1.5),), ((9.0, 9.0, 9.0), (5.0, 2.0, 1.5)), ()])
def test_a_cloud_in_parts_ignores_the_same_stations(stations, signs, tmp_path, recwarn, rng):
    torus = pr.procedural("torus", 20_000)
    given = torus.normals * rng.choice([-1, 1], (len(torus), 1)) if signs else None
    scans = {SCAN: np.ones(len(torus), np.uint8)} if len(stations) == 2 else {}
    points = Points(torus.world, given, attributes=scans, georeference=Georeference(stations=stations))
    pr.write(tmp_path / "cloud.npz", points)
    parts = prepared(tmp_path / "cloud.npz", tmp_path / "parts.pointray", 8192)
    scene = pr.Scene()
    scene.add(parts)
    hits = scene.intersect([(0, 0, 5), (0, 0, -5)], [(0.7, 0, -5), (0.7, 0, 5)])
    assert hits.normal[0, 2] > 0.3 and hits.normal[1, 2] < -0.3
    assert [bool(re.search(NOTE, str(one.message))) for one in recwarn].count(True) == bool(stations)
