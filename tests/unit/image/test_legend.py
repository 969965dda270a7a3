"""Legends: their position, colours and ticks, on all kinds of pictures, and bad input."""

import numpy as np
import pytest
from PIL import Image

import pointray as pr
from helpers.clouds import sphere_points
from pointray.cli import execute
from pointray.image.legend import draw_legend, labels, ticks
from pointray.image.tone import linear_to_srgb
from pointray.shade.colormaps import colormap

HEIGHT = pr.Attribute("height", "viridis", (0, 10))


def blank(width, height, level, channels=3):
    return np.full((height, width, channels), level, np.uint8)


def column_of(drawn, name):
    """A column of the picture that shows a map's colours, and its rows as entries of the map."""
    table = colormap(name).astype(int)

    def away(colors):
        return np.abs(colors[:, None, :3].astype(int) - table).max(axis=-1)

    x = int(np.flatnonzero(away(drawn[len(drawn) // 2]).min(axis=1) <= 2)[1])
    column = away(drawn[:, x])
    rows = np.flatnonzero(column.min(axis=1) <= 2)
    return x, rows, column.argmin(axis=1)[rows]


@pytest.mark.parametrize("size", [(800, 600), (320, 240), (1920, 1080), (120, 90)])
@pytest.mark.parametrize("level", [0, 255])
def test_a_bar_from_the_greatest_to_the_least(size, level):
    before = blank(*size, level)
    drawn = draw_legend(before, HEIGHT)
    assert drawn.shape == before.shape and drawn.dtype == np.uint8 and (before == level).all()
    x, rows, entries = column_of(drawn, "viridis")
    assert x > 0.6 * size[0] and 0.35 < len(rows) / size[1] < 0.55
    assert entries[0] > 245 and entries[-1] < 10 and (np.diff(entries) <= 0).all()
    changed = (drawn != level).any(axis=2)
    assert 0.005 < changed.mean() < 0.3 and not changed[:, : size[0] // 3].any()
    assert not changed[[0, -1]].any() and not changed[:, -1].any()


@pytest.mark.parametrize("level", [0, 90, 255])
def test_text_is_dark_on_light(level):
    """Text beside the bar is dark on a light panel, on any background."""
    drawn = draw_legend(blank(800, 600, level), HEIGHT).astype(int)
    x, rows, _ = column_of(drawn, "viridis")
    beside = drawn[rows[0] : rows[-1], x + 14 : x + 40].mean(axis=2)
    ink, panel = beside.min(), np.median(beside)
    assert ink < 60 and panel > 200


def test_ticks_are_drawn_at_their_values():
    drawn = draw_legend(blank(800, 600, 255), pr.Attribute("height", range=(0.5, 10))).astype(int)
    x, rows, _ = column_of(drawn, "viridis")
    right = x + np.flatnonzero((drawn[300, x:] < 60).all(axis=1))[0]  # the bar's edge
    marks = np.flatnonzero((drawn[:, right + 3] < 60).all(axis=1))
    values = 10 - 9.5 * (marks - rows[0]) / (rows[-1] - rows[0])
    assert values == pytest.approx(np.arange(10, 1, -2), abs=0.1)


@pytest.mark.parametrize(
    ("low", "high", "texts"),
    [
        (0, 1, "0.0 0.2 0.4 0.6 0.8 1.0"),
        (-0.96, 0.96, "-0.8 -0.6 -0.4 -0.2 0.0 0.2 0.4 0.6 0.8"),
        (212, 1480, "400 600 800 1000 1200 1400"),
        (5.4e6, 5.4e6 + 500, "5400000 5400100 5400200 5400300 5400400 5400500"),
        (0, 1e-5, "0 2e-06 4e-06 6e-06 8e-06 1e-05"),
        (0.1, 0.1001, "0.10000 0.10002 0.10004 0.10006 0.10008 0.10010"),
        (-3e9, 3e9, "-3e+09 -2e+09 -1e+09 0 1e+09 2e+09 3e+09"),
    ],
)
def test_ticks_are_round(low, high, texts):
    assert labels(ticks(low, high)) == texts.split()


@pytest.mark.parametrize("seed", range(50))
def test_ticks_of_any_range(seed):
    rng = np.random.default_rng(seed)
    low = rng.normal() * 10.0 ** rng.integers(-6, 7)
    high = low + 10.0 ** rng.uniform(-3, 3) * max(abs(low), 1e-6)
    for most in (2, 5, 9):
        found = ticks(low, high, most)
        assert 1 <= len(found) <= most and low - 1e-9 * abs(low) <= found[0] <= found[-1] <= high + 1e-9 * abs(high)
        texts = labels(found)
        assert len(set(texts)) == len(texts)


@pytest.mark.parametrize(("name", "last"), [("tab10", 6), ("tab20", 18), ("tab10", 300)])
@pytest.mark.parametrize("size", [(800, 600), (320, 240)])
def test_classes_are_drawn_as_colour_fields(name, last, size):
    drawn = draw_legend(blank(*size, 30), pr.Attribute("class", name, (0, last)))
    count = min(last + 1, len(colormap(name)))
    for k, color in enumerate(colormap(name)):
        assert ((drawn == color).all(axis=2).sum() > 25) == (k < count)  # smaller areas are text
    centers = [np.argwhere((drawn == colormap(name)[k]).all(axis=2)).mean(axis=0) for k in range(count)]
    assert (np.diff([y for y, _ in centers]) < 0).all() and np.ptp([x for _, x in centers]) < 2


def test_a_long_name_fits():
    drawn = draw_legend(
        blank(320, 240, 255), pr.Attribute("a name that is far too long for any legend " * 3, range=(0, 1))
    )
    assert (drawn[:, :20] == 255).all() and (drawn != 255).any()


def test_legends_are_drawn_on_all_kinds_of_pictures(tmp_path):
    """Linear and transparent pictures get the same legend and are unchanged beside it."""
    shown = draw_legend(blank(160, 120, 0), HEIGHT).astype(int)
    linear = draw_legend(np.zeros((120, 160, 3), np.float32), HEIGHT)
    assert linear.dtype == np.float32
    x, rows, _ = column_of(shown, "viridis")
    np.testing.assert_allclose(255 * linear_to_srgb(linear)[rows, x], shown[rows, x], atol=1)
    clear = draw_legend(np.zeros((120, 160, 4), np.float32), HEIGHT)
    assert (clear[..., 3] > 0).any() and (clear[0, 0] == 0).all() and clear[rows, x, 3] == pytest.approx(1)
    levels = draw_legend(np.zeros((120, 160, 4), np.uint8), HEIGHT)
    assert levels.shape == (120, 160, 4) and (levels[rows, x, 3] == 255).all()
    for name in ("a.png", "a.jpg"):
        pr.write_image(tmp_path / name, np.zeros((120, 160, 3), np.float32), exposure=3, curve="filmic", legend=HEIGHT)
        written = np.asarray(Image.open(tmp_path / name)).astype(int)
        beside = draw_legend(blank(160, 120, 0), HEIGHT, beside=True).astype(int)
        assert np.abs(written - beside).mean() < (0 if name == "a.png" else 3) + 1e-9


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: draw_legend(blank(40, 30, 0), pr.Attribute("height")), "shown_attributes"),
        (lambda: draw_legend(np.zeros((30, 40)), HEIGHT), r"\(30, 40\)"),
        (lambda: draw_legend(np.zeros((30, 40, 3), np.int64), HEIGHT), "int64"),
        (lambda: pr.write_image("a.exr", np.zeros((3, 4, 3)), legend=HEIGHT), "legend"),
    ],
)
def test_a_bad_legend_is_refused(make, says):
    with pytest.raises(ValueError, match=says):
        make()


# --------------------------------------------------------------------------------------------- the command line


def test_render_draws_a_legend(tmp_path, capsys):
    rows = sphere_points(3000)
    pr.write(tmp_path / "scan.ply", pr.Points(rows, rows))
    pictures = {}
    for more in ("", "--legend"):
        arguments = ["render", str(tmp_path / "scan.ply"), "-o", str(tmp_path / "a.png"), "--color-by", "height"]
        assert execute([*arguments, "--size", "160x120", "--spp", "1", "--exposure", "1", *more.split()]) == 0
        pictures[more] = np.asarray(Image.open(tmp_path / "a.png")).astype(int)
    _, rows, entries = column_of(pictures["--legend"][:, 160:], "viridis")
    assert len(rows) > 40 and entries[0] > 245 and entries[-1] < 10
    assert np.array_equal(pictures[""], pictures["--legend"][:, :160])
    for wrong in (["--legend"], ["--legend", "--color-by", "z", "-o", str(tmp_path / "a.npz")]):
        capsys.readouterr()
        assert execute(["render", str(tmp_path / "missing.ply"), "-o", str(tmp_path / "a.png"), *wrong]) == 2
        output = capsys.readouterr().err
        assert "--legend" in output and "missing" not in output and output.count("\n") == 1
