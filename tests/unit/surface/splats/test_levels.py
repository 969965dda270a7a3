"""Levels of detail: their points, which one is shown, and that distant views flicker less."""

import warnings

import numpy as np
import pytest

import pointray as pr
from helpers.marks import long
from pointray.cli import execute
from pointray.engine.kernels.records import INSTANCE, SHAPE_ROW
from pointray.engine.kernels.tree import ROW
from pointray.rendering.lod import at_distance
from pointray.surface.splats.groups import groups_in_cells
from pointray.surface.splats.levels import coarsen


@pytest.fixture(scope="module")
def statue():
    model = pr.Model(pr.procedural("statue", 100_000))
    model.make_levels()
    return model


def moved(x, scale=1.0):
    out = np.diag([scale, scale, scale, 1.0])
    out[:3, 3] = x
    return out


@pytest.mark.long
def test_each_level_is_coarser_than_the_previous(statue):
    counts = [len(statue.points), *(len(level.points) for level in statue.levels)]
    *counts, spheres = counts  # the last level is drawn as spheres
    assert len(counts) >= 4 and min(counts) >= 700 and 50 <= spheres < counts[-1] / 1.5
    for fine, coarse in zip(counts, counts[1:], strict=False):
        assert 2.5 < fine / coarse < 5
    for level in statue.levels[:-1]:
        some = level.points.world[:: 1 + len(level.points) // 2000]
        away = np.abs(pr.procedural_distance("statue", some))
        assert np.median(away) < 0.1 * np.median(level.radii)
        assert np.abs(level.bounds - statue.bounds).max() < 2 * np.median(level.radii)
    nbytes, levels, statue.levels = statue.nbytes, statue.levels, ()
    alone, statue.levels = statue.nbytes, levels
    assert alone < nbytes < 1.6 * alone


def test_cells_average_each_side_apart():
    """Both sides of a thin wall stay apart, and attributes and colours are means."""
    x = np.array([[0, 0, 0], [0.4, 0, 0], [0.1, 0.1, 0.1], [5, 5, 5]], float)
    normals = np.array([[0, 0, 1], [0, 0, 1], [0, 0, -1], [1, 0, 0]], float)
    colors = np.array([[0, 0, 0], [100, 100, 100], [10, 20, 30], [255, 0, 0]], np.uint8)
    points = pr.Points(x, normals, colors, {"height": [1.0, 3.0, 7.0, 9.0]}, origin=(0, 0, 0))
    coarse = coarsen(points, np.ones(4, np.float32), 1.0)[0]
    assert np.allclose(coarse.positions, [[0.2, 0, 0], [0.1, 0.1, 0.1], [5, 5, 5]])
    assert coarse.normals.tolist() == [[0, 0, 1], [0, 0, -1], [1, 0, 0]]
    assert coarse.colors.tolist() == [[71, 71, 71], [10, 20, 30], [255, 0, 0]]
    assert coarse.attributes["height"].tolist() == [2, 7, 9]


def test_groups_are_those_of_cells_and_sides():
    """Compared with NumPy: which rows form a group, their means, and the extents of supports."""
    rng = np.random.default_rng(7)
    x, normals = rng.normal(size=(2, 20_000, 3)).astype(np.float32)
    normals[:21] = -np.repeat(np.eye(3, dtype=np.float32), 7, axis=0)
    radii, colors = rng.uniform(0.1, 0.5, 20_000).astype(np.float32), rng.integers(0, 255, (20_000, 3))
    cell = np.floor((x - x.min(axis=0)) / np.float32(0.3))
    axis = np.abs(normals).argmax(axis=1)
    key = np.column_stack([cell, axis, normals[np.arange(20_000), axis] < 0])
    _, first, ids, counts = np.unique(key, axis=0, return_index=True, return_inverse=True, return_counts=True)
    ids, at = ids.ravel(), np.argsort(first)
    groups = groups_in_cells(x, normals, 0.3)
    assert len(groups.starts) == len(first) + 1
    assert groups.order[groups.starts[:-1]].tolist() == np.sort(first).tolist()
    for rows in np.split(groups.order, groups.starts[1:-1])[::50]:
        assert rows.tolist() == np.flatnonzero(ids == ids[rows[0]]).tolist()
    for values in (x, colors.astype(np.float32), radii):
        sums = np.zeros((len(first), *values.shape[1:]))
        np.add.at(sums, ids, values)
        np.testing.assert_allclose(groups.mean(values), (sums.T / counts).T[at], atol=1e-9, rtol=1e-9)
    middles = np.empty((len(first), 3), np.float32)
    middles[at] = groups.mean(x)
    most = np.zeros(len(first))
    np.maximum.at(most, ids, np.linalg.norm(x - middles[ids], axis=1) + radii)
    np.testing.assert_allclose(groups.reach(x, radii, middles[at]), most[at], rtol=1e-5)


def test_supports_of_levels_stay_within_those_they_replace():
    """Isolated parts, like leaves of a plant, hardly grow; closing the gaps between them gave 22 times the hits."""
    rng = np.random.default_rng(3)
    ball, up = pr.procedural("sphere", 30_000), np.array([0, 0.6, 0.8])
    away = rng.normal(scale=0.015, size=(200, 20, 3))
    isolated = (rng.uniform(-4, 4, (200, 1, 3)) + away - (away @ up)[..., None] * up).reshape(-1, 3)
    normals = np.concatenate([ball.normals, np.tile(up, (len(isolated), 1))])
    model = pr.Model(pr.Points(np.concatenate([ball.positions, isolated]), normals))
    model.make_levels()
    rays = pr.Camera.look_at((0, -14, 3), (0, 0, 0), size=(300, 300)).rays()

    def hit(shown):
        scene = pr.Scene()
        scene.add(shown)
        return np.isfinite(scene.intersect(*rays).t)

    whole = hit(model)
    for level in model.levels[:-1]:  # the last one is drawn as spheres
        seen = hit(level)
        grown = 0.2 if len(level.points) > 2000 else 1.0  # the last level's cells are wider than the isolated parts
        assert (seen & ~whole).sum() < grown * whole.sum() and (whole & ~seen).sum() < 0.03 * whole.sum()


def level_of(scene, camera, spp=1):
    world, levels = at_distance(scene.snapshot(), camera, spp)
    models = scene.snapshot().world.instances[SHAPE_ROW::INSTANCE]
    assert world.table.size == ROW * len(set(zip(models, levels, strict=True)))  # no tree that is not shown
    return levels.tolist()


@pytest.mark.parametrize("projection", ["perspective", "orthographic", "panorama"])
def test_distant_instances_use_coarser_levels(statue, projection):
    scene = pr.Scene()
    plain = pr.Model(pr.procedural("sphere", 3000))
    scene.add(plain)
    for k in range(6):
        scene.add(statue, moved((0, 4.0**k, 0)))
    camera = pr.Camera.look_at((0, -4, 1), (0, 0, 1), size=(300, 300), projection=projection)
    rows = level_of(scene, camera)
    assert rows[0] == 0  # has no levels
    seen = np.array(rows[1:])
    if projection == "orthographic":
        assert len(set(seen)) == 1
    else:
        assert seen[-1] == len(statue.levels) and (np.diff(seen) >= 0).all()
        assert seen[0] < seen[-1] or projection == "panorama"
    assert (np.array(level_of(scene, camera, 16)) <= rows).all()


def test_the_scale_of_an_instance_decides_its_level(statue):
    scene = pr.Scene()
    for scale in (0.01, 0.1, 1.0, 13.0):
        scene.add(statue, moved((0, 30, 0), scale))
    seen = level_of(scene, pr.Camera.look_at((0, -4, 1), (0, 0, 1), size=(300, 300)))
    assert seen[0] == len(statue.levels) and seen[-1] == 0 and sorted(seen, reverse=True) == seen


def test_levels_reduce_the_error_and_flicker_of_distant_views(statue):
    """They are closer to a converged picture than those of all points, and change less while the camera moves."""
    scene = pr.Scene()
    scene.add(statue)
    scene.add_light(pr.SunLight((0.5, 0.7, -1), 3))
    scene.background = 0.5

    def picture(k, **options):
        near = pr.Camera.frame(scene.bounds, size=(96, 96))
        target = np.array(near.target)
        eye = target + 3 * (np.array(near.eye) - target) + k * np.array([0.06, 0.036, 0])
        return np.clip(pr.render(scene, pr.Camera.look_at(eye, target, size=(96, 96)), pr.Settings(**options)), 0, 1)

    frames = {
        name: [picture(k, **options) for k in range(4)]
        for name, options in {"all": {"levels": False}, "levels": {}, "exact": {"spp": 64, "levels": False}}.items()
    }
    seen = np.abs(frames["exact"][0][..., 0] - 0.5) > 0.01

    def change(images):
        return np.mean([np.abs(a - b)[seen].mean() for a, b in zip(images, images[1:], strict=False)])

    motion = change(frames["exact"])
    assert change(frames["levels"]) - motion < 0.5 * (change(frames["all"]) - motion)
    errors = {name: np.sqrt(((frames[name][0] - frames["exact"][0])[seen] ** 2).mean()) for name in ("all", "levels")}
    assert errors["levels"] < 1.05 * errors["all"]


def test_levels_are_used_only_in_pictures_and_can_be_disabled(statue):
    scene = pr.Scene()
    scene.add(statue)
    far = pr.Camera.look_at((0, -60, 1), (0, 0, 1), size=(64, 64), fov=5)
    plain = pr.Scene()
    plain.add(pr.Model(statue.points, statue.radii))
    off = pr.render(scene, far, pr.Settings(levels=False))
    assert np.abs(off - pr.render(plain, far)).max() < 0.02
    assert np.abs(off - pr.render(scene, far)).max() > 0.02
    hits = scene.intersect(*far.rays())
    hit = hits.instance >= 0
    away = np.linalg.norm(statue.points.world[hits.point[hit]] - hits.position[hit], axis=1)
    assert away.max() < statue.radii.max()


@pytest.mark.parametrize("name, allowed", [long("z", 0.01), long("x", 0.01), ("wave", 0.02)])
def test_attribute_colours_of_levels_match_those_of_all_points(statue, name, allowed):
    """Colours by coordinates and by values equal those of many samples of all points, except at silhouettes."""
    scene = pr.Scene()
    x = statue.points.world
    points = pr.Points(x, statue.points.normals, attributes={"wave": np.sin(3 * x[:, 2]) + x[:, 0]})
    model = pr.Model(points, statue.radii)
    model.make_levels()
    scene.add(model, material=pr.Diffuse(pr.Attribute(name)))
    far = pr.Camera.look_at((0, -60, 1), (0, 0, 1), size=(64, 64), fov=5)
    assert level_of(scene, far)[0] >= 2
    exact = pr.render(scene, far, pr.Settings("color", spp=64, levels=False))
    inside = exact[..., 3] == 1
    picture = pr.render(scene, far, pr.Settings("color"))
    assert inside.mean() > 0.02
    assert np.abs(picture - exact)[inside].mean() < allowed
    assert np.abs(picture - pr.render(scene, far, pr.Settings("color", levels=False))).max() > 0


@pytest.mark.long
def test_each_instance_has_the_colours_of_its_level(statue):
    """With several levels, colourings and models at once, each looks as it does alone."""
    cameras = [pr.Camera.look_at((0, -d, 1), (0, 0, 1), size=(48, 48), fov=240 / d) for d in (5, 20, 60)]
    values = {"a": statue.points.world[:, 2], "b": statue.points.world[:, 0]}
    points = pr.Points(statue.points.world, statue.points.normals, attributes=values)
    model = pr.Model(points, statue.radii)
    model.make_levels()
    together = pr.Scene()
    ids = [together.add(model, moved((9 * k, 0, 0)), pr.Diffuse(pr.Attribute(n))) for k, n in enumerate("abx")]
    together.add(statue, moved((36, 0, 0)))
    for k, name in enumerate("abx"):
        alone = pr.Scene()
        alone.add(model, moved((9 * k, 0, 0)), pr.Diffuse(pr.Attribute(name)))
        for camera in cameras:
            there = np.array([9.0 * k, 0, 0])
            view = pr.Camera.look_at(camera.eye + there, camera.target + there, size=(48, 48), fov=camera.fov)
            for other in ids:
                together.update(other, transform=moved((9 * ids.index(other), 0, 0 if other == ids[k] else 1000)))
            np.testing.assert_array_equal(*(pr.render(s, view, pr.Settings("color")) for s in (alone, together)))


@pytest.mark.long
def test_levels_are_not_used_for_classes(statue):
    """Levels are not shown for classes, which have no mean, nor if they are newer than the colouring."""
    kinds = {"kind": (statue.points.world[:, 2] > 1).astype(float), "smooth": statue.points.world[:, 2]}
    points = pr.Points(statue.points.world, statue.points.normals, attributes=kinds)
    model = pr.Model(points, statue.radii)
    model.make_levels()
    scene = pr.Scene()
    far = pr.Camera.look_at((0, -60, 1), (0, 0, 1), size=(64, 64), fov=5)
    scene.add(model, material=pr.Diffuse(pr.Attribute("kind", "tab10")))
    assert level_of(scene, far) == [0]
    late, model.levels = model.levels, ()
    scene = pr.Scene()
    scene.add(model, material=pr.Diffuse(pr.Attribute("smooth")))
    before = pr.render(scene, far, pr.Settings("color"))
    model.levels = late
    assert level_of(scene, far) == [0]
    np.testing.assert_array_equal(pr.render(scene, far, pr.Settings("color")), before)


def test_means_of_attributes_ignore_nan():
    x = np.array([[0, 0, 0], [0.1, 0, 0], [0.2, 0, 0], [5, 5, 5], [5.1, 5, 5], [5.2, 5, 5]], float)
    values = [1.0, np.nan, 3.0, np.nan, np.inf, 9.0]
    points = pr.Points(x, np.tile([0, 0, 1.0], (6, 1)), attributes={"v": values}, origin=(0, 0, 0))
    coarse = coarsen(points, np.ones(6, np.float32), 1.0)[0]
    np.testing.assert_array_equal(coarse.attributes["v"], [2.0, np.nan])


# ------------------------------------------------------------------------------------------- on the command line

SMALL = ["--size", "48x36", "--spp", "1"]


@pytest.fixture(scope="module")
def scan(tmp_path_factory):
    path = tmp_path_factory.mktemp("levels") / "statue.ply"
    pr.write(path, pr.procedural("statue", 20_000))
    return path


@pytest.fixture(scope="module")
def saved(scan):
    """The scan as a model with levels."""
    path = scan.with_name("whole.pointray")
    assert execute(["prepare", str(scan), "-o", str(path)]) == 0
    return path


def frames(scan, name, *more):
    """Return the pictures of a film of two frames."""
    folder = scan.with_name(name)
    film = ["--seconds", "1", "--fps", "2"]
    assert execute(["animate", str(scan), "-o", str(folder), *film, *SMALL, *more]) == 0
    return [path.read_bytes() for path in sorted(folder.iterdir())]


@pytest.mark.long
def test_films_of_a_scan_use_levels(scan, monkeypatch):
    made = []
    real = pr.Model.make_levels
    monkeypatch.setattr(pr.Model, "make_levels", lambda model, *output: (made.append(model), real(model, *output)))
    with_levels, without = frames(scan, "with"), frames(scan, "without", "--no-levels")
    assert len(made) == 1 and all(a != b for a, b in zip(with_levels, without, strict=True))
    # No levels are made if none is shown, or if a surface is asked for.
    assert frames(scan, "near", "--size", "240x180") and frames(scan, "disc", "--surface", "disc")
    assert len(made) == 1


def test_saved_models_have_levels(scan, saved, tmp_path):
    plain, whole = tmp_path / "plain.pointray", saved
    assert execute(["prepare", str(scan), "-o", str(plain), "--no-levels"]) == 0
    assert pr.Model.load(plain).levels == () and len(pr.Model.load(whole).levels) >= 2
    pictures = {}
    for name, model, more in (("plain", plain, []), ("levels", whole, []), ("off", whole, ["--no-levels"])):
        more = [*SMALL, "--light", "headlight", *more]
        assert execute(["render", str(model), "-o", str(tmp_path / f"{name}.png"), *more]) == 0
        pictures[name] = (tmp_path / f"{name}.png").read_bytes()
    assert pictures["off"] == pictures["plain"] != pictures["levels"]


def test_scene_files_use_the_levels_of_saved_models(saved, tmp_path):
    file = tmp_path / "scene.toml"
    for word in ("", "levels = true"):
        file.write_text(f'[models.a]\nfile = "{saved.as_posix()}"\n{word}\n[[instances]]\nmodel = "a"\n')
        for name, more in (("on", []), ("off", ["--no-levels"])):
            assert execute(["render", str(file), "-o", str(tmp_path / f"{name}.png"), *SMALL, *more]) == 0
        assert (tmp_path / "on.png").read_bytes() != (tmp_path / "off.png").read_bytes()


def test_normals_of_levels_face_as_those_of_their_points():
    """The sides of a thin body face opposite directions in every level, without a warning."""
    across = np.linspace(-1, 1, 160)
    x, y = (a.ravel() for a in np.meshgrid(across, across))
    body = np.concatenate([np.column_stack([x, y, np.full(len(x), z)]) for z in (-0.04, 0.04)])
    normals = np.repeat([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]], len(x), axis=0)
    model = pr.Model(pr.Points(body, normals))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        model.make_levels()
    assert len(model.levels) >= 3
    inner = np.random.default_rng(2).uniform(-0.7, 0.7, (500, 2))
    for level in model.levels[:-1]:  # the last one is drawn as spheres
        scene = pr.Scene()
        scene.add(level)
        for side in (-1.0, 1.0):
            start = np.column_stack([inner, np.full(len(inner), 2.0 * side)])
            hits = scene.intersect(start, np.tile([0.0, 0.0, -side], (len(inner), 1)))
            assert np.isfinite(hits.t).all()
            assert (hits.normal[:, 2] * side > 0.9).all()
