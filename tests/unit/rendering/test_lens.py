"""Camera rays from kernels: projections, the lens, and pixel filters."""

import dataclasses
from functools import cache

import numpy as np
import pytest

import pointray as pr
from pointray.base.choices import FILTERS, number_of
from pointray.engine.jit import borrow, keep_alive, kernel
from pointray.engine.kernels.sampling import pixel_key
from pointray.engine.kernels.scratch import DIRECTION, ORIGIN, TILE, load3, new_scratch
from pointray.rendering.film import EDGE, begin_tile, pixel_of, set_pixel_rays
from pointray.rendering.lens import position_in_pixel

EYE, TARGET = np.array([5.0, 3, 2]), np.array([-1.0, 0, 1])
FORWARD = (TARGET - EYE) / np.linalg.norm(TARGET - EYE)


@kernel
def _camera_rays(camera, sampling, origins, directions):
    memory = new_scratch(1)
    scratch = borrow(memory)
    height, width, spp = origins.shape[:3]
    for top in range(0, height, EDGE):
        for left in range(0, width, EDGE):
            begin_tile((left, top), (width, height), sampling[0], scratch)
            for sample in range(spp):
                set_pixel_rays(camera, (width, height), (left, top), sample, (sampling[1], sampling[2]), scratch)
                for i in range(TILE):
                    x, y = pixel_of((left, top), i)
                    if x < width and y < height:
                        o, d = load3(scratch.world, ORIGIN + i), load3(scratch.world, DIRECTION + i)
                        for c in range(3):
                            origins[y, x, sample, c], directions[y, x, sample, c] = o[c], d[c]
    keep_alive(memory)


@kernel
def _pixel_positions(sampling, out):
    for k in range(out.shape[0]):
        for sample in range(out.shape[1]):
            out[k, sample, 0], out[k, sample, 1] = position_in_pixel(pixel_key(k, 7, sampling[0]), sample, sampling[2])


def camera_with(projection, **more):
    return pr.Camera.look_at(EYE, TARGET, (0.1, 0.2, 1), 55, (21, 12), projection, **more)


def rays(camera, spp, shape="box", seed=0):
    """Return origins and directions, (h, w, spp, 3)."""
    width, height = camera.size
    out = np.empty((2, height, width, spp, 3))
    _camera_rays(camera.record(), (seed, spp, number_of(FILTERS, shape)), out[0], out[1])
    return out


def at_depth(origins, directions, depth):
    """Return points on rays at a depth along the view."""
    t = (depth - (origins - EYE) @ FORWARD) / (directions @ FORWARD)
    return origins + t[..., None] * directions


# ------------------------------------------------------------------------------------------------ projections


@pytest.mark.parametrize("shape", FILTERS)
@pytest.mark.parametrize("projection", ["perspective", "orthographic", "panorama"])
def test_a_single_sample_goes_through_the_pixel_centres(projection, shape):
    aperture = 0.0 if projection == "panorama" else 2.0
    camera = camera_with(projection, aperture=aperture)
    origins, directions = rays(camera, 1, shape, seed=5)
    np.testing.assert_allclose(origins[:, :, 0], camera.rays()[0], atol=1e-14)
    np.testing.assert_allclose(directions[:, :, 0], camera.rays()[1], atol=1e-15)


def test_perspective_rays_are_forward_plus_an_offset():
    """The direction is forward + u right + v up, with the middle of the picture at distance one."""
    right = np.cross(FORWARD, (0.1, 0.2, 1))
    right /= np.linalg.norm(right)
    half = np.tan(np.radians(55) / 2)
    u, v = (2 * np.arange(21) + 1) / 21 - 1, 1 - (2 * np.arange(12) + 1) / 12
    want = FORWARD + (half * 21 / 12 * u)[:, None] * right + (half * v)[:, None, None] * np.cross(right, FORWARD)
    want /= np.linalg.norm(want, axis=-1, keepdims=True)
    origins, directions = rays(camera_with("perspective"), 1)
    assert (origins == EYE).all()
    np.testing.assert_allclose(directions[:, :, 0], want, atol=1e-15)


def test_samples_of_the_box_stay_in_their_pixels():
    origins, directions = rays(camera_with("orthographic"), 16)
    tall = 2 * np.tan(np.radians(55) / 2) * np.linalg.norm(TARGET - EYE)
    pixel = tall / 12
    away = origins - camera_with("orthographic").rays()[0][:, :, None]
    assert np.abs(away).max() < pixel * np.sqrt(0.5) and np.linalg.norm(away, axis=-1).max() > 0.6 * pixel
    assert (directions == directions[0, 0, 0]).all()


@pytest.fixture(scope="module")
def scene():
    scene = pr.Scene()
    scene.add(pr.Model(pr.procedural("torus", 5000)))
    return scene


@pytest.mark.parametrize("view", [(0, -3, 0), (1.5, -2, 2)])
@pytest.mark.parametrize("projection", ["perspective", "orthographic", "panorama"])
def test_a_depth_picture_equals_the_hits_of_its_rays(scene, projection, view):
    """Depths are along the view, in a panorama from the eye; all rays may be parallel to two axes."""
    camera = pr.Camera.look_at(view, (0, 0, 0), size=(40, 40), projection=projection)
    depth = pr.render(scene, camera, pr.Settings("depth"))
    origins, directions = camera.rays()
    position = scene.intersect(origins, directions).position
    forward = -np.array(view) / np.linalg.norm(view)
    want = np.linalg.norm(position - view, axis=-1) if projection == "panorama" else (position - view) @ forward
    hit = np.isfinite(want)
    assert hit.mean() > 0.01
    assert np.array_equal(depth[..., 3] == 1, hit)
    np.testing.assert_allclose(depth[hit][:, 0], want[hit], rtol=1e-5)


# --------------------------------------------------------------------------------------------------- the lens


@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
@pytest.mark.parametrize("focus", [None, 3.0, np.inf])
def test_the_plane_of_focus_is_sharp(projection, focus):
    """Rays through all lens positions intersect there; at depth z they are off by
    the lens position times |z - focus| / focus, which gives the circle of confusion."""
    camera = camera_with(projection, aperture=0.6, focus=focus)
    through_lens, sharp = rays(camera, 64, seed=3), rays(dataclasses.replace(camera, aperture=0), 64, seed=3)
    focus = focus or np.linalg.norm(TARGET - EYE)
    np.testing.assert_allclose(np.linalg.norm(through_lens[1], axis=-1), 1, rtol=1e-14)
    aside = np.linalg.norm(through_lens[0] - sharp[0], axis=-1)
    assert 0.29 < aside.max() <= 0.3
    for z in (1.0, 3.0, 20.0, *([focus] if np.isfinite(focus) else [])):
        off = np.linalg.norm(at_depth(*through_lens, z) - at_depth(*sharp, z), axis=-1)
        spread = abs(z / focus - 1)
        np.testing.assert_allclose(off, aside * spread, atol=1e-9)
        assert 2 * off.max() == pytest.approx(0.6 * spread, rel=0.01, abs=1e-9)


@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
def test_the_lens_is_a_uniformly_sampled_disc(projection):
    camera = camera_with(projection, aperture=0.6)
    away = (rays(camera, 64)[0] - rays(dataclasses.replace(camera, aperture=0), 64)[0]).reshape(-1, 3)
    np.testing.assert_allclose(away @ FORWARD, 0, atol=1e-14)
    right = np.cross(FORWARD, (0, 0, 1))
    right /= np.linalg.norm(right)
    x, y = away @ right, away @ np.cross(right, FORWARD)
    for share in np.linspace(0.05, 0.95, 19):
        assert (np.hypot(x, y) < 0.3 * np.sqrt(share)).mean() == pytest.approx(share, abs=0.01)
        assert (np.arctan2(y, x) < (2 * share - 1) * np.pi).mean() == pytest.approx(share, abs=0.01)


def edge(size, aperture=0.0, shape="box"):
    """Return the coverage of a row of pixels, 0.1 wide at distance 4, by a half plane; focus at 2."""
    scene = pr.Scene()
    scene.add(pr.Model(pr.Points([[-100, 0, 0]], [[0, -1, 0]]), [100.0], surface="disc"))
    fov = np.degrees(2 * np.arctan(0.05 / 4))
    camera = pr.Camera.look_at((0, -4, 0), (0, 0, 0), fov=fov, size=(size, 1), aperture=aperture, focus=2.0)
    return pr.render(scene, camera, pr.Settings("normal", spp=4096, filter=shape))[0, :, 3]


def test_a_lens_blurs_an_edge_over_the_circle_of_confusion():
    """At twice the focus distance its diameter is the aperture, 2. Coverage is the covered part of the circle."""
    x = 0.1 * (np.arange(30) - 14.5)
    s = np.clip(-x, -1, 1)
    np.testing.assert_allclose(edge(30, 2.0), 0.5 + (s * np.sqrt(1 - s * s) + np.arcsin(s)) / np.pi, atol=0.01)


# ------------------------------------------------------------------------------------------------ pixel filters

X = np.linspace(-1.5, 1.5, 3001)  # pixels


def filter_of(shape):
    """Return the filter over X by its definition, integrated over the other axis."""
    if shape == "box":
        return np.where(np.abs(X) < 0.5, 1.0, 0.0)
    if shape == "tent":
        return np.maximum(1 - np.abs(X), 0)
    if shape == "gaussian":
        return np.where(np.hypot(X, X[:, None]) < 1.5, np.exp(-2 * (X**2 + X[:, None] ** 2)), 0).sum(axis=0)
    turn = 2 * np.pi * (X / 3 + 0.5)
    return 0.35875 - 0.48829 * np.cos(turn) + 0.14128 * np.cos(2 * turn) - 0.01168 * np.cos(3 * turn)


@cache
def shares(shape):
    """Return the integral of the filter left of each value of X."""
    f = filter_of(shape)
    return (np.cumsum(f) - f / 2) / f.sum()


def farthest(positions, shape):
    """Return the greatest difference between the distributions of positions and filter (Kolmogorov-Smirnov)."""
    return np.abs(np.searchsorted(np.sort(positions), X) / len(positions) - shares(shape)).max()


@pytest.mark.parametrize("shape", FILTERS)
def test_sample_positions_are_distributed_like_the_filter(shape):
    out = np.empty((64, 1024, 2))
    _pixel_positions((1, 1024, number_of(FILTERS, shape)), out)
    for positions in np.moveaxis(out.reshape(-1, 2), 1, 0):
        assert farthest(positions, shape) < 0.003
        others = {other: farthest(positions, other) for other in FILTERS if other != shape}
        # The tent and Blackman and Harris's window are nearly as wide.
        assert min(others.values()) > (0.008 if shape in ("tent", "blackman-harris") else 0.02)
    away = np.hypot(*np.moveaxis(out, 2, 0)) if shape == "gaussian" else np.abs(out).max(axis=2)
    end = {"box": 0.5, "tent": 1.0}.get(shape, 1.5)
    assert 0.8 * end < away.max() <= end
    x, y = out.reshape(-1, 2).T
    assert abs(np.corrcoef(x, y)[0, 1]) < 0.01
    assert abs(np.corrcoef(x * x, y * y)[0, 1]) < (0.05 if shape == "gaussian" else 0.01)  # whose support is a circle


@pytest.mark.parametrize("shape", FILTERS)
def test_the_coverage_at_an_edge_is_the_integral_of_the_filter(shape):
    """A pixel's coverage is the part of its filter beyond the edge; pixels do not share samples."""
    want = np.interp(2.5 - np.arange(6), X, shares(shape), left=0, right=1)
    np.testing.assert_allclose(edge(6, shape=shape), want, atol=0.004)


def test_an_unknown_filter_is_refused():
    with pytest.raises(ValueError, match="'sinc'; available: box, tent, gaussian, blackman-harris"):
        pr.Settings(filter="sinc")
