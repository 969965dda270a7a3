"""Cleaning removes artificial strays and keeps real points."""

import numpy as np
import pytest

import pointray as pr
from helpers.clouds import sphere_points
from helpers.marks import long
from helpers.places import MODELS, shared_model

SCANS = [
    long("tls_pumpA_rgb"),
    long("rgbd_kinect_chair_rgb"),
    long("autzen_stadium_crop_rgb"),
    long("potree_lion_takanawa_rgb"),
]
BALL = sphere_points(5000)


def planted(world, seed=1):
    """Return the cloud, 20 stray points and a clump of ten, all 1 to 30 diagonals away."""
    low, high = world.min(axis=0), world.max(axis=0)
    size, draw = np.linalg.norm(high - low), np.random.default_rng(seed)
    directions = draw.normal(size=(20, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    single = (low + high) / 2 + directions * size * draw.uniform(1, 30, (20, 1))
    clump = high + [2 * size, 0, 0] + draw.normal(size=(10, 3)) * size * 1e-4
    return pr.Points(np.vstack([world, single, clump]))


def test_duplicates_are_found_bit_for_bit():
    near = np.nextafter(BALL[:10], np.float32(9))
    points = pr.Points(np.vstack([BALL, BALL[:100], near]))
    flaws = pr.find_flaws(points)
    assert flaws.duplicates.nonzero()[0].tolist() == list(range(5000, 5100))
    assert len(pr.clean(points)) == 5010
    assert pr.clean(points, duplicates=False) is points


@pytest.mark.parametrize("scale", [1e-6, 1, 1e6])
def test_outliers_are_found_at_any_scale(scale):
    points = planted(BALL * np.float64(scale))
    flaws = pr.find_flaws(points)
    assert flaws.outliers[5000:].all() and not flaws.outliers[:5000].any()
    assert len(pr.clean(points)) == 5000
    assert len(pr.clean(points, outliers=False)) == 5030


def test_sparse_parts_and_second_objects_are_kept():
    sparse = sphere_points(500, seed=3) * np.float32(10) + np.float32(15)
    other = sphere_points(2000, seed=4) + np.float32(500)
    assert not pr.find_flaws(pr.Points(np.vstack([BALL, sparse, other]))).outliers.any()


@pytest.mark.parametrize("rows", [np.ones((100, 3)), BALL[:1], BALL[:10], np.array([[0, 0, 0], [1e6, 0, 0]])])
def test_few_points_have_no_outliers(rows):
    flaws = pr.find_flaws(pr.Points(rows))
    assert not flaws.outliers.any()
    assert flaws.duplicates.sum() == len(rows) - len(np.unique(rows, axis=0))


def test_rows_that_are_not_finite_are_kept_in_place():
    rows = np.vstack([np.full((3, 3), np.nan), BALL, BALL[:5]])
    cleaned = pr.clean(pr.Points(rows))
    assert len(cleaned) == 5003 and not cleaned.finite[:3].any()


@pytest.mark.scans
@pytest.mark.parametrize("name", SCANS if MODELS.exists() else SCANS[:1])
def test_scans_lose_a_few_in_a_thousand_at_most(name):
    points = pr.read(shared_model(f"points/{name}.ply"))
    before = pr.find_flaws(points).outliers
    assert before.mean() < 3e-3
    after = pr.find_flaws(planted(points.world)).outliers
    assert after[-30:].all()
    assert np.abs(after[:-30].sum() - before.sum()) < 1e-4 * len(points)
