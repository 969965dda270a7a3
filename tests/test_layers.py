"""Pictures in layers: their contents, and what EXR and NPZ files keep of them."""

import sys

import numpy as np
import pytest

import pointray as pr
from conftest import sphere_points
from pointray.cli import execute
from pointray.image import write_image, write_layers
from pointray.rendering.picture import render_snapshot

NONE = 2**32 - 1  # -1 in an EXR


@pytest.fixture(scope="module")
def scene() -> pr.Scene:
    """A red sphere above a checker, a green one with its own material, and sky between them."""
    rows = sphere_points(3000)
    model = pr.Model(pr.Points(rows, rows, np.tile(np.uint8([255, 128, 0]), (3000, 1))))
    scene = pr.Scene()
    scene.add(model)
    scene.add(model, [[1, 0, 0, 3], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]], pr.Phong((0.1, 0.8, 0.2)))
    scene.add(pr.Plane((0, 0, -1), (0, 0, 1), checker=1.0))
    return scene


@pytest.fixture(scope="module")
def camera() -> pr.Camera:
    return pr.Camera.look_at((1, -9, 1.5), (1.5, 0, 0.5), size=(40, 24))


@pytest.fixture(scope="module")
def layers(scene: pr.Scene, camera: pr.Camera) -> dict[str, np.ndarray]:
    return pr.render_layers(scene, camera, pr.Settings(spp=2))


def read_exr(path):
    """Channels of an EXR, one by one."""
    exr = pytest.importorskip("OpenEXR")
    with exr.File(str(path), separate_channels=True) as file:
        return {name: channel.pixels.copy() for name, channel in file.channels().items()}


# ------------------------------------------------------------------------------------------- what is in the layers


def test_layers_are_those_of_the_middle_rays(scene, camera, layers):
    origins, directions = camera.rays()
    hits = scene.intersect(origins, directions)
    for name in ("normal", "position", "instance", "point"):
        np.testing.assert_array_equal(layers[name], getattr(hits, name))
        assert layers[name].dtype == getattr(hits, name).dtype
    hit = hits.instance >= 0
    assert 0.3 < hit.mean() < 0.95 and set(hits.instance[hit]) == {0, 1, 2}
    np.testing.assert_allclose(layers["position"][hit], (origins + hits.t[..., None] * directions)[hit], atol=1e-5)
    forward = np.subtract(camera.target, camera.eye) / np.linalg.norm(np.subtract(camera.target, camera.eye))
    np.testing.assert_allclose(layers["depth"][hit], ((layers["position"] - camera.eye) @ forward)[hit], rtol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(layers["normal"][hit], axis=1), 1, atol=1e-5)


def test_what_nothing_is_in_each_layer(layers):
    nothing = layers["instance"] < 0
    assert np.isposinf(layers["depth"][nothing]).all() and np.isnan(layers["position"][nothing]).all()
    assert not layers["normal"][nothing].any() and not layers["albedo"][nothing].any()
    assert (layers["point"][nothing] == -1).all() and (layers["point"][layers["instance"] == 2] == -1).all()


def test_radiance_is_the_picture(scene, camera, layers):
    np.testing.assert_array_equal(layers["radiance"], pr.render(scene, camera, pr.Settings(spp=2)))


def test_albedo_is_the_material_s_color_else_the_points_own(layers):
    own, given, plane = (layers["albedo"][layers["instance"] == k] for k in range(3))
    np.testing.assert_allclose(own, np.tile(np.float32([1, 0.2158605, 0]), (len(own), 1)), atol=1e-5)
    np.testing.assert_array_equal(given, np.tile(np.float32([0.1, 0.8, 0.2]), (len(given), 1)))
    assert sorted(set(plane[:, 0])) == [0.25, 0.5]


def test_layers_tell_their_progress(scene, camera, monkeypatch):
    def told(scene, camera, settings, progress):
        progress(1.0)
        return render_snapshot(scene, camera, settings, None)

    monkeypatch.setattr("pointray.rendering.layers.render_snapshot", told)
    shares = []
    pr.render_layers(scene, camera, pr.Settings(spp=3), shares.append)
    assert shares == [0.75, 1.0]


# ----------------------------------------------------------------------------------------------- what files keep


def test_an_npz_keeps_everything(tmp_path, layers):
    write_layers(tmp_path / "a.NPZ", layers)
    with np.load(tmp_path / "a.NPZ", allow_pickle=False) as file:
        assert set(file) == set(layers)
        for name in layers:
            np.testing.assert_array_equal(file[name], layers[name])
            assert file[name].dtype == layers[name].dtype
    assert [path.name for path in tmp_path.iterdir()] == ["a.NPZ"]


def test_an_exr_keeps_everything_as_float32(tmp_path, layers):
    write_layers(tmp_path / "a.exr", layers)
    channels = read_exr(tmp_path / "a.exr")
    colors = ["R", "G", "B", "A", "albedo.R", "albedo.G", "albedo.B"]
    vectors = [f"{name}.{axis}" for name in ("normal", "position") for axis in "XYZ"]
    assert sorted(channels) == sorted([*colors, *vectors, "Z", "instance", "point"])
    for names, layer in (
        ("RGBA", "radiance"),
        (["Z"], "depth"),
        (["normal.X", "normal.Y", "normal.Z"], "normal"),
        (["position.X", "position.Y", "position.Z"], "position"),
        (["albedo.R", "albedo.G", "albedo.B"], "albedo"),
    ):
        planes = np.stack([channels[name] for name in names], axis=-1)
        np.testing.assert_array_equal(planes, layers[layer].astype(np.float32).reshape(planes.shape))
    for name in ("instance", "point"):
        assert channels[name].dtype == np.uint32
        np.testing.assert_array_equal(channels[name].view(np.int32), layers[name])
        assert (channels[name] == NONE).any()


def test_indices_beyond_float32_survive(tmp_path):
    point = np.array([[2**24 + 1, NONE - 1, -1]])
    write_layers(tmp_path / "a.exr", {"point": point})
    assert read_exr(tmp_path / "a.exr")["point"].tolist() == [[2**24 + 1, NONE - 1, NONE]]
    with pytest.raises(ValueError, match=r"'point': .* NPZ"):
        write_layers(tmp_path / "b.exr", {"point": point + 1})


@pytest.mark.parametrize("channels", [3, 4])
def test_a_picture_as_exr_is_its_own_numbers(tmp_path, channels):
    image = np.random.default_rng(0).normal(size=(4, 6, channels)).astype(np.float32)
    image[0, 0], image[1, 1, 0] = np.nan, np.inf
    write_image(tmp_path / "a.exr", image, exposure=2, curve="filmic")
    found = read_exr(tmp_path / "a.exr")
    assert sorted(found) == sorted("RGBA"[:channels])
    np.testing.assert_array_equal(np.stack([found[name] for name in "RGBA"[:channels]], axis=-1), image)
    assert [path.name for path in tmp_path.iterdir()] == ["a.exr"]


@pytest.mark.parametrize(
    ("name", "layers", "words"),
    [
        ("a.png", {"depth": np.zeros((2, 3))}, r"cannot write \.png; can write \.exr, \.npz"),
        ("a.npz", {}, "layers holds none"),
        ("a.npz", {"depth": np.array([[object()]])}, "'depth' must hold real numbers"),
        ("a.npz", {"depth": np.zeros(3)}, r"'depth': \(3,\)"),
        ("a.npz", {"depth": np.zeros((2, 3)), "normal": np.zeros((3, 2, 3))}, r"'normal': \(3, 2, 3\)"),
        ("a.exr", {"heat": np.zeros((2, 3))}, "'heat'.*radiance, depth"),
        ("a.exr", {"normal": np.zeros((2, 3))}, "'normal' must have 3 channels"),
    ],
)
def test_what_are_no_layers(tmp_path, name, layers, words):
    pytest.importorskip("OpenEXR")
    with pytest.raises(ValueError, match=words):
        write_layers(tmp_path / name, layers)
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_is_an_oserror(tmp_path, monkeypatch):
    exr = pytest.importorskip("OpenEXR")
    monkeypatch.setattr(exr.File, "write", lambda *arguments: exr.File("/no/such/file.exr"))
    with pytest.raises(OSError, match="/no/such/file"):
        write_layers(tmp_path / "a.exr", {"depth": np.zeros((2, 3))})
    assert list(tmp_path.iterdir()) == []


# --------------------------------------------------------------------------------------------- the command line


@pytest.fixture
def scan(tmp_path):
    rows = sphere_points(3000)
    pr.write(tmp_path / "scan.ply", pr.Points(rows, rows))
    return tmp_path / "scan.ply"


def test_render_writes_all_layers(scan, capsys):
    pytest.importorskip("OpenEXR")
    for name in ("a.npz", "a.exr"):
        arguments = ["render", str(scan), "-o", str(scan.with_name(name)), "--size", "16x12", "--background", "none"]
        assert execute(arguments) == 0
        assert capsys.readouterr().out.startswith(f"{scan.with_name(name)}: 16x12, 3,000 points, 7 layers\n")
    channels = read_exr(scan.with_name("a.exr"))
    with np.load(scan.with_name("a.npz")) as layers:
        assert len(layers) == 7 and layers["radiance"].shape == (12, 16, 4)
        np.testing.assert_array_equal(channels["Z"], layers["depth"])
        np.testing.assert_array_equal(channels["A"], layers["radiance"][..., 3])
        assert np.isfinite(layers["depth"][6, 8]) and layers["radiance"][6, 8, 3] == 1


def test_without_openexr_it_says_what_to_install(scan, tmp_path, monkeypatch, capsys):
    """The message comes before the scan is looked for, which is absent."""
    monkeypatch.setitem(sys.modules, "OpenEXR", None)
    for command in (["render", "missing.ply"], ["demo"]):
        assert execute([*command, "-o", str(tmp_path / "a.exr")]) == 2
        err = capsys.readouterr().err
        assert err == f"pointray: {tmp_path / 'a.exr'} needs OpenEXR: pip install 'pointray[files]'\n"
    with pytest.raises(ValueError, match="pip install"):
        write_image(tmp_path / "a.exr", np.zeros((2, 3, 3)))


def test_exposure_is_no_part_of_layers(scan, capsys):
    assert execute(["render", str(scan), "-o", str(scan.with_name("a.npz")), "--exposure", "1"]) == 2
    assert "--exposure" in capsys.readouterr().err


def test_layers_keep_the_background_that_is_asked_for(scan):
    """In a picture the background is behind everything; in layers it is light like the rest."""
    for name, more in (("a.npz", ["--background", "0.5,0.25,1"]), ("b.npz", [])):
        assert execute(["render", str(scan), "-o", str(scan.with_name(name)), "--size", "16x12", *more]) == 0
    with np.load(scan.with_name("a.npz")) as layers:
        np.testing.assert_allclose(layers["radiance"][0, 0], [0.5, 0.25, 1, 1])
    with np.load(scan.with_name("b.npz")) as layers:
        np.testing.assert_array_equal(layers["radiance"][0, 0], 0)
