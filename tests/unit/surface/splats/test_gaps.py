"""Discs bridge gaps wider than three spacings only if both rims agree, and no disc fills a picture."""

import numpy as np
import pytest

import pointray as pr
from pointray.cloud.neighbors import kd_order, neighbors
from pointray.cloud.statistics import CloudStatistics
from pointray.surface.splats import cells, choose_radii
from pointray.surface.splats.gaps import WIDEST, find_limits
from pointray.surface.splats.radii import OVERLAP
from pointray.surface.tree.settings import TRIM

SPACING = 0.05
UP = np.float32([0, 0, 1])


@pytest.fixture
def rng():
    return np.random.default_rng(54)


def reaches(x, normals, others=None):
    """Return the extents of the points' cells, in the points' order."""
    x, normals = np.asarray(x, np.float32), np.asarray(normals, np.float32)
    order = kd_order(x)
    chosen = choose_radii(x[order], normals[order], others=None if others is None else np.asarray(others, np.float32))
    out = np.empty(len(x), np.float32)
    out[order] = chosen.radii / OVERLAP
    return out


def two_sheets(rng, rise):
    """Return two level squares 6 spacings apart, the second one higher; and which points lie on the rims."""
    side = np.arange(0, 1, SPACING)
    x = np.stack(np.meshgrid(side, side, [0]), -1).reshape(-1, 3)
    other = x + [1 + 5 * SPACING, 0, rise]
    both = np.concatenate([x, other]) + rng.uniform(-0.1, 0.1, (2 * len(x), 3)) * SPACING * [1, 1, 0]
    rims = (np.abs(both[:, 0] - (1 + 2 * SPACING)) < 3.5 * SPACING) & (np.abs(both[:, 1] - 0.5) < 0.3)
    return both, rims


def in_the_gap(rng, rise):
    return rng.uniform([1 - SPACING, 0, 0], [1 + 5 * SPACING, 1, max(rise, SPACING)], (300, 3))


@pytest.mark.parametrize(("rise", "bridged"), [(0.0, True), (4 * SPACING, False)])
def test_a_gap_full_of_scattered_points_is_bridged_if_its_rims_agree(rng, rise, bridged):
    x, rims = two_sheets(rng, rise)
    alone = reaches(x, np.tile(UP, (len(x), 1)))
    assert (alone[rims] > 2.5 * SPACING).mean() > 0.9  # surface all around: as wide as needed
    found = reaches(x, np.tile(UP, (len(x), 1)), in_the_gap(rng, rise))
    if bridged:
        np.testing.assert_array_equal(found[rims], alone[rims])
    else:
        assert found[rims].max() <= 0.5 * WIDEST * 1.3 * SPACING  # the 8th neighbour of a rim is farther away
        inner = (np.abs(x[:, :2] - 0.5) < 0.3).all(axis=1)
        np.testing.assert_array_equal(found[inner], alone[inner])


def test_surface_points_in_a_crown_do_not_cover_it(rng):
    x = rng.normal(size=(6000, 3)).astype(np.float32)
    normals = rng.normal(size=x.shape).astype(np.float32)
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    some = np.arange(len(x)) % 10 == 0
    spacing = np.sqrt(np.pi / 8) * neighbors(x, 9, x[some])[0][:, 8]
    found = reaches(x[some], normals[some], x[~some]) / spacing
    assert (found <= 0.5 * WIDEST * 1.001).mean() > 0.9
    assert (reaches(x[some], normals[some]) / spacing <= 0.5 * WIDEST).mean() < 0.5


@pytest.mark.parametrize("name", ["sphere", "torus", "statue", "lattice"])
def test_clean_models_keep_their_radii(name, monkeypatch):
    points = pr.procedural(name, 5_000)
    found = pr.Model(points).radii
    monkeypatch.setattr(cells.Cells, "narrow", lambda *_: None)
    np.testing.assert_array_equal(found, pr.Model(points).radii)


def clouds(rng):
    """Clouds in which a few points would fill a picture."""
    ball = rng.normal(size=(3000, 3))
    ball /= np.linalg.norm(ball, axis=1)[:, None]
    yield rng.uniform(size=(300, 3))
    yield rng.uniform(size=(1000, 3))
    yield np.concatenate([ball, [[30, 0, 0]]])
    yield np.concatenate([ball, rng.normal(size=(5, 3)) + 4])
    yield np.concatenate([0.2 * ball, rng.normal(size=(60, 3))])
    for count in (60, 100):
        yield np.concatenate([0.2 * ball[:800], rng.uniform(-1, 1, (count, 3))])


@pytest.mark.parametrize("scatter", ["surface", "spheres"])
def test_no_point_covers_2_percent_of_a_picture(rng, scatter):
    for x in clouds(rng):
        model, scene = pr.Model(pr.Points(x), scatter=scatter), pr.Scene()
        scene.add(model)
        hits = scene.intersect(*pr.frame(model, size=(200, 150)).rays())
        most = np.bincount(hits.point[np.isfinite(hits.t)]).max()
        assert most < 0.02 * hits.t.size


@pytest.mark.parametrize("count", [2, 3, 8, 20])
def test_a_few_points_have_no_limit(rng, count):
    x = rng.uniform(size=(count, 3)).astype(np.float32)
    near = neighbors(x, min(9, count))[1]
    limits = find_limits(x, near, None, CloudStatistics())
    assert np.isinf(limits.half).all()
    model = pr.Model(pr.Points(x, np.tile(UP, (count, 1))))
    scene = pr.Scene()
    scene.add(model)
    up = scene.intersect(x + UP * 10 + np.float32([1e-3, 0, 0]) * TRIM, -np.tile(UP, (count, 1)))
    assert np.isfinite(up.t).all()


def test_radii_are_the_same_in_any_unit(rng):
    x = rng.normal(size=(3000, 3)).astype(np.float32)
    normals = np.tile(UP, (len(x), 1))
    one = reaches(x[:1000], normals[:1000], x[1000:])
    np.testing.assert_allclose(reaches(x[:1000] * 1024, normals[:1000], x[1000:] * 1024), one * 1024, rtol=1e-6)
