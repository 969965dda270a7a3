"""Categories, which are few whole numbers, are never blended; legends show their names and swatches."""

import numpy as np
import pytest
from PIL import Image

import pointray as pr
from pointray.data import categories_of
from pointray.image.legend import draw_legend
from pointray.image.tone import linear_to_srgb
from pointray.shade.attributes import category_colors, category_name


@pytest.fixture(scope="module")
def scene():
    """A sphere of ground below and water (ASPRS's 2 and 9) above, and its height."""
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
        (np.zeros((100, 2)), None),
    ],
)
def test_what_are_categories(values, found):
    assert categories_of(values) == found


def test_their_names():
    assert category_name(pr.Attribute("classification"), 2) == "2 ground"
    assert category_name(pr.Attribute("scalar_Classification"), 6) == "6 building"
    assert category_name(pr.Attribute("classification"), 77) == category_name(pr.Attribute("label"), 77) == "77"


@pytest.mark.parametrize("categories", [[], [1.5], True, "water", [[1, 2]]])
def test_bad_categories(categories):
    with pytest.raises(ValueError, match="categories"):
        pr.Attribute("label", categories=categories)


@pytest.mark.parametrize("attribute", [pr.Attribute("z", range=(0, 1)), pr.Attribute("label", categories=[1, 2, 6])])
def test_a_legend_in_a_file_covers_nothing(tmp_path, attribute):
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
