"""Splats that were read keep their shapes: needles, ellipsoids and discs in all directions."""

import warnings

import numpy as np
import pytest

import pointray as pr
from helpers.gaussian_files import packed, save, trained
from helpers.splat_files import Cloud, cloud, covariances
from helpers.spz_files import plain, rows
from pointray.io.files import read, write
from pointray.io.formats.splats import _own_shapes
from pointray.io.formats.splats._own_shapes import SMALL_W, THICKNESS, with_large_w

EXTENSIONS = pytest.mark.parametrize("extension", [".ply", ".splat", ".spz"])


def needles(rng, n=300, **fields):
    """Splats of trained scenes, most of them much longer than wide."""
    scale = np.log(rng.permuted(np.tile([0.3, 0.01, 0.003], (n, 1)), axis=1) * rng.uniform(0.5, 2, (n, 1)))
    given = {"xyz": rng.normal(size=(n, 3)), "harmonic": rng.uniform(-1, 1, (n, 3)), "scale": scale}
    return Cloud(**{**given, "opacity": rng.uniform(-1, 3, n), "turn": rng.normal(size=(n, 4)), **fields})


def splats_of(made, **changes):
    """Points as readers make them, with other attributes; None removes one."""
    attributes = {"opacity": made.alpha, "scale": np.exp(made.scale), "rotation": made.turn} | changes
    kept = {name: values for name, values in attributes.items() if values is not None}
    return pr.Points(made.xyz, made.axes, made.rgb.astype(np.uint8), kept)


def saved(tmp_path, points, name="a.ply"):
    """Write splats; return what is read again and the messages."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        pr.write_splats(tmp_path / name, points)
    return read(tmp_path / name, opacity=0), [str(one.message).partition(f"{name}: ")[2] for one in caught]


def check_shapes(points, made, near):
    """Compare covariances, which do not depend on the order and the signs of the axes."""
    found = covariances(points.attributes["scale"], points.attributes["rotation"])
    np.testing.assert_allclose(found, covariances(np.exp(made.scale), made.turn), rtol=0, atol=near)
    sizes = [np.sort(values, axis=1) for values in (np.log(points.attributes["scale"]), made.scale)]
    np.testing.assert_allclose(*sizes, rtol=0, atol=1e-5 if near < 1e-4 else 0.5 / 16 + 0.003)


@EXTENSIONS
@pytest.mark.parametrize("source", ["a.ply", "a.splat", "a.spz", "packed.ply"])
def test_needles_keep_their_shape(tmp_path, rng, source, extension):
    """Each format stores them as exactly as its bytes allow: 1 in 128 of .splat, 6% of the size of SPZ."""
    made = needles(rng)
    if source == "a.ply":
        save(tmp_path / source, trained(made))
    else:
        data = {"a.splat": rows, "a.spz": plain, "packed.ply": packed}[source](made)
        (tmp_path / source).write_bytes(data)
    first = read(tmp_path / source, opacity=0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # nothing is lost
        pr.write_splats(tmp_path / f"b{extension}", first)
    again = read(tmp_path / f"b{extension}", opacity=0)
    check_shapes(again, made, 1e-5 if (source, extension) == ("a.ply", ".ply") else 0.08)
    before = Cloud(made.xyz, 0, 0, np.log(first.attributes["scale"]), first.attributes["rotation"])
    check_shapes(again, before, {".ply": 1e-5, ".splat": 0.02, ".spz": 0.08}[extension])
    assert np.abs((again.normals * first.normals).sum(axis=1)).min() > 0.999


@EXTENSIONS
def test_writing_again_changes_nothing(tmp_path, rng, extension):
    first, _ = saved(tmp_path, splats_of(needles(rng)), f"a{extension}")
    again, lost = saved(tmp_path, first, f"b{extension}")
    assert lost == []
    np.testing.assert_allclose(again.attributes["opacity"], first.attributes["opacity"], rtol=1e-5)
    np.testing.assert_allclose(*(np.sort(one.attributes["scale"], axis=1) for one in (first, again)), rtol=1e-5)
    shapes = [covariances(one.attributes["scale"], one.attributes["rotation"]) for one in (first, again)]
    np.testing.assert_allclose(*shapes, atol={".ply": 1e-6, ".splat": 0.02, ".spz": 0.02}[extension])


def test_a_ply_and_a_splat_file_keep_the_order_of_the_axes(tmp_path, rng):
    made = needles(rng)
    for name in ("a.ply", "a.splat"):
        points, _ = saved(tmp_path, splats_of(made), name)
        np.testing.assert_allclose(np.log(points.attributes["scale"]), made.scale, atol=1e-5)


def test_a_small_w_is_avoided_by_other_axes(rng):
    turns = rng.normal(size=(1000, 4)).astype(np.float32)
    turns[:24] = _own_shapes.CUBE
    turns[24:48] = -_own_shapes.CUBE
    turns /= np.linalg.norm(turns, axis=1, keepdims=True)
    scales = rng.uniform(0.01, 1, (1000, 3)).astype(np.float32)
    found, turned = with_large_w(scales, turns)
    assert turned[:, 0].min() >= SMALL_W and (np.abs(turns[:, 0]) < SMALL_W).mean() > 0.4
    assert turned[np.abs(turns[:, 0]) < SMALL_W, 0].min() > 0.85
    np.testing.assert_allclose(covariances(found, turned), covariances(scales, turns), atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(turned, axis=1), 1, rtol=1e-5)
    same = np.abs(turns[:, 0]) >= SMALL_W
    np.testing.assert_array_equal(found[same], scales[same])


def test_flat_splats_have_a_thickness_below_their_width(tmp_path, rng):
    """Also needles of 2D Gaussian Splatting: the mean of both widths is larger than the smaller one."""
    made = needles(rng)
    made.scale[:, :2] = np.log([1.0, 0.001])
    points, _ = saved(tmp_path, read(save(tmp_path / "a.ply", trained(made, without=["scale_2"])), opacity=0), "b.ply")
    made.scale[:, 2] = np.log(THICKNESS * 0.001)
    check_shapes(points, made, 1e-5)
    assert np.abs((points.normals * made.axes).sum(axis=1)).min() > 0.9999


@pytest.mark.parametrize("turns", [None, np.zeros(300), np.zeros((300, 3))])
def test_needles_without_a_rotation_become_round_with_a_message(tmp_path, rng, turns):
    made = needles(rng)
    made.scale[:50] = np.log([0.1, 0.1, 0.01])
    points, lost = saved(tmp_path, splats_of(made, rotation=turns))
    assert lost == ["makes 250 elongated splats round, because the points have no attribute rotation of four columns"]
    scale = np.sort(points.attributes["scale"], axis=1)
    np.testing.assert_allclose(scale[:, 1], scale[:, 2], rtol=1e-5)
    wanted = np.sort(np.exp(made.scale), axis=1)
    np.testing.assert_allclose(scale[:, 2], np.sqrt(wanted[:, 1] * wanted[:, 2]), rtol=1e-5)
    assert np.abs((points.normals * made.axes).sum(axis=1)).min() > 0.9999


def test_invalid_rotations_and_scales_are_reported(tmp_path, rng):
    made = needles(rng)
    turns, scales = made.turn.copy(), np.exp(made.scale)
    turns[0], turns[1], turns[2] = 0, np.nan, np.inf
    scales[10, 1], scales[11], scales[12, 0], scales[13, 2], scales[14] = np.nan, 0, -1, np.inf, [1e300, 1, 1]
    scales[20, 1] = 0  # as thin as can be
    points, lost = saved(tmp_path, splats_of(made, rotation=turns, scale=scales))
    assert lost == ["leaves out 5 splats with an invalid scale", "does not rotate 3 splats with an invalid rotation"]
    assert len(points) == 295 and np.isfinite(points.attributes["scale"]).all()
    np.testing.assert_allclose(points.attributes["scale"][:3], scales[:3], rtol=1e-5)
    np.testing.assert_array_equal(points.attributes["rotation"][:3], [[1, 0, 0, 0]] * 3)
    assert 0 < points.attributes["scale"].min() < 1e-37


def test_normals_are_not_needed(tmp_path, rng):
    made = needles(rng)
    points = splats_of(made).with_normals(None)
    back, lost = saved(tmp_path, points)
    assert lost == [] and np.abs((back.normals * made.axes).sum(axis=1)).min() > 0.9999


@pytest.mark.parametrize("extension", [".las", ".csv", ".pcd", ".npz", ".e57", ".glb"])
def test_other_formats_store_the_rotation(tmp_path, extension):
    points = read(save(tmp_path / "a.ply", trained(cloud(50))), opacity=0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        write(tmp_path / f"b{extension}", points)
        back = read(tmp_path / f"b{extension}").attributes
    values = back.get("rotation", back.get("rotation_0"))
    wanted = points.attributes["rotation"]
    np.testing.assert_allclose(values, wanted if values.ndim > 1 else wanted[:, 0], atol=1e-6)


def test_attributes_that_are_not_used_are_named(tmp_path, rng):
    made = needles(rng)
    for attributes, wanted in (
        ({"radius": np.full(300, -1.0)}, ["ignores the attribute radius: expected one positive number per point"]),
        ({"scale": np.full((300, 3), 1e-300)}, ["ignores the attribute scale: expected two or three positive numbers"]),
        ({"scale": np.full((300, 3), 1e300)}, ["ignores the attribute scale: expected two or three positive numbers"]),
        (
            {"scale": np.exp(made.scale), "radius": np.full(300, 0.1)},
            ["ignores the attribute scale, because there is an attribute radius"],
        ),
        ({"rotation": made.turn, "radius": np.full(300, 0.1)}, ["cannot store the attribute rotation"]),
    ):
        points = pr.Points(made.xyz, made.axes, attributes=attributes)
        with pytest.warns(UserWarning, match="a.splat") as caught:
            write(tmp_path / "a.splat", points)
        found = [str(one.message).partition("a.splat: ")[2] for one in caught]
        assert len(found) == 1 and found[0].startswith(wanted[0])
        assert np.isfinite(read(tmp_path / "a.splat").attributes["scale"]).all()
