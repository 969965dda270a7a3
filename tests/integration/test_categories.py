"""Categories (few distinct integers) are never blended; legends show their names and colours."""

import numpy as np
import pytest
from PIL import Image

import pointray as pr
from pointray.cli import execute
from pointray.cloud.points import categories_of
from pointray.image.legend import _entries, draw_legend
from pointray.image.tone import linear_to_srgb
from pointray.shade.attributes import category_colors, category_name


@pytest.fixture(scope="module")
def scene():
    """A sphere with classes ground below and water above (2 and 9 of ASPRS), and its height."""
    points = pr.procedural("sphere", 3_000)
    high = points.positions[:, 2] > 0
    of_points = {"classification": np.where(high, 9, 2).astype(np.float32), "height": points.positions[:, 2]}
    scene = pr.Scene()
    scene.add(pr.Model(pr.Points(points.positions, points.normals, None, of_points)))
    return scene


def test_hits_have_a_category_and_no_mean(scene):
    rays = pr.Camera.frame(scene.bounds, size=(64, 64)).rays()
    hits = scene.intersect(*rays, attributes=["classification", "height"])
    hit = hits.instance >= 0
    found = hits.attributes["classification"]
    assert set(np.unique(found[hit])) == {2, 9} and np.isnan(found[~hit]).all()
    points = scene.models[0].points
    assert np.array_equal(found[hit], points.attributes["classification"][hits.point[hit]])
    assert (hits.attributes["height"][hit] != points.attributes["height"][hits.point[hit]]).mean() > 0.9  # blended


def test_pictures_show_their_colours_and_no_others(scene):
    view = pr.Camera.frame(scene.bounds, size=(64, 64))
    painted = scene.copy()
    painted.update(next(iter(painted.shapes)), material=pr.Diffuse(pr.Attribute("classification")))
    image = pr.render(painted, view, pr.Settings("color"))
    shown = painted.shown_attributes[0]
    assert shown.values == (2, 9) and shown.range is None
    colors = {tuple(c) for c in np.rint(255 * linear_to_srgb(image[image[..., 3] > 0][:, :3])).astype(int).tolist()}
    assert colors == {(0xAA, 0x55, 0x00), (0x55, 0xFF, 0xFF)} == {tuple(c) for c in category_colors(shown).tolist()}
    painted.update(next(iter(painted.shapes)), material=pr.Diffuse(pr.Attribute("classification", categories=False)))
    blended = pr.render(painted, view, pr.Settings("color"))
    assert len(np.unique(blended[..., :3].reshape(-1, 3), axis=0)) > 3


@pytest.mark.parametrize(
    ("values", "found"),
    [
        (np.arange(1000) % 3, (0, 1, 2)),
        (np.arange(1000) % 3 - 1.0, (-1, 0, 1)),
        (np.arange(1000) % 33, None),
        (np.arange(1000) % 3 + 0.5, None),
        (np.where(np.arange(5000) == 4321, np.nan, 1.0), None),
        (np.where(np.arange(5000) == 4321, 1.4, 1.0), None),
        (np.array([0.0, 1.0, 2.0]), None),
        (np.array([True, True, False]), (False, True)),
        (np.array([2**53, 2**53 + 1] * 20), (2**53, 2**53 + 1)),
        (np.zeros((100, 2)), None),
    ],
)
def test_categories_are_recognised_by_values(values, found):
    assert categories_of(values) == found


@pytest.mark.parametrize("name", ["classification", "scalar_Classification", "point_source_id", "scan"])
def test_labels_are_always_categories(name):
    assert categories_of(np.uint8([2, 6, 64]), name) == categories_of(np.float32([2, 64, 6]), name) == (2, 6, 64)
    assert categories_of(np.arange(256), name) == tuple(range(256))
    assert categories_of(np.arange(257), name) is categories_of(np.float32([2, 2.5]), name) is None
    assert categories_of(np.array([2.0, np.nan]), name) is None
    assert categories_of(np.arange(40), "intensity") is categories_of(np.arange(3), "class") is None


@pytest.mark.parametrize("name", ["intensity", "scalar_Intensity", "Reflectance"])
def test_measurements_are_not_categories(name):
    values = np.arange(1000) % 3
    assert categories_of(values, name) is None and categories_of(values, "user_data") == (0, 1, 2)


def test_a_category_has_its_name_or_its_number():
    assert category_name(pr.Attribute("classification"), 2) == "2 ground"
    assert category_name(pr.Attribute("scalar_Classification"), 6) == "6 building"
    assert category_name(pr.Attribute("classification"), 77) == category_name(pr.Attribute("label"), 77) == "77"


def test_bools_are_shown_as_no_and_yes():
    shown = pr.Attribute("withheld", categories=(True, False))
    assert [category_name(shown, value) for value in shown.values] == ["no", "yes"]
    points = pr.procedural("sphere", 2000)
    scene = pr.Scene()
    flags = {"withheld": points.positions[:, 0] > 0}
    scene.add(pr.Model(points.changed(attributes=flags)), material=pr.Diffuse(pr.Attribute("withheld")))
    assert scene.shown_attributes[0].values == (False, True) and scene.shown_attributes[0] == shown
    hits = scene.intersect((0.5, -3, 0), (0, 1, 0), attributes="withheld")
    assert hits.attributes["withheld"].dtype == np.bool_ and hits.attributes["withheld"]


def many_classes(count, n=4000):
    """Return a sphere in `count` belts of classes, the highest of them user-defined."""
    points = pr.procedural("sphere", n)
    belt = np.clip(((points.positions[:, 2] + 1) / 2 * count).astype(int), 0, count - 1)
    classes = np.linspace(0, 255, count).astype(np.uint8)
    return points.changed(colors=None, attributes={"classification": classes[belt]}), classes


@pytest.mark.parametrize("count", [2, 12, 60, 256])
def test_las_classes_are_never_mixed(count):
    """Pictures show only the colours of classes, none in between, even for more than 32."""
    points, _ = many_classes(count)
    scene = pr.Scene()
    scene.add(pr.Model(points), material=pr.Diffuse(pr.Attribute("classification")))
    shown = scene.shown_attributes[0]
    present = np.unique(points.attributes["classification"])
    assert shown.values == tuple(present.tolist())
    colors = category_colors(shown)
    assert len(np.unique(colors, axis=0)) == len(present)
    image = pr.render(scene, pr.Camera.frame(scene.bounds, size=(64, 64)), pr.Settings("color"))
    seen = np.rint(255 * linear_to_srgb(image[image[..., 3] == 1][:, :3])).astype(int)
    assert {tuple(c) for c in seen.tolist()} <= {tuple(c) for c in colors.tolist()}
    assert len(np.unique(seen, axis=0)) > min(count, 40) / 4


@pytest.mark.parametrize("name", ["classification", "label"])
@pytest.mark.parametrize("count", [10, 20, 40, 256])
def test_colours_of_categories_differ(name, count):
    colors = category_colors(pr.Attribute(name, categories=range(count))).astype(int)
    apart = np.abs(colors[:, None] - colors).max(axis=-1) + 999 * np.eye(count, dtype=int)
    assert apart.min() >= (3 if count > 40 else 16)


def test_few_points_may_have_classes():
    few = pr.procedural("sphere", 3000).select(np.arange(0, 3000, 300))
    scene = pr.Scene()
    kinds = {"classification": np.arange(10, dtype=np.uint8)}
    scene.add(pr.Model(few.changed(attributes=kinds)), material=pr.Diffuse(pr.Attribute("classification")))
    assert scene.shown_attributes[0].values == tuple(range(10))
    assert category_name(scene.shown_attributes[0], 6) == "6 building"


@pytest.mark.parametrize(("name", "dtype"), [("return_number", np.uint8), ("intensity", np.uint16)])
def test_other_integers_are_blended_if_there_are_many(name, dtype):
    points = pr.procedural("sphere", 3000)
    values = np.arange(3000) % 5 + 1 if name == "return_number" else np.arange(3000)
    scene = pr.Scene()
    scene.add(
        pr.Model(points.changed(attributes={name: values.astype(dtype)})), material=pr.Diffuse(pr.Attribute(name))
    )
    assert scene.shown_attributes[0].values == ((1, 2, 3, 4, 5) if name == "return_number" else ())
    hits = scene.intersect((0, -3, 0.1), (0, 1, 0), attributes=name)
    assert hits.attributes[name].dtype == (np.uint8 if name == "return_number" else np.float32)


@pytest.mark.parametrize("count", [3, 33, 256])
@pytest.mark.parametrize("height", [120, 400])
def test_a_legend_of_many_classes_counts_those_that_do_not_fit(count, height):
    rows, length = _entries(pr.Attribute("classification", categories=range(count)), max(height / 40, 10.0), height)
    assert length <= height and length / len(rows) >= 8
    assert len(rows) == count or rows[-1].text == f"and {count - len(rows) + 1} more"
    image = np.zeros((height, 300, 3), np.uint8)
    assert draw_legend(image, pr.Attribute("classification", categories=range(count))).any()


def test_render_draws_a_legend_of_classes(tmp_path):
    points, _ = many_classes(40)
    pr.write(tmp_path / "a.ply", points)
    assert execute(
        ["render", str(tmp_path / "a.ply"), "-o", str(tmp_path / "a.png"), "--color-by", "classification", "--legend",
         "--size", "200x160", "--light", "headlight"]
    ) == 0  # fmt: skip
    image = np.asarray(Image.open(tmp_path / "a.png"))
    assert image.shape[1] >= 200


@pytest.mark.parametrize("categories", [[], [1.5], True, "water", [[1, 2]]])
def test_bad_categories_are_refused(categories):
    with pytest.raises(ValueError, match="categories"):
        pr.Attribute("label", categories=categories)


@pytest.mark.parametrize("attribute", [pr.Attribute("z", range=(0, 1)), pr.Attribute("label", categories=[1, 2, 6])])
def test_a_legend_in_a_file_does_not_cover_the_scan(tmp_path, attribute):
    image = np.random.default_rng(1).random((120, 200, 3)).astype(np.float32)
    pr.write_image(tmp_path / "without.png", image)
    pr.write_image(tmp_path / "with.png", image, legend=attribute)
    without, found = (np.asarray(Image.open(tmp_path / f"{name}.png")) for name in ("without", "with"))
    assert found.shape[0] == 120 and 225 < found.shape[1] < 300
    assert np.array_equal(found[:, :200, :3], without[..., :3])
    strip = found[:, 200:, :3].astype(int)
    assert (strip == 255).all(axis=-1).mean() > 0.5
    if attribute.values:
        for color in category_colors(attribute).astype(int):
            assert (np.abs(strip - color).max(axis=-1) == 0).sum() > 20
    assert draw_legend(image, attribute).shape == image.shape
