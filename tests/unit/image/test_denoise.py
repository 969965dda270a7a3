"""Denoising: errors decrease, coverage is kept, and a missing package is reported."""

import sys

import numpy as np
import pytest

import pointray as pr
from pointray.cli import execute


def stage(points, size):
    """A body on a floor below a lamp, and a camera."""
    scene = pr.Scene()
    scene.add(pr.Model(points))
    scene.add(pr.Plane(scene.bounds[0], (0, 0, 1), 0.7))
    scene.add_light(pr.SphereLight((2, -3, 4), 0.8, 30))
    return scene, pr.Camera.frame(scene.bounds, size=size)


@pytest.fixture(scope="module")
def small_stage():
    return stage(pr.procedural("sphere", 3_000), (80, 60))


def picture(stage, **options):
    return pr.render(*stage, pr.Settings(integrator="path", **options))


@pytest.mark.long
def test_denoising_reduces_the_error():
    pytest.importorskip("pyoidn")
    statue = stage(pr.procedural("statue", 20_000), (160, 120))
    exact = picture(statue, spp=256)
    noisy, clean = picture(statue, spp=4, seed=1), picture(statue, spp=4, seed=1, denoise=True)
    errors = [np.sqrt(((image - exact)[..., :3] ** 2).mean()) for image in (noisy, clean)]
    assert errors[1] < 0.7 * errors[0]  # 0.60 to 0.66 with four seeds
    assert np.array_equal(noisy[..., 3], clean[..., 3])
    assert clean[..., :3].mean() == pytest.approx(noisy[..., :3].mean(), rel=0.02)
    assert (clean >= 0).all() and clean.dtype == np.float32


def test_pictures_without_noise_are_not_changed(small_stage):
    phong = [pr.render(*small_stage, pr.Settings(spp=2, denoise=denoise)) for denoise in (False, True)]
    assert np.array_equal(*phong)


@pytest.mark.parametrize("integrator", ["path", "ao"])
def test_pixels_without_noise_are_not_changed(integrator):
    """Background, sky and a surface of constant light in all samples keep their last bit."""
    pytest.importorskip("pyoidn")
    scene = pr.Scene()
    ball = pr.Model(pr.procedural("sphere", 3_000))
    scene.add(ball)
    scene.add(ball, pr.transform((3, 0, 0)), pr.Emissive((0.3, 0.6, 0.9)))
    scene.background = (0.3, 0.31, 0.33)
    camera = pr.Camera.frame(scene.bounds, size=(80, 45))
    for sky in (False, True):
        if sky:
            rows = np.linspace(0.2, 1.0, 64)[:, None, None]
            scene.background = None
            scene.add_light(pr.EnvironmentLight(image=np.broadcast_to(rows, (64, 128, 3)).astype(np.float32)))
        options = {"integrator": integrator, "spp": 8, "seed": 3}
        noisy, clean = (pr.render(scene, camera, pr.Settings(denoise=on, **options)) for on in (False, True))
        alone = pr.Scene()
        for instance, shift in ((ball, (0, 0, 0)), (ball, (3, 0, 0))):
            alone.add(instance, pr.transform(shift))
        surfaces = pr.render(alone, camera, pr.Settings(integrator="color", spp=8, seed=3))[..., 3]
        beside = surfaces == 0
        assert beside.mean() > 0.3 and np.array_equal(clean[beside], noisy[beside])
        if integrator == "path":
            same = np.abs(noisy[..., :3] - (0.3, 0.6, 0.9)).max(axis=-1) < 1e-6
            assert same.mean() > 0.05 and np.array_equal(clean[same], noisy[same])
        assert (clean[surfaces == 1] != noisy[surfaces == 1]).any()


def test_a_missing_denoiser_is_reported(small_stage, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyoidn", None)
    with pytest.raises(ValueError, match=r"pip install 'pointray\[denoise\]'"):
        picture(small_stage, denoise=True, spp=65536)  # the message comes before the work begins


@pytest.mark.parametrize("command", ["render -o out.png", "animate -o film"])
@pytest.mark.parametrize("file", ["scan.ply", "scene.toml"])
def test_commands_report_a_missing_denoiser_first(tmp_path, monkeypatch, capsys, command, file):
    """The message comes before the scan is read and anything is written."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, "pyoidn", None)
    (tmp_path / "scan.ply").write_text("no points")
    (tmp_path / "scene.toml").write_text('[models.a]\nfile = "scan.ply"\n[[instances]]\nmodel = "a"\n')
    name, *output = command.split()
    assert execute([name, file, *output, "--denoise", "--integrator", "path"]) == 2
    printed = capsys.readouterr().err
    assert "pointray[denoise]" in printed and len(printed.splitlines()) == 1
    assert {path.name for path in tmp_path.iterdir()} == {"scan.ply", "scene.toml"}
    assert execute([name, file, *output, "--denoise"]) == 2  # without noise the scan is read, and bad
    assert "pointray[denoise]" not in capsys.readouterr().err
