"""Baked light compared with exact solutions: irradiance, its directions, and sky visibility."""

from functools import cache

import numpy as np
import pytest

import pointray as pr
from helpers.marks import long

FEW = {"patches": 2000, "links": 16}  # where the light need not be exact


@cache
def sphere(n):
    return pr.Model(pr.procedural("sphere", n))


@pytest.fixture
def ball():
    return sphere(5_000)


@pytest.mark.parametrize("n", [5_000, long(20_000)])
def test_all_bounces_add_up_inside_a_sphere(n):
    """In a closed sphere of albedo 0.8, the light is 5 times the direct light everywhere."""
    scene = pr.Scene()
    scene.add(sphere(n), material=pr.Diffuse(0.8))
    scene.add_light(pr.PointLight((0, 0, 0), 1.0))
    total = pr.bake(scene).irradiance(0, side=-1)
    assert abs(total.mean() / 5.0 - 1.0) < 0.01
    assert total.std() / total.mean() < 0.01


@pytest.mark.parametrize("n", [5_000, long(20_000)])
def test_only_the_outside_of_a_closed_body_is_lit(n):
    scene, ball = pr.Scene(), sphere(n)
    scene.add(ball, material=pr.Diffuse(0.5))
    scene.add_light(pr.EnvironmentLight())
    baked = pr.bake(scene)
    assert [sign for _, sign in baked._exchange._lit] == [1]
    assert (baked.irradiance(0, side=-1) == 0.0).all() and (baked.indirect(0, side=-1) == 0.0).all()
    assert baked.irradiance(0) == pytest.approx(np.pi, rel=0.01)  # of an even sky of radiance 1
    assert baked.ambient_occlusion(0) == pytest.approx(1.0, abs=0.01)
    assert baked.nbytes == 16 * len(ball.tree.order)


@pytest.mark.long
@pytest.mark.parametrize(("edge", "n"), [(80, 5_000), long(300, 20_000)])
def test_sky_visibility_below_a_ball_is_exact(edge, n):
    """A unit sphere on a plane hides 1 - (1 + d^2)^-1.5 of the sky from a point at distance d."""
    ground = pr.Points(*_sheet(edge, 4.0))
    scene = pr.Scene()
    scene.add(sphere(n), pr.transform(translate=(0, 0, 1)), material=pr.Diffuse(0.0))
    floor = scene.add(pr.Model(ground), material=pr.Diffuse(0.0))
    scene.add_light(pr.EnvironmentLight())
    seen = pr.bake(scene).ambient_occlusion(floor)
    d = np.linalg.norm(ground.positions[:, :2], axis=1)
    exact = 1.0 - (1.0 + d**2) ** -1.5
    inside = np.abs(ground.positions[:, :2]).max(axis=1) < 3.5
    far = inside & (d > 2 * 8.0 / edge)
    assert np.sqrt(np.mean((seen - exact)[inside] ** 2)) < 0.015
    assert np.abs(seen - exact)[far].max() < 0.05


def _sheet(edge, half):
    """Return positions and normals of a square sheet."""
    u = (np.arange(edge) + 0.5) / edge * 2 * half - half
    x, y = np.meshgrid(u, u)
    positions = np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3)
    return positions, np.broadcast_to([0.0, 0.0, 1.0], positions.shape)


@pytest.mark.long
def test_baked_pictures_equal_path_traced_ones():
    model = pr.Model(pr.procedural("statue", 30_000))
    scene = pr.Scene()
    scene.add(model, material=pr.Diffuse((0.7, 0.5, 0.4)))
    scene.add(pr.Plane((0, 0, model.bounds[0, 2]), (0, 0, 1), color=0.5))
    scene.add(pr.Plane((model.bounds[0, 0] - 0.3, 0, 0), (1, 0, 0), color=(0.8, 0.1, 0.1)))
    scene.add_light(pr.EnvironmentLight(1.0, ground=0.3))
    scene.add_light(pr.SunLight((-1, 1, -1), 2.0))
    camera = pr.frame(scene, size=(96, 96))
    scene.baked = pr.bake(scene)
    baked = pr.render(scene, camera, pr.Settings("baked", spp=64))[..., :3]
    path = pr.render(scene, camera, pr.Settings("path", spp=1024, max_depth=None))[..., :3]
    assert abs(baked.mean() / path.mean() - 1.0) < 0.01
    assert np.sqrt(np.mean((baked - path) ** 2)) / path.mean() < 0.03


def test_changed_lights_need_no_new_links(ball):
    scene = pr.Scene()
    scene.add(ball, material=pr.Diffuse(0.5))
    floor = scene.add(pr.Plane((0, 0, -1), (0, 0, 1), color=0.5))
    scene.add_light(pr.SunLight((0, 0, -1), 1.0))
    baked = pr.bake(scene, pr.BakeSettings(**FEW))
    assert baked.stale is None
    before = baked.indirect(0)
    scene.lights = [pr.SunLight((0, 0, -1), 2.0)]
    assert "update" in baked.stale
    baked.update()
    assert baked.stale is None
    assert baked.indirect(0) == pytest.approx(2.0 * before, rel=1e-4, abs=1e-6)
    scene.update(floor, transform=pr.transform(translate=(0, 0, -1)))
    assert "bake again" in baked.stale
    with pytest.raises(ValueError, match="bake again"):
        baked.update()


def test_changed_materials_need_no_new_links(ball):
    scene = pr.Scene()
    body = scene.add(ball, material=pr.Diffuse(0.5))
    floor = scene.add(pr.Plane((0, 0, -1), (0, 0, 1), color=0.5))
    scene.add_light(pr.SunLight((0, 0, -1), 1.0))
    baked = pr.bake(scene, pr.BakeSettings(noise=1.0, **FEW))
    scene.update(floor, material=pr.Diffuse((0.9, 0.1, 0.0)))
    scene.update(body, material=pr.Diffuse(0.2))
    assert "update" in baked.stale
    baked.update()
    assert baked.stale is None
    fresh = pr.bake(scene, pr.BakeSettings(noise=1.0, **FEW))
    assert baked.indirect(body) == pytest.approx(fresh.indirect(body), rel=1e-4, abs=1e-6)
    assert baked.indirect(body)[:, 2].max() < 1e-3 * baked.indirect(body)[:, 0].max()


def test_stale_light_is_never_shown_silently(ball):
    scene = pr.Scene()
    scene.add(ball)
    scene.add_light(pr.EnvironmentLight())
    scene.baked = pr.bake(scene, pr.BakeSettings(**FEW))
    camera = pr.frame(scene, size=(8, 8))
    pr.render(scene, camera, pr.Settings("baked"))
    scene.add(ball, pr.transform(translate=(3, 0, 0)))
    with pytest.warns(pr.StaleLightWarning, match="bake again"):
        pr.render(scene, camera, pr.Settings("baked"))
    pr.render(scene, camera, pr.Settings("baked"))  # once


def test_a_light_that_follows_the_camera_does_not_make_it_stale(ball):
    """Warnings are errors in tests."""
    scene = pr.Scene()
    scene.add(ball)
    scene.lights = [pr.SunLight((0, 0, -1)), pr.SunLight((0, 0, -1), camera=True)]
    scene.baked = pr.bake(scene, pr.BakeSettings(**FEW))
    lit = pr.render(scene, pr.frame(scene, size=(8, 8)), pr.Settings("baked"))
    scene.lights = scene.lights[:1]
    assert lit[..., :3].mean() > pr.render(scene, pr.frame(scene, size=(8, 8)), pr.Settings("baked"))[..., :3].mean()


def test_the_light_does_not_depend_on_threads(ball):
    scene = pr.Scene()
    scene.add(ball, material=pr.Diffuse(0.5))
    scene.add(pr.Plane((0, 0, -1), (0, 0, 1), color=0.5))
    scene.add_light(pr.EnvironmentLight(1.0, ground=0.2))
    one, three = (pr.bake(scene, pr.BakeSettings(threads=threads, **FEW)) for threads in (1, 3))
    assert (one.irradiance(0) == three.irradiance(0)).all()


def test_invalid_arguments_of_baking_are_refused(ball):
    with pytest.raises(ValueError, match="empty"):
        pr.bake(pr.Scene())
    with pytest.raises(ValueError, match="scene must be a Scene, a Model"):
        pr.bake(3)
    for bad in ({"links": 0}, {"noise": -0.1}, {"patches": 1}, {"memory": 0}, {"albedo_scale": 2.0}, {"seed": -1}):
        with pytest.raises(ValueError, match=next(iter(bad))):
            pr.BakeSettings(**bad)
    scene = pr.Scene()
    floor = scene.add(pr.Plane((0, 0, 0), (0, 0, 1)))
    with pytest.warns(UserWarning, match="no light"):
        baked = pr.bake(scene, pr.BakeSettings(**FEW))
    with pytest.raises(ValueError, match="id"):
        baked.irradiance(floor)
    ball_alone = pr.Scene()
    number = ball_alone.add(ball)
    ball_alone.add_light(pr.EnvironmentLight())
    with pytest.raises(ValueError, match="side"):
        pr.bake(ball_alone, pr.BakeSettings(**FEW)).irradiance(number, side=0)
    with pytest.raises(ValueError, match="baked"):
        scene.baked = 3


@pytest.mark.filterwarnings("ignore::pointray.StaleLightWarning")
def test_light_of_another_tree_is_never_used(ball):
    """If a model is replaced by a larger one, its records would be read out of bounds: it is dark instead."""
    scene = pr.Scene()
    scene.add(ball)
    scene.add(pr.Plane((0, 0, -1), (0, 0, 1)))
    scene.add_light(pr.EnvironmentLight())
    scene.baked = pr.bake(scene, pr.BakeSettings(links=4, patches=600))
    other = scene.exchange({ball: pr.Model(pr.procedural("sphere", 10_000))})
    rows, _ = scene.baked.tables(other.snapshot(), np.zeros(2, np.int64))
    rows = rows.reshape(2, -1)
    assert (rows[0, :3] == 0).all() and rows[1, 0] != 0
    camera = pr.frame(other, size=(16, 16))
    assert np.isfinite(pr.render(other, camera, pr.Settings("baked"))).all()


def test_a_small_sun_in_a_picture_of_the_sky_leaves_no_speckles():
    """Links would hit it by chance: four pixels contain two thirds of the light."""
    image = np.full((128, 256, 3), 0.3)
    image[40:42, 100:102] = 2_000.0
    theta = (np.arange(128) + 0.5) / 128 * np.pi
    weights = np.maximum(np.cos(theta), 0.0) * np.sin(theta) * (np.pi / 128) * (2 * np.pi / 256)
    exact = float((image[..., 0].sum(axis=1) * weights).sum())
    scene = pr.Scene()
    ground = scene.add(pr.Model(pr.Points(*_sheet(60, 1.0))), material=pr.Diffuse(0.0))
    scene.add_light(pr.EnvironmentLight(image=image))
    light = pr.bake(scene).irradiance(ground)[:, 0]
    assert light.std() / light.mean() < 0.02
    assert light.mean() == pytest.approx(exact, rel=0.02)


def test_lamps_block_light_from_behind():
    """A lamp with a black back that covers a glowing ceiling leaves the floor dark."""
    scene = pr.Scene()
    ground = scene.add(pr.Model(pr.Points(*_sheet(40, 0.2))), material=pr.Diffuse(0.0))
    scene.add(pr.Plane((0, 0, 2), (0, 0, -1)), material=pr.Emissive(1.0))
    open_light = pr.bake(scene).indirect(ground)[:, 0]
    assert open_light == pytest.approx(np.pi, rel=0.02)
    scene.add_light(pr.DiskLight((0, 0, 1.0), (0, 0, -1), 20.0, 0.0))
    hidden = pr.bake(scene).indirect(ground)[:, 0]
    assert hidden.max() < 0.05


def test_light_that_does_not_fit_is_refused(ball):
    scene = pr.Scene()
    scene.add(ball)
    scene.add_light(pr.EnvironmentLight())
    with pytest.raises(ValueError, match="memory"):
        pr.bake(scene, pr.BakeSettings(memory=1_000, patches=64, links=1, noise=1.0))
