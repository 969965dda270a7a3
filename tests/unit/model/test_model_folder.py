"""Models in parts: rays hit what they hit in the whole, and damaged folders are refused."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import pointray as pr
from helpers.marks import long, long_scan
from helpers.places import shared_model
from pointray.cli import execute
from pointray.model.array_file import read_arrays
from pointray.model.model_file import KIND
from pointray.model.model_folder import INDEX, POINTS, LevelFile, PartFile, write_level, write_part
from pointray.model.out_of_core.split import split
from pointray.model.out_of_core.trees import nth_least
from pointray.surface.tree.build import build_tree
from pointray.surface.tree.parts import splats_of

SIDES = ((0.45, -1.0, 0.35), (-1.0, 0.3, 0.2), (0.1, 0.2, 1.0))


def leaves(model: pr.Model) -> set[bytes]:
    return {leaf.tobytes() for leaf in model.tree.leaves.reshape(-1, 16)}


def noisy_wall(rng: np.random.Generator, count: int = 60_000) -> pr.Points:
    """Return a thin, open, coloured wall with noise, of different density on one side."""
    x, z = rng.uniform(0, 1, (2, count)) ** [[1.5], [1.0]]
    positions = np.column_stack([x, 0.05 * np.sin(9 * x) + rng.normal(0, 0.002, len(x)), z])
    colors = rng.integers(0, 256, positions.shape).astype(np.uint8)
    return pr.Points(positions, colors=colors, attributes={"height": z, "class": (4 * x).astype(np.uint8)})


def clouds(name: str) -> pr.Points:
    if name == "wall":
        return noisy_wall(np.random.default_rng(6))
    if name == "lion":
        return pr.read(shared_model("points/potree_lion_takanawa_rgb.ply"))
    return pr.procedural(name, 100_000)


@pytest.fixture(scope="module", params=["wall", long("statue"), long_scan("lion")])
def both(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[pr.Model, pr.Model]:
    model = pr.Model(clouds(request.param), scatter="surface")
    folder = tmp_path_factory.mktemp("parts") / "a.pointray"
    split(model, folder, 20_000, levels=False)
    return model, pr.Model.load(folder)


def test_the_trees_of_the_parts_equal_that_of_the_whole(both: tuple[pr.Model, pr.Model]) -> None:
    whole, parted = both
    assert len(parted.parts) == -(-len(splats_of(whole.tree, whole.radii).radii) // 16_384) > 3
    assert set.union(*(leaves(part) for part in parted.parts)) == leaves(whole)
    assert sum(part.tree.leaves.size for part in parted.parts) == whole.tree.leaves.size
    assert all(np.array_equal(part.tree.head, whole.tree.head) for part in parted.parts)
    assert np.array_equal(parted.bounds, whole.bounds)
    np.testing.assert_allclose(parted.surface_bounds, whole.surface_bounds)
    assert parted.longest == whole.longest
    assert parted.spacing == pytest.approx(whole.spacing, rel=0.01)


@pytest.mark.parametrize("placed", [False, True])
def test_rays_hit_the_same_in_parts_and_in_the_whole(both: tuple[pr.Model, pr.Model], placed: bool) -> None:
    whole, parted = both
    row_of = splats_of(whole.tree, whole.radii).rows
    transform = pr.transform(rotate=40, scale=2.5, translate=(3, -2, 1)) if placed else None
    seen, hits, others = 0, [], []
    scenes = [pr.Scene(), pr.Scene()]
    for scene, model in zip(scenes, both, strict=True):
        scene.add(pr.Plane((0, 0, -9), (0, 0, 1)))
        assert scene.add(model, transform) == 1
    for side in SIDES:
        rays = pr.Camera.frame(scenes[0].bounds, side, size=(200, 200)).rays()
        a, b = (scene.intersect(*rays, attributes=list(whole.points.attributes)) for scene in scenes)
        assert np.array_equal(a.instance, b.instance)
        here = a.instance == 1
        seen += here.sum()
        hits.append([a.t[here], a.normal[here], a.color[here], a.point[here]])
        others.append([b.t[here], b.normal[here], b.color[here], row_of[b.point[here]]])
        for name, values in a.attributes.items():
            same = (values[here] == b.attributes[name][here]) | (values[here] != values[here])
            assert same.mean() > 0.9995
        assert np.array_equal(scenes[0].occluded(*rays), scenes[1].occluded(*rays))
    t, normals, colors, points = (np.concatenate(column) for column in zip(*hits, strict=True))
    t2, normals2, colors2, points2 = (np.concatenate(column) for column in zip(*others, strict=True))
    assert seen > 10_000
    assert (t != t2).sum() <= 2  # on a cut, as all those below
    assert (normals != normals2).any(axis=1).mean() < 5e-4
    assert np.abs(normals - normals2).max() < 1e-4
    assert (colors != colors2).any(axis=1).mean() < 5e-4
    assert (points != points2).mean() < 1e-4


def test_what_a_ray_meets_in_parts_does_not_depend_on_other_rays(
    both: tuple[pr.Model, pr.Model], rng: np.random.Generator
) -> None:
    scene = pr.Scene()
    scene.add(both[1])
    for side in SIDES:
        origins, directions = (a.reshape(-1, 3) for a in pr.Camera.frame(scene.bounds, side, size=(200, 200)).rays())
        order = rng.permutation(len(origins))
        wanted, found = scene.intersect(origins, directions), scene.intersect(origins[order], directions[order])
        for name in ("t", "position", "normal", "color", "point"):
            np.testing.assert_array_equal(getattr(found, name), getattr(wanted, name)[order], name)


def test_pictures_of_parts_equal_those_of_the_whole(both: tuple[pr.Model, pr.Model]) -> None:
    pictures = []
    for model in both:
        scene = pr.Scene()
        scene.add(model, material=pr.Phong())
        scene.add_light(pr.SunLight((0.5, 0.7, -1)))
        camera = pr.Camera.frame(model.bounds, SIDES[0], size=(160, 120))
        pictures.append([pr.render(scene, camera, pr.Settings(integrator=name)) for name in ("phong", "ao", "path")])
    for one, other in zip(*pictures, strict=True):
        assert np.isclose(one, other, atol=1e-4).all(axis=2).mean() > 0.999


def test_points_and_radii_are_kept(both: tuple[pr.Model, pr.Model]) -> None:
    whole, parted = both
    rows = splats_of(whole.tree, whole.radii).rows
    assert np.array_equal(parted.points.positions, whole.points.positions[rows])
    assert np.array_equal(parted.radii, whole.radii[rows])
    for name, values in whole.points.attributes.items():
        assert np.array_equal(parted.points.attributes[name], values[rows])
    listed = [part.tree.order[part.tree.order >= 0] for part in parted.parts]
    assert len(np.unique(np.concatenate(listed))) > 0.999 * len(rows)  # others have no surface
    assert sum(len(some) for some in listed) < 1.35 * len(rows)  # parts this small have many neighbours


def test_operations_that_need_the_whole_model_are_refused(both: tuple[pr.Model, pr.Model], tmp_path: Path) -> None:
    parted = both[1]
    for work in (
        lambda: parted.save(tmp_path / "a.pointray"),
        lambda: parted.rebuild(0, surface="imls"),
        parted.make_levels,
        lambda: parted.splats,
    ):
        with pytest.raises(ValueError, match="not one in parts"):
            work()


def test_the_tree_is_built_again_of_what_it_keeps(rng: np.random.Generator) -> None:
    model = pr.Model(noisy_wall(rng, 20_000), scatter="surface")
    again = build_tree(splats_of(model.tree, model.radii), model.settings, in_order=True)
    for name, one, other in zip(model.tree._fields, model.tree, again, strict=True):
        assert np.array_equal(one, other, equal_nan=True), name


def test_numbers_are_found_by_their_rank(rng: np.random.Generator) -> None:
    values = rng.lognormal(0, 2, 10_001).astype(np.float32)
    chunks = [values[:17], values[17:9000], values[9000:]]
    for n in (0, 1, 200, 5000, 10_000):
        assert nth_least(lambda: chunks, n) == np.partition(values, n)[n]
    equal = np.full(100, 3.5, np.float32)
    assert nth_least(lambda: [equal, equal], 150) == 3.5


@pytest.fixture(scope="module")
def undamaged(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of two parts."""
    folder = tmp_path_factory.mktemp("undamaged") / "a.pointray"
    split(pr.Model(pr.procedural("sphere", 20_000)), folder, 16_384, levels=False)
    assert len(pr.Model.load(folder).parts) == 2
    return folder


@pytest.fixture
def folder(undamaged: Path, tmp_path: Path) -> Path:
    """A copy to damage."""
    return Path(shutil.copytree(undamaged, tmp_path / "a.pointray"))


def damaged(folder: Path, **changes: object) -> None:
    index = json.loads((folder / INDEX).read_text())
    index.update(changes)
    (folder / INDEX).write_text(json.dumps(index))


def damaged_part(folder: Path, **changes: object) -> None:
    """Change the first part's entry in the index."""
    parts = json.loads((folder / INDEX).read_text())["parts"]
    damaged(folder, parts=[parts[0] | changes, *parts[1:]])


def described(name: str, spacing: float) -> dict[str, object]:
    """Return the index entry of a level of detail."""
    return LevelFile(f"{name}.pointray", 1, spacing, 16, 1, "")._asdict()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda f: (f / INDEX).unlink(), "index.json is missing"),
        (lambda f: (f / INDEX).write_text("{"), "index.json"),
        (lambda f: (f / INDEX).write_text("[]"), "not the index"),
        (lambda f: damaged(f, format="other"), "not the index"),
        (lambda f: damaged(f, version=99), "another version"),
        (lambda f: damaged(f, parts=[]), "parts are missing"),
        (lambda f: damaged(f, supports=[0, 1]), "supports"),
        (lambda f: damaged(f, bounds=[[0, 0, 0], [1, 1, "a"]]), "index.json"),
        (lambda f: damaged(f, settings={"surface": "other"}), "damaged"),
        (lambda f: damaged(f, id="other"), "points.pointray.*another folder"),
        (lambda f: damaged(f, more=1), "index.json"),
        (lambda f: damaged_part(f, reach=[[0, 0, 0], [1, 1, -1]]), "bounds"),
        (lambda f: damaged_part(f, spacing=-1.0), "spacing"),
        (lambda f: damaged_part(f, longest=1.5), "points, blocks or bytes"),
        (lambda f: damaged_part(f, name="../part-0001.pointray"), "files of the folder"),
        (lambda f: damaged_part(f, name="part-0001.pointray"), "files of the folder"),
        (lambda f: damaged_part(f, levels=[{"name": "a.pointray"}]), "index.json"),
        (lambda f: damaged_part(f, levels=[described("a", 2.0), described("b", 1.0)]), "fine to coarse"),
        (lambda f: (f / "part-0001.pointray").write_bytes(b""), "part-0001.pointray.*truncated"),
        (lambda f: shutil.copy(f / "part-0000.pointray", f / "part-0001.pointray"), "part-0001.pointray"),
        (lambda f: (f / POINTS).write_bytes((f / POINTS).read_bytes()[:-64]), "points.pointray.*truncated"),
    ],
    ids=range(21),
)
def test_damaged_folders_are_refused(folder: Path, change: object, message: str) -> None:
    change(folder)  # type: ignore[operator]
    with pytest.raises(ValueError, match=message):
        pr.Model.load(folder)


def test_the_index_describes_parts_without_opening_their_files(both: tuple[pr.Model, pr.Model], tmp_path: Path) -> None:
    for part in both[1].parts:
        stored = write_part(tmp_path, "0", 0, 5, part.bounds, part.tree)
        assert PartFile.of(json.loads(json.dumps(stored.facts))) == stored
        assert (stored.reach is not None) == part.has_surface and stored.longest == part.longest
        if stored.reach is None:
            continue
        assert stored.reach == part.surface_bounds.tolist()
        assert stored.spacing == pytest.approx(np.median(part.radii[part.tree.order[part.tree.order >= 0]]), rel=1e-6)


def test_levels_of_detail_are_saved_models_with_the_id_of_their_folder(tmp_path: Path) -> None:
    model = pr.Model(pr.procedural("sphere", 5000))
    model.make_levels()
    level = model.levels[0]
    stored = write_level(tmp_path, "12", 3, 1, level.data.to_stored())
    assert (stored.name, stored.points, stored.longest) == ("part-0003-1.pointray", len(level.points), level.longest)
    assert stored.nbytes == (tmp_path / stored.name).stat().st_size
    assert stored.spacing == level.spacing
    about, _ = read_arrays(tmp_path / stored.name, KIND)
    assert (about["folder"], about["part"], about["level"]) == ("12", 3, 1)
    assert np.array_equal(pr.Model.load(tmp_path / stored.name).tree.leaves, level.tree.leaves)
    part = write_part(tmp_path, "12", 3, 5, model.bounds, model.tree)._replace(levels=[stored])
    assert PartFile.of(json.loads(json.dumps(part.facts))) == part


def test_a_missing_part_is_named(folder: Path) -> None:
    (folder / "part-0001.pointray").unlink()
    with pytest.raises(OSError, match="part-0001.pointray"):
        pr.Model.load(folder)


def run(*arguments: object) -> int:
    return execute([str(argument) for argument in arguments])


def test_the_command_line_prepares_and_shows_parts(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scan, parted, ready = tmp_path / "a.ply", tmp_path / "city.pointray", tmp_path / "a.pointray"
    pr.write(scan, pr.procedural("torus", 20_000))
    assert run("prepare", scan, "-o", f"{parted}/", "--part-points", 20_000) == 0
    assert "20,000 points in 2 parts" in capsys.readouterr().out
    assert run("prepare", scan, "-o", ready) == 0
    for model in (parted, ready):
        exact = "--size", "80x60", "--light", "headlight", "--no-levels"
        assert run("render", model, "-o", model.with_suffix(".png"), *exact) == 0
    one, other = (Image.open(model.with_suffix(".png")) for model in (parted, ready))
    # The automatic camera of a model in parts is chosen from levels of detail, so it differs slightly.
    assert np.abs(np.asarray(one, np.int16) - np.asarray(other)).mean() < 1
    capsys.readouterr()
    assert run("info", parted, "--json") == 0
    stored = json.loads(capsys.readouterr().out)
    assert (stored["parts"], stored["points"]) == (2, 20_000)
    assert stored["files"][0]["bytes"] == sum(file.stat().st_size for file in parted.iterdir())
    assert run("render", parted, "-o", tmp_path / "b.png", "--size", "40x30") == 0  # in the studio, without baking


@pytest.mark.long
def test_the_command_line_bakes_light_for_parts(
    undamaged: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    parted = undamaged
    light = tmp_path / "a.bake"
    assert run("bake", parted, "-o", light, "--patches", 500, "--links", 16) == 0
    assert run("render", parted, "-o", tmp_path / "c.png", "--size", "40x30", "--bake", light) == 0
    assert run("bake", parted, "-o", tmp_path / "b.ply", "--patches", 500, "--links", 16) == 2
    assert "not one in parts" in capsys.readouterr().err


def test_light_baked_into_parts_equals_that_of_the_whole(both: tuple[pr.Model, pr.Model]) -> None:
    pictures = []
    for model in both:
        scene = pr.Scene()
        scene.add(model)
        scene.lights = [pr.SunLight((0.5, 0.7, -1)), pr.EnvironmentLight()]
        scene.baked = pr.bake(scene, pr.BakeSettings(patches=4000, links=32))
        camera = pr.Camera.frame(model.bounds, SIDES[0], size=(80, 60))
        pictures.append(pr.render(scene, camera, pr.Settings(integrator="baked"))[..., :3])
    one, other = pictures
    assert np.abs(one - other).mean() < 0.06 * one.mean()  # noise of other patches; 0.5 if a part has no light


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["-o", "city/"], "a folder whose name ends in .pointray"),
        (["-o", "none/city.pointray/"], "folder not found"),
        (["-o", "full.pointray/"], "already exists and is not empty"),
        (["-o", "a.pointray/", "--part-points", "0"], "--part-points must be 1 or more"),
    ],
)
def test_wrong_folders_are_refused(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    message: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    pr.write("a.ply", pr.procedural("sphere", 1000))
    (tmp_path / "full.pointray").mkdir()
    (tmp_path / "full.pointray" / "mine").touch()
    before = sorted(tmp_path.rglob("*"))
    assert run("prepare", "a.ply", *arguments) == 2
    assert message in capsys.readouterr().err
    assert sorted(tmp_path.rglob("*")) == before


def test_a_failed_write_leaves_no_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*arguments: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("pointray.model.out_of_core.finish.write_part", full)
    with pytest.raises(OSError, match="No space"):
        split(pr.Model(pr.procedural("sphere", 2000)), tmp_path / "a.pointray")
    assert not (tmp_path / "a.pointray").exists()


def test_a_folder_with_files_is_not_written_to(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").touch()
    with pytest.raises(ValueError, match="already exists and is not empty"):
        split(pr.Model(pr.procedural("sphere", 1000)), tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]
