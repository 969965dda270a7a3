"""Normals are oriented towards scanner stations: one, several, or unknown for some points."""

import numpy as np
import pytest

import pointray as pr
from helpers.stations import BOTH, EAST, WEST, seen_torus
from pointray import Points, estimate_normals
from pointray.cloud.georeference import SCAN, Georeference
from pointray.cloud.normals.estimate import repair_normals
from pointray.cloud.normals.stations import eyes_of


def wall(n=4000, thickness=0.002, origin=(0, 0, 0)):
    """Return a thin wall, scanned from both sides: positions, exact normals, and the station of each point."""
    rng = np.random.default_rng(5)
    scan = rng.integers(0, 2, n)
    x = np.where(scan == 0, -thickness, thickness) / 2
    positions = np.column_stack([x, rng.random((n, 2))]) + origin
    return positions, np.column_stack([np.sign(x), np.zeros((n, 2))]), scan


def wrong(normals, exact):
    """Return the share of normals that face the wrong side."""
    return float((np.einsum("ij,ij->i", normals, exact) < 0).mean())


def test_stations_orient_both_sides_of_a_thin_wall():
    positions, exact, scan = wall()
    told = Points(positions, attributes={SCAN: scan.astype(np.int32)}, georeference=BOTH)
    assert wrong(estimate_normals(told).normals, exact) == 0
    assert wrong(pr.estimate_normals(Points(positions)).normals, exact) > 0.2
    assert wrong(pr.estimate_normals(Points(positions), viewpoint=WEST).normals, exact) > 0.2


def test_stations_of_a_scan_far_from_zero_are_exact():
    far = np.array([512_345.678, 5_400_000.123, 321.5])
    positions, exact, scan = wall(origin=far)
    georeference = Georeference(stations=tuple(tuple(far + station) for station in BOTH.stations))
    assert (
        wrong(estimate_normals(Points(positions, attributes={SCAN: scan}, georeference=georeference)).normals, exact)
        == 0
    )


def test_a_single_station_applies_to_points_without_a_station_column():
    positions, exact, scan = wall()
    one = Georeference(stations=(WEST,))
    assert (estimate_normals(Points(positions, georeference=one)).normals[:, 0] < 0).all()
    assert (estimate_normals(Points(positions, georeference=one), viewpoint=EAST).normals[:, 0] > 0).all()
    unsaid = Points(positions, attributes={SCAN: np.where(scan == 0, 0, -1)}, georeference=one)
    assert np.isnan(eyes_of(unsaid)[scan == 1]).all() and (eyes_of(unsaid)[scan == 0] == WEST).all()


def test_each_point_may_have_its_own_viewpoint():
    positions, exact, scan = wall()
    eyes = np.array(BOTH.stations)[scan]
    assert wrong(estimate_normals(Points(positions), viewpoint=eyes).normals, exact) == 0
    for shape in (eyes[:-1], eyes[:, :2], np.zeros((0, 3))):
        with pytest.raises(ValueError, match="viewpoint must have the shape"):
            estimate_normals(Points(positions), viewpoint=shape)


@pytest.mark.filterwarnings("ignore:.*belong to scans such as")
@pytest.mark.parametrize("scans", [[7, -1], [np.nan, 0.5]])
def test_unknown_stations_change_nothing(scans):
    positions, _, scan = wall(800)
    without = estimate_normals(Points(positions)).normals
    unknown = Points(positions, attributes={SCAN: np.array(scans)[scan]}, georeference=BOTH)
    assert eyes_of(unknown) is None
    np.testing.assert_array_equal(estimate_normals(unknown).normals, without)
    np.testing.assert_array_equal(estimate_normals(Points(positions, georeference=BOTH)).normals, without)
    blind = np.full((800, 3), np.nan)
    np.testing.assert_array_equal(estimate_normals(Points(positions), viewpoint=blind).normals, without)


@pytest.mark.parametrize("outward", [1, -1])
def test_points_of_an_unknown_station_agree_with_the_others(outward):
    """The scan is inside out: if unknown ones did not follow the known ones, half of them would face outward."""
    torus, scan, _ = seen_torus()
    lost = np.random.default_rng(2).random(len(torus)) < 0.5
    eyes = torus.positions + outward * torus.normals
    eyes[lost] = np.nan
    found = estimate_normals(Points(torus.positions), viewpoint=eyes).normals
    assert wrong(found, outward * torus.normals) < 0.002


def test_a_group_without_a_known_station_faces_outward():
    ball = pr.procedural("sphere", 1500)
    positions = np.concatenate([ball.positions, ball.positions + (10, 0, 0)])
    eyes = np.full((3000, 3), np.nan)
    eyes[:1500] = 0
    exact = np.concatenate([-ball.normals, ball.normals])
    assert wrong(estimate_normals(Points(positions), viewpoint=eyes).normals, exact) == 0


def test_equal_positions_take_the_station_of_the_first_row():
    positions, exact, scan = wall(1000)
    twice = np.concatenate([positions, positions[::-1]])
    scans = np.concatenate([scan, np.full(1000, 0)])
    found = estimate_normals(Points(twice, attributes={SCAN: scans}, georeference=BOTH)).normals
    np.testing.assert_array_equal(found[1000:], found[:1000][::-1])
    assert wrong(found[:1000], exact) == 0


def test_rows_that_are_not_finite_do_not_shift_the_stations():
    positions, exact, scan = wall(1000)
    holes = np.insert(positions, [0, 300, 1000], np.nan, axis=0)
    scans = np.insert(scan, [0, 300, 1000], 1)
    found = estimate_normals(Points(holes, attributes={SCAN: scans}, georeference=BOTH)).normals
    good = np.isfinite(holes).all(axis=1)
    assert wrong(found[good], exact) == 0 and (found[~good] == 0).all()


def test_models_use_the_stations():
    positions, exact, scan = wall(thickness=0.2)
    fields = {"attributes": {SCAN: scan}, "georeference": BOTH}
    scene = pr.Scene()
    scene.add(pr.Model(Points(positions, **fields)))
    hits = scene.intersect([WEST, EAST], [(1, 0.1, 0.04), (-1, 0.1, 0.14)])
    assert hits.normal[:, 0] == pytest.approx([-1, 1], abs=0.05)


def test_given_normals_are_kept_and_missing_ones_estimated():
    positions, exact, scan = wall(thickness=0.2)
    fields = {"attributes": {SCAN: scan}, "georeference": BOTH}
    given, output = repair_normals(Points(positions, -exact, **fields))
    np.testing.assert_array_equal(given.normals, -exact)
    repaired, output = repair_normals(Points(positions, np.zeros_like(exact), **fields))
    assert wrong(repaired.normals, exact) == 0 and "estimated" in output


def test_inconsistent_normals_are_turned_to_their_stations():
    positions, exact, scan = wall(thickness=0.2)
    signs = np.where(np.random.default_rng(3).random(len(exact)) < 0.5, -1, 1)[:, None]
    fields = {"attributes": {SCAN: scan}, "georeference": BOTH}
    repaired, output = repair_normals(Points(positions, exact * signs, **fields))
    assert wrong(repaired.normals, exact) == 0 and "signs recomputed" in output and "viewpoint=" not in output


def test_correct_normals_of_a_thin_wall_are_kept():
    positions, exact, scan = wall()
    fields = {"attributes": {SCAN: scan}, "georeference": BOTH}
    repaired, output = repair_normals(Points(positions, exact, **fields))
    np.testing.assert_array_equal(repaired.normals, exact)
    assert output is None


def test_two_stations_orient_a_torus():
    torus, scan, cosine = seen_torus()
    told = Points(torus.positions, attributes={SCAN: scan.astype(np.uint8)}, georeference=BOTH)
    assert wrong(estimate_normals(told).normals[cosine > 0.1], torus.normals[cosine > 0.1]) == 0


def test_fitted_normals_in_place_of_wrong_ones_face_the_stations():
    from pointray.cloud.normals.validation import refit_normals

    positions, exact, scan = wall(thickness=0.2)
    points = Points(positions, -exact, attributes={SCAN: scan}, georeference=BOTH)
    assert wrong(refit_normals(points).normals, exact) == 0  # the file's normals, which all face away, do not flip them
