"""`render`, `view`, `bake` and `frame` of scans, points, models and objects of other libraries."""

from __future__ import annotations

import time

import numpy as np
import pytest
from PIL import Image

import pointray as pr
from helpers.places import shared_model
from pointray.auto_view.default_scene import models_of
from pointray.cli import execute

SMALL = pr.Settings("phong", spp=1)


@pytest.fixture(scope="module")
def statue():
    return pr.procedural("statue", 4000)


@pytest.fixture(scope="module")
def scan(tmp_path_factory, statue):
    file = tmp_path_factory.mktemp("scan") / "statue.ply"
    pr.write(file, statue)
    return file


def pixels(file):
    return np.asarray(Image.open(file)).astype(int)


def written(image, folder):
    pr.write_image(folder / "api.png", image)
    return pixels(folder / "api.png")


@pytest.mark.slow
def test_render_of_a_file_is_the_picture_of_the_command(scan, statue, tmp_path, capsys):
    execute(["render", str(scan), "-o", str(tmp_path / "cli.png"), "--no-cache"])
    expected = pixels(tmp_path / "cli.png")
    image = pr.render(scan)
    assert image.shape == (600, 800, 4) and image.dtype == np.float32 and (image[..., 3] == 1).all()
    np.testing.assert_array_equal(written(image, tmp_path), expected)
    np.testing.assert_array_equal(pr.render(str(scan)), image)
    np.testing.assert_array_equal(pr.render(statue), image)
    assert (expected[0, 0] < expected[-1, 0]).all() and expected.std() > 20  # a gradient behind a statue


@pytest.mark.long
@pytest.mark.scans
@pytest.mark.parametrize("name", ["rgbd_kinect_chair_rgb", "sfm_garden_rgb_nonormals"])
@pytest.mark.filterwarnings("ignore")
def test_render_of_real_scans_is_the_picture_of_the_command(name, tmp_path, capsys):
    """One-sided, from above, with strays: view, light, back faces and exposure are chosen alike."""
    file = shared_model(f"points/{name}.ply")
    execute(["render", str(file), "-o", str(tmp_path / "cli.png"), "--no-cache"])
    np.testing.assert_array_equal(written(pr.render(file), tmp_path), pixels(tmp_path / "cli.png"))


def test_settings_and_camera_may_be_given(statue):
    camera = pr.frame(statue, view="left", size=(40, 30))
    image = pr.render(statue, camera, SMALL)
    assert image.shape == (30, 40, 4)
    depth = pr.render(statue, camera, pr.Settings("depth"))
    assert np.abs(depth - image).max() > 0.1
    seen = []
    pr.render(statue, camera, SMALL, progress=lambda stage, share: seen.append(stage))
    assert seen[0] == "normals" and seen[-1] == "rendering"


def test_a_scene_gets_the_automatic_camera(statue):
    scene = pr.Scene()
    scene.add(pr.Model(statue))
    np.testing.assert_array_equal(pr.render(scene, settings=SMALL), pr.render(scene, pr.frame(scene), SMALL))


def test_models_points_files_and_other_objects_give_the_same_picture(scan, statue, tmp_path):
    camera = pr.frame(statue, size=(40, 30))
    expected = pr.render(statue, camera, SMALL)
    model = pr.Model(statue)
    model.save(tmp_path / "a.pointray")
    things = [scan, [scan], model, tmp_path / "a.pointray", statue.to_structured(), [statue], [model]]
    for thing in things:
        np.testing.assert_array_equal(pr.render(thing, camera, SMALL), expected, str(type(thing)))
    open3d = pytest.importorskip("open3d", exc_type=ImportError)
    cloud = open3d.t.geometry.PointCloud(open3d.core.Tensor.from_numpy(statue.world))
    assert np.abs(pr.render(cloud, camera, SMALL) - expected).mean() < 0.2


def test_lists_hold_several_models(scan, statue):
    other = pr.Points(statue.world + [5, 0, 0], statue.normals)
    pr.write(scan.with_name("other.ply"), statue)
    assert len(models_of([scan, scan.with_name("other.ply")], "scene")) == 1  # files of one cloud
    assert [len(model.points) for model in models_of([statue, scan, other], "scene")] == [4000] * 3
    assert len(models_of(statue.world.tolist()[:500], "scene")) == len(models_of([*statue.world[:500]], "scene")) == 1
    assert len(models_of([statue.world[:500], other.world[:500]], "scene")) == 2
    both, one = pr.render([statue, other], settings=SMALL), pr.render(statue, settings=SMALL)
    assert both.shape == one.shape and np.abs(both - one).max() > 0.1


def test_a_folder_stands_for_the_scans_in_it(statue, tmp_path):
    camera = pr.frame(statue, size=(40, 30))
    pr.write(tmp_path / "a.ply", statue)
    np.testing.assert_array_equal(pr.render(tmp_path, camera, SMALL), pr.render(statue, camera, SMALL))


@pytest.mark.parametrize("function", [pr.render, pr.view])
def test_the_wrong_element_of_a_list_is_named(function, statue):
    for wrong in (5, None, pr.Scene()):
        with pytest.raises(TypeError, match=r"^scene\[1\] must be a Scene, a Model, Points"):
            function([statue, wrong])


def test_bake_and_frame_take_the_same_things(statue):
    baked = pr.bake(statue.to_structured(), pr.BakeSettings(links=4, patches=256))
    assert baked.irradiance(0).shape == (4000, 3) and baked.irradiance(0).max() > 0.1
    assert pr.frame(statue.world) == pr.frame(pr.Points(statue.world))


@pytest.mark.parametrize("thing", [None, 3, object(), [object()], {1}])
@pytest.mark.parametrize("function", [pr.render, pr.view, pr.bake])
def test_other_objects_are_refused(function, thing):
    with pytest.raises((TypeError, ValueError), match=r"^scene(:| must be a Scene, a Model, Points, a path)"):
        function(thing)


@pytest.mark.parametrize("function", [pr.render, pr.view, pr.bake])
def test_missing_and_wrong_files_are_named(function, tmp_path):
    with pytest.raises(OSError, match="absent.laz"):
        function(tmp_path / "absent.laz")
    (tmp_path / "a.ply").write_text("this text is not a PLY file")
    with pytest.raises(ValueError, match="a.ply"):
        function(tmp_path / "a.ply")
    with pytest.raises(ValueError, match="invalid colours"):
        function({"x": np.arange(3.0), "y": np.arange(3.0), "z": np.arange(3.0), "colors": np.full((3, 3), -9.0)})


def test_options_are_checked_before_files_are_read(tmp_path):
    for wrong in ({"camera": 3}, {"settings": 3}, {"progress": 3}, {"spread": 3}):
        with pytest.raises(ValueError, match=next(iter(wrong))):
            pr.render(tmp_path / "absent.laz", **wrong)


def loaded(thing, **options):
    """Show a thing in a viewer, wait until it is loaded, and return the scene that browsers show."""
    viewer = pr.view(thing, open_browser=False, block=False, **options)
    shared, end = viewer._sessions._shared, time.monotonic() + 120
    while not shared.problem and (shared.scene is None or shared.is_coarse or shared.is_building):
        assert time.monotonic() < end
        time.sleep(0.02)
    viewer.close()
    assert shared.problem == ""
    return shared


def test_view_of_points_files_and_models(scan, statue, tmp_path, capsys):
    pr.Model(statue).save(tmp_path / "a.pointray")
    for thing in (scan, statue, tmp_path / "a.pointray", [statue, statue.to_structured()]):
        shared = loaded(thing)
        assert len(shared.scene.models) == (2 if isinstance(thing, list) else 1)
        assert shared.settings.integrator == "baked" and shared.exposes and shared.look == "studio"
        assert len(shared.scene.lights) == 3 and np.allclose(shared.up, (0, 0, 1))
    assert loaded(scan, up="-y").up == (0, -1, 0)


def test_a_scene_file_is_shown_but_not_rendered(scan, tmp_path, capsys):
    file = tmp_path / "a.toml"
    file.write_text(
        f'[camera]\neye = [0, -4, 0]\ntarget = [0, 0, 0]\n[models.a]\nfile = "{scan}"\n[[instances]]\nmodel = "a"\n'
    )
    assert len(loaded(file).scene.models) == 1
    with pytest.raises(ValueError, match="a.toml: a scene file: pass .* of `load_scene`"):
        pr.render(file)


def test_prepare_takes_points_in_memory(statue, tmp_path):
    rows = statue.to_structured()
    assert pr.prepare(rows, tmp_path / "a.pointray").points == 4000
    assert pr.prepare(rows, tmp_path / "a.ply", every=4).points == 1000
    assert pr.prepare(statue, f"{tmp_path}/parts.pointray/").parts == 1
    box = pr.read(tmp_path / "a.ply").bounds
    half = pr.prepare(statue, tmp_path / "b.ply", bounds=[box[0], box.mean(axis=0)]).points
    assert 0 < half < 2000
    with pytest.raises(ValueError, match="points: contains no selected points"):
        pr.prepare(statue, tmp_path / "c.ply", bounds=[[9, 9, 9], [10, 10, 10]])
