"""Frayed borders of noisy scans are trimmed; closed bodies and clean borders are not changed."""

import numpy as np
import pytest

import pointray as pr
from pointray.cloud.neighbors import kd_order
from pointray.surface.splats.support import find_support

NOISE = np.float32(1e-3)


def cap(lowest):
    """Return a sphere above a height with 40 points beside its rim that face across it, and which those are."""
    ball = np.asarray(pr.procedural("sphere", 8000).positions)
    ball = ball[ball[:, 2] > lowest]
    angle = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    side = np.sqrt(1 - max(lowest, 0) ** 2) * 1.015
    rim = np.stack([side * np.cos(angle), side * np.sin(angle), np.full(40, max(lowest, 0) + 0.03)], -1)
    normals = np.concatenate([ball, np.stack([-np.sin(angle), np.cos(angle), 0 * angle], -1)]).astype(np.float32)
    x = np.concatenate([ball, rim]).astype(np.float32)
    order = kd_order(x)
    return x[order], normals[order], (np.arange(len(x)) >= len(ball))[order]


def support(x, normals, noise):
    noise = None if noise is None else np.full(len(x), noise, np.float32)
    return find_support(x, normals, None, 1.0, borders=True, sheets=True, noise=noise)


def test_points_beyond_a_noisy_border_become_small():
    x, normals, out = cap(0.2)
    found, before = support(x, normals, NOISE), support(x, normals, None)
    usual = np.median(before.radii[~out])
    assert np.median(before.radii[out]) > 0.8 * usual
    assert (found.radii[out] < 0.7 * usual).all() and np.median(found.radii[out]) < 0.45 * usual
    assert found.borders[out].any(axis=1).mean() > 0.9
    inner = ~out & (x[:, 2] > 0.35)
    np.testing.assert_array_equal(found.radii[inner], before.radii[inner])
    np.testing.assert_array_equal(found.borders[inner], before.borders[inner])


def test_clean_borders_are_not_trimmed():
    x, normals, _ = cap(0.2)
    found, before = support(x, normals, 0.0), support(x, normals, None)
    np.testing.assert_array_equal(found.radii, before.radii)
    np.testing.assert_array_equal(found.borders, before.borders)


@pytest.mark.parametrize("noise", [NOISE, 0.1])
def test_a_closed_body_is_not_trimmed(noise):
    x, normals, _ = cap(-2.0)
    found, before = support(x, normals, noise), support(x, normals, None)
    np.testing.assert_array_equal(found.radii, before.radii)
    np.testing.assert_array_equal(found.borders, before.borders)


def test_discs_on_a_noisy_rim_are_no_wider_than_those_around():
    """Every fifth point beside the rim is missing, so that the others extend beyond it."""
    rng = np.random.default_rng(5)
    x = np.c_[rng.uniform(size=(6000, 2)), np.zeros(6000)]
    gone = (x[:, 0] > 0.95) & (rng.uniform(size=6000) < 0.7)
    x = x[~gone].astype(np.float32)
    x = x[kd_order(x)]
    normals = np.tile(np.float32([0, 0, 1]), (len(x), 1))
    found, before = support(x, normals, NOISE), support(x, normals, None)
    cut = found.radii < before.radii
    assert cut.any() and found.borders[cut].any(axis=1).all()
    edge = np.abs(x[:, :2] - 0.5).max(axis=1) > 0.42
    assert not cut[~edge].any()
