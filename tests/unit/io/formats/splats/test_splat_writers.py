"""Writers of Gaussian splats: what they store, read by the package's readers and by other code."""

import gzip
import warnings
from functools import partial

import numpy as np
import pytest
from plyfile import PlyData

import pointray as pr
from helpers.clouds import sphere_points
from helpers.splat_files import HARMONIC, Cloud, matrix
from helpers.spz_files import plain, rows
from pointray.auto_view import splats
from pointray.base.atomic_write import replacing
from pointray.io.files import read, write
from pointray.io.formats._source import CHUNK
from pointray.io.formats.splats import _flat, _spz_write, gaussians, splat
from pointray.io.formats.splats._flat import BALL, OPACITY, WIDTH, FlatSplats
from pointray.io.formats.splats._own_shapes import THICKNESS

WRITERS = {".ply": gaussians.write, ".spz": _spz_write.write, ".splat": splat.write}
EVERY = pytest.mark.parametrize("extension", WRITERS)


def save(path, points, progress=None):
    """Write points as splats, also to a .ply; return what cannot be stored."""
    with replacing(path) as file:
        return WRITERS[path.suffix](file, points, progress)


def discs(rng, n=300, **fields):
    """Points of random colours and radii, with normals in all directions."""
    normals = rng.normal(size=(n, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    radii = rng.uniform(0.01, 0.1, n).astype(np.float32)
    given = {"normals": normals, "colors": rng.integers(0, 256, (n, 3), np.uint8), "attributes": {"radius": radii}}
    return pr.Points(rng.normal(size=(n, 3)), **{**given, **fields})


def expected(points):
    """The splats of points with normals and radii, as logarithms and logits."""
    splats = FlatSplats(points)
    scales, turns = splats.shapes(slice(0, len(points)))
    harmonic = (points.colors / 255 - 0.5) / HARMONIC
    logit = np.full(len(points), np.log(OPACITY / (1 - OPACITY)))
    return Cloud(points.positions.astype(float), harmonic, logit, np.log(scales.astype(float)), turns.astype(float))


# --------------------------------------------------------------------------------------------------- own readers


@EVERY
def test_splats_are_read_back(tmp_path, rng, extension):
    points = discs(rng)
    path = tmp_path / f"a{extension}"
    assert save(path, points) == []
    back, radii = read(path), points.attributes["radius"]
    exact = extension != ".spz"
    np.testing.assert_allclose(back.positions, points.positions, rtol=0, atol=1e-9 if exact else 2.0**-20)
    np.testing.assert_allclose(back.colors, points.colors, rtol=0, atol=0 if exact else 1)
    assert (back.normals * points.normals).sum(axis=1).min() > (0.99999 if extension == ".ply" else 0.9995)
    wanted = np.sort(np.stack([THICKNESS * WIDTH * radii, WIDTH * radii, WIDTH * radii], axis=1))
    steps = np.log(np.sort(back.attributes["scale"], axis=1) / wanted)
    np.testing.assert_allclose(steps, 0, atol=1e-5 if exact else 0.5 / 16 + 1e-5)
    np.testing.assert_allclose(back.attributes["opacity"], OPACITY, rtol=1e-6)


@pytest.mark.parametrize("extension", [".spz", ".splat"])
def test_pr_write_selects_the_format_by_the_extension(tmp_path, rng, extension):
    points = discs(rng, 50)
    write(tmp_path / f"a{extension}", points)
    save(tmp_path / f"b{extension}", points)
    assert (tmp_path / f"a{extension}").read_bytes() == (tmp_path / f"b{extension}").read_bytes()


def test_pr_write_writes_points_to_a_ply(tmp_path, rng):
    write(tmp_path / "a.ply", discs(rng, 50))
    assert set(read(tmp_path / "a.ply").attributes) == {"radius"}
    assert {x.name for x in pr.formats() if x.writes} >= {"3D Gaussian splatting", "PLY", "SPZ", "splat"}


# -------------------------------------------------------------------------------------------------- other readers


def test_a_ply_has_the_properties_of_training(tmp_path, rng):
    points = discs(rng)
    save(tmp_path / "a.ply", points)
    [vertex] = PlyData.read(str(tmp_path / "a.ply")).elements
    names = "x y z nx ny nz f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3"
    assert [p.name for p in vertex.properties] == names.split() and {p.val_dtype for p in vertex.properties} == {"f4"}
    made = expected(points)
    columns = [made.xyz, points.normals, made.harmonic, made.opacity[:, None], made.scale, made.turn]
    for name, column in zip(names.split(), np.concatenate(columns, axis=1).T, strict=True):
        np.testing.assert_allclose(vertex[name], column, atol=1e-5, err_msg=name)


def test_an_spz_has_the_bytes_of_its_description(tmp_path, rng):
    points = discs(rng)
    save(tmp_path / "a.spz", points)
    packed = (tmp_path / "a.spz").read_bytes()
    assert packed[:4] == b"\x1f\x8b\x08\0" and packed[4:8] == bytes(4)  # neither a name nor a time
    data = gzip.decompress(packed)
    bits = int(np.floor(np.log2((2**23 - 1) / np.abs(points.positions).max())))
    wanted = plain(expected(points), version=2, bits=bits)
    assert len(data) == len(wanted) == 16 + 19 * len(points) and data[:16] == wanted[:16]
    apart = np.frombuffer(data, np.uint8).astype(int) - np.frombuffer(wanted, np.uint8)
    assert np.abs(apart).max() <= 1 and (apart != 0).mean() < 0.02  # halves are rounded up or to even


def test_a_splat_file_has_the_bytes_of_its_description(tmp_path, rng):
    points = discs(rng)
    save(tmp_path / "a.splat", points)
    data, wanted = (tmp_path / "a.splat").read_bytes(), rows(expected(points))
    layout = [("x", "<f4", 6), ("c", "u1", 4), ("q", "u1", 4)]
    found, made = np.frombuffer(data, layout), np.frombuffer(wanted, layout)
    np.testing.assert_allclose(found["x"], made["x"], rtol=1e-6)
    np.testing.assert_array_equal(found["c"], made["c"])
    apart = np.abs(found["q"].astype(int) - made["q"])
    assert apart.max() <= 1 and (apart != 0).mean() < 0.02


@pytest.mark.parametrize("extension", [".ply", ".spz"])
def test_gsply_reads_the_splats(tmp_path, rng, extension):
    gsply = pytest.importorskip("gsply", exc_type=ImportError)
    points = discs(rng)
    save(tmp_path / f"a{extension}", points)
    data = (gsply.plyread if extension == ".ply" else gsply.read_spz)(str(tmp_path / f"a{extension}"))
    made = expected(points)
    np.testing.assert_allclose(data.means, made.xyz, atol=2e-6)
    np.testing.assert_allclose(data.scales, made.scale, atol=0.04)
    np.testing.assert_allclose(data.sh0, made.harmonic, atol=0.03)


# ---------------------------------------------------------------------------------------------------- conversion


def test_the_thin_axis_is_turned_to_the_normal(rng):
    points = discs(rng, 2000)
    axes = [*np.eye(3), *-np.eye(3), np.full(3, -(3**-0.5))]
    points.normals[: len(axes)] = axes
    scales, turns = FlatSplats(points).shapes(slice(0, len(points)))
    thin = np.array([matrix(q)[:, s.argmin()] for q, s in zip(turns, scales, strict=True)])
    np.testing.assert_allclose(thin, points.normals, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(turns, axis=1), 1, rtol=1e-6)
    assert turns[:, 0].min() > 0.45  # three bytes determine it well


def test_points_without_a_normal_become_spheres(tmp_path, rng):
    points = discs(rng, 40)
    points.normals[::2], points.normals[0] = 0, np.nan
    points.normals[1::2] *= 7
    save(tmp_path / "a.ply", points)
    scale, radii = read(tmp_path / "a.ply").attributes["scale"], points.attributes["radius"]
    np.testing.assert_allclose(scale[::2], BALL * np.repeat(radii[::2, None], 3, axis=1), rtol=1e-5)
    np.testing.assert_allclose(scale[1::2].max(axis=1), WIDTH * radii[1::2], rtol=1e-5)
    np.testing.assert_allclose(scale[1::2].min(axis=1), THICKNESS * WIDTH * radii[1::2], rtol=1e-5)


def test_missing_normals_are_estimated(tmp_path):
    positions = sphere_points(400)
    with pytest.warns(UserWarning, match="^the points have no normals: estimated from their neighbours$"):
        write(tmp_path / "a.spz", pr.Points(positions))
    assert (read(tmp_path / "a.spz").normals * positions).sum(axis=1).min() > 0.99


def test_missing_radii_follow_the_spacing(tmp_path, rng):
    """An even sphere has supports of 1.15 spacings; a stray gets one of the size of its neighbours' at most."""
    z, turn = np.linspace(-0.9995, 0.9995, 2000), np.arange(2000) * np.pi * (3 - 5**0.5)
    positions = np.stack([np.cos(turn) * np.sqrt(1 - z * z), np.sin(turn) * np.sqrt(1 - z * z), z], axis=1)
    positions[1000] = 1.5, 0, 0
    save(tmp_path / "a.ply", pr.Points(positions, positions))
    radii = read(tmp_path / "a.ply").attributes["scale"].max(axis=1) / WIDTH
    spacing = np.sqrt(4 * np.pi / 2000)
    assert 1.0 < np.median(radii) / spacing < 1.3
    assert 1.9 < radii[1000] / np.median(radii) < 2.2 and np.ptp(np.delete(radii, 1000)) < 0.5 * spacing
    for column in (np.zeros(2000), np.full(2000, np.nan), np.ones((2000, 2))):  # not radii
        save(tmp_path / "b.ply", pr.Points(positions, positions, attributes={"radius": column}))
        assert (tmp_path / "b.ply").read_bytes() == (tmp_path / "a.ply").read_bytes()


@EVERY
@pytest.mark.parametrize(
    "positions", [[[1, 2, 3]], [[1, 2, 3]] * 20, [[0, 0, 0], [1, 0, 0]], [[0, 0, 0]] * 9 + [[1, 1, 1]]]
)
def test_few_or_equal_points_are_written(tmp_path, extension, positions):
    save(tmp_path / f"a{extension}", pr.Points(positions))
    back = read(tmp_path / f"a{extension}")
    np.testing.assert_allclose(back.world, positions, atol=1e-6)
    assert (back.attributes["scale"] > 0).all() and np.isfinite(back.attributes["scale"]).all()


@EVERY
def test_splats_that_were_read_are_written_unchanged(tmp_path, rng, extension):
    one, other = tmp_path / f"a{extension}", tmp_path / f"b{extension}"
    points = discs(rng, 200)
    points.normals[:20] = 0
    save(one, points.changed(attributes={**points.attributes, "opacity": rng.uniform(0.2, 0.9, 200)}))
    first = read(one)
    assert save(other, first) == []
    again = read(other)
    for name in ("scale", "opacity"):
        ordered = [np.sort(x.attributes[name], axis=-1) for x in (first, again)]
        np.testing.assert_allclose(*ordered, rtol=1e-5)
    assert np.ptp(first.attributes["opacity"]) > 0.5
    np.testing.assert_array_equal(first.colors, again.colors)
    assert (first.normals * again.normals)[20:].sum(axis=1).min() > 0.999


def test_opacities_of_0_and_1_have_finite_logits(tmp_path, rng):
    points = discs(rng, 3)
    save(tmp_path / "a.ply", points.changed(attributes={"opacity": np.array([0.0, 1.0, 0.5])}))
    values = PlyData.read(str(tmp_path / "a.ply"))["vertex"]["opacity"]
    assert np.isfinite(values).all() and values[0] < -5 and values[1] > 5 and abs(values[2]) < 1e-6
    np.testing.assert_allclose(read(tmp_path / "a.ply", opacity=0).attributes["opacity"], [0, 1, 0.5], atol=1e-5)


def test_points_without_colors_have_that_of_clay(tmp_path, rng):
    save(tmp_path / "a.splat", discs(rng, 20, colors=None))
    assert (read(tmp_path / "a.splat").colors == _flat.CLAY).all()


# ------------------------------------------------------------------------------------------------ what is lost


def test_what_cannot_be_stored_is_named(tmp_path, rng):
    points = discs(rng, 50)
    world = points.world + [500_000, 5_400_000, 100]
    world[7] = np.nan
    attributes = {**points.attributes, **{f"a{k}": np.arange(50) for k in range(6)}}
    georeference = pr.Georeference("EPSG:25832", stations=((0.0, 0.0, 0.0),))
    far = pr.Points(world, points.normals, points.colors, attributes, None, georeference)
    lost = save(tmp_path / "a.splat", far)
    place = ", ".join(f"{x:.15g}" for x in far.origin)
    assert lost == [
        f"stores positions relative to ({place}), because viewers of splats use 32-bit floats",
        "leaves out 1 row without a finite position",
        "cannot store the attributes a0, a1, a2, a3 and 2 more",
        "cannot store the coordinate system",
        "cannot store the scanner positions",
    ]
    kept = far.finite
    np.testing.assert_array_equal(read(tmp_path / "a.splat").world, far.positions[kept])
    np.testing.assert_allclose(far.origin, [500_000, 5_400_000, 100], atol=20)
    with pytest.warns(UserWarning, match="a.spz: ") as caught:
        write(tmp_path / "a.spz", far)
    assert [str(one.message).partition("a.spz: ")[2] for one in caught] == lost


def test_the_largest_coordinate_decides_the_bits_of_an_spz(tmp_path, rng):
    for size, bits in ((1e-3, 24), (1.0, 22), (1000.0, 13), (8_000_000.0, 0)):
        points = discs(rng, 30)
        positions = np.clip(points.positions, -1, 1) * np.float32(size)
        positions[0] = size
        save(tmp_path / "a.spz", pr.Points.about((0, 0, 0), positions, points.normals, attributes=points.attributes))
        assert gzip.decompress((tmp_path / "a.spz").read_bytes())[13] == bits
        np.testing.assert_allclose(read(tmp_path / "a.spz").world, positions, atol=0.501 * 2.0**-bits)


def test_coordinates_that_are_too_large_for_an_spz_change_no_file(tmp_path, rng):
    (tmp_path / "a.spz").write_bytes(b"before")
    points = discs(rng, 30)
    far = pr.Points.about((0, 0, 0), points.positions * np.float32(1e8), points.normals)
    message = r"a\.spz: an SPZ file cannot store coordinates above 8,388,607, got .*; use larger units$"
    for writer in (write, partial(splats.write_points, progress=None)):
        with pytest.raises(ValueError, match=message):
            writer(tmp_path / "a.spz", far)
    assert (tmp_path / "a.spz").read_bytes() == b"before" and len(list(tmp_path.iterdir())) == 1


@pytest.mark.parametrize("size", [5e6, 9e11])
def test_large_coordinates_of_a_splat_file_are_read_back(tmp_path, rng, size):
    points = discs(rng, 30, attributes={"radius": np.full(30, size / 10)})
    positions = np.clip(points.positions, -1, 1) * np.float32(size)
    write(tmp_path / "a.splat", pr.Points.about((0, 0, 0), positions, points.normals, attributes=points.attributes))
    back = read(tmp_path / "a.splat")
    np.testing.assert_allclose(back.world, positions, rtol=1e-6)
    np.testing.assert_allclose(back.attributes["scale"].max(axis=1), WIDTH * size / 10, rtol=1e-5)


def test_sizes_beyond_those_of_an_spz_are_reported(tmp_path, rng):
    radii = np.full(30, 0.01, np.float32)
    radii[:3] = 1e-5, 1e4, 2e-5
    points = discs(rng, 30, attributes={"radius": radii})
    assert save(tmp_path / "a.spz", points) == ["changes the size of 3 splats: SPZ stores widths from 4.5e-5 to 380"]
    scale = read(tmp_path / "a.spz").attributes["scale"].max(axis=1)
    np.testing.assert_allclose(scale[:2], [np.exp(-10), np.exp(255 / 16 - 10)], rtol=1e-5)


@pytest.mark.parametrize(("width", "visible"), [(8.4e-5, False), (5e-5, False), (1.2e-4, True), (1e-3, True)])
def test_small_splats_that_become_round_in_an_spz_are_reported(tmp_path, rng, width, visible):
    """Their thickness is too small, though their width is not."""
    radii = np.full(30, 0.01, np.float32)
    radii[:20] = width / WIDTH
    points = discs(rng, 30, attributes={"radius": radii})
    lost = save(tmp_path / "a.spz", points)
    message = "makes 20 small splats round: SPZ stores no axis below 4.5e-5; use smaller units"
    assert lost == ([] if visible else [message])
    scale = np.sort(read(tmp_path / "a.spz").attributes["scale"], axis=1)[:20]
    np.testing.assert_allclose(scale[:, 2], width, rtol=0.033)
    assert (scale[:, 0] < 0.5 * scale[:, 2]).all() == visible


def test_small_needles_that_become_round_in_an_spz_are_reported(tmp_path, rng):
    attributes = {"scale": np.tile([8e-5, 4e-6, 4e-6], (30, 1)), "rotation": rng.normal(size=(30, 4))}
    attributes["scale"][:3] = 8e-5  # a sphere
    [message] = save(tmp_path / "a.spz", discs(rng, 30, attributes=attributes))
    assert message.startswith("makes 27 small splats round")


# ------------------------------------------------------------------------------------------------------ streaming


@EVERY
def test_parts_make_the_same_file(tmp_path, rng, extension, monkeypatch):
    points = discs(rng, 257)
    save(tmp_path / f"a{extension}", points)
    monkeypatch.setattr(_flat, "CHUNK", 64)
    shares = []
    save(tmp_path / f"b{extension}", points, shares.append)
    assert (tmp_path / f"a{extension}").read_bytes() == (tmp_path / f"b{extension}").read_bytes()
    assert shares == sorted(shares) and shares[-1] == pytest.approx(1) and len(shares) > 5
    assert CHUNK > 257


@EVERY
def test_a_failure_leaves_the_old_file(tmp_path, rng, extension):
    path = tmp_path / f"a{extension}"
    path.write_bytes(b"before")

    def stop(share):
        if share > 0.9:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        save(path, discs(rng, 50), stop)
    assert path.read_bytes() == b"before" and [p.name for p in tmp_path.iterdir()] == [path.name]


def test_nothing_overflows(tmp_path, rng):
    """Normals and radii at the limits of float32."""
    points = discs(rng, 20, attributes={"radius": np.geomspace(1e-30, 1e30, 20)})
    points.normals[:] *= np.float32(1e30)
    points.normals[:5] = np.inf
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for extension in WRITERS:
            save(tmp_path / f"a{extension}", points)
