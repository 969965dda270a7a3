"""Spheres and discs in models in parts equal those of the whole, split from a model or built part by part."""

from __future__ import annotations

import json
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pointray as pr
from helpers.marks import long
from helpers.places import shared_model
from pointray.base.disk_columns import Columns
from pointray.cli import execute
from pointray.cloud.neighbors import kd_order
from pointray.io.files import request_of
from pointray.io.selection import Selection
from pointray.model.model_folder import INDEX
from pointray.model.out_of_core.prepare import prepare
from pointray.model.out_of_core.split import split
from pointray.surface.splats.scattered.classification import find_scattered, scattered_places
from pointray.surface.splats.scattered.spheres import Drawing
from pointray.surface.tree.settings import check_settings

SIZE = 1 << 14


def wood(rng: np.random.Generator, count: int = 30_000, crowns: int = 12) -> pr.Points:
    """Return ground with crowns, colours and attributes; the last half of the points is scattered."""
    ground = rng.uniform(-2, 2, (count // 2, 2))
    ground = np.column_stack([ground, 0.1 * np.sin(3 * ground[:, 0])])
    middles = np.column_stack([rng.uniform(-1.7, 1.7, (crowns, 2)), np.full(crowns, 0.7)])
    leaves = rng.normal(size=(count - len(ground), 3))
    leaves *= 0.35 * rng.random((len(leaves), 1)) ** (1 / 3) / np.linalg.norm(leaves, axis=1, keepdims=True)
    positions = np.concatenate([ground, leaves + middles[rng.integers(crowns, size=len(leaves))]])
    kinds = {"height": positions[:, 2].astype(np.float32), "number": np.arange(count, dtype=np.int32)}
    return pr.Points(positions, colors=rng.integers(0, 256, (count, 3)).astype(np.uint8), attributes=kinds)


def model_of(points: pr.Points, scatter: str = "spheres", share: float = 0.5, **options: Any) -> pr.Model:
    """Return a model whose last points are scattered."""
    mask = np.arange(len(points)) >= (1 - share) * len(points)
    return pr.Model(points, scatter=scatter, _scattered=mask, **options)


CASES: dict[str, Callable[[np.random.Generator], pr.Model]] = {
    "spheres": lambda rng: model_of(wood(rng)),
    "discs": lambda rng: model_of(wood(rng), "discs"),
    "no surface": lambda rng: model_of(wood(rng), share=1.0),
}


@pytest.fixture(scope="module", params=["spheres", long("discs"), "no surface"])
def both(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[pr.Model, pr.Model, Path]:
    """A whole model, the same in parts, and its folder."""
    whole = CASES[request.param](np.random.default_rng(7))
    folder = tmp_path_factory.mktemp("parts") / "a.pointray"
    split(whole, folder, SIZE)
    return whole, pr.Model.load(folder), folder


def scenes_of(*models: pr.Model, transform: Any = None) -> list[pr.Scene]:
    scenes = [pr.Scene() for _ in models]
    for scene, model in zip(scenes, models, strict=True):
        scene.add(model, transform)
    return scenes


def rays_at(rng: np.random.Generator, count: int = 20_000) -> tuple[np.ndarray, np.ndarray]:
    ends = rng.uniform([-2, -2, -0.2], [2, 2, 1.1], (count, 3))
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return ends - 6 * directions, directions


def check_rays(one: pr.Scene, other: pr.Scene, rays: Any, names: list[str]) -> Any:
    """Check that both scenes give the same hits, and return those of the first."""
    a, b = (scene.intersect(*rays, attributes=names) for scene in (one, other))
    hit = np.isfinite(a.t)
    assert hit.mean() > 0.1 and np.array_equal(hit, np.isfinite(b.t))
    assert (a.t != b.t).mean() < 2e-4
    assert (a.normal != b.normal).any(axis=1).mean() < 5e-4
    assert (a.color != b.color).any(axis=1).mean() < 5e-4
    for name in names:
        assert (a.attributes[name] != b.attributes[name])[hit].mean() < 5e-4
    assert np.array_equal(one.occluded(*rays), other.occluded(*rays))
    return a


def test_rays_meet_in_parts_what_they_meet_in_the_whole(
    both: tuple[pr.Model, pr.Model, Path], rng: np.random.Generator
) -> None:
    whole, parted, _ = both
    one, other = scenes_of(whole, parted)
    rays = rays_at(rng)
    hits = check_rays(one, other, rays, ["height", "number"])
    assert 0.2 < whole.scattered[hits.point[np.isfinite(hits.t)]].mean()
    again = other.intersect(*rays)
    here = np.isfinite(again.t)
    numbers = [model.points.attributes["number"] for model in (whole, parted)]
    assert (numbers[0][hits.point[here]] == numbers[1][again.point[here]]).mean() > 0.999
    away = rng.normal(size=(len(rays[0]), 3))
    check = [scene.intersect(hits.position[here], away[here]).t for scene in (one, other)]
    assert (check[0] != check[1]).mean() < 1e-3  # rays that start on spheres and on the surface


def test_instances_and_clip_planes(both: tuple[pr.Model, pr.Model, Path], rng: np.random.Generator) -> None:
    origins, directions = rays_at(rng, 5000)
    scenes = scenes_of(*both[:2], transform=pr.transform(rotate=40, scale=2.5, translate=(3, -2, 1)))
    check_rays(*scenes, (2.5 * origins + [3, -2, 1], directions), [])
    scenes = scenes_of(*both[:2])
    for scene in scenes:
        scene.clips = [((0, 0, 0.6), (0, 0.3, -1))]
    check_rays(*scenes, (origins, directions), ["height"])


def test_columns_of_points_are_kept(both: tuple[pr.Model, pr.Model, Path]) -> None:
    whole, parted, folder = both
    rows = np.argsort(whole.points.attributes["number"])[parted.points.attributes["number"]]
    assert np.array_equal(parted.scattered, whole.scattered[rows])
    assert parted.scattered.any() and not np.diff(parted.scattered.astype(int)).min() < 0  # the last ones
    assert np.array_equal(parted.radii, whole.radii[rows])
    assert np.array_equal(parted.points.colors, whole.points.colors[rows])
    assert parted.drawing == whole.drawing and parted.settings == whole.settings
    assert parted.spacing == pytest.approx(whole.spacing, rel=0.01)
    np.testing.assert_allclose(parted.surface_bounds, whole.surface_bounds)
    index = json.loads((folder / INDEX).read_text())
    assert (index["version"], index["scattered"]) == (3, whole.scattered.sum())
    owned = np.split(np.arange(len(rows)), np.cumsum([part["points"] for part in index["parts"]])[:-1])
    for part, mine in zip(parted.parts, owned, strict=True):
        slots = part.tree.order[part.tree.order >= 0]
        if parted.scattered[mine[0]]:
            assert np.array_equal(np.sort(slots), mine)
        else:
            assert not parted.scattered[slots].any()


def test_pictures_equal_those_of_the_whole(both: tuple[pr.Model, pr.Model, Path]) -> None:
    pictures = []
    for scene in scenes_of(*both[:2]):
        scene.add_light(pr.SunLight((0.5, 0.7, -1)))
        camera = pr.Camera.frame(both[0].bounds, (0.45, -1, 0.35), size=(120, 90))
        settings = [pr.Settings(name, spp=2, levels=False) for name in ("phong", "ao", "path")]
        pictures.append([pr.render(scene, camera, some) for some in settings])
    for one, other in zip(*pictures, strict=True):
        assert one[..., :3].max() > 0.2
        assert np.isclose(one, other, atol=1e-4).all(axis=2).mean() > 0.998


def test_light_is_baked_into_parts_as_into_the_whole(both: tuple[pr.Model, pr.Model, Path]) -> None:
    pictures = []
    for scene in scenes_of(*both[:2]):
        scene.add_light(pr.SunLight((0.5, 0.7, -1)))
        camera = pr.Camera.frame(both[0].bounds, (0.45, -1, 0.35), size=(80, 60))
        baked = pr.bake(scene, pr.BakeSettings(patches=4000, links=64))
        scene.baked = baked
        pictures.append(pr.render(scene, camera, pr.Settings("baked", levels=False))[..., :3])
    one, other = pictures
    assert one.mean() > 0.02 and abs(one.mean() / other.mean() - 1) < 0.05
    assert np.corrcoef(one.ravel(), other.ravel())[0, 1] > 0.97


def levels_in(folder: Path) -> list[list[tuple[int, float]]]:
    parts = json.loads((folder / INDEX).read_text())["parts"]
    return [[(level["points"], level["spacing"]) for level in part["levels"]] for part in parts]


def test_levels_are_those_of_the_whole_and_hide_as_much(
    both: tuple[pr.Model, pr.Model, Path], rng: np.random.Generator
) -> None:
    whole, parted, folder = both
    whole.make_levels()
    assert any(levels_in(folder))
    loose = [part for part in parted.parts if part.tree.head[11]]
    assert loose and all(part.levels for part in loose)
    known = np.concatenate([level.points.positions[level.scattered] for level in whole.levels])
    known = set(map(bytes, known))
    rays = rays_at(rng, 4000)
    seen = scenes_of(parted)[0].occluded(*rays).mean()
    scene, copies = pr.Scene(), 0
    for part in parted.parts:
        scene.add(part.levels[0] if part.levels else part)
    assert scene.occluded(*rays).mean() == pytest.approx(seen, abs=0.06)
    for part in loose:
        spacings = [level.spacing for level in part.levels]
        assert spacings == sorted(spacings)
        for level in part.levels:
            copy = pickle.loads(pickle.dumps(level))
            copy.__dict__.pop("spacing", None)
            assert level.scattered.all() and copy.spacing == pytest.approx(level.spacing)
            copies += sum(bytes(row) in known for row in level.points.positions)
            assert sum(bytes(row) in known for row in level.points.positions) in (0, len(level.points))
    assert copies > 0  # a cell that several parts share has one sphere, the whole's


def prepared(
    file: Path, folder: Path, scatter: str | None = "spheres", size: float = 1.0, levels: bool = True
) -> pr.Model:
    """Return the model of a file, built part by part."""
    reading = request_of(), Selection(1, None, None, None, None)
    drawing = None if scatter is None else Drawing(scatter, size)
    prepare([file], reading, folder, (check_settings("apss", 4, 1, "auto"), "auto", drawing), SIZE, levels=levels)
    return pr.Model.load(folder)


def check_alike(one: pr.Scene, other: pr.Scene, rays: Any) -> None:
    """Check that both scenes give about the same hits."""
    a, b = (scene.intersect(*rays, attributes=["height"]) for scene in (one, other))
    hit = np.isfinite(a.t) & np.isfinite(b.t)
    assert hit.mean() > 0.1 and (np.isfinite(a.t) != np.isfinite(b.t)).mean() < 5e-4
    for first, second, least in ((a.t, b.t, 2e-3), (a.normal, b.normal, 0.03), (a.color, b.color, 0.03)):
        assert (np.abs(first[hit] - second[hit]) > least).mean() < 5e-3
    assert (np.abs(a.attributes["height"][hit] - b.attributes["height"][hit]) > 2e-3).mean() < 5e-3


def check_prepared(points: pr.Points, tmp_path: Path, **options: Any) -> pr.Model:
    """Check that points built part by part equal those of the whole, and radii and hits nearly; return the model.

    The whole fits normals with neighbours in another order: last bits differ.
    """
    pr.write(tmp_path / "a.ply", points)
    points = pr.read(tmp_path / "a.ply")
    radii = points.attributes.get("radius")
    whole = pr.Model(points, radii, scatter=options.get("scatter", "spheres"), scatter_size=options.get("size", 1.0))
    parts = prepared(tmp_path / "a.ply", tmp_path / "a.pointray", **options)
    rows = np.argsort(points.attributes["number"])[parts.points.attributes["number"]]
    assert np.array_equal(parts.scattered, whole.scattered[rows])
    assert (np.abs(parts.radii - whole.radii[rows]) > 1e-3 * whole.radii[rows]).mean() < 5e-3
    assert np.array_equal(parts.points.positions, points.positions[rows])
    assert parts.drawing == whole.drawing and parts.settings == whole.settings and parts.smooth == whole.smooth
    check_alike(*scenes_of(whole, parts), rays_at(np.random.default_rng(0)))
    assert not (tmp_path / "a.pointray" / "unfinished").exists()
    return parts


def test_scattered_points_are_found_part_by_part(tmp_path: Path, rng: np.random.Generator) -> None:
    parts = check_prepared(wood(rng), tmp_path, levels=False)
    assert 0.3 < parts.scattered.mean() < 0.55
    assert sum(bool(part.tree.head[11]) for part in parts.parts) == 1


@pytest.mark.long
@pytest.mark.parametrize("name", ["discs", "none", "large", "radii", "all", "many", "rounded", "normals", "surface"])
def test_more_clouds_part_by_part(name: str, tmp_path: Path, rng: np.random.Generator) -> None:
    points, options = wood(rng), {"scatter": name} if name in ("discs", "none", "surface") else {}
    if name == "many":
        points = wood(rng, 120_000, 40)
    if name == "rounded":  # many points lie on the cuts of the order; no two coincide
        rounded = (np.rint(points.positions * 512) / 512).astype(np.float32)
        points = points.changed(positions=rounded).select(np.unique(rounded, axis=0, return_index=True)[1])
        numbers = np.random.default_rng(1).permutation(len(points)).astype(np.int32)
        points = points.changed(attributes={**points.attributes, "number": numbers})
    if name == "large":
        options = {"scatter": "spheres", "size": 1.7}
    if name == "radii":
        points = points.changed(attributes={**points.attributes, "radius": np.full(30_000, 0.03, np.float32)})
    if name == "all":
        points = points.changed(positions=rng.uniform(-2, 2, (30_000, 3)).astype(np.float32))
    if name == "normals":
        points = points.with_normals(pr.estimate_normals(points).normals)
    if name == "none":
        pr.write(tmp_path / "a.ply", points)
        parts = prepared(tmp_path / "a.ply", tmp_path / "a.pointray", **options)
        assert not parts.scattered.any() and 10_000 < len(parts.points) < 20_000
        assert parts.drawing.scatter == "none"
        return
    parts = check_prepared(points, tmp_path, **options)
    if name == "all":
        assert parts.scattered.mean() > 0.99
    if name == "surface":
        assert json.loads((tmp_path / "a.pointray" / INDEX).read_text())["version"] == 2


@pytest.mark.scans
@pytest.mark.long
@pytest.mark.parametrize("file", ["raw/Megaplot.laz", "raw/pcl_samp11_utm.pcd", "raw/small_gicp_target.ply"])
def test_real_scans_part_by_part(file: str, tmp_path: Path) -> None:
    """Some have rounded coordinates or coincident points."""
    path = shared_model(file)
    points = pr.read(path)
    mask = pr.Model(points).scattered
    parts = prepared(path, tmp_path / "a.pointray")
    assert 0.2 < mask.mean() < 0.9
    order, other = np.lexsort(points.positions.T), np.lexsort(parts.points.positions.T)
    assert np.array_equal(points.positions[order], parts.points.positions[other])
    assert (mask[order] != parts.scattered[other]).mean() < 0.04  # 0.7% (Megaplot) to 2.9% (samp11)


def test_a_stretch_of_the_order_gives_what_the_whole_does(rng: np.random.Generator) -> None:
    """Tested with two woods far apart, in which a fourth of the points coincide."""
    one = wood(rng, 3 * SIZE // 4).positions
    one += rng.normal(scale=0.05, size=one.shape).astype(np.float32)  # so that coarse scales decide
    one = np.concatenate([one, one[rng.integers(len(one), size=SIZE // 4)]])
    positions = np.concatenate([one, one[::-1] + np.float32([20, 0, 0])])
    some = kd_order(positions)[SIZE:]
    assert (some >= SIZE).all()
    first = np.sort(np.unique(positions[some], axis=0, return_index=True)[1])
    wanted = find_scattered(positions)[some][first]
    for rows, is_same in ((SIZE + first, True), (np.arange(len(first)), False)):
        assert np.array_equal(scattered_places(positions[some][first], rows), wanted) == is_same


def test_nothing_is_left_of_scattered_points(tmp_path: Path, rng: np.random.Generator) -> None:
    pr.write(tmp_path / "a.ply", pr.Points(rng.uniform(-1, 1, (20_000, 3)).astype(np.float32)))
    # Some neighbourhoods of a random cloud are flat by chance; a smaller one has none.
    pr.write(tmp_path / "b.ply", pr.Points(rng.uniform(-1, 1, (16, 3)).astype(np.float32)))
    with pytest.raises(ValueError, match="scatter: all points are scattered"):
        prepared(tmp_path / "b.ply", tmp_path / "b.pointray", "none")


@pytest.mark.long
def test_a_run_that_is_interrupted_again_and_again_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, rng: np.random.Generator
) -> None:
    points = wood(rng, 50_000)
    points = points.changed(attributes={**points.attributes, "radius": np.full(50_000, 0.03, np.float32)})
    pr.write(tmp_path / "a.ply", points)
    wanted = prepared(tmp_path / "a.ply", tmp_path / "whole.pointray")
    put, stops = Columns.put, 0

    def stop(self: Columns, name: str, facts: Any) -> None:
        put(self, name, facts)
        if not name.startswith("level-") and (name, self.folder.name) not in seen:
            seen.add((name, self.folder.name))
            raise KeyboardInterrupt

    seen: set[tuple[str, str]] = set()
    with monkeypatch.context() as patch:
        patch.setattr(Columns, "put", stop)
        while True:
            try:
                prepared(tmp_path / "a.ply", tmp_path / "a.pointray")
                break
            except KeyboardInterrupt:
                stops += 1
    assert stops > 40
    again = pr.Model.load(tmp_path / "a.pointray")
    assert np.array_equal(again.points.positions, wanted.points.positions)
    assert np.array_equal(again.radii, wanted.radii) and np.array_equal(again.scattered, wanted.scattered)
    for one, other in zip(again.parts, wanted.parts, strict=True):
        for a, b in zip(one.tree, other.tree, strict=True):
            np.testing.assert_array_equal(a, b)
    assert levels_in(tmp_path / "a.pointray") == levels_in(tmp_path / "whole.pointray")


def test_given_radii_stay_a_surface_unless_asked(tmp_path: Path, rng: np.random.Generator) -> None:
    points = wood(rng, 20_000)
    points = points.changed(attributes={"radius": np.full(20_000, 0.05, np.float32)})
    pr.write(tmp_path / "a.ply", points)
    parts = prepared(tmp_path / "a.ply", tmp_path / "a.pointray", None, levels=False)
    assert parts.drawing.scatter == "surface" and not parts.scattered.any()


@pytest.mark.parametrize("target", ["a.pointray", "a.pointray/"])
def test_a_size_alone_does_not_ask_for_spheres_of_given_radii(
    target: str, tmp_path: Path, rng: Any, monkeypatch: Any
) -> None:
    points = wood(rng, 20_000)
    pr.write(tmp_path / "a.ply", points.changed(attributes={"radius": np.full(20_000, 0.05, np.float32)}))
    monkeypatch.setattr("pointray.model.preparation.fits", lambda files, request, memory: False)
    assert (
        execute(
            ["prepare", str(tmp_path / "a.ply"), "-o", f"{tmp_path}/{target}", "--scatter-size", "2", "--no-levels"]
        )
        == 0
    )
    model = pr.Model.load(tmp_path / "a.pointray")
    assert model.drawing == Drawing("surface", 2.0) and not model.scattered.any()


def test_prepare_names_the_option(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pr.write(tmp_path / "a.ply", pr.Points(np.ones((5, 3))))
    assert execute(["prepare", str(tmp_path / "a.ply"), "-o", str(tmp_path / "a.pointray")]) == 2
    assert "a.ply: --scatter: no radius can be chosen" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"scattered": 10**9}, "more scattered points than"),
        ({"scattered": -1}, "points, blocks or bytes"),
        ({"scattered": 0.5}, "points, blocks or bytes"),
        ({"settings": {"surface": "apss", "scatter": "balls"}}, "damaged"),
    ],
)
def test_damaged_indices_are_refused(change: dict[str, Any], message: str, tmp_path: Path, rng: Any) -> None:
    split(model_of(wood(rng, 1000)), tmp_path / "a.pointray", SIZE, levels=False)
    index = json.loads((tmp_path / "a.pointray" / INDEX).read_text())
    (tmp_path / "a.pointray" / INDEX).write_text(json.dumps({**index, **change}))
    with pytest.raises(ValueError, match=message):
        pr.Model.load(tmp_path / "a.pointray")


@pytest.mark.parametrize("fits", [True, False])
def test_the_command_line_says_how_points_are_drawn(
    fits: bool,
    tmp_path: Path,
    rng: np.random.Generator,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    scan, folder = tmp_path / "a.ply", tmp_path / "a.pointray"
    pr.write(scan, wood(rng, 20_000))
    monkeypatch.setattr("pointray.model.preparation.fits", lambda files, request, memory: fits)
    message = ["prepare", str(scan), "-o", f"{folder}/", "--scatter", "spheres", "--scatter-size", "1.5", "--no-levels"]
    assert execute([*message, "--memory", "2GiB"]) == 0
    model = pr.Model.load(folder)
    assert model.drawing == Drawing("spheres", 1.5) and model.scattered.mean() > 0.3
    picture = ["-o", str(tmp_path / "a.png"), "--size", "64x48", "--light", "headlight"]
    assert execute(["render", str(folder), *picture]) == 0
    capsys.readouterr()
    for more, text in (
        (["-o", str(tmp_path / "b.ply"), "--scatter", "discs"], "require a model"),
        (["-o", f"{tmp_path}/b.pointray/", "--scatter-size", "-1"], "--scatter-size"),
        (["-o", f"{tmp_path}/b.pointray/", "--scatter", "balls"], "balls"),
    ):
        assert execute(["prepare", str(scan), *more]) == 2
        assert text in capsys.readouterr().err


@pytest.mark.long
def test_a_part_whose_cells_belong_to_others_is_no_error(tmp_path: Path, rng: np.random.Generator) -> None:
    """The last part is one point, which shares its cell with points of the part before it."""
    positions = rng.uniform(-1, 1, (SIZE + 1, 2))
    positions = np.column_stack([positions, np.zeros(len(positions))])
    kinds = {"classification": np.zeros(len(positions), np.uint8)}
    model = pr.Model(pr.Points(positions, np.tile([0, 0, 1.0], (len(positions), 1)), attributes=kinds))
    split(model, tmp_path / "a.pointray", SIZE)
    assert [part["points"] for part in json.loads((tmp_path / "a.pointray" / INDEX).read_text())["parts"]] == [SIZE, 1]
