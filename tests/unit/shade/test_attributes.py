"""Colour by attribute: maps, ranges, colours between points, kinds of pictures, and bad input."""

import sys

import numpy as np
import pytest

import pointray as pr
from helpers.marks import long
from helpers.matplotlib_maps import map_of_matplotlib
from pointray.base.choices import COLORMAPS
from pointray.cli import execute
from pointray.image.tone import linear_to_srgb, srgb_to_linear
from pointray.shade.colormaps import colormap, shows_classes

CAMERA = pr.Camera.look_at((0, -4, 0), (0, 0, 0), fov=32, size=(24, 24))
SMOOTH = [name for name in COLORMAPS if not shows_classes(name)]


@pytest.fixture(scope="module")
def model():
    """The unit sphere with all kinds of attributes and with colours."""
    points = pr.procedural("sphere", 6000)
    x = points.positions
    attributes = {
        "height": x[:, 2],
        "steps": np.floor(2 * x[:, 2] + 2),
        "half": np.where(x[:, 0] > 0, np.nan, 0.25),
        "endless": np.where(x[:, 0] > 0, np.inf, -np.inf),
        "place": x * (1, 2, 3),
        "odd": np.where(x[:, 0] > 0, 2.0, 6.0),
        "lost": np.full(6000, np.nan),
    }
    own = np.tile(np.uint8([10, 200, 30]), (6000, 1))
    return pr.Model(pr.Points(x, points.normals, own, attributes))


def constant(value):
    """The unit sphere with one value everywhere."""
    points = pr.procedural("sphere", 1500)
    return pr.Model(pr.Points(points.positions, points.normals, None, {"value": np.full(1500, value)}))


def seen(model, attribute, transform=None):
    """Return hits on a model coloured by an attribute, which rays hit, and their colours as sRGB levels."""
    scene = pr.Scene()
    scene.add(model, transform, pr.Diffuse(attribute))
    hits = scene.intersect(*CAMERA.rays(), attributes=list(model.points.attributes))
    hit = hits.instance >= 0
    assert hit.mean() > 0.3
    return hits, hit, np.rint(255 * linear_to_srgb(hits.color[hit])).astype(int)


def color_at(name, share):
    """The colour of a map at 0..1, as matplotlib chooses it, in levels."""
    table = colormap(name)
    return table[np.minimum((np.asarray(share) * len(table)).astype(int), len(table) - 1)].astype(int)


# ---------------------------------------------------------------------------------------------------- the maps


@pytest.mark.parametrize("name", COLORMAPS)
def test_color_maps_equal_those_of_matplotlib(name):
    pytest.importorskip("matplotlib")
    for each in (name, name + "_r"):
        found, want = colormap(each).astype(int), map_of_matplotlib(each).astype(int)
        assert found.shape == want.shape and np.abs(found - want).max() <= 1


def test_other_maps_come_from_matplotlib(monkeypatch):
    pytest.importorskip("matplotlib")
    for name in ("Spectral", "jet_r", "Set1"):
        assert np.abs(colormap(name).astype(int) - map_of_matplotlib(name)).max() <= 1
    assert shows_classes("Set1") and not shows_classes("Spectral")
    with pytest.raises(ValueError, match="'rainbows'.*viridis.*tab20"):
        pr.Attribute("height", "rainbows")
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(ValueError, match="'Pastel1'.*viridis.*tab20.*pip install"):
        pr.Attribute("height", "Pastel1")


# -------------------------------------------------------------------------------------------- what color shows


@pytest.mark.parametrize("value", [0.0, *map(long, (95 / 256, 0.3, 0.5, 1.0, -7.0)), 171 / 256, 9.0])
def test_a_constant_value_has_its_color_to_one_level(value, tmp_path):
    from PIL import Image

    for name in ("viridis", "turbo", "RdBu"):
        scene = pr.Scene()
        scene.add(constant(value), material=pr.Diffuse(pr.Attribute("value", name, (0, 1))))
        image = pr.render(scene, CAMERA, pr.Settings("color"))
        pr.write_image(tmp_path / "a.png", image)
        shown = np.asarray(Image.open(tmp_path / "a.png")).astype(int)
        shown = shown[shown[..., 3] == 255][:, :3]
        assert len(shown) > 100 and np.abs(shown - color_at(name, np.clip(value, 0, 1))).max() <= 1


@pytest.mark.parametrize("name", SMOOTH)
def test_the_map_is_followed(model, name):
    """The colour at a hit is that of the map at the blended value."""
    hits, hit, shown = seen(model, pr.Attribute("height", name, (-1, 1)))
    share = hits.attributes["height"][hit] / 2 + 0.5
    steps = np.stack([color_at(name, np.clip(share + e, 0, 1)) for e in (-1e-3, 0, 1e-3)])
    assert (np.abs(shown - steps).max(axis=2).min(axis=0) <= 1).all()
    assert len(np.unique(shown, axis=0)) > 50


def test_values_are_blended_not_colors():
    """Between red and blue points the map's white is seen, and all colours are on the map."""
    points = pr.procedural("sphere", 1500)
    side = (points.positions[:, 0] > 0) + 0.5  # whole numbers would be categories
    shown = seen(
        pr.Model(pr.Points(points.positions, points.normals, None, {"side": side})), pr.Attribute("side", "RdBu")
    )[2]
    away = np.abs(shown[:, None] - colormap("RdBu").astype(int)).max(axis=2).min(axis=1)
    assert away.max() <= 1 and (shown.min(axis=1) > 200).any()


def test_classes_are_not_blended(model):
    """No 4 appears between classes 2 and 6; the class is that of the splat with the most weight."""
    for name, color in (("tab10", [2, 6]), ("tab20", [2, 6])):
        hits, hit, shown = seen(model, pr.Attribute("odd", name))
        want = colormap(name).astype(int)[color]
        assert {tuple(c) for c in shown} == {tuple(c) for c in want}
        of_point = model.points.attributes["odd"][hits.point[hit]].astype(int)
        assert (shown == colormap(name).astype(int)[of_point]).all()


def test_class_colors_repeat_and_start_at_the_range():
    for value, given, color in ((13, None, 3), (25, (20, 29), 5), (-4, (0, 9), 0), (70, (0, 9), 9), (5.4, None, 5)):
        shown = seen(constant(value), pr.Attribute("value", "tab10", given))[2]
        assert (shown == colormap("tab10").astype(int)[color]).all()


def test_points_without_a_value_are_grey(model):
    hits, hit, shown = seen(model, pr.Attribute("half", "viridis", (0, 1)))
    x = hits.position[hit][:, 0]
    assert (shown[x > 0.1] == 128).all() and (shown[x < -0.1] == color_at("viridis", 0.25)).all()
    grey = (shown == 128).all(axis=1)
    assert np.isin(grey, (True, False)).all() and np.abs(x[grey].min()) < 0.1 and np.abs(x[~grey].max()) < 0.1
    assert {tuple(c) for c in shown[~grey]} == {tuple(color_at("viridis", 0.25))}  # NaN must not darken its neighbours
    assert (seen(model, pr.Attribute("lost"))[2] == 128).all()
    assert (seen(model, pr.Attribute("lost", "tab10"))[2] == 128).all()


def test_most_of_the_weight_decides_whether_there_is_a_value(model):
    """The grey begins at x = 0, within half a spacing, and not where the first or the last value ends."""
    scene = pr.Scene()
    scene.add(model, material=pr.Diffuse(pr.Attribute("half", "viridis", (0, 1))))
    x, z = np.random.default_rng(0).uniform(-0.15, 0.15, (2, 4000))
    color = scene.intersect(np.stack([x, np.full(4000, -4.0), z], axis=1), [0, 1, 0]).color
    grey = np.ptp(color, axis=1) == 0
    assert x[~grey].max() < 0.04 and x[grey].min() > -0.04
    assert abs(grey.mean() - (x > 0).mean()) < 0.04


def test_infinite_values_are_clamped(model):
    hits, hit, shown = seen(model, pr.Attribute("endless", "gray", (0, 1)))
    x = hits.position[hit][:, 0]
    assert (shown[x > 0.1] == 255).all() and (shown[x < -0.1] == 0).all()


def test_columns_and_lengths(model):
    hits, hit, shown = seen(model, pr.Attribute("place[2]", "gray", (-3, 3)))
    assert np.abs(shown[:, 0] - 255 * (hits.position[hit][:, 2] + 1) / 2).max() < 4
    hits, hit, shown = seen(model, pr.Attribute("place", "gray", (0, 4)))
    length = np.linalg.norm(hits.position[hit] * (1, 2, 3), axis=1)
    assert np.abs(shown[:, 0] - 255 * length / 4).max() < 6


@pytest.mark.parametrize("axis", "xyz")
def test_coordinates_are_the_worlds(model, axis):
    turn = np.array([[0.0, 0, 1.5, 0.3], [1.5, 0, 0, 0], [0, 1.5, 0, -0.2], [0, 0, 0, 1]])
    k = "xyz".index(axis)
    hits, hit, shown = seen(model, pr.Attribute(axis, "gray", (-2, 2)), turn)
    share = (hits.position[hit][:, k] + 2) / 4
    assert np.abs(shown[:, 0] - 255 * share).max() < 1.5


def test_coordinates_of_maps():
    """Colours are as smooth millions of metres away as at the origin."""
    points = pr.procedural("sphere", 3000)
    cloud = pr.Points(points.positions.astype(float) + (4.5e6, 5.4e6, 300), points.normals)
    scene = pr.Scene()
    scene.add(pr.Model(cloud), material=pr.Diffuse(pr.Attribute("y", "gray", (5.4e6 - 1, 5.4e6 + 1))))
    hits = scene.intersect(*pr.Camera.frame(scene.bounds, (1, 0, 0), size=(20, 20)).rays())
    hit = hits.instance >= 0
    shown = 255 * linear_to_srgb(hits.color[hit])[:, 0]
    assert hit.any() and np.abs(shown - 255 * (hits.position[hit][:, 1] - 5.4e6 + 1) / 2).max() < 1.5


def test_each_of_two_sheets_shows_its_own_values():
    x, y = np.meshgrid(np.linspace(-1, 1, 60), np.linspace(-1, 1, 60))
    flat = np.stack([x.ravel(), y.ravel(), np.zeros(3600)], axis=1)
    up = np.tile([0.0, 0, 1], (3600, 1))
    upper = np.repeat([1.0, 0.0], 3600)
    cloud = pr.Points(
        np.concatenate([flat, flat - (0, 0, 0.012)]), np.concatenate([up, -up]), None, {"upper": upper, "side": upper}
    )
    scene = pr.Scene()
    scene.add(pr.Model(cloud), material=pr.Diffuse(pr.Attribute("upper", "gray", (0, 1))))
    scene.add(pr.Model(cloud), [[1, 0, 0, 5], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]], pr.Diffuse(1))
    a, b = np.random.default_rng(0).uniform(-0.8, 0.8, (2, 500))
    for height, color in ((3, 1), (-3, 0)):
        hits = scene.intersect(np.stack([a, b, np.full(500, height)], axis=1), [0, 0, -np.sign(height)])
        assert (hits.instance == 0).all() and (hits.color == color).all()


# --------------------------------------------------------------------------------------------------- the range


def test_the_range_is_chosen_from_percentiles(model):
    """The range is the 2nd to the 98th percentile; models that share a colour use their least and greatest."""
    height = model.points.attributes["height"]
    low, high = np.percentile(height, [2, 98])
    shifted = pr.Model(pr.Points(model.points.positions, model.points.normals, None, {"height": height + 5}))
    color = pr.Attribute("height", "magma")
    scene = pr.Scene()
    scene.add(model, material=pr.Diffuse(color))
    assert scene.shown_attributes == [pr.Attribute("height", "magma", (low, high))]
    number = scene.add(shifted, material=pr.Phong(color))
    (shown,) = scene.shown_attributes
    assert shown.range == (low, pytest.approx(high + 5)) and shown.colormap == "magma"
    scene.remove(number)
    assert scene.shown_attributes[0].range == (low, high)
    scene.update(0, material=pr.Diffuse())
    assert scene.shown_attributes == []


@pytest.mark.parametrize(
    ("values", "name", "want"),
    [
        (np.full(1500, 3.25), "viridis", (2.75, 3.75)),
        (np.full(1500, np.nan), "viridis", (0, 1)),
        (np.append(np.zeros(1499), 4.5), "viridis", (0, 4.5)),
        (np.append(np.full(1499, np.inf), 4.0), "viridis", (3.5, 4.5)),
        (np.arange(1500) % 7, "tab10", (0, 6)),
        (np.full(1500, np.nan), "tab10", (0, 1)),
    ],
)
def test_odd_values_have_a_range(values, name, want):
    points = pr.procedural("sphere", 1500)
    scene = pr.Scene()
    model = pr.Model(pr.Points(points.positions, points.normals, None, {"value": values}))
    scene.add(model, material=pr.Diffuse(pr.Attribute("value", name)))
    assert scene.shown_attributes[0].range == want


def test_the_range_of_a_coordinate_moves_with_the_instance(model):
    scene, shift = pr.Scene(), np.eye(4)
    shift[2, 3] = 10
    number = scene.add(model, material=pr.Diffuse(pr.Attribute("z")))
    before = scene.shown_attributes[0].range
    assert before == pytest.approx(np.percentile(model.points.positions[:, 2], [2, 98]), abs=1e-6)
    scene.update(number, transform=shift)
    assert scene.shown_attributes[0].range == pytest.approx(np.add(before, 10))


# ------------------------------------------------------------------------------------------- instances, pictures


def test_each_instance_has_its_own_colors(model):
    """One model in its own colours and by three attributes, with materials that differ only in these."""
    scene, colors = pr.Scene(), [None, *(pr.Attribute(name, "gray", (-1, 1)) for name in ("height", "z", "steps"))]
    for k, color in enumerate([*colors, colors[1]]):
        shift = np.eye(4)
        shift[0, 3] = 3 * k
        scene.add(model, shift, pr.Diffuse(color))
    found = []
    for k in range(5):
        origins, directions = CAMERA.rays()
        hits = scene.intersect(origins + (3 * k, 0, 0), directions)
        assert set(np.unique(hits.instance)) == {-1, k}
        found.append(hits.color)
    hit = found[0].any(axis=-1)
    assert np.allclose(found[0][hit], srgb_to_linear(np.uint8([10, 200, 30])), atol=1e-6)
    assert np.abs(linear_to_srgb(found[1]) - linear_to_srgb(found[2])).max() < 0.02
    assert (found[3] != found[1]).any() and np.allclose(found[4], found[1], atol=1e-5)
    scene.update(1, material=pr.Diffuse(colors[3]))
    origins, directions = CAMERA.rays()
    assert np.allclose(scene.intersect(origins + (3, 0, 0), directions).color, found[3], atol=1e-5)


def test_memory_is_allocated_only_for_used_attributes(model):
    scene = pr.Scene()
    scene.add(model)
    number = scene.add(model, material=pr.Diffuse(pr.Attribute("z")))
    assert scene.snapshot().world.map_positions.size == 0
    scene.update(number, material=pr.Diffuse(pr.Attribute("height")))
    map_positions = scene.snapshot().world.map_positions
    assert map_positions.size == len(model.tree.order) < 1.1 * 6000
    scene.update(number, transform=2 * np.eye(4) - np.diag([0, 0, 0, 1]))
    assert scene.snapshot().world.map_positions is map_positions  # not made again because something moved
    scene.remove(number)
    assert scene.snapshot().world.map_positions.size == 0


MATERIALS = {
    "diffuse": lambda color: pr.Diffuse(color),
    "phong": lambda color: pr.Phong(color, 0.3, 30),
    "principled": lambda color: pr.Principled(color, 0.4, 0.5),
    "emissive": lambda color: pr.Emissive((0.1, 0.2, 0.3), color),
    "mirror": lambda color: pr.Mirror(color),
}


@pytest.mark.parametrize("name", MATERIALS)
@pytest.mark.parametrize("integrator", ["phong", "ao", "path"])
def test_every_integrator_and_material(name, integrator):
    """A constant attribute gives the same picture as its colour."""
    pictures, sphere = [], constant(0.7)
    linear = srgb_to_linear(colormap("plasma")[int(0.7 * 256)])
    for color in (pr.Attribute("value", "plasma", (0, 1)), linear):
        scene = pr.Scene()
        scene.add(sphere, material=MATERIALS[name](color))
        scene.add(pr.Plane((0, 0, -1), (0, 0, 1)))
        scene.add_light(pr.SunLight((0.5, 1, -1)))
        pictures.append(pr.render(scene, CAMERA, pr.Settings(integrator, spp=2)))
    assert pictures[0].std() > 0.01
    np.testing.assert_allclose(pictures[0], pictures[1], atol=1e-5)


def test_the_albedo_layer_contains_attribute_colors():
    scene = pr.Scene()
    scene.add(constant(0.7), material=pr.Diffuse(pr.Attribute("value", "plasma", (0, 1))))
    layers = pr.render_layers(scene, CAMERA)
    hit = layers["instance"] >= 0
    np.testing.assert_allclose(
        layers["albedo"][hit], np.tile(srgb_to_linear(colormap("plasma")[179]), (hit.sum(), 1)), atol=1e-6
    )


def test_a_saved_model_keeps_its_attributes(model, tmp_path):
    model.save(tmp_path / "a.pointray")
    one = seen(model, pr.Attribute("height"))[2]
    other = seen(pr.Model.load(tmp_path / "a.pointray"), pr.Attribute("height"))[2]
    assert np.array_equal(one, other)


# -------------------------------------------------------------------------------------------------- bad input


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda m: pr.Attribute(3), "name"),
        (lambda m: pr.Attribute("height", None), "colormap"),
        (lambda m: pr.Attribute("height", range=(1, 1)), "lower first"),
        (lambda m: pr.Attribute("height", range=(0, np.inf)), "finite"),
        (lambda m: pr.Attribute("height", range="wide"), "two numbers"),
        (lambda m: pr.Attribute("height", range=(1, 2, 3)), "two numbers"),
        (lambda m: pr.Attribute("z", "tab10"), "classes"),
        (lambda m: pr.Scene().add(m, material=pr.Diffuse(pr.Attribute("width"))), r"'width'.*height.*place\[0..2\].*z"),
        (lambda m: pr.Scene().add(m, material=pr.Phong(pr.Attribute("place[3]"))), r"'place\[3\]'"),
        (lambda m: pr.Scene().add(m, material=pr.Mirror(pr.Attribute("height[0]"))), r"'height\[0\]'"),
        (lambda m: pr.Scene().add(pr.Plane((0, 0, 0), (0, 0, 1)), None, pr.Diffuse(pr.Attribute("z"))), "plane"),
    ],
)
def test_bad_attributes_are_refused(model, make, says):
    with pytest.raises(ValueError, match=says):
        make(model)


def test_an_update_that_is_refused_changes_nothing(model):
    scene = pr.Scene()
    number = scene.add(model, material=pr.Diffuse(pr.Attribute("height")))
    with pytest.raises(ValueError, match="width"):
        scene.update(number, material=pr.Diffuse(pr.Attribute("width")))
    assert [a.name for a in scene.shown_attributes] == ["height"]


# --------------------------------------------------------------------------------------------- the command line


@pytest.fixture
def scan(tmp_path, model):
    pr.write(tmp_path / "scan.ply", model.points)
    return tmp_path / "scan.ply"


def rendered(scan, *more):
    """The middle row of a picture, in levels."""
    from PIL import Image

    picture = scan.with_name("a.png")
    view = ["--eye", "0,-4,0", "--target", "0,0,0", "--size", "24x24", "--spp", "1", "--integrator", "color"]
    assert execute(["render", str(scan), "-o", str(picture), *view, *more]) == 0
    return np.asarray(Image.open(picture))[..., :3].astype(int)


def test_color_by_shows_an_attribute(scan):
    z, height = (rendered(scan, "--color-by", f"{name}:gray:-1,1") for name in ("z", "height"))
    assert 150 < z[5, 12, 0] < 255 and z[18, 12, 0] < 90 and np.abs(z - height).max() <= 3  # the scan has a 'height'
    assert (rendered(scan, "--color-by", "odd:tab10")[12, 6] == colormap("tab10")[6]).all()
    assert (rendered(scan, "--color-by", "lost")[12, 12] == 128).all()


def test_height_is_along_up(model, tmp_path, capsys):
    pr.write(tmp_path / "scan.ply", pr.Points(model.points.positions, model.points.normals))
    tall = rendered(tmp_path / "scan.ply", "--color-by", "height:gray:-1,1", "--eye", "-4,0,0", "--up", "0,2,0")
    assert 150 < tall[5, 12, 0] < 255 and tall[18, 12, 0] < 90
    arguments = ["render", str(tmp_path / "scan.ply"), "-o", str(tmp_path / "a.png"), "--color-by", "height"]
    assert execute([*arguments, "--up", "0,1,1"]) == 2
    assert "along x, y or z" in capsys.readouterr().err


@pytest.mark.parametrize("value", ["z:magenta", "z:gray:1", "z:gray:2,1", "z:gray:a,b", ":gray", "z:gray:1,2:3"])
def test_color_by_is_checked_first(value, tmp_path, capsys):
    """Bad options are reported before the file is read, which is empty."""
    (tmp_path / "broken.ply").write_text("nothing")
    arguments = ["render", str(tmp_path / "broken.ply"), "-o", str(tmp_path / "a.png"), "--color-by", value]
    assert execute(arguments) == 2
    output = capsys.readouterr().err
    assert "broken.ply" not in output and output.count("\n") == 1


def test_an_unknown_attribute_is_reported_before_the_model_is_made(scan, monkeypatch, capsys):
    monkeypatch.setattr(pr, "Model", None)
    assert execute(["render", str(scan), "-o", str(scan.with_name("a.png")), "--color-by", "width"]) == 2
    output = capsys.readouterr().err
    assert "'width'" in output and "height, " in output and output.count("\n") == 1
