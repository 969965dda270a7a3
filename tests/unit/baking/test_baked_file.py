"""Files of baked light: what is saved is loaded, and damage, other scenes and failing disks do no harm."""

import json
import mmap
import os
import subprocess
import sys
from itertools import pairwise

import numpy as np
import pytest

import pointray as pr
from helpers.baked_room import COLORS, QUICK, SKY, SUN, ball, plain_ball, room
from helpers.model_bytes import copied, join, split
from helpers.places import TESTS
from pointray.model import array_file


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    baked = pr.bake(room(), QUICK)
    path = tmp_path_factory.mktemp("baked") / "room.bake"
    baked.save(path)
    return baked, path


@pytest.fixture
def parts(saved):
    """The parts of the file, as copies to change."""
    return copied(split(saved[1].read_bytes()))


def picture(scene, baked, size=32, distance=1.0, **settings):
    scene.baked = baked
    near = pr.Camera.frame(scene.bounds, size=(size, size))
    eye = np.array(near.target) + distance * (np.array(near.eye) - near.target)
    camera = pr.Camera.look_at(eye, near.target, size=(size, size))
    return pr.render(scene, camera, pr.Settings("baked", spp=2, **settings))


def refused(path, scene=None):
    """Return the error of a refused file, checked to be one line with its name and what to do."""
    with pytest.raises(ValueError) as error:
        pr.Baked.load(path, scene or room())
    told = str(error.value)
    assert "\n" not in told and told.startswith(f"{path}: ") and told.endswith(": bake again")
    return told.removeprefix(f"{path}: ").removesuffix(": bake again")


# ------------------------------------------------------------------------------------------------- what comes back


def close(got, want):
    """Return whether light differs by at most 1/256 of the brightest channel."""
    return (np.abs(got - want) <= want.max(axis=1, keepdims=True) / 256).all()


def test_saved_light_is_loaded(saved):
    baked, path = saved
    scene = room()
    again = pr.Baked.load(path, scene)
    assert again.stale is None and again.nbytes == baked.nbytes > 0 and "from a file" in repr(again)
    np.testing.assert_array_equal(picture(scene, again), picture(room(), baked))
    assert picture(scene, again).std() > 0.1
    for id in (0, 2):
        assert close(again.irradiance(id), baked.irradiance(id)) and close(again.indirect(id), baked.indirect(id))
        np.testing.assert_allclose(again.ambient_occlusion(id), baked.ambient_occlusion(id), rtol=0, atol=1e-5)
        assert baked.ambient_occlusion(id).std() > 0.1
    with pytest.raises(ValueError, match="id"):
        again.irradiance(1)


@pytest.fixture(scope="module")
def leveled():
    model = pr.Model(pr.procedural("torus", 12_000))
    model.make_levels()
    return model


def test_levels_of_detail_are_saved_and_loaded(tmp_path, leveled):
    scene = room(leveled)
    baked = pr.bake(scene, QUICK)
    baked.save(tmp_path / "a")
    again = pr.Baked.load(tmp_path / "a", scene)
    assert len(leveled.levels) >= 1
    far = picture(scene, again, distance=10.0)
    np.testing.assert_array_equal(far, picture(scene, baked, distance=10.0))
    assert np.abs(far - picture(scene, again, distance=10.0, levels=False)).max() > 0


def test_light_is_valid_for_saved_and_loaded_models(tmp_path, saved):
    plain_ball().save(tmp_path / "m")
    scene = room(pr.Model.load(tmp_path / "m"))
    again = pr.Baked.load(saved[1], scene)
    assert again.stale is None
    np.testing.assert_array_equal(picture(scene, again), picture(room(), saved[0]))


def test_instances_are_matched_by_order(saved):
    scene, places = pr.Scene(), (None, None, pr.transform(translate=(2.5, 0, 0), scale=0.8), None)
    scene.remove(scene.add(plain_ball()))
    for shape, place in zip(room().shapes.values(), places, strict=True):
        scene.add(shape, place)
    scene.clips, scene.lights = room().clips, room().lights
    again = pr.Baked.load(saved[1], scene)
    assert close(again.irradiance(3), saved[0].irradiance(2))
    np.testing.assert_array_equal(picture(scene, again), picture(room(), saved[0]))


def test_settings_except_threads_are_saved(tmp_path):
    settings = pr.BakeSettings(links=2, patches=64, noise=2.0, max_depth=3, memory=10**9, albedo_scale=0.5, seed=7)
    pr.bake(room(), pr.BakeSettings(**{**vars(settings), "threads": 1})).save(tmp_path / "a")
    assert pr.Baked.load(tmp_path / "a", room())._settings == settings


def test_light_is_memory_mapped(saved, monkeypatch):
    """No array is copied, and writing to an array does not change the file."""
    monkeypatch.setattr(array_file, "SMALL", 0)
    before = saved[1].read_bytes()
    again = pr.Baked.load(saved[1], room())
    arrays = [*again._kept.records.values(), *again._stored.skies.values()]
    assert len(arrays) >= 6 and sum(array.nbytes for array in arrays) > 0.8 * len(before)
    for array in arrays:
        memory = array
        while isinstance(memory, np.ndarray):
            assert not memory.flags.owndata
            memory = memory.base
        assert isinstance(memory, mmap.mmap) or isinstance(memory.obj, mmap.mmap)
        array[:] = 0
    assert saved[1].read_bytes() == before


def test_loaded_light_is_saved_again_over_its_own_file(tmp_path, saved):
    path = tmp_path / "a"
    saved[0].save(path)
    shares = []
    scene = room(lights=[SKY])
    again = pr.Baked.load(path, scene)
    again.save(path, lambda _, share: shares.append(share))
    assert path.read_bytes() == saved[1].read_bytes()
    assert shares == sorted(shares) and shares[-1] == 1.0
    assert os.listdir(tmp_path) == ["a"]


# ------------------------------------------------------------------------------------------------- other scenes


def normals_up():
    normals = pr.procedural("sphere", 2000).normals.copy()
    normals[0] = 0.0, 0.6, 0.8
    return normals


def without_last(scene):
    scene.remove(3)
    return scene


def swapped():
    scene = room()
    scene.remove(0)
    scene.add(plain_ball())
    return scene


@pytest.mark.parametrize(
    ("scene", "words"),
    [
        (lambda: without_last(room()), "4 instances were baked, this scene has 3"),
        (pr.Scene, "4 instances were baked, this scene has 0"),
        (lambda: room(ball(size=1.0001)), "instance 0 differs in its points"),
        (lambda: room(ball(normals=normals_up())), "instance 0 differs in its points"),
        (lambda: room(ball(radius_scale=1.01)), "instance 0 differs in its radii"),
        (lambda: room(ball(surface="imls")), "instance 0 differs in its surface"),
        (lambda: room(ball(samples=5)), "instance 0 differs in its surface"),
        (lambda: room(place=pr.transform(translate=(2.5, 0, 1e-3), scale=0.8)), "instance 2 differs in its transform"),
        (lambda: room(floor=(0, 0, -1.001)), "instance 1 differs in its place"),
        (lambda: room(catcher=True), "instance 1 differs in its kind"),
        (swapped, "instance 1 differs in its kind"),
        (lambda: room(clips=()), "its clip planes differ"),
        (lambda: room(clips=[((0, 0, 2.9), (0, 0, 1))]), "its clip planes differ"),
    ],
)
def test_the_light_of_another_scene_is_refused_with_the_reason(saved, scene, words):
    assert refused(saved[1], scene()) == f"the light belongs to another scene: {words}"


def test_scenes_with_other_levels_of_detail_are_refused(tmp_path, leveled):
    pr.bake(room(leveled), QUICK).save(tmp_path / "a")
    bare = pr.Model(leveled.points)
    assert refused(tmp_path / "a", room(bare)).endswith("instance 0 differs in its levels of detail")


def test_levels_made_after_the_bake_have_no_light(tmp_path):
    model = pr.Model(pr.procedural("torus", 12_000))
    baked = pr.bake(room(model), QUICK)
    model.make_levels()
    assert "bake again" in baked.stale
    with pytest.raises(ValueError, match="levels"):
        baked.save(tmp_path / "a")
    assert os.listdir(tmp_path) == []


def test_an_update_lights_levels_made_after_the_bake(tmp_path):
    model = pr.Model(pr.procedural("torus", 12_000))
    scene = room(model)
    baked = pr.bake(scene, QUICK)
    model.make_levels()
    assert baked.lacks_levels(scene) and not pr.bake(scene, QUICK).lacks_levels(scene)
    before = picture(scene, baked, distance=10.0, levels=False)  # no warning: what is shown has light
    with pytest.warns(pr.StaleLightWarning, match="levels"):
        dark = picture(scene, baked, distance=10.0)
    baked.update()
    assert baked.stale is None
    after = picture(scene, baked, distance=10.0)
    assert np.abs(after - dark).max() > 0.05 and np.abs(after - before).max() < 0.3
    assert after == pytest.approx(picture(scene, pr.bake(scene, QUICK), distance=10.0), rel=1e-4)
    baked.save(tmp_path / "a")


@pytest.mark.parametrize(
    "scene",
    [
        lambda: room(lights=[SKY]),
        lambda: room(lights=[pr.EnvironmentLight(1.1, ground=0.3), SUN]),
        lambda: room(albedo=0.3),
        lambda: room(ball(colors=255 - COLORS)),
    ],
    ids=["lights", "sky", "material", "colors"],
)
def test_other_lights_materials_and_colors_make_light_stale(saved, scene):
    scene = scene()
    again = pr.Baked.load(saved[1], scene)
    assert "update" in again.stale
    with pytest.warns(pr.StaleLightWarning):
        picture(scene, again)
    again.update()
    fresh = pr.bake(scene, QUICK)
    assert again.stale is None and "patches" in repr(again)
    np.testing.assert_array_equal(again.irradiance(0), fresh.irradiance(0))
    np.testing.assert_array_equal(picture(scene, again), picture(scene, fresh))


def test_light_that_follows_the_camera_is_not_baked(saved):
    lamp = pr.SunLight((0, 0, -1), 1.0, camera=True)
    assert pr.Baked.load(saved[1], room(lights=[SKY, SUN, lamp])).stale is None


def test_a_scene_that_changes_later_makes_light_stale(saved):
    scene = room()
    again = pr.Baked.load(saved[1], scene)
    scene.lights = [SKY]
    assert "update" in again.stale
    scene.lights = [SKY, SUN]
    assert again.stale is None
    scene.update(0, transform=pr.transform(translate=(0, 0, 1)))
    assert "bake again" in again.stale
    with pytest.raises(ValueError, match="bake again"):
        again.update()


def test_the_file_describes_the_scene_that_was_baked(tmp_path):
    """Later changes of the scene do not matter."""
    scene = room()
    baked = pr.bake(scene, QUICK)
    scene.lights = [SKY]
    scene.update(0, transform=pr.transform(translate=(0, 0, 1)))
    baked.save(tmp_path / "a")
    assert pr.Baked.load(tmp_path / "a", room()).stale is None
    assert "transform" in refused(tmp_path / "a", scene)


# ------------------------------------------------------------------------------------------------- hostile files


def boundaries(data):
    """Return the offsets of the header, contents and padding of each array."""
    out, at = [0], 0
    while (at := data.find(b"\x93NUMPY", at)) >= 0:
        contents = at + 10 + int.from_bytes(data[at + 8 : at + 10], "little")
        out += [at, contents]
        at = contents
    return [*out, len(data) - 64]


def test_a_file_that_is_cut_off_is_refused(tmp_path, saved):
    data = saved[1].read_bytes()
    edges = boundaries(data)
    assert len(edges) == 2 + 2 * 7
    middle = [(a + b) // 2 for a, b in pairwise(edges)]
    near = [edge + step for edge in edges for step in (-1, 0, 1)]
    for length in {0, 5, 6, 9, len(data) - 1, *near, *middle}:
        if 0 <= length < len(data):
            (tmp_path / "a").write_bytes(data[:length])
            assert "a: " not in refused(tmp_path / "a")


def test_other_files_are_refused(tmp_path):
    for path in (tmp_path / "absent", tmp_path):
        with pytest.raises(OSError):
            pr.Baked.load(path, room())
    np.save(tmp_path / "a.npy", np.arange(10))
    plain_ball().save(tmp_path / "m")
    for content in (b"ply\nformat ascii 1.0\n" * 100, *((tmp_path / name).read_bytes() for name in ("a.npy", "m"))):
        (tmp_path / "a").write_bytes(content)
        assert "not a file of baked light" in refused(tmp_path / "a")
    with pytest.raises(ValueError, match="not a saved model"):
        pr.bake(room(), QUICK).save(tmp_path / "a")
        pr.Model.load(tmp_path / "a")


DAMAGES = [
    ("version", 1, "another version"),
    ("version", None, "another version"),
    ("layout", [4, 0, 1, 3], "another version"),
    ("format", "pointray model", "not a file of baked light"),
    ("arrays", ["sides", "coarse", "spreads", "grids", "records"], "skies is missing"),
    ("arrays", ["sides", "coarse", "spreads", "grids", "a\nb", "skies"], "records is missing"),
    ("unit", float("nan"), "unit"),
    ("unit", float("inf"), "unit"),
    ("unit", -1.0, "unit"),
    ("unit", 0.0, "unit"),
    ("unit", 6e33, "unit"),
    ("unit", "1.0", "unit"),
    ("unit", None, "unit"),
    ("unit", True, "unit"),
    ("settings", None, "settings"),
    ("settings", {"links": 0}, "links"),
    ("settings", {"a\nb": 0}, "settings"),
    ("shapes", None, "keys of its scene"),
    ("shapes", [1, 2, 3, 4], "keys of its scene"),
    ("shapes", [{}, {}, {}, {}], "instance 0 differs in its kind"),
    ("clips", None, "clip planes"),
    ("light", None, "keys of its scene"),
]


@pytest.mark.parametrize(("name", "value", "words"), DAMAGES)
def test_a_wrong_description_is_refused(tmp_path, parts, name, value, words):
    parts.about[name] = value
    (tmp_path / "a").write_bytes(join(parts))
    assert words in refused(tmp_path / "a")


def put(index, value):
    def change(array):
        array[index] = value
        return array

    return change


ARRAYS = [
    ("sides", put((0, 0), 4), "side"),
    ("sides", put((0, 0), -1), "side"),
    ("sides", put((0, 1), 0), "side"),
    ("sides", put((0, 1), 2**31 - 1), "side"),
    ("sides", put((1, 0), 0), "side"),
    ("sides", lambda sides: sides[::-1].copy(), "side"),
    ("sides", lambda sides: sides[:-1].copy(), "records is"),
    ("sides", lambda sides: sides[:0].copy(), "grids is"),
    ("sides", lambda sides: sides.astype(np.int64), "sides is"),
    *(("grids", put((0, k), value), "grid") for k in range(4) for value in (np.nan, np.inf, -np.inf, 1e200)),
    *(("grids", put((0, k), value), "grid") for k in (2, 3) for value in (0.0, -1.0, 1e-300)),
    ("grids", put((0, 3), 32.5), "grid"),
    ("grids", put((0, 3), 33.0), "grid of a plane"),
    ("grids", put((0, 3), 34.0), "records is"),
    ("grids", put((0, 3), 2.0**14), "records is"),
    ("grids", lambda grids: grids[:-1].copy(), "grids is"),
    ("grids", lambda grids: grids.astype(np.float32), "grids is"),
    ("records", lambda records: records[:-1].copy(), "records is"),
    ("records", lambda records: np.concatenate([records, records]), "records is"),
    ("records", lambda records: records.view(np.float32), "records is"),
    ("records", lambda records: records[:, :3].copy(), "records is"),
    ("skies", lambda skies: skies[:-1].copy(), "skies is"),
    ("skies", lambda skies: skies.view(np.float16), "skies is"),
    ("skies", lambda skies: np.full(skies.shape, np.nan, np.float32), "skies is"),
]


@pytest.mark.parametrize(("name", "change", "words"), ARRAYS)
def test_a_wrong_array_is_refused(tmp_path, parts, name, change, words):
    parts.arrays[name] = change(parts.arrays[name])
    (tmp_path / "a").write_bytes(join(parts))
    assert words in refused(tmp_path / "a")


def test_a_deeply_nested_description_is_refused(tmp_path):
    """It exceeds the recursion limit of Python's parser."""
    np.save(tmp_path / "a.npy", np.frombuffer(b"[" * 200_000, np.uint8))
    assert "its description is damaged" in refused(tmp_path / "a.npy")


@pytest.mark.parametrize("seed", range(4))
def test_random_damage_is_refused_or_shown_in_finite_pictures(tmp_path, saved, seed):
    rng = np.random.default_rng(seed)
    data = np.frombuffer(saved[1].read_bytes(), np.uint8)
    loaded, scene = 0, room()
    for k in range(50):
        broken = data.copy()
        # Half of the damage is done to the headers, the description and the small arrays.
        at = rng.integers(0, len(data) if k % 2 else 3000, rng.integers(1, 20))
        broken[at] ^= rng.integers(1, 256, len(at)).astype(np.uint8)
        (tmp_path / "a").write_bytes(broken.tobytes())
        try:
            again = pr.Baked.load(tmp_path / "a", scene)
        except ValueError as error:
            assert "\n" not in str(error)
            continue
        loaded += 1
        if again.stale is None:
            assert np.isfinite(picture(scene, again, size=16)).all()
        assert np.isfinite(again.irradiance(0)).all() and (again.irradiance(0) >= 0).all()
        assert (again.ambient_occlusion(2) <= 1).all()
    assert 50 > loaded > 5


@pytest.mark.parametrize("fill", [0, -1, 2**31 - 1, -(2**31), 0x7F7F7F7F])
def test_every_record_decodes_to_finite_light(tmp_path, parts, fill):
    """This holds for all bit patterns, with the largest unit."""
    parts.arrays["records"][:] = fill
    parts.about["unit"] = 5e33
    (tmp_path / "a").write_bytes(join(parts))
    scene = room()
    again = pr.Baked.load(tmp_path / "a", scene)
    assert np.isfinite(again.indirect(0)).all() and (again.indirect(0) >= 0).all()
    parts.about["unit"] = 1.0
    (tmp_path / "a").write_bytes(join(parts))
    assert np.isfinite(picture(scene, pr.Baked.load(tmp_path / "a", scene))).all()


def test_wrong_arguments_are_refused(tmp_path, saved):
    for path in (3, None, b"a", [tmp_path]):
        with pytest.raises(ValueError, match="path"):
            saved[0].save(path)
        with pytest.raises(ValueError, match="path"):
            pr.Baked.load(path, room())
    with pytest.raises(ValueError, match="scene"):
        pr.Baked.load(saved[1], plain_ball())
    with pytest.raises(ValueError, match="progress"):
        saved[0].save(tmp_path / "a", 3)
    assert os.listdir(tmp_path) == []


# ------------------------------------------------------------------------------------------------- failing writes


def test_a_failed_write_keeps_the_old_file(tmp_path, saved):
    def stop(stage, share):
        raise KeyboardInterrupt

    (tmp_path / "a").write_bytes(b"old")
    with pytest.raises(KeyboardInterrupt):
        saved[0].save(tmp_path / "a", stop)
    assert [(path.name, path.read_bytes()) for path in tmp_path.iterdir()] == [("a", b"old")]
    with pytest.raises(OSError):
        saved[0].save(tmp_path / "none" / "a")


# Bakes and saves two versions alternately in processes that are killed: at a random time, near the start of saving, or
# once the new file has been begun. Prints how many kills left an unfinished file, and what was wrong.
KILLS = """
import json, os, random, signal, sys, time
from pathlib import Path
from helpers.baked_room import SKY, SUN, QUICK, room
import pointray as pr

path, rng = Path(sys.argv[1]) / "a.bake", random.Random(5)
scenes = [room(lights=[SKY, SUN]), room(lights=[SKY])]
contents, took = [], []
for scene in scenes:
    begin = time.perf_counter()
    baked = pr.bake(scene, QUICK)
    took.append(time.perf_counter() - begin)
    baked.save(path)
    took.append(time.perf_counter() - begin - took[-1])
    contents.append(path.read_bytes())
    assert contents[-1] == path.read_bytes()
bakes, saves = took[2:]
wrong, unfinished = [], 0

def in_child(work):
    child = os.fork()
    if child == 0:
        try:
            work()
        finally:
            os._exit(1)
    return child

def work(pipe):
    while True:
        for scene in scenes:
            baked = pr.bake(scene, QUICK)
            os.write(pipe, b"w")
            baked.save(path)

for k in range(300):
    if k >= 30 and unfinished:
        break
    here, there = os.pipe()
    child = in_child(lambda: work(there))
    os.close(there)
    if k % 3:
        for _ in range(rng.randrange(1, 3)):
            os.read(here, 1)
    end = time.perf_counter() + 300.0
    while k % 3 == 2 and len(list(path.parent.iterdir())) == 1:
        if time.perf_counter() > end:
            wrong.append([k, "began no file"])
            break
    time.sleep(rng.random() * (2 * bakes, saves, 0.2 * saves)[k % 3])
    os.kill(child, signal.SIGKILL)
    status = os.waitpid(child, 0)[1]
    os.close(here)
    if not os.WIFSIGNALED(status):
        wrong.append([k, "ended by itself"])
    if path.read_bytes() not in contents:
        wrong.append([k, "neither the old file nor the new one"])
    pr.Baked.load(path, scenes[contents.index(path.read_bytes())])
    unfinished += len(list(path.parent.iterdir())) > 1
    for left in path.parent.glob(".pointray-*"):
        os.remove(left)
print(json.dumps([unfinished, wrong]))
"""


@pytest.mark.long
@pytest.mark.skipif(os.name != "posix", reason="processes and signals of POSIX")
def test_killed_processes_leave_the_old_file_or_the_new_one(tmp_path):
    paths = os.pathsep.join([str(TESTS), *filter(None, [os.environ.get("PYTHONPATH")])])
    command = [sys.executable, "-W", "ignore::DeprecationWarning", "-c", KILLS, str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, env={**os.environ, "PYTHONPATH": paths}, check=False)
    assert done.returncode == 0, done.stderr
    unfinished, wrong = json.loads(done.stdout)
    assert wrong == [] and unfinished > 0
