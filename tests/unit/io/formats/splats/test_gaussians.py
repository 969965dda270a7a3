"""PLY files of Gaussian splats: the training format, and compressed."""

import re
import warnings

import numpy as np
import pytest
from plyfile import PlyData, PlyElement

from helpers.gaussian_files import packed, save, trained
from helpers.places import shared_model
from helpers.splat_files import check, cloud, damaged
from pointray.cloud.normals.estimate import repair_normals
from pointray.io.files import headers, read, write
from pointray.io.formats._source import HEAD, MAYBE, SURE, Request
from pointray.io.formats.ply import _binary, ply
from pointray.io.formats.splats import compressed_gaussians, gaussians


@pytest.mark.parametrize(("text", "order"), [(True, "="), (False, "<"), (False, ">")])
@pytest.mark.parametrize("dtype", ["f4", "f8"])
def test_files_of_the_training_format_are_read(tmp_path, text, order, dtype):
    made = cloud(300)
    points = read(save(tmp_path / "a.ply", trained(made, dtype=dtype), text=text, order=order), opacity=0)
    check(points, made)
    assert set(points.attributes) == {"opacity", "scale", "rotation"}
    assert {values.dtype for values in points.attributes.values()} == {np.dtype(np.float32)}


def test_transparent_splats_are_left_out(tmp_path):
    made = cloud(300)
    path = save(tmp_path / "a.ply", trained(made))
    for opacity in (0.1, 0.5, 0.9):
        check(read(path, opacity=opacity), made, made.alpha >= opacity)
    check(read(path), made, made.alpha >= 0.1)
    with pytest.warns(UserWarning, match=f"^[^ ]*{(made.alpha < 0.5).sum()} of 300 splats are left out: their opac"):
        read(path, opacity=0.5)
    with pytest.raises(ValueError, match=r"none of its 300 splats has an opacity of 1 or more: the maximum is 0\.99"):
        read(path, opacity=1)


def test_the_number_of_transparent_splats_is_reported(tmp_path):
    made = cloud(300)
    path = save(tmp_path / "a.ply", trained(made))
    with gaussians.GaussianSource(path, Request(opacity=0.5)) as source:
        assert source.listing.count is None
        assert source.listing.rows == source.listing.facts["splats"] == 300
        kept = sum(len(chunk.positions) for chunk in source.chunks())
    assert source.listing.facts["transparent"] == 300 - kept == (made.alpha < 0.5).sum()
    with gaussians.GaussianSource(path, Request(opacity=0)) as source:
        assert source.listing.count == 300


def test_wide_rows_are_read_in_smaller_chunks(tmp_path, monkeypatch):
    monkeypatch.setattr(_binary, "CHUNK_BYTES", 104 * 40)
    made = cloud(100)
    path = save(tmp_path / "a.ply", trained(made))
    check(read(path, opacity=0), made)
    with gaussians.GaussianSource(path, Request(opacity=0)) as source:
        assert [len(chunk.positions) for chunk in source.chunks()] == [40, 40, 20]


def test_flat_splats_have_their_third_axis_as_normal(tmp_path):
    made = cloud(100)
    points = read(save(tmp_path / "a.ply", trained(made, without=["scale_2"])), opacity=0)
    made.scale[:, 2] = -20
    assert np.abs((points.normals * made.axes).sum(axis=1)).min() > 0.9999
    np.testing.assert_allclose(np.log(points.attributes["scale"]), made.scale[:, :2], atol=1e-5)


def test_other_properties_are_kept_and_other_elements_skipped(tmp_path):
    made = cloud(100)
    label = np.arange(100, dtype=np.uint16)
    more = [PlyElement.describe(np.zeros(3, [("f", "f4")]), name) for name in ("extrinsic", "intrinsic")]
    path = save(tmp_path / "a.ply", more[0], trained(made, label=label, red=label.astype("u1")), more[1])
    points = read(path, opacity=0)
    check(points, made)
    assert set(points.attributes) == {"opacity", "scale", "rotation", "label"}
    assert points.attributes["label"].dtype == np.uint16
    np.testing.assert_array_equal(points.attributes["label"], label)


@pytest.mark.parametrize("name", ["opacity", "rot_0", "rot_3", "f_dc_2", "scale_1", "x"])
def test_missing_properties_are_named(tmp_path, name):
    path = save(tmp_path / "a.ply", trained(cloud(10), without=[name]))
    with pytest.raises(ValueError, match=r"properties x, y, z of" if name == "x" else f"of splats: {name}$"):
        read(path)


def test_splats_with_nan_are_read(tmp_path):
    made = cloud(20)
    made.xyz[0] = made.harmonic[1] = made.turn[2] = np.nan
    made.opacity[3], made.turn[4], made.scale[5] = np.nan, 0, np.nan
    made.opacity[6:], made.harmonic[6] = 90, np.inf
    path = save(tmp_path / "a.ply", trained(made))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        points = read(path, opacity=0)
    assert len(points) == 20
    assert np.isnan(points.positions[0]).all()
    np.testing.assert_array_equal(points.colors[[1, 6]], [[128] * 3, [255] * 3])
    np.testing.assert_array_equal(points.normals[[2, 4]], 0)
    np.testing.assert_array_equal(points.attributes["rotation"][[2, 4]], 0)
    assert len(read(path, opacity=0.99)) == 14 + (made.alpha[:6] > 0.99).sum()


def test_quaternions_of_any_length_are_normalised(tmp_path):
    made = cloud(3)
    made.turn *= [[1e-30], [1e30], [1e18]]
    points = read(save(tmp_path / "a.ply", trained(made)), opacity=0)
    assert np.abs((points.normals * made.axes).sum(axis=1)).min() > 0.9999


def test_a_file_that_is_cut_off_is_reported(tmp_path):
    path = save(tmp_path / "a.ply", trained(cloud(100)))
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(ValueError, match="is cut off: 100 vertices of 104 bytes"):
        read(path, strict=True)


def test_splats_are_recognised_by_contents(tmp_path):
    head = save(tmp_path / "a.ply", trained(cloud(3))).read_bytes()[:HEAD]
    assert gaussians.recognise(head, tmp_path / "a.txt") > ply.recognise(head, tmp_path) == SURE > MAYBE
    assert compressed_gaussians.recognise(head, tmp_path) == 0
    head = packed(cloud(3))[:HEAD]
    assert compressed_gaussians.recognise(head, tmp_path / "a.txt") > ply.recognise(head, tmp_path)
    assert gaussians.recognise(head, tmp_path) == gaussians.recognise(b"f_dc_0 rot_0", tmp_path) == 0


def test_splats_are_written_as_points(tmp_path):
    points = read(save(tmp_path / "a.ply", trained(cloud(50))), opacity=0)
    write(tmp_path / "b.ply", points)
    again = read(tmp_path / "b.ply")
    np.testing.assert_array_equal(again.normals, points.normals)
    np.testing.assert_array_equal(again.attributes["opacity"], points.attributes["opacity"])


def test_repairing_normals_sets_the_signs_of_splats(tmp_path):
    rng = np.random.default_rng(3)
    made = cloud(3000)
    made.xyz /= np.linalg.norm(made.xyz, axis=1, keepdims=True)
    made.scale[:] = [-3, -3, -8]  # discs on a sphere that randomly face in or out
    up = made.xyz * rng.choice([-1, 1], (3000, 1))
    made.turn = np.column_stack([1 + up[:, 2], -up[:, 1], up[:, 0], np.zeros(3000)])
    points, message = repair_normals(read(save(tmp_path / "a.ply", trained(made)), opacity=0))
    assert "signs recomputed" in message
    assert (points.normals * made.xyz).sum(axis=1).min() > 0.999


# ------------------------------------------------------------------------------------------------------ compressed


@pytest.mark.parametrize("shades", [True, False])
@pytest.mark.parametrize("n", [1, 256, 700])
def test_compressed_splats_are_exact_to_their_quantization(tmp_path, n, shades):
    made = cloud(n)
    (tmp_path / "a.ply").write_bytes(packed(made, shades, harmonics=n < 300))
    points = read(tmp_path / "a.ply", opacity=0)
    check(points, made, turned=0.9995, shades=3, position=0.006, scale=0.005, opacity=0.003)
    check_threshold(tmp_path / "a.ply", points)
    [(_, form, listing)] = headers(tmp_path / "a.ply")
    assert (form.name, listing.facts["comments"]) == ("3D Gaussian splatting, compressed", ["made by hand"])


def check_threshold(path, points):
    opacity = float(np.median(points.attributes["opacity"]))
    some = read(path, opacity=opacity)
    rows = points.attributes["opacity"] >= np.float32(opacity)
    np.testing.assert_array_equal(some.positions, points.positions[rows])
    np.testing.assert_array_equal(some.normals, points.normals[rows])


def test_more_splats_than_are_unpacked_together(tmp_path, monkeypatch):
    (tmp_path / "a.ply").write_bytes(packed(cloud(1500)))
    whole = read(tmp_path / "a.ply")
    monkeypatch.setattr(compressed_gaussians, "ROWS", 512)
    parts = read(tmp_path / "a.ply")
    np.testing.assert_array_equal(parts.positions, whole.positions)
    np.testing.assert_array_equal(parts.attributes["scale"], whole.attributes["scale"])


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (packed(cloud(300), chunks=1), "300 splats need 2 chunks of 256, the header announces 1"),
        (packed(cloud(300), chunks=3), "300 splats need 2 chunks of 256, the header announces 3"),
        (packed(cloud(300), harmonics=False)[:-1], "is cut off: 300 splats reach to byte"),
        (packed(cloud(3), names=["position", "rotation", "color", "x"]), "'vertex' lacks packed_scale"),
        (packed(cloud(3)).replace(b"min_scale_y", b"min_scale_w"), "'chunk' lacks min_scale_y"),
        (packed(cloud(3)).replace(b"element chunk", b"element chink"), "'chunk' not found; available: chink, vertex"),
        (packed(cloud(3)).replace(b"uint packed_c", b"float packed_c"), "color' has type float32, expected uint"),
        (packed(cloud(3)).replace(b"binary_little_endian", b"ascii"), "must be in a binary format, not ascii"),
        (packed(cloud(3)).replace(b"vertex 3", b"vertex 0"), "0 vertices"),
        (packed(cloud(3)).replace(b"vertex 3", b"vertex 999999999999"), "999,999,999,999 splats need"),
    ],
)
def test_damaged_compressed_files_are_refused(tmp_path, data, message):
    (tmp_path / "a.ply").write_bytes(data)
    with pytest.raises(ValueError, match=re.escape(message)):
        read(tmp_path / "a.ply", strict=True)


def test_chunks_with_infinite_bounds_are_read(tmp_path):
    made = cloud(300)
    made.xyz[256:] = np.nan
    with np.errstate(invalid="ignore"):
        (tmp_path / "a.ply").write_bytes(packed(made))
    points = read(tmp_path / "a.ply", opacity=0)
    assert points.finite.sum() == 256


@pytest.mark.scans
def test_a_file_of_supersplat_is_read():
    """Compared with an independent parser."""
    path = shared_model("raw/3dgs_biker.compressed.ply")
    data = PlyData.read(str(path))
    vertex, chunk = data["vertex"].data, data["chunk"].data[np.arange(len(data["vertex"].data)) // 256]
    points = read(path, opacity=0)
    assert len(points) == 152_746
    for k, (shift, mask, name) in enumerate([(21, 2047, "x"), (11, 1023, "y"), (0, 2047, "z")]):
        share = ((vertex["packed_position"] >> shift) & mask) / mask
        low, high = chunk[f"min_{name}"].astype("f8"), chunk[f"max_{name}"].astype("f8")
        np.testing.assert_allclose(points.positions[:, k], low + (high - low) * share, rtol=0, atol=5e-7)
    np.testing.assert_allclose(points.attributes["opacity"], (vertex["packed_color"] & 255) / 255, atol=1e-7)
    low, high = chunk["min_b"].astype("f8"), chunk["max_b"].astype("f8")
    blue = np.clip(low + (high - low) * (((vertex["packed_color"] >> 8) & 255) / 255), 0, 1) * 255
    np.testing.assert_allclose(points.colors[:, 2], blue, atol=0.501)
    assert len(read(path)) == 100_034


@pytest.mark.parametrize("kind", ["trained", "text", "compressed"])
def test_damage_is_reported_in_one_line(tmp_path, kind):
    rng = np.random.default_rng(5)
    path = tmp_path / "a.ply"
    if kind == "compressed":
        data = packed(cloud(300))
    else:
        data = save(path, trained(cloud(20)), text=kind == "text").read_bytes()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for _ in range(60):
            path.write_bytes(damaged(rng, data))
            try:
                assert len(read(path, opacity=0, strict=True)) <= 400
            except ValueError as error:
                assert "\n" not in str(error)
