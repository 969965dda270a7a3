"""Muted back faces, compared with NumPy; and where they are not muted."""

from dataclasses import replace

import numpy as np
import pytest

import pointray as pr
from pointray.auto_view.fronts import shows_backs
from pointray.cli import execute
from pointray.engine.kernels.vec import LUMINANCE
from pointray.rendering import picture
from pointray.shade.backfaces import EDGE_LEVEL, LEVEL, SATURATION
from pointray.shade.environment import harmonics

COLOR = np.array([0.7, 0.4, 0.2])
CAMERA = pr.Camera.look_at((0.8, -2.6, 1.6), (0, 0, -0.3), size=(24, 24))
BOTH = pytest.mark.parametrize("integrator", ["phong", "baked"])


@pytest.fixture(scope="module")
def bowl():
    """Return the lower half of a sphere with outward normals; from above mostly its inner side is visible."""
    points = pr.procedural("sphere", 6_000)
    return pr.Model(points.select(points.positions[:, 2] < 0.1))


def scene_of(model, lights, material=None):
    scene = pr.Scene()
    scene.add(model, material=material or pr.Diffuse(COLOR))
    scene.lights = lights
    return scene


def pictures(scene, integrator):
    if integrator == "baked":
        scene.baked = pr.bake(scene, pr.BakeSettings(patches=512, links=4, noise=1.0))
    settings = pr.Settings(integrator, levels=False)
    return [pr.render(scene, CAMERA, replace(settings, backfaces=b)) for b in ("same", "muted")]


def backs_of(scene):
    """Return hits of rays through pixel centres, which are on back faces, and their cosines."""
    origins, directions = CAMERA.rays()
    hits = scene.intersect(origins, directions)
    cosine = (hits.normal * directions).sum(axis=-1)
    return hits, np.isfinite(hits.t) & (cosine > 0), cosine


def toned(light):
    """The muted colour under light, (...,), of a white surface."""
    grey = COLOR @ LUMINANCE
    return (SATURATION * COLOR + (1 - SATURATION) * grey) * light[..., None]


@BOTH
def test_muted_back_faces_are_lit_by_the_sky_only(bowl, integrator):
    sky = pr.EnvironmentLight(0.8, horizon=0.5, ground=0.2)
    scene = scene_of(bowl, [pr.SunLight((0.3, 0.2, -1)), sky])
    same, muted = pictures(scene, integrator)
    hits, back, cosine = backs_of(scene)
    assert 100 < back.sum() < 0.9 * np.isfinite(hits.t).sum()
    # The normal is turned towards the camera.
    irradiance = harmonics(-hits.normal[back].astype(float)).T @ sky.tables()[4].reshape(9, 3)
    expected = toned(irradiance @ LUMINANCE / np.pi * (EDGE_LEVEL + (LEVEL - EDGE_LEVEL) * cosine[back]))
    np.testing.assert_allclose(muted[back][:, :3], expected, rtol=2e-3, atol=1e-4)
    np.testing.assert_array_equal(muted[~back], same[~back])
    assert np.abs(muted[back] - same[back]).max() > 0.1
    assert (muted[..., 3] == same[..., 3]).all()


def test_without_lights_the_headlight_lights_them(bowl):
    scene = scene_of(bowl, [])
    _, muted = pictures(scene, "phong")
    _, back, cosine = backs_of(scene)
    expected = toned(EDGE_LEVEL + (LEVEL - EDGE_LEVEL) * cosine[back])
    np.testing.assert_allclose(muted[back][:, :3], expected, rtol=2e-3, atol=1e-4)


@pytest.mark.parametrize(
    ("lights", "material"),
    [
        ([pr.PointLight((0, 0, 3), 10.0)], None),  # the level of even light is undefined
        ([pr.EnvironmentLight()], pr.Dielectric()),
        ([pr.EnvironmentLight()], pr.Mirror()),
    ],
)
def test_some_back_faces_are_not_muted(bowl, lights, material):
    np.testing.assert_array_equal(*pictures(scene_of(bowl, lights, material), "phong"))


@pytest.mark.parametrize("integrator", ["path", "ao", "normal", "color"])
def test_other_integrators_have_no_muted_faces(bowl, integrator):
    np.testing.assert_array_equal(*pictures(scene_of(bowl, [pr.EnvironmentLight()]), integrator))


def test_planes_are_not_muted(bowl):
    scene = scene_of(bowl, [pr.EnvironmentLight()])
    scene.add(pr.Plane((0, 0, 3), (0, 0, 1)))  # seen from below
    below = pr.Camera.look_at((0, -3, 1), (0, 0, 3), size=(8, 8))
    settings = pr.Settings(backfaces="muted")
    np.testing.assert_array_equal(*(pr.render(scene, below, s) for s in (pr.Settings(), settings)))


def test_views_of_many_back_faces_are_detected(bowl):
    scene = scene_of(bowl, [])
    assert shows_backs(scene, CAMERA)
    assert not shows_backs(scene, pr.frame(scene, up="z", elevation=-30, azimuth=0))
    assert not shows_backs(scene, pr.Camera.look_at((0, 0, 9), (0, 0, 20)))  # nothing is seen


@pytest.mark.parametrize("value", ["black", None, 1])
def test_unknown_backfaces_are_refused(value):
    with pytest.raises(ValueError, match="unknown backfaces"):
        pr.Settings(backfaces=value)


@pytest.mark.parametrize(
    ("options", "shown"),
    [
        ([], "muted"),
        (["--backfaces", "same"], "same"),
        (["--elevation", "60"], "same"),
        (["--elevation", "60", "--backfaces", "muted"], "muted"),
    ],
)
def test_commands_mute_back_faces_unless_there_are_many(bowl, tmp_path, monkeypatch, options, shown):
    """The bowl shows its front from below, its back from above. Explicit options are kept."""
    asked, real = [], picture.render

    def render(scene, camera, settings, *more):
        asked.append(settings.backfaces)
        return real(scene, camera, settings, *more)

    monkeypatch.setattr(picture, "render", render)
    pr.write(tmp_path / "bowl.ply", bowl.points)
    small = ["--size", "24x18", "--up", "z", "--view", "bottom", "--light", "headlight"]
    assert execute(["render", str(tmp_path / "bowl.ply"), "-o", str(tmp_path / "a.png"), *small, *options]) == 0
    assert asked == [shown]
