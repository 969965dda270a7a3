"""Parts and levels of detail are opened when needed and released when over budget."""

from __future__ import annotations

import copy
import json
import pickle
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pointray as pr
from pointray.auto_view import sample
from pointray.cli import execute
from pointray.cli.read_options import Reading
from pointray.cli.scan_surface import PLAIN
from pointray.cli.serve import shared_scene_of
from pointray.model import residency as residence
from pointray.model.array_file import drop_pages
from pointray.model.model import PrebuiltModel
from pointray.model.model_file import check_level
from pointray.model.model_folder import INDEX, read_folder, read_part, write_index, write_level, write_part
from pointray.model.out_of_core.split import split
from pointray.model.residency import Key
from pointray.rendering.window import may_see
from pointray.viewer.painter import Frame, FrameRequest, Painter
from pointray.viewer.view_settings import ViewSettings

COUNT, PART = 100_000, 16_384
UP = (0.0, 0.0, 1.0)
NEAR = pr.Camera.look_at((-0.3, 0.5, 0.8), (0.8, 0.5, 0.1), size=(64, 48))  # at one end of the terrain
FAR = pr.Camera.look_at((20, -25, 20), (4, 0.5, 0), size=(64, 48))
DOWN = np.array([0.0, 0, -1])


def terrain() -> pr.Points:
    """Return a terrain, eight units long and one wide."""
    random = np.random.default_rng(3)
    x, y = random.uniform(0, 8, COUNT), random.uniform(0, 1, COUNT)
    z = 0.1 * np.sin(3 * x) * np.cos(5 * y)
    colors = np.column_stack([30 * x, 200 * y, 100 + 0 * x]).astype(np.uint8)
    return pr.Points(
        np.column_stack([x, y, z]), colors=colors, attributes={"class": (x / 2).astype(np.uint8), "warmth": x + y}
    )


def give_levels(folder: Path, patch: pytest.MonkeyPatch) -> None:
    """Give each large part levels of detail, built from its own points."""
    patch.setattr("pointray.model.levels_of_detail.LEAST_POINTS", 100)
    index, whole = read_folder(folder)
    parts, start = [], 0
    for number, file in enumerate(index.parts):
        rows = np.arange(start, start + file.points)
        start += file.points
        if file.points < 5000:
            parts.append(file._replace(levels=[]))
            continue
        part = pr.Model(whole.points.select(rows), whole.radii[rows])
        part.make_levels()
        files = [
            write_level(folder, index.id, number, k + 1, level.data.to_stored()) for k, level in enumerate(part.levels)
        ]
        parts.append(file._replace(levels=files))
    write_index(folder, index._replace(parts=parts))


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("resident") / "terrain.pointray"
    split(pr.Model(terrain()), folder, PART, levels=False)
    with pytest.MonkeyPatch.context() as patch:
        give_levels(folder, patch)
    return folder


@pytest.fixture(scope="module")
def whole() -> pr.Model:
    """The same model in one piece, without levels of detail."""
    return pr.Model(terrain())


@pytest.fixture
def folder(made: Path, tmp_path: Path) -> Path:
    """A copy to damage."""
    twin = tmp_path / "twin.pointray"
    twin.mkdir()
    for file in made.iterdir():
        (twin / file.name).write_bytes(file.read_bytes())
    return twin


def spoil(path: Path) -> None:
    """Replace the contents of a file with garbage of the same size."""
    path.write_bytes(np.random.default_rng(0).bytes(path.stat().st_size))


def scene_of(model: pr.Model, **material: Any) -> pr.Scene:
    scene = pr.Scene()
    scene.add(model, material=pr.Diffuse(**material))
    scene.add_light(pr.SunLight((0.5, 0.3, -1)))
    return scene


def open_files(model: pr.Model) -> set[tuple[int, int]]:
    held = model._cache
    assert held is not None
    return {key for part in model.parts for level in (part, *part.levels) if held.is_open(key := level.source.key)}


def key_of(number: int, level: int = 0) -> Key:
    return Key(number, level)


def along(model: pr.Model) -> list[int]:
    """Return the numbers of the parts with levels of detail, from x = 0 to x = 8."""
    return [number for number in np.argsort([part.bounds[0, 0] for part in model.parts]).tolist() if number < 6]


# ------------------------------------------------------------------------------------------------------ what is opened


def test_a_model_is_opened_without_its_parts(folder: Path) -> None:
    for file in folder.glob("part-*"):
        spoil(file)
    model = pr.Model.load(folder)
    scene = scene_of(model)
    scene.snapshot()
    pr.frame(pr.Points(model.bounds))
    assert open_files(model) == set()
    assert model.resident_bytes == 0
    assert len(model.points) == COUNT
    assert np.array_equal(scene.bounds, model.bounds)
    assert model.longest >= 16
    assert 0 < model.spacing < 0.1
    assert model.has_levels
    assert [len(part.levels) for part in model.parts] == [3] * 6 + [0]  # the last one has few points
    assert all(part.spacing < part.levels[0].spacing < part.levels[-1].spacing for part in model.parts[:6])
    with pytest.raises(ValueError, match=r"part-0003\.pointray"):
        _ = model.parts[3].tree
    with pytest.raises(ValueError, match=r"part-0003-1\.pointray"):
        _ = model.parts[3].levels[0].points
    with pytest.raises(AttributeError, match="nonsense"):
        _ = model.parts[3].nonsense


def test_pictures_open_only_the_levels_they_show(made: Path) -> None:
    model = pr.Model.load(made)
    order = along(model)
    pr.render(scene_of(model), FAR)
    last = {key_of(number, len(part.levels)) for number, part in enumerate(model.parts)}
    assert open_files(model) == last
    model = pr.Model.load(made)
    pr.render(scene_of(model), NEAR)
    found = open_files(model)
    assert (order[0], 0) in found
    assert (order[-1], 0) not in found
    assert len(found) == len(model.parts)  # one level of each
    assert model.resident_bytes == sum(model._cache.file(key).nbytes for key in found)


def test_damaged_files_are_reported_when_they_are_needed(folder: Path) -> None:
    first, *_, last = along(pr.Model.load(folder))
    wanted = pr.render(scene_of(pr.Model.load(folder)), NEAR)
    spoil(folder / f"part-{last:04d}.pointray")
    spoil(folder / f"part-{first:04d}-3.pointray")
    assert np.array_equal(pr.render(scene_of(pr.Model.load(folder)), NEAR), wanted)
    scene = scene_of(pr.Model.load(folder))
    with pytest.raises(ValueError, match=rf"part-{last:04d}\.pointray"):
        pr.render(scene, NEAR, pr.Settings(levels=False))
    with pytest.raises(ValueError, match=rf"part-{first:04d}-3\.pointray"):
        pr.render(scene, FAR)
    (folder / f"part-{last:04d}.pointray").unlink()
    with pytest.raises(OSError, match=rf"part-{last:04d}\.pointray"):
        scene.intersect((7.0, 0.5, 5), DOWN)
    with pytest.raises(OSError, match=rf"part-{last:04d}\.pointray"):
        pr.Model.load(folder)


def test_the_command_line_names_a_damaged_level(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    spoil(folder / "part-0002-3.pointray")
    picture = folder.parent / "a.png"
    assert execute(["render", str(folder), "-o", str(picture), "--size", "40x30"]) == 2
    assert "part-0002-3.pointray" in capsys.readouterr().err
    assert not picture.exists()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda f: (f / "part-0001-1.pointray").write_bytes(b"abc"), r"part-0001-1\.pointray.*truncated"),
        (lambda f: (f / "part-0001-1.pointray").unlink(), r"part-0001-1\.pointray"),
        (lambda f: (f / "part-0001-2.pointray").rename(f / "part-0001.pointray"), "part-0001"),
    ],
)
def test_file_sizes_are_checked_on_opening(folder: Path, change: Callable[[Path], None], message: str) -> None:
    change(folder)
    with pytest.raises((ValueError, OSError), match=message):
        pr.Model.load(folder)


def change_index(folder: Path, **changes: Any) -> None:
    """Change the index entry of the finest level of the first part."""
    index = json.loads((folder / INDEX).read_text())
    index["parts"][0]["levels"][0] |= changes
    (folder / INDEX).write_text(json.dumps(index))


def test_levels_are_validated_when_opened(folder: Path) -> None:
    index, whole = read_folder(folder)
    level = pr.Model.load(folder).parts[0].levels[0]
    file = index.parts[0].levels[0]

    def written(of: pr.Model, id: str = index.id, part: int = 0, number: int = 1) -> str:
        """Return the error from opening a level that was written with these values."""
        stored = write_level(folder.parent, id, part, number, of.data.to_stored())
        (folder.parent / stored.name).rename(folder / file.name)
        change_index(folder, points=stored.points, longest=stored.longest, nbytes=stored.nbytes)
        try:
            _ = pr.Model.load(folder).parts[0].levels[0].tree
        except ValueError as error:
            return str(error)
        return ""

    assert written(level) == ""
    assert "not belong to this folder" in written(level, id="another")
    assert "not belong to this folder" in written(level, part=5)
    assert "not belong to this folder" in written(level, number=2)
    small = pr.Model(pr.procedural("sphere", 900))
    assert "different attributes" in written(small)
    moved = pr.Model(
        pr.Points.about(
            (1, 2, 3), level.points.positions, colors=level.points.colors, attributes=level.points.attributes
        )
    )
    assert "a different origin" in written(moved)
    tree = level.tree._replace(refs=level.tree.refs + 1_000_000)
    damaged = PrebuiltModel(level.data._replace(tree=tree))
    assert "a reference is not a block" in written(damaged)
    assert written(level) == ""
    change_index(folder, longest=16 * 1000)
    with pytest.raises(ValueError, match="longest leaf"):
        _ = pr.Model.load(folder).parts[0].levels[0].tree
    change_index(folder, longest=file.longest, points=file.points + 1)
    with pytest.raises(ValueError, match="points without levels of detail, got"):
        _ = pr.Model.load(folder).parts[0].levels[0].tree


def test_a_valid_file_is_checked_once_unless_it_changes(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    checked = []

    def check(tree: Any, points: int) -> None:
        checked.append(points)
        check_level(tree, points)

    monkeypatch.setattr("pointray.model.model_file.check_level", check)
    model = pr.Model.load(folder, memory=1)
    for number in (0, 1, 0, 1, 0):
        _ = model.parts[number].tree
    assert len(checked) == 2
    (folder / "part-0001.pointray").write_bytes((folder / "part-0001.pointray").read_bytes())
    _ = model.parts[1].tree
    assert len(checked) == 3


# ----------------------------------------------------------------------------------------------------------- the budget


def test_the_least_recently_used_parts_are_released_first(made: Path) -> None:
    size = max(file.nbytes for file in read_folder(made)[0].parts)
    model = pr.Model.load(made, memory=3 * size)

    def opened(number: int) -> set[int]:
        _ = model.parts[number].tree
        return {part for part, level in open_files(model)}

    assert [opened(number) for number in (0, 1, 2)][-1] == {0, 1, 2}
    assert opened(0) == {0, 1, 2}
    assert opened(3) == {0, 2, 3}
    assert opened(1) == {0, 1, 3}
    assert model.resident_bytes <= 3 * size
    tree = model.parts[0].tree  # a tree in use is released as well, and keeps its contents
    before = [array.copy() for array in tree]
    for number in (4, 5, 6):
        opened(number)
    assert not model.parts[0].source.is_open
    assert all(np.array_equal(one, other, equal_nan=True) for one, other in zip(tree, before, strict=True))


def test_the_coarsest_levels_stay_open(made: Path) -> None:
    model = pr.Model.load(made, memory=1)
    for part in model.parts:
        for level in (part, *part.levels):
            _ = level.tree
    assert open_files(model) == {*((number, 3) for number in range(6)), (6, 0)}  # which was opened last


def test_few_files_are_open_at_once(made: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(residence, "MOST_OPEN", 2)
    model = pr.Model.load(made)
    for part in model.parts:
        _ = part.tree
    assert len(open_files(model)) == 2


def test_dropped_pages_are_read_again(made: Path) -> None:
    index, whole = read_folder(made)
    tree = read_part(made, index, (1, 0), whole).tree
    before = [array.copy() for array in tree]
    drop_pages(tree)
    drop_pages([np.zeros(3)])
    assert all(np.array_equal(one, other, equal_nan=True) for one, other in zip(tree, before, strict=True))


@pytest.mark.parametrize("memory", [0, -1, 1.5, "1GiB", True])
def test_a_wrong_budget_is_refused(made: Path, memory: Any) -> None:
    with pytest.raises(ValueError, match="memory"):
        pr.Model.load(made, memory=memory)


def test_pictures_are_the_same_with_any_budget(made: Path) -> None:
    models = [pr.Model.load(made, memory=memory) for memory in (1, None)]
    for material in ({}, {"color": pr.Attribute("warmth")}, {"color": pr.Attribute("class")}):
        scenes = [scene_of(model, **material) for model in models]
        for camera in (NEAR, FAR, NEAR):
            for settings in (pr.Settings(), pr.Settings("path", spp=2), pr.Settings(levels=False)):
                one, other = (pr.render(scene, camera, settings) for scene in scenes)
                assert one[..., 3].any()
                assert np.array_equal(one, other)


@pytest.mark.parametrize("name", ["warmth", "class", "z"])
def test_colours_of_attributes_equal_those_of_the_whole(made: Path, whole: pr.Model, name: str) -> None:
    pictures = []
    for model in (whole, pr.Model.load(made, memory=1)):
        scene = scene_of(model, color=pr.Attribute(name, range=None if name == "class" else (0, 8)))
        pictures.append(pr.render(scene, NEAR, pr.Settings("color", levels=False)))
    assert np.isclose(*pictures, atol=1e-4).all(axis=2).mean() > 0.999
    assert len(np.unique(pictures[0][..., :3].reshape(-1, 3), axis=0)) > 1


def test_automatic_ranges_are_close_to_those_of_the_whole(made: Path, whole: pr.Model) -> None:
    models = whole, pr.Model.load(made)
    shown = [scene_of(model, color=pr.Attribute("warmth")).shown_attributes[0].range for model in models]
    assert np.allclose(*shown, atol=0.05)


RSS = """
import sys, gc, psutil, pointray as pr
model = pr.Model.load(sys.argv[1], memory=int(sys.argv[2]))
base, most = psutil.Process().memory_info().rss, 0
for turn in range(2):
    for part in model.parts:
        assert part.tree.blocks.sum() != 0 and part.tree.spheres.size and part.tree.leaves.sum() != 1
        most = max(most, psutil.Process().memory_info().rss)
print(most - base)
"""


@pytest.mark.long
@pytest.mark.skipif(sys.platform != "linux", reason="what counts as resident is the system's affair")
def test_resident_memory_stays_within_the_budget(tmp_path: Path) -> None:
    folder = tmp_path / "many.pointray"
    split(pr.Model(pr.procedural("sphere", PART)), folder, PART)
    index, whole = read_folder(folder)
    tree = read_part(folder, index, (0, 0), whole).tree
    bounds = np.array(index.parts[0].bounds)
    copies = [write_part(folder, index.id, k, 0, bounds, tree) for k in range(1, 60)]  # of the same splats
    write_index(folder, index._replace(parts=[*index.parts, *copies]))
    total, one = sum(file.nbytes for file in copies), copies[0].nbytes

    def grown(budget: int) -> int:
        """Return the growth of memory of a process that views all of them."""
        command = [sys.executable, "-c", RSS, str(folder), str(budget)]
        return int(subprocess.run(command, capture_output=True, text=True, check=True, timeout=300).stdout)

    assert total > 70 << 20
    assert grown(2 * total) > 0.6 * total
    assert grown(10 * one) < 10 * one + (24 << 20)


# --------------------------------------------------------------------------------------------------------------- rays


def test_rays_open_what_they_reach_first(made: Path) -> None:
    model, whole = pr.Model.load(made), pr.Model.load(made)
    scene, full = scene_of(model), scene_of(whole)
    low, high = model.parts[0].bounds
    hit = scene.intersect(np.append((low + high)[:2] / 2, 5.0), DOWN)
    assert hit.instance == 0
    assert open_files(model) == {(0, 0)}
    assert scene.intersect((4, 0.5, 5), -DOWN).instance == -1
    assert scene.intersect((4, 0.5, 5), DOWN, -np.inf, 1).instance == -1
    assert scene.intersect((4, 0.5, 5), (0, 0, 0)).instance == -1
    assert open_files(model) == {(0, 0)}
    assert scene.intersect((4, 0.5, -5), DOWN, -np.inf, 0).t == pytest.approx(-5, abs=0.2)
    assert scene.occluded((4, 0.5, -5), DOWN, -np.inf, 0)
    model = pr.Model.load(made)
    scene = scene_of(model)
    # Along the whole terrain, below its peaks: the first hit hides the rest.
    ray = (-1.0, 0.05, 0.05), (1.0, 0, 0)
    pieces = scene.intersect(*ray)
    assert pieces.instance == 0
    assert len(open_files(model)) < len(model.parts) / 2
    random = np.random.default_rng(2)
    origins = random.uniform((-1, -1, 0.3), (9, 2, 3), (300, 3))
    directions = random.normal(0, 1, (300, 3)) * (1, 1, 0.3) - (0, 0, 0.4)
    limits = random.uniform(-1, 1, 300), random.uniform(1, 6, 300)
    full.snapshot().opened()
    for some in (slice(0, 1), slice(0, 10), slice(0, 300)):
        rays = origins[some], directions[some], limits[0][some], limits[1][some]
        fresh = scene_of(pr.Model.load(made, memory=1))
        one = fresh.intersect(*rays, attributes=["warmth", "class"])
        other = full_hits(full, rays)
        assert np.array_equal(one.t, other.t) and np.array_equal(one.point, other.point)
        assert np.array_equal(one.normal, other.normal) and np.array_equal(one.color, other.color)
        for name in ("warmth", "class"):
            assert np.array_equal(one.attributes[name], other.attributes[name], equal_nan=True)
        assert np.array_equal(fresh.occluded(*rays), other.instance >= 0)
    assert 15 < np.isfinite(other.t).sum() < 290


def full_hits(scene: pr.Scene, rays: tuple[Any, ...]) -> pr.Hits:
    """Hits with all parts open."""
    import pointray.scene.paged_rays as reached

    most, reached.MOST = reached.MOST, 0
    try:
        return scene.intersect(*rays, attributes=["warmth", "class"])
    finally:
        reached.MOST = most


def test_rays_open_parts_of_transformed_instances(made: Path) -> None:
    model = pr.Model.load(made, memory=1)
    scene = pr.Scene()
    transform = pr.transform(rotate=30, axis=(1, 2, 3), scale=2.0, translate=(1, 5, -3))
    scene.add(model, transform)
    scene.add(model)
    rays = pr.Camera.frame(scene.bounds, (0.3, -1, 0.5), size=(24, 18)).rays()
    one, other = scene.intersect(*rays), full_hits(scene, rays)
    assert set(np.unique(one.instance)) >= {-1, 0}
    assert np.array_equal(one.t, other.t) and np.array_equal(one.instance, other.instance)


def test_boxes_outside_the_picture_are_not_visible() -> None:
    random = np.random.default_rng(1)
    low = random.uniform(-4, 4, (300, 3))
    boxes = np.concatenate([low, low + random.uniform(0.01, 1, (300, 3))], axis=1)
    for projection in ("perspective", "orthographic"):
        camera = pr.Camera.look_at((0, -5, 1), (0.5, 0, 0), fov=30, size=(40, 30), projection=projection)
        origins, directions = (a.reshape(-1, 1, 3) for a in camera.rays())
        near, far = np.sort([(boxes[:, :3] - origins) / directions, (boxes[:, 3:] - origins) / directions], axis=0)
        entered = (np.maximum(near.max(axis=2), 0) <= far.min(axis=2)).any(axis=0)
        found = may_see(camera, boxes)
        assert (found | ~entered).all()
        assert entered.sum() <= found.sum() < 0.5 * len(boxes)
    assert may_see(pr.Camera.look_at((0, 0, 0), (1, 0, 0), projection="panorama"), boxes).all()


# --------------------------------------------------------------------------------------------------- copies, other uses


def test_pickles_contain_the_whole_model(made: Path) -> None:
    model = pr.Model.load(made)
    twin = pickle.loads(pickle.dumps(model))
    assert [part.source for part in twin.parts] == [None] * len(model.parts)
    assert twin.has_levels
    assert twin.resident_bytes == twin.nbytes > 0.9 * model.nbytes
    one, other = (pr.render(scene_of(model), NEAR) for model in (model, twin))
    assert np.array_equal(one, other)
    shared = copy.copy(model)
    assert shared.parts[0] is model.parts[0]
    assert shared.place == model.place


def test_nbytes_counts_files_and_points(made: Path) -> None:
    model = pr.Model.load(made)
    index, whole = read_folder(made)
    files = sum(file.nbytes for file in index.files)
    assert files < model.nbytes < files + 60 * COUNT
    assert model.parts[0].nbytes == sum(file.nbytes for file in (index.parts[0], *index.parts[0].levels))
    assert model.resident_bytes == 0


@pytest.mark.parametrize(("points", "level"), [(1, 3), (3000, 2), (1 << 30, 1)])
def test_the_first_view_is_found_from_a_coarse_level(
    made: Path, monkeypatch: pytest.MonkeyPatch, points: int, level: int
) -> None:
    monkeypatch.setattr(sample, "COARSE", points)
    model = pr.Model.load(made)
    found, wanted = pr.frame(model), pr.frame(terrain())
    assert open_files(model) == {(number, level) for number in range(6)}
    assert np.allclose(found.eye, wanted.eye, atol=0.5)
    assert found.up == wanted.up


def test_info_verifies_every_byte(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert execute(["info", str(folder), "--verify", "--json"]) == 0
    path = folder / "part-0002-1.pointray"
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    capsys.readouterr()
    assert execute(["info", str(folder), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["points"] == COUNT
    assert execute(["info", str(folder), "--verify"]) == 2
    assert "part-0002-1.pointray" in capsys.readouterr().err
    scan = folder.parent / "a.ply"
    pr.write(scan, pr.procedural("sphere", 1000))
    assert execute(["info", str(scan), "--verify"]) == 2
    assert "a model in parts" in capsys.readouterr().err


@pytest.mark.parametrize(("memory", "message"), [("1GiB", "a model in parts"), ("much", "a size like")])
def test_a_budget_is_for_models_in_parts(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], memory: str, message: str
) -> None:
    pr.write(tmp_path / "a.ply", pr.procedural("sphere", 1000))
    assert execute(["view", str(tmp_path / "a.ply"), "--no-open", "--memory", memory]) == 2
    assert message in capsys.readouterr().err


# ---------------------------------------------------------------------------------------------------------- the viewer


class Page:
    """Collects the pictures and errors of a painter."""

    def __init__(self, scene: pr.Scene, samples: int = 1) -> None:
        self.frames: list[Frame] = []
        self.errors: list[str] = []
        self._scene, self._heard = scene, threading.Condition()
        self.view = ViewSettings(integrator="color", samples=samples)
        self.painter = Painter(self._deliver, self._fail, lambda *output: None)

    def _deliver(self, frame: Frame) -> None:
        self.painter.seen(frame.number)
        with self._heard:
            self.frames.append(frame)
            self._heard.notify_all()

    def _fail(self, text: str) -> None:
        with self._heard:
            self.errors.append(text)
            self._heard.notify_all()

    def look(self, camera: pr.Camera) -> None:
        self.painter.want(FrameRequest(camera, self.view, self._scene, (1, 0), UP, True, 0.0))

    def wait(self, until: Callable[[], bool]) -> None:
        with self._heard:
            assert self._heard.wait_for(until, 60), (len(self.frames), self.errors)


@pytest.fixture
def pages() -> Iterator[list[Page]]:
    made: list[Page] = []
    yield made
    for page in made:
        page.painter.close()


def held_back(monkeypatch: pytest.MonkeyPatch, reader: str) -> threading.Event:
    """Block the reading of parts, or of levels, until the event is set."""
    event, read = threading.Event(), getattr(residence, reader)

    def wait(*args: Any) -> Any:
        assert event.wait(60)
        return read(*args)

    monkeypatch.setattr(residence, reader, wait)
    return event


def test_the_viewer_shows_coarser_levels_until_finer_ones_are_there(
    made: Path, monkeypatch: pytest.MonkeyPatch, pages: list[Page]
) -> None:
    event = held_back(monkeypatch, "read_part")
    model = pr.Model.load(made)
    page = Page(scene_of(model))
    pages.append(page)
    page.look(NEAR)
    page.wait(lambda: len(page.frames) > 0)
    assert {level > 0 for _, level in open_files(model)} == {True}
    page.look(FAR)  # the painter continues while a file is read
    page.wait(lambda: page.frames[-1].request.camera == FAR)
    page.look(NEAR)
    page.wait(lambda: page.frames[-1].request.camera == NEAR)
    page.wait(lambda: page.frames[-1].size == NEAR.size)
    coarse = page.frames[-1].jpeg
    event.set()
    ready = scene_of(pr.Model.load(made))
    pr.render(ready, NEAR)
    needed = open_files(ready.models[0])  # pictures of a viewer at work may open more
    other = Page(ready)
    pages.append(other)
    other.look(NEAR)
    other.wait(lambda: bool(other.frames) and other.frames[-1].size == NEAR.size)
    assert other.frames[-1].jpeg != coarse
    page.wait(lambda: needed <= open_files(model))  # with parts that change no pixel
    page.wait(lambda: page.frames[-1].jpeg == other.frames[-1].jpeg)
    assert page.errors == other.errors == []


def test_the_viewer_reports_a_damaged_part_and_shows_the_rest(folder: Path, pages: list[Page]) -> None:
    first = along(pr.Model.load(folder))[0]
    spoil(folder / f"part-{first:04d}.pointray")
    model = pr.Model.load(folder)
    page = Page(scene_of(model))
    pages.append(page)
    page.look(NEAR)
    page.wait(lambda: len(page.frames) > 0 and len(page.errors) > 0)
    assert f"part-{first:04d}.pointray" in page.errors[0]
    page.look(FAR)
    page.wait(lambda: page.frames[-1].request.camera == FAR)
    page.look(NEAR)
    page.wait(lambda: page.frames[-1].request.camera == NEAR)
    assert len(page.errors) == 1  # reported once
    assert any(number == first and level > 0 for number, level in open_files(model))


def test_the_viewer_stays_within_its_budget_and_becomes_idle(made: Path, pages: list[Page]) -> None:
    index, _ = read_folder(made)
    coarsest = sum(part.levels[-1].nbytes for part in index.parts[:6])
    budget = coarsest + 2 * max(part.nbytes for part in index.parts)
    model = pr.Model.load(made, memory=budget)
    page = Page(scene_of(model), samples=16)
    pages.append(page)
    page.look(NEAR)
    page.wait(lambda: bool(page.frames) and page.frames[-1].samples == 16)
    comes_to_rest, pause = False, threading.Event()
    for _ in range(150):
        count = len(page.frames)
        pause.wait(0.4)
        comes_to_rest = len(page.frames) == count
        if comes_to_rest:
            break
    assert comes_to_rest  # nothing is drawn again and again
    assert model.resident_bytes <= budget
    assert (along(model)[0], 0) in open_files(model)  # the nearest is there


def test_a_folder_is_viewed_with_direct_light_and_a_budget(made: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sample, "COARSE", 1)
    pr.render(scene_of(pr.Model.load(made)), FAR)  # loads the kernel that a picture needs
    options = {"settings": pr.Settings("baked"), "up": None, "light": None, "fill": None, "background": "auto"}
    options |= {"ground": False, "normals": "auto", "bake": None, "quick": True, "memory": 1 << 20}
    options |= {"backfaces": None, "contact_shadow": True}
    surface = dict(PLAIN)
    shared, load = shared_scene_of([made], Reading(), {}, options, surface)
    load(shared)
    assert shared.problem == ""
    assert shared.settings.integrator == "phong"
    model = shared.scene.models[0]
    assert model._cache.budget == 1 << 20
    assert open_files(model) == {(number, 3) for number in range(6)}
    assert shared.build is not None
    assert shared.scan("front").camera().size


def test_a_closed_viewer_opens_nothing(made: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    event = held_back(monkeypatch, "read_part")
    page = Page(scene_of(pr.Model.load(made)))
    page.look(NEAR)
    page.wait(lambda: len(page.frames) > 0)
    page.painter.close()
    event.set()
    for _ in range(100):
        if page.painter.has_ended:
            break
        threading.Event().wait(0.1)
    assert page.painter.has_ended
