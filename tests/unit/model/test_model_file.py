import json
import os
import subprocess
import sys

import numpy as np
import pytest

import pointray as pr
from helpers.places import TESTS, shared_model
from pointray.cli import execute
from pointray.engine.kernels.tree import BORDERED, LEAF, LONGEST, REFINE, SHEETED, STEP, SURFACE, Tree
from pointray.model.array_file import ALIGN
from pointray.model.model import PrebuiltModel


def cloud(rng, n):
    points = pr.procedural("torus", n)
    colors = rng.integers(0, 255, (n, 3), np.uint8)
    attributes = {"heat": rng.random(n), "flow": rng.random((n, 2))}
    world = points.positions + np.array([5e6, 0, 0])
    return pr.Points(world, points.normals, colors, attributes)


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    model = pr.Model(cloud(np.random.default_rng(5), 3000), refine=2)
    path = tmp_path_factory.mktemp("saved") / "torus.pointray"
    model.save(path)
    return model, path


def hits_of(model):
    scene = pr.Scene()
    scene.add(model)
    origins, directions = pr.Camera.frame(model.bounds, size=(24, 24)).rays()
    return scene.intersect(origins, directions, attributes=("heat", "flow"))


def test_a_loaded_model_equals_the_saved_one(saved):
    model, path = saved
    again = pr.Model.load(path)
    assert (again.surface, again.settings, again.nbytes) == (model.surface, model.settings, model.nbytes)
    assert np.array_equal(again.bounds, model.bounds) and np.array_equal(again.radii, model.radii)
    for name in ("positions", "origin", "normals", "colors"):
        assert np.array_equal(getattr(again.points, name), getattr(model.points, name))
    for one, other in zip(model.tree, again.tree, strict=True):
        assert one.dtype == other.dtype and np.array_equal(one, other, equal_nan=True)
    want, got = hits_of(model), hits_of(again)
    assert np.isfinite(want.t).any()
    for name in ("t", "position", "normal", "color", "point", "instance"):
        assert np.array_equal(getattr(want, name), getattr(got, name), equal_nan=True)
    for name, values in want.attributes.items():
        assert np.array_equal(values, got.attributes[name], equal_nan=True)


@pytest.mark.parametrize("options", [{"surface": "disc"}, {"surface": "paper", "trim": None}])
def test_models_of_all_kinds_are_saved_and_loaded(tmp_path, options):
    model = pr.Model(pr.procedural("sphere", 500).positions, **options)
    model.save(tmp_path / "m")
    again = pr.Model.load(tmp_path / "m")
    assert again.settings == model.settings
    assert again.points.normals is None and again.points.colors is None
    assert np.array_equal(again.tree.blocks, model.tree.blocks)


def test_a_loaded_model_is_saved_again_over_its_own_file(tmp_path, saved):
    path = tmp_path / "m"
    saved[0].save(path)
    shares = []
    again = pr.Model.load(path)
    again.save(path, lambda _, share: shares.append(share))
    assert path.read_bytes() == saved[1].read_bytes()
    assert shares == sorted(shares) and shares[-1] == 1.0
    assert os.listdir(tmp_path) == ["m"]


def test_writing_to_a_loaded_model_does_not_change_its_file(saved):
    before = saved[1].read_bytes()
    model = pr.Model.load(saved[1])
    model.radii[:] = 0
    model.tree.blocks[:] = 0
    assert saved[1].read_bytes() == before


def test_a_file_that_is_cut_off_is_an_error(tmp_path, saved):
    data = saved[1].read_bytes()
    for length in (0, 1, 5, 6, 60, 200, 1000, len(data) // 3, len(data) // 2, len(data) - ALIGN - 1, len(data) - 1):
        (tmp_path / "m").write_bytes(data[:length])
        with pytest.raises(ValueError, match="m: "):
            pr.Model.load(tmp_path / "m")


def test_other_files_are_an_error(tmp_path):
    with pytest.raises(OSError):
        pr.Model.load(tmp_path / "absent")
    np.save(tmp_path / "a.npy", np.arange(10))
    for content in (b"ply\nformat ascii 1.0\n" * 100, (tmp_path / "a.npy").read_bytes()):
        (tmp_path / "m").write_bytes(content)
        with pytest.raises(ValueError, match="not a saved model"):
            pr.Model.load(tmp_path / "m")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"version": 2', '"version": 9', "another version"),
        ('"pointray model"', '"mesh"', "not a saved model"),
        ('"tree.refs"', '"tree.rags"', "tree.refs is missing"),
        ('"surface": "apss"', '"surface": "none"', "settings"),
        ('"levels": []', '"levels": 17', "settings"),
        (', "levels": []', ',"levels":[{}]', "missing"),
    ],
)
def test_another_description_is_an_error(tmp_path, saved, old, new, message):
    data = saved[1].read_bytes()
    start = data.index(b"{", 80)
    end = start + json.JSONDecoder().raw_decode(data[start : start + 10_000].decode("latin-1"))[1]
    text = data[start:end].decode().replace(old, new)
    json.loads(text)
    assert len(text) <= end - start
    (tmp_path / "m").write_bytes(data[:start] + text.ljust(end - start).encode() + data[end:])
    with pytest.raises(ValueError, match=message):
        pr.Model.load(tmp_path / "m")


def damages():
    """Return changes that a wrong byte on the disk may cause: (array of the tree, function that changes it)."""

    def put(index, value):
        def change(array):
            array[index] = value

        return change

    def circle(array):
        array[np.flatnonzero(array >= 0)[0]] = 0

    def ghost(array):
        array[np.flatnonzero(array < 0)[0]] = -(2**31)

    return [
        ("children", put(0, 10**9)),
        ("children", put(0, -(10**9))),
        ("children", circle),
        ("children", ghost),
        ("refs", put(3, 10**8)),
        ("refs", put(3, -5)),
        ("spans", put(0, -1)),
        ("spans", put(1, 10**8)),
        ("order", put(0, 10**7)),
        ("order", put(0, -7)),
        ("head", put(SURFACE, 17.0)),
        ("head", put(REFINE, 1e30)),
        ("head", put(0, np.nan)),
        ("leaves", put(BORDERED, 1.0)),
        ("leaves", put(SHEETED, 1.0)),
        ("leaves", put(STEP, 0.0)),
    ]


@pytest.fixture(scope="module")
def leveled(tmp_path_factory):
    model = pr.Model(cloud(np.random.default_rng(6), 30_000))
    model.make_levels()
    path = tmp_path_factory.mktemp("leveled") / "torus.pointray"
    model.save(path)
    return model, path


def far_picture(model, **settings):
    scene = pr.Scene()
    scene.add(model, material=pr.Diffuse(pr.Attribute("heat")))
    near = pr.Camera.frame(model.bounds, size=(32, 32))
    eye = np.array(near.target) + 8 * (np.array(near.eye) - near.target)
    return pr.render(scene, pr.Camera.look_at(eye, near.target, size=(32, 32)), pr.Settings("color", **settings))


def test_levels_of_detail_are_saved_and_loaded(tmp_path, leveled):
    model, path = leveled
    again = pr.Model.load(path)
    assert len(again.levels) == len(model.levels) >= 2 and again.nbytes == model.nbytes
    for one, other in zip(model.levels, again.levels, strict=True):
        assert (one.settings, one.spacing, one.longest) == (other.settings, other.spacing, other.longest)
        assert np.array_equal(one.tree.blocks, other.tree.blocks)
    picture = far_picture(again)
    np.testing.assert_array_equal(picture, far_picture(model))
    assert np.abs(picture - far_picture(again, levels=False)).max() > 0
    again.save(tmp_path / "m")
    assert (tmp_path / "m").read_bytes() == path.read_bytes()


def test_an_old_file_without_levels_is_read(tmp_path, saved):
    """Older files did not keep levels."""
    data = saved[1].read_bytes()
    assert data.count(b', "levels": []') == 1
    (tmp_path / "m").write_bytes(data.replace(b', "levels": []', b" " * 14))
    assert pr.Model.load(tmp_path / "m").levels == ()


def test_a_damaged_level_is_an_error(tmp_path, leveled):
    model = pr.Model.load(leveled[1])
    model.levels[0].tree.refs[3] = 10**8
    model.save(tmp_path / "m")
    with pytest.raises(ValueError, match="damaged"):
        pr.Model.load(tmp_path / "m")
    model = pr.Model.load(leveled[1])
    del model.levels[0].points.attributes["heat"]
    model.save(tmp_path / "m")
    with pytest.raises(ValueError, match="different attributes"):
        pr.Model.load(tmp_path / "m")


@pytest.mark.parametrize(("name", "change"), damages())
def test_a_damaged_tree_is_an_error(tmp_path, saved, name, change):
    model = pr.Model.load(saved[1])
    array = getattr(model.tree, name)
    if name == "leaves":  # at a leaf that is not empty
        array = array[LEAF * int(np.flatnonzero(array[STEP::LEAF])[0]) :]
    change(array)
    model.save(tmp_path / "m")
    with pytest.raises(ValueError, match="damaged"):
        pr.Model.load(tmp_path / "m")


def test_random_damage_is_an_error_or_leads_no_ray_astray(tmp_path, saved, rng):
    data = np.frombuffer(saved[1].read_bytes(), np.uint8)
    loaded = 0
    for _ in range(60):
        broken = data.copy()
        at = rng.integers(0, len(data), 20)
        broken[at] = rng.integers(0, 256, len(at))
        (tmp_path / "m").write_bytes(broken.tobytes())
        try:
            model = pr.Model.load(tmp_path / "m")
        except ValueError:
            continue
        loaded += 1
        hits_of(model)
    assert loaded > 0


def test_bits_above_a_color_are_ignored(tmp_path, saved):
    model = pr.Model.load(saved[1])
    tree = model.tree._replace(colors=model.tree.colors | (1 << 30))
    PrebuiltModel(model.data._replace(tree=tree)).save(tmp_path / "m")
    assert np.array_equal(hits_of(pr.Model.load(tmp_path / "m")).color, hits_of(saved[0]).color)


def test_wrong_lengths_are_an_error(tmp_path, saved):
    for name in Tree._fields:
        model = pr.Model.load(saved[1])
        array = getattr(model.tree, name)
        if array.size:
            tree = model.tree._replace(**{name: array[:-1]})
            PrebuiltModel(model.data._replace(tree=tree)).save(tmp_path / "m")
            with pytest.raises(ValueError, match="damaged"):
                pr.Model.load(tmp_path / "m")


def test_the_command_line_saves_and_renders_models(tmp_path):
    scan, model, picture = (tmp_path / name for name in ("a.ply", "a.pointray", "a.png"))
    pr.write(scan, pr.procedural("torus", 2000))
    assert execute(["prepare", str(scan), "-o", str(model)]) == 0
    assert execute(["render", str(model), "-o", str(picture), "--size", "40x30", "--spp", "1"]) == 0
    assert picture.exists() and pr.Model.load(model).surface == "apss"


@pytest.mark.scans
def test_metadata_of_a_scan_is_saved_and_loaded(tmp_path):
    model = pr.Model(pr.read(shared_model("points/nefertiti_50k.ply")))
    model.save(tmp_path / "m")
    assert np.array_equal(pr.Model.load(tmp_path / "m").tree.leaves, model.tree.leaves)


def test_options_of_building_are_refused_for_saved_models(saved, tmp_path, capsys):
    for option in (["--surface", "disc"], ["--samples", "8"], ["--radius-scale", "2"]):
        assert execute(["render", str(saved[1]), "-o", str(tmp_path / "a.png"), *option]) == 2
        assert "part of a saved model" in capsys.readouterr().err
    assert not (tmp_path / "a.png").exists()


def test_an_invalid_model_is_reported_with_its_file(tmp_path, capsys):
    pr.write(tmp_path / "one.ply", pr.Points(np.zeros((1, 3)), np.float32([[0, 0, 1]])))
    assert execute(["prepare", str(tmp_path / "one.ply"), "-o", str(tmp_path / "one.pointray")]) == 2
    assert "one.ply: " in capsys.readouterr().err
    assert not (tmp_path / "one.pointray").exists()


@pytest.mark.long
def test_extreme_numbers_in_a_file_cause_no_invalid_memory_access(tmp_path):
    """This runs in its own process, which an invalid memory access may crash."""
    command = [sys.executable, str(TESTS / "helpers" / "model_extremes.py"), str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, f"exit status {done.returncode}: {done.stderr[-2000:]}"
    refused, loaded = map(int, done.stdout.split())
    assert refused > 1500 and loaded > 300


def test_a_span_whose_end_wraps_around_is_an_error(tmp_path, saved):
    model = pr.Model.load(saved[1])
    model.tree.spans[:2] = 2**31 - 1, 1
    model.save(tmp_path / "m")
    with pytest.raises(ValueError, match="span"):
        pr.Model.load(tmp_path / "m")


def test_a_model_saved_without_the_longest_step_is_the_same(tmp_path, saved):
    """Older files did not keep the longest step."""
    model = pr.Model.load(saved[1])
    model.tree.head[LONGEST] = 0.0
    model.save(tmp_path / "m")
    assert pr.Model.load(tmp_path / "m").tree.head[LONGEST] == saved[0].tree.head[LONGEST] > 0


def test_bounds_far_from_the_points_are_an_error(tmp_path, saved):
    """No camera could frame such bounds."""
    model = pr.Model.load(saved[1])
    model.data.bounds[1, 2] = 1e206
    model.save(tmp_path / "m")
    with pytest.raises(ValueError, match="bounds"):
        pr.Model.load(tmp_path / "m")
