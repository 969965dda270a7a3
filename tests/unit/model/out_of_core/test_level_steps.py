"""Levels of detail of models in parts equal those of the whole, and continue across cuts."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pointray as pr
from pointray.base.disk_columns import Column, Columns
from pointray.cli import execute
from pointray.cloud.neighbors import kd_order
from pointray.io.files import request_of
from pointray.io.selection import Selection
from pointray.model.model import PrebuiltModel
from pointray.model.model_folder import INDEX
from pointray.model.out_of_core import level_steps as coarser
from pointray.model.out_of_core.prepare import prepare
from pointray.model.out_of_core.split import split
from pointray.model.out_of_core.trees import cells_of, plan_of, shown, tree_within
from pointray.surface.splats.levels import LEAST_POINTS
from pointray.surface.splats.scattered.spheres import ALL_SURFACE
from pointray.surface.tree.build import build_tree
from pointray.surface.tree.parts import splats_of
from pointray.surface.tree.settings import check_settings
from pointray.surface.tree.stored import find_surface_bounds, stored_splats

SIZE = 1 << 14


def statue(count: int = 6 * SIZE) -> pr.Points:
    """Return a cloud with colours and attributes of all kinds."""
    points = pr.procedural("statue", count)
    x, y, z = points.positions.T
    kinds = {
        "height": np.where(z > 1, z, np.nan),
        "classification": (3 * x).astype(np.uint8),
        "few": np.rint(2 * y).astype(np.int16),
        "many": (1000 * y).astype(np.int32),
        "pairs": np.stack([x, z], axis=1).astype(np.float32),
    }
    return points.changed(attributes=kinds)


def noisy(rng: np.random.Generator) -> pr.Points:
    """Return an open cloud of several densities, with noise that smoothing removes."""
    x, z = rng.uniform(0, 1, (2, 5 * SIZE)) ** [[1.5], [1.0]]
    positions = np.column_stack([x, 0.05 * np.sin(9 * x) + rng.normal(0, 0.002, len(x)), z])
    return pr.Points(positions.astype(np.float32), attributes={"height": z})


def plate(rng: np.random.Generator) -> pr.Points:
    """Return a plate so thin that all splats have an opposite sheet nearby; a few points lie far away."""
    x, z = rng.uniform(0, 1, (2, 3 * SIZE))
    side = rng.choice([-1.0, 1.0], len(x))
    positions = np.column_stack([x, 5e-3 * side, z])
    positions[:7] += [[3, 3, 9]]
    return pr.Points(positions.astype(np.float32), np.outer(side, [0, 1, 0]))


CLOUDS: dict[str, Callable[[np.random.Generator], pr.Points]] = {
    "statue": lambda rng: statue(),
    "noisy": noisy,
    "plate": plate,
}


def large(points: pr.Points, folder: Path) -> None:
    """Write a model in parts, part by part."""
    file = folder.with_suffix(".ply")
    if not file.exists():  # another one would be another task
        pr.write(file, points)
    reading = request_of(), Selection(1, None, None, None, None)
    prepare([file], reading, folder, (check_settings("apss", 4, 1, "auto"), "auto", ALL_SURFACE), SIZE)


FORMS = [  # a cloud, and how its model in parts is built
    pytest.param((name, way), id=f"{name}-{way}", marks=pytest.mark.long)
    for name in CLOUDS
    for way in ("split", "large")
]


@pytest.fixture(scope="module", params=FORMS)
def both(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[pr.Model, Path]:
    """A model with levels, and a folder with the same in parts."""
    name, way = request.param
    folder = tmp_path_factory.mktemp("levels") / "a.pointray"
    points = CLOUDS[name](np.random.default_rng(3))
    if way == "large":
        large(points, folder)
        points = pr.read(folder.with_suffix(".ply"))
    model = pr.Model(points, scatter="surface")
    model.make_levels()
    if way == "split":
        split(model, folder, SIZE)
    assert sorted(path.name.split("-")[0] for path in folder.iterdir() if "part" not in path.name) == [
        "index.json",
        "points.pointray",
    ]
    return model, folder


def parts_of(folder: Path) -> list[dict[str, Any]]:
    return json.loads((folder / INDEX).read_text())["parts"]


def rows_of(points: pr.Points) -> np.ndarray:
    """Return all columns of each point, sorted by position."""
    columns = [points.positions, points.normals, *([] if points.colors is None else [points.colors])]
    columns += [np.nan_to_num(values.reshape(len(points), -1), nan=-99.0) for values in points.attributes.values()]
    return np.concatenate(columns, axis=1, dtype=np.float64)


def levels_of(whole: pr.Model, folder: Path) -> list[list[pr.Model]]:
    """Return for each level of the whole the levels of parts with its points: of all parts, or none."""
    files = [pr.Model.load(folder / entry["name"]) for part in parts_of(folder) for entry in part["levels"]]
    known = [set(map(bytes, rows_of(level.points))) for level in whole.levels]
    found: list[list[pr.Model]] = [[] for _ in known]
    for model in files:
        rows = set(map(bytes, rows_of(model.points)))
        number = next((number for number, some in enumerate(known) if rows <= some), None)
        assert number is not None or len(model.points) < 2 * LEAST_POINTS
        if number is not None:
            found[number].append(model)
    complete = [models if len(models) == len(parts_of(folder)) else [] for models in found]
    assert complete[0] and (complete[1] or whole.points.colors is None)
    return complete


def test_levels_of_parts_equal_those_of_the_whole(both: tuple[pr.Model, Path]) -> None:
    whole, folder = both
    assert len(parts_of(folder)) >= 3
    for models, level in zip(levels_of(whole, folder), whole.levels, strict=True):
        if not models:
            continue
        found = np.concatenate([rows_of(model.points) for model in models])
        assert np.array_equal(np.unique(found, axis=0), np.unique(rows_of(level.points), axis=0))
        assert all(model.settings == level.settings for model in models)
        assert {name: values.dtype for name, values in models[0].points.attributes.items()} == {
            name: values.dtype for name, values in level.points.attributes.items()
        }
        radii = dict(zip(map(bytes, rows_of(level.points)), level.radii, strict=True))
        for model in models:
            wanted = np.array([radii[bytes(row)] for row in rows_of(model.points)])
            assert (np.abs(model.radii / wanted - 1) > 1e-4).mean() < 2e-3
        assert sum(len(model.points) for model in models) < 1.5 * len(level.points)
        # All lattices have the same origin and the same steps.
        assert {model.tree.head[:6].tobytes() for model in models} == {level.tree.head[:6].tobytes()}


def test_the_index_describes_levels(both: tuple[pr.Model, Path]) -> None:
    whole, folder = both
    for part in parts_of(folder):
        reaches = [part["reach"]]
        for number, entry in enumerate(part["levels"]):
            model = pr.Model.load(folder / entry["name"])
            assert entry["name"].endswith(f"-{number + 1}.pointray")
            assert (entry["points"], entry["spacing"]) == (len(model.points), model.spacing)
            reaches.append(model.surface_bounds.tolist())
        low, high = np.min([low for low, _ in reaches], axis=0), np.max([high for _, high in reaches], axis=0)
        np.testing.assert_allclose(part["reach"][0], np.maximum(low, whole.surface_bounds[0]), atol=1e-6)
        np.testing.assert_allclose(part["reach"][1], np.minimum(high, whole.surface_bounds[1]), atol=1e-6)
        spacings = [entry["spacing"] for entry in part["levels"]]
        assert spacings == sorted(spacings)


def test_rays_hit_the_same_in_levels_of_parts_and_of_the_whole(both: tuple[pr.Model, Path]) -> None:
    whole, folder = both
    for models, level in zip(levels_of(whole, folder), whole.levels, strict=True):
        if not models:
            continue
        hits = []
        for some in ([level], models):
            scene = pr.Scene()
            for model in some:
                scene.add(model)
            found = []
            for side in ((0.45, -1.0, 0.35), (-1.0, 0.3, 0.2), (0.1, 0.2, 1.0)):
                bounds = np.quantile(whole.points.world, [0.01, 0.99], axis=0)
                camera = pr.Camera.frame(bounds, side, size=(300, 300))
                found.append(scene.intersect(*camera.rays()))
            hits.append([np.concatenate([getattr(one, name) for one in found]) for name in ("t", "normal", "color")])
        (t, normal, color), (t2, normal2, color2) = hits
        hit, hit2 = np.isfinite(t), np.isfinite(t2)
        assert hit.sum() > 20_000
        assert (hit != hit2).mean() < 1e-4
        seen = hit & hit2
        apart = np.abs(t[seen] - t2[seen]) > 1e-3 * np.median(level.radii)
        assert apart.mean() < 1e-3
        assert (np.abs(normal - normal2)[seen].max(axis=1) > 1e-2).mean() < 1e-3
        assert (np.abs(color - color2)[seen].max(axis=1) > 1e-2).mean() < 1e-3


def test_no_part_is_shown_twice(both: tuple[pr.Model, Path]) -> None:
    """The surfaces that rays can hit in levels of two parts overlap only by rounding."""
    boxes = [model.surface_bounds for model in levels_of(*both)[0]]
    for k, one in enumerate(boxes):
        for other in boxes[:k]:
            size = np.minimum(one[1], other[1]) - np.maximum(one[0], other[0])
            assert (size <= 1e-3 * (one[1] - one[0]).max()).any()


def brightness(models: list[pr.Model], bounds: np.ndarray) -> np.ndarray:
    """Return the brightness of each pixel in the light of a sun."""
    scene = pr.Scene()
    for model in models:
        scene.add(model, material=pr.Diffuse(0.8))
    scene.add_light(pr.SunLight((0.5, 0.7, -1)))
    camera = pr.Camera.frame(bounds, (0.45, -1, 0.35), size=(150, 150))
    return pr.render(scene, camera, pr.Settings("phong"))[..., :3].max(axis=2)


@pytest.mark.long
def test_no_shadows_lie_along_cuts_between_two_levels(tmp_path: Path) -> None:
    """The surfaces of two levels differ in height: the step must not block rays from the lower one."""
    model = pr.Model(pr.procedural("statue", 8 * SIZE))
    split(model, tmp_path / "a.pointray", SIZE)
    finer, coarser = (
        [
            pr.Model.load(tmp_path / "a.pointray" / part["levels"][k]["name"])
            for part in parts_of(tmp_path / "a.pointray")
        ]
        for k in range(2)
    )
    for models in (finer, coarser):
        assert all(model.tree.noise.any() for model in models)
    alone = [brightness(models, model.bounds) for models in (finer, coarser)]
    odd = [brightness([*finer[k::2], *coarser[1 - k :: 2]], model.bounds) for k in range(2)]
    dark = [(both < 0.3 * np.minimum(*alone)).sum() for both in odd]
    assert sum(dark) <= 16  # without margins 44


@pytest.mark.long
def test_a_repeatedly_interrupted_run_can_be_resumed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Levels are built once, wherever the work was interrupted."""
    points, calls = pr.procedural("torus", 80_000), []
    for name in ("show_part", "coarsen_part", "support_part", "tree_part"):
        work = getattr(coarser, name)
        monkeypatch.setattr(coarser, name, lambda *rest, work=work: calls.append(rest) or work(*rest))
    large(points, tmp_path / "whole.pointray")
    put, left, all_calls = Columns.put, [0], len(calls)

    def counted(self: Columns, name: str, facts: Any) -> None:
        put(self, name, facts)
        left[0] -= name.startswith("level-")
        if not left[0]:
            raise KeyboardInterrupt

    calls.clear()
    for stop in (1, 8, 14, 17, 9):
        left[0] = stop
        with monkeypatch.context() as patch:
            patch.setattr(Columns, "put", counted)
            with pytest.raises(KeyboardInterrupt):
                large(points, tmp_path / "a.pointray")
    large(points, tmp_path / "a.pointray")
    assert len(calls) == all_calls
    first, again = parts_of(tmp_path / "whole.pointray"), parts_of(tmp_path / "a.pointray")
    assert sum(len(part["levels"]) for part in first) > 4
    for one, other in zip(first, again, strict=True):
        for entry, entry2 in zip(one["levels"], other["levels"], strict=True):
            assert entry | {"sha256": 0} == entry2 | {"sha256": 0}
            models = [pr.Model.load(tmp_path / folder / entry["name"]) for folder in ("whole.pointray", "a.pointray")]
            for a, b in zip(models[0].tree, models[1].tree, strict=True):
                np.testing.assert_array_equal(a, b)


@pytest.mark.long
def test_memory_is_bounded_by_a_part(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No stage of the levels reads more rows at once than a part with its margin has."""
    read, most, inside = Column.__getitem__, [0], [False]

    def counted(self: Column, rows: Any) -> Any:
        out = read(self, rows)
        if inside[0] and "boxes" not in self.name:
            most[0] = max(most[0], len(out))
        return out

    def stage(*arguments: Any) -> Any:
        inside[0] = True
        try:
            return write(*arguments)
        finally:
            inside[0] = False

    import pointray.model.out_of_core.finish as finish_module

    write = finish_module.write_levels
    monkeypatch.setattr(Column, "__getitem__", counted)
    monkeypatch.setattr(finish_module, "write_levels", stage)
    monkeypatch.setattr(coarser, "sample_of", lambda count: [slice(0, min(4096, count))])
    large(pr.procedural("torus", 400_000), tmp_path / "a.pointray")
    assert len(parts_of(tmp_path / "a.pointray")) == 25
    assert SIZE <= most[0] < 2 * SIZE


@pytest.mark.long
def test_parts_of_other_densities_have_the_levels_that_make_them_smaller(
    tmp_path: Path, rng: np.random.Generator
) -> None:
    """In sparse parts fine cells contain one point each: the first level of such a part is coarser."""
    x, z = rng.uniform(0, 1, (2, 90_000))
    scale = np.where(np.arange(len(x)) < 60_000, 0.05, 1.0)
    positions = np.column_stack([scale * x, scale * z, 0.0 * x])
    split(
        pr.Model(pr.Points(positions, np.tile([0.0, 0, 1], (len(x), 1))), scatter="surface"),
        tmp_path / "a.pointray",
        SIZE,
    )
    finest = [part["levels"][0]["points"] / part["points"] for part in parts_of(tmp_path / "a.pointray")[:-1]]
    spacing = [part["levels"][0]["spacing"] for part in parts_of(tmp_path / "a.pointray")[:-1]]
    # 2 / 3 plus the margin: 0.69 to 0.71 for 50 clouds. A level that saves nothing has 1.05, with its margin.
    assert max(finest) < 0.8
    assert max(spacing) > 4 * min(spacing)


def test_parts_may_have_no_levels(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scan, folder = tmp_path / "a.ply", tmp_path / "a.pointray"
    pr.write(scan, pr.procedural("sphere", 20_000))
    words = ["prepare", str(scan), "-o", f"{folder}/", "--part-points", "20000", "--no-levels"]
    assert execute(words) == 0
    assert not any(part["levels"] for part in parts_of(folder))
    assert not list(folder.glob("part-*-*"))


def test_a_part_that_is_too_small_has_no_levels(tmp_path: Path) -> None:
    split(pr.Model(pr.procedural("sphere", SIZE + 100)), tmp_path / "a.pointray", SIZE)
    first, last = parts_of(tmp_path / "a.pointray")
    assert first["levels"] and not last["levels"] and last["points"] == 100 < LEAST_POINTS


def test_the_spaces_of_parts_share_all_space_and_hold_their_points(rng: np.random.Generator) -> None:
    points = pr.procedural("torus", 3 * SIZE)
    model = pr.Model(points)
    splats = splats_of(model.tree, model.radii)
    plan = plan_of([shown(splats, SIZE, part) for part in range(3)], splats.radii, SIZE)
    cells = cells_of(plan)
    places = rng.uniform(-9, 9, (5000, 3))
    inside = (places[:, None] >= cells[None, :, :3]) & (places[:, None] < cells[None, :, 3:])
    assert (inside.all(axis=2).sum(axis=1) == 1).all()
    for part, cell in enumerate(cells):
        mine = splats.positions[part * SIZE : (part + 1) * SIZE]
        assert ((mine >= cell[:3] - 1e-6) & (mine <= cell[3:] + 1e-6)).all()


BOXES = [
    np.array([-0.5, -2, -2, 0.3, 2, 2]),
    np.array([-2, -2, 0.9, 2, 2, 3.0]),
    np.array([-9.0] * 3 + [9.0] * 3),
    np.array([5.0, 5, 5, 6, 6, 6]),  # nothing inside
]


@pytest.fixture(scope="module")
def sphere() -> pr.Model:
    return pr.Model(pr.procedural("sphere", 40_000))


@pytest.mark.parametrize("box", BOXES, ids=range(4))
def test_a_tree_within_a_box_has_the_surface_in_it_and_no_other(box: np.ndarray, sphere: pr.Model) -> None:
    """This holds if whole ranges of splats lie outside."""
    points, model = sphere.points, sphere
    splats = splats_of(model.tree, model.radii)
    splats = splats._replace(rows=np.arange(len(splats.radii), dtype=np.int32))
    whole = build_tree(splats, model.settings, in_order=True)
    shared = whole.head[:6].copy(), float(np.partition(splats.radii, len(splats.radii) // 50)[len(splats.radii) // 50])
    tree = tree_within(splats, box, shared, model.settings)
    reach = find_surface_bounds(tree)
    if box[0] == 5:
        assert reach is None
        return
    assert reach is not None
    assert (reach[0] >= box[:3] - 1e-4).all() and (reach[1] <= box[3:] + 1e-4).all()
    np.testing.assert_array_equal(kd_order(splats.positions), np.arange(len(splats.positions)))
    assert len(stored_splats(tree).rows) <= len(splats.radii)
    scenes = [pr.Scene(), pr.Scene()]
    for scene, made in zip(scenes, (whole, tree), strict=True):
        kept = points.select(splats_of(model.tree, model.radii).rows)
        scene.add(PrebuiltModel(model.data._replace(tree=made, points=kept)))
    rays = pr.Camera.frame(model.bounds, (0.3, -1, 0.5), size=(120, 120)).rays()
    one, other = (scene.intersect(*rays) for scene in scenes)
    where = np.asarray(one.position)
    within = np.isfinite(one.t) & (where >= box[:3] + 1e-3).all(axis=-1) & (where <= box[3:] - 1e-3).all(axis=-1)
    assert within.sum() > 100
    np.testing.assert_allclose(np.asarray(other.t)[within], np.asarray(one.t)[within], rtol=1e-5)
