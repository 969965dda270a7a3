"""Tiles without a visible model are not traced, which does not change pictures."""

import numpy as np
import pytest

import pointray as pr
from pointray.rendering import plan
from pointray.rendering.window import EVERYWHERE, window_of

CAMERA = {"eye": (3, -7, 2.5), "target": (0.4, 0, 0.3), "size": (203, 117)}


@pytest.fixture(scope="module")
def model():
    return pr.Model(pr.procedural("torus", 4000))


def scene_of(model):
    scene = pr.Scene()
    scene.add(model, material=pr.Phong((0.8, 0.5, 0.2)))
    scene.add_light(pr.PointLight((2, -3, 5), 30))
    return scene


def both(scene, camera, settings, monkeypatch):
    """Return the picture, and the picture with all tiles traced."""
    image = pr.render(scene, camera, settings)
    with monkeypatch.context() as patch:
        patch.setattr(plan, "window_of", lambda camera, top: EVERYWHERE)
        return image, pr.render(scene, camera, settings)


@pytest.mark.parametrize("background", [None, (0.2, 0.4, 0.7)])
@pytest.mark.parametrize("integrator", ["phong", "ao", "path", "normal", "depth", "color", "cost"])
def test_skipping_tiles_does_not_change_pictures(model, integrator, background, monkeypatch):
    scene = scene_of(model)
    scene.background = background
    for projection, change in (("perspective", {}), ("orthographic", {}), ("perspective", {"eye": (0.2, 0.1, 0.1)})):
        camera = pr.Camera.look_at(**CAMERA | {"size": (107, 61)} | change, projection=projection, fov=35)
        one, whole = both(scene, camera, pr.Settings(integrator, spp=2), monkeypatch)
        assert np.array_equal(one, whole)


@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
def test_the_window_fits_the_model_tightly(model, projection):
    """The window exceeds the model by at most a tile."""
    scene, camera = scene_of(model), pr.Camera.look_at(**CAMERA, projection=projection, fov=35)
    left, top, right, bottom = window_of(camera, scene.snapshot().world.top)
    rows, columns = np.nonzero(np.isfinite(scene.intersect(*camera.rays()).t))
    assert left < columns.min() and columns.max() + 1 < right and top < rows.min() and rows.max() + 1 < bottom
    assert columns.min() - left < 30 and right - columns.max() < 30
    assert rows.min() - top < 30 and bottom - rows.max() < 30


def test_no_tile_is_skipped_where_a_model_may_be_visible(model):
    top = scene_of(model).snapshot().world.top
    assert window_of(pr.Camera.look_at(**CAMERA, projection="panorama"), top) == EVERYWHERE
    assert window_of(pr.Camera.look_at(**CAMERA, aperture=0.3), top) == EVERYWHERE
    assert window_of(pr.Camera.look_at((0.2, 0.1, 0.1), (1, 0, 0)), top) == EVERYWHERE


def test_other_objects_are_visible_outside_the_window(model, monkeypatch):
    """Planes, lights that paths hit, and the sky are visible; an empty scene is background."""
    camera = pr.Camera.look_at(**CAMERA)
    plane, lamp, sky = scene_of(model), scene_of(model), scene_of(model)
    plane.add(pr.Plane((0, 0, -0.5), (0, 0, 1)))
    origins, directions = camera.rays()
    lamp.add_light(pr.SphereLight(origins[15, 20] + 10 * directions[15, 20], 0.3, 9))
    sky.add_light(pr.EnvironmentLight())
    sky.background = "environment"
    for scene in (plane, lamp, sky):
        one, whole = both(scene, camera, pr.Settings("path", spp=1), monkeypatch)
        assert np.array_equal(one, whole) and one[:, :40, :3].sum() > 0.0
    empty = pr.Scene()
    empty.background = (0.1, 0.2, 0.3)
    assert np.allclose(pr.render(empty, camera), (0.1, 0.2, 0.3, 1.0))
