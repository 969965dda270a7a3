"""Fits to neighbours of sixteen points at once, compared with float64 references for one point at a time."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from helpers import naive_fits
from helpers.marks import long
from pointray.cloud.denoising.creases import fit_creases
from pointray.cloud.denoising.fit import fit_surface
from pointray.cloud.normals.jets import _fit_rows, fit_residuals
from pointray.cloud.normals.layers import Layers

COUNT = 360
PLACES = {"here": (1.0, 0.0), "tiny": (1e-12, 0.0), "huge": (1e12, 0.0), "far off": (1.0, 300.0)}


def saddle(noise, count=COUNT, seed=1):
    """Return points of a wavy surface with noise (in spacings), and a table of neighbours, nearest first."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(-1, 1, (2, count))
    points = np.stack([x, y, 0.4 * x * y + 0.1 * np.sin(3 * x)], axis=1)
    return points + rng.normal(size=points.shape) * noise * 2 / np.sqrt(count)


def table(points, k):
    return np.ascontiguousarray(cKDTree(points).query(points, k)[1].astype(np.int32).reshape(len(points), k))


def degrees(a, b):
    """Return angles between lines."""
    a, b = np.asarray(a, float), np.asarray(b, float)
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), abs((a * b).sum(1))))


def alike(values, truth, share, some=0.99):
    """Return whether nearly all values differ from the truth by at most a share; ties may be broken differently."""
    return (abs(values - truth) <= share * abs(truth) + 1e-30).mean() >= some


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize(("noise", "sizes"), [(0.0, [10, 16]), (0.3, [10, 16, 32, 64])])
def test_normals_equal_those_of_the_reference(noise, sizes, place):
    scale, shift = PLACES[place]
    points = (saddle(noise) * scale + shift).astype(np.float32)
    near = table(points, sizes[-1])
    rows = np.arange(COUNT)[3:-4]  # not a multiple of sixteen
    out, residuals = _fit_rows(points, rows, near[3:-4], sizes, noise)
    wide = points.astype(np.float64)
    truth = [naive_fits.normal_and_plane(wide[near[i]] - wide[i], sizes, noise) for i in rows]
    normals, planes, left = (np.array(values) for values in zip(*truth, strict=True))
    assert np.quantile(degrees(out[:, :3], normals), 0.99) < 0.01
    assert np.quantile(degrees(out[:, 3:], planes), 0.99) < 0.01
    np.testing.assert_array_equal(np.isnan(residuals), np.isnan(left))
    known = np.isfinite(left)
    assert alike(residuals[known], left[known], 0.01, 0.9 if noise == 0.0 else 0.99)
    np.testing.assert_allclose(np.linalg.norm(out[:, :3], axis=1), 1, atol=1e-5)


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("known", [False, True])
def test_fitted_surfaces_equal_those_of_the_reference(known, place):
    scale, shift = PLACES[place]
    points = (saddle(0.3) * scale + shift).astype(np.float32)
    points[1::2] = points[::2] + np.float32(0.03 * scale)  # a second layer, which faces the other way if known
    normals = np.zeros((COUNT, 3), np.float32)
    normals[::2, 2], normals[1::2, 2] = 1, -1
    normals[5] = np.nan  # it has no side, so no neighbour is on it
    rows, near, sizes = np.arange(COUNT), table(points, 64), [16, 32, 64]
    noise = np.linspace(0.001, 0.05, COUNT).astype(np.float32) * np.float32(scale)
    found = fit_surface(points, rows, near, normals if known else None, noise)
    wide, truth = points.astype(np.float64), []
    for i in rows:
        others = near[i][normals[near[i]] @ normals[i] >= 0] if known else near[i]
        truth.append(naive_fits.to_surface(wide[others] - wide[i], sizes, float(noise[i])))
    shifts, turned, planes, errors = (np.array(values) for values in zip(*truth, strict=True))
    away = np.linalg.norm(found[0] - shifts, axis=1)
    assert np.quantile(away, 0.99) < 1e-3 * np.linalg.norm(shifts, axis=1).mean()
    sound = (turned != 0).any(axis=1)
    assert sound.sum() >= COUNT - 1 and (found[1][~sound] == 0).all()
    assert np.quantile(degrees(found[1], turned)[sound], 0.99) < 0.02
    assert np.quantile(degrees(found[2], planes)[sound], 0.99) < 0.02
    assert alike(found[3][sound, 1], errors[sound, 1], 1e-3)
    assert np.quantile(abs(found[3][sound, 0] - errors[sound, 0]), 0.99) < 1e-3 * errors[sound, 0].max()


def test_planes_equal_those_of_the_reference():
    points = saddle(0.4).astype(np.float32)
    near = table(points, 64)
    layers = Layers(points)
    layers.needed(1.0)
    layers.add_neighbors(slice(0, COUNT), near)
    wide = points.astype(np.float64)
    truth = [naive_fits.plane(wide[near[i]] - wide[i]) for i in range(COUNT)]
    normals = np.array([axes[0] for axes, _, _ in truth])
    moved = wide + np.array([(axes[0] @ mean) * axes[0] for axes, _, mean in truth])
    assert degrees(layers.planes, normals).max() < 0.01
    np.testing.assert_allclose(layers.moved, moved, atol=1e-5)


@pytest.mark.parametrize("k", [16, long(63), 64, long(128)])
def test_creases_equal_those_of_the_reference(k):
    """Checked at points of a cube near its edges and corners. (With two neighbours any plane fits.)"""
    rng = np.random.default_rng(7)
    n, face = 4000, rng.integers(0, 3, 4000)
    points = rng.uniform(0, 1, (n, 3))
    points[np.arange(n), face] = 0
    points = (points + rng.normal(size=(n, 3)) * 0.3 * np.sqrt(3 / n)).astype(np.float32)
    second, third = np.sort(points, axis=1)[:, 1:].T
    rows = np.concatenate([np.flatnonzero(second < 0.08)[:60], np.flatnonzero(third < 0.08)[:20]])
    near = np.ascontiguousarray(cKDTree(points).query(points[rows], k)[1].astype(np.int32))
    errors = np.tile(np.array([0.3, 0.6], np.float32) * np.float32(np.sqrt(3 / n)), (len(rows), 1))
    models = fit_creases(points, rows, near, errors)
    counts, wide, off = np.zeros(len(rows)), points.astype(np.float64), []
    for i, row in enumerate(rows):
        planes = naive_fits.crease(wide[near[i]] - wide[row], float(errors[i, 0]), float(errors[i, 1]))
        counts[i] = 0 if planes is None else len(planes)
        if planes is not None and counts[i] == models[i, 0]:
            off.append(abs(models[i, 1:-1].reshape(3, 4)[: len(planes)] - planes).max())
    assert (counts != models[:, 0]).mean() <= 0.02
    if k > 16:
        assert (counts == 2).sum() > 5 and (counts == 3).any()
        assert np.quantile(off, 0.95) < 1e-3


def test_fits_do_not_depend_on_the_batch():
    """The other points of the sixteen do not change a point's fit by a bit."""
    count = 900
    points = saddle(0.3, count).astype(np.float32)
    near, rows = table(points, 64), np.arange(count)
    noise = np.full(count, 0.02, np.float32)
    some = np.random.default_rng(2).permutation(count)[:101]
    for whole, part in (
        (_fit_rows(points, rows, near, [10, 16, 64], 0.3), _fit_rows(points, some, near[some], [10, 16, 64], 0.3)),
        (fit_surface(points, rows, near, None, noise), fit_surface(points, some, near[some], None, noise[some])),
    ):
        for a, b in zip(whole, part, strict=True):
            np.testing.assert_array_equal(a[some], b)


@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (0.6, 0, 0.8), (1, 2, 3)])
@pytest.mark.parametrize("scale", [1e-12, 1.0, 1e12])
def test_points_on_a_line_have_a_normal_perpendicular_to_it(axis, scale):
    t = np.random.default_rng(3).uniform(-1, 1, 50)
    line = np.array(axis) / np.linalg.norm(axis)
    points = (t[:, None] * line * scale).astype(np.float32)
    near, rows = table(points, 40), np.arange(50)
    out, residuals = _fit_rows(points, rows, near, [10, 16, 32, 40], 0.1)
    assert np.isnan(residuals).all()
    np.testing.assert_allclose(np.linalg.norm(out[:, :3], axis=1), 1, atol=1e-5)
    assert abs(out[:, :3] @ line).max() < 1e-3
    shifts, normals, _, errors = fit_surface(points, rows, near, None, np.full(50, 0.1 * scale, np.float32))
    assert (shifts == 0).all() and (normals == 0).all() and np.isinf(errors[:, 1]).all()
    assert np.isnan(fit_residuals(points, rows, near, 16)).all()


@pytest.mark.parametrize("k", [3, 7, 8, 16, 64, 150])
def test_points_in_a_plane_have_its_normal(k):
    rng = np.random.default_rng(4)
    points = np.zeros((300, 3), np.float32)
    points[:, :2] = rng.integers(-9, 10, (300, 2)) + rng.uniform(-0.3, 0.3, (300, 2))
    near = table(points, k)
    out, residuals = _fit_rows(points, np.arange(300), near, [k], 0.0)
    assert (abs(out[:, [2, 5]]) > 1 - 1e-6).mean() > (0.8 if k < 8 else 0.99)  # three points may lie on a line
    assert k < 8 or np.nanmax(residuals) < 1e-5


def test_coincident_points_have_a_unit_normal():
    points = np.zeros((40, 3), np.float32)
    near = np.tile(np.arange(20, dtype=np.int32), (40, 1))
    out, residuals = _fit_rows(points, np.arange(40), near, [10, 16], 0.0)
    np.testing.assert_allclose(np.linalg.norm(out[:, :3], axis=1), 1, atol=1e-5)
    assert np.isnan(residuals).all()
    found = fit_surface(points, np.arange(40), near, None, np.full(40, 0.1, np.float32))
    assert not any(np.isnan(values).any() for values in found)
    assert (fit_creases(points, np.arange(40), near, np.full((40, 2), 0.1, np.float32)) == 0).all()


def test_neighbours_at_two_very_different_scales():
    """Ten neighbours within a millionth of the distance of the others."""
    points = saddle(0.0)
    points = np.concatenate([points, points[:300] * 1e-6]).astype(np.float32)
    near = table(points, 64)
    rows = np.arange(len(points))
    out, _ = _fit_rows(points, rows, near, [10, 16, 32, 64], 0.0)
    wide = points.astype(np.float64)
    truth = np.array([naive_fits.normal_and_plane(wide[near[i]] - wide[i], [10, 16, 32, 64], 0.0)[0] for i in rows])
    assert np.quantile(degrees(out[:, :3], truth), 0.99) < 0.05
