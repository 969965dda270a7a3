"""GLB files of points as pointray writes them, read again by pointray and trimesh, and checked against glTF's rules."""

import json
import struct

import numpy as np
import pytest

import pointray as pr
from helpers.places import shared_model
from helpers.written_clouds import FAR, check_same, rich_cloud, with_nan, written
from pointray.io.files import read, write_points
from pointray.io.formats.mesh import _glb_write

SIZES = {5120: 1, 5121: 1, 5122: 2, 5123: 2, 5126: 4}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}


def exact_cloud(rng, **fields):
    """A cloud of which GLB keeps everything."""
    points = rich_cloud(rng, **fields)
    kept = ("intensity", "in_u1", "in_i1", "in_u2", "in_i2", "in_f4", "in_bool")
    return points.changed(attributes={name: points.attributes[name] for name in kept})


def tree_of(path):
    """The JSON of a file, and its binary part, after the checks of both chunks."""
    data = path.read_bytes()
    magic, version, total, length, kind = struct.unpack_from("<4sIII4s", data)
    assert (magic, version, total, kind) == (b"glTF", 2, len(data), b"JSON")
    assert length % 4 == 0
    size, kind = struct.unpack_from("<I4s", data, 20 + length)
    assert kind == b"BIN\0" and 28 + length + size == len(data) and size % 4 == 0
    return json.loads(data[20 : 20 + length]), data[28 + length :]


def check_rules(path):
    """The rules of glTF 2.0 for vertex attributes: alignment, limits, finite numbers, unit normals."""
    tree, data = tree_of(path)
    assert tree["buffers"] == [{"byteLength": len(data)}]
    for primitive in tree["meshes"][0]["primitives"]:
        assert primitive["mode"] == 0
        for name, index in primitive["attributes"].items():
            accessor = tree["accessors"][index]
            view = tree["bufferViews"][accessor["bufferView"]]
            size, width = SIZES[accessor["componentType"]], WIDTHS[accessor["type"]]
            stride = view["byteStride"]  # needed where primitives share a view
            assert stride % 4 == 0 and stride >= size * width
            assert view["byteOffset"] % 4 == accessor["byteOffset"] % 4 == 0
            assert accessor["byteOffset"] + (accessor["count"] - 1) * stride + size * width <= view["byteLength"]
            assert name in ("POSITION", "NORMAL", "COLOR_0") or name.startswith("_")
            if accessor["componentType"] == 5126:
                start = view["byteOffset"] + accessor["byteOffset"]
                rows = np.frombuffer(data, "<f4", accessor["count"] * width, start).reshape(-1, width)
                assert np.isfinite(rows).all()
                if name == "NORMAL":
                    np.testing.assert_allclose(np.linalg.norm(rows, axis=1), 1, rtol=0, atol=1e-3)
                if name == "POSITION":
                    assert accessor["min"] == rows.min(axis=0).tolist()
                    assert accessor["max"] == rows.max(axis=0).tolist()
    return tree


def test_everything_is_restored(rng, tmp_path):
    points = exact_cloud(rng)
    losses, again = written(tmp_path / "a.glb", points)
    assert losses == []
    check_same(points, again)
    tree = check_rules(tmp_path / "a.glb")
    assert tree["nodes"][0]["translation"] == points.origin.tolist()
    assert {"POSITION", "NORMAL", "COLOR_0", "_INTENSITY"} <= set(tree["meshes"][0]["primitives"][0]["attributes"])


def test_trimesh_reads_the_same(rng, tmp_path):
    trimesh = pytest.importorskip("trimesh")
    points = exact_cloud(rng)
    write_points(tmp_path / "a.glb", points)
    scene = trimesh.load(tmp_path / "a.glb")
    (cloud,) = scene.geometry.values()
    np.testing.assert_array_equal(cloud.vertices, points.positions)
    np.testing.assert_array_equal(cloud.colors[:, :3], points.colors)
    np.testing.assert_array_equal(scene.graph[scene.graph.nodes_geometry[0]][0][:3, 3], points.origin)


def test_pygltflib_reads_the_same(rng, tmp_path):
    pygltflib = pytest.importorskip("pygltflib", exc_type=ImportError)
    points = exact_cloud(rng)
    write_points(tmp_path / "a.glb", points)
    file = pygltflib.GLTF2().load(str(tmp_path / "a.glb"))
    view = file.bufferViews[file.accessors[file.meshes[0].primitives[0].attributes.NORMAL].bufferView]
    rows = np.frombuffer(file.binary_blob(), "<f4", view.byteLength // 4, view.byteOffset).reshape(-1, 3)
    np.testing.assert_array_equal(rows, points.normals)


def test_wide_attributes(rng, tmp_path):
    wide = {
        f"w{k}": rng.integers(0, 9, (50, k)).astype(np.uint8 if k < 3 else np.int16)  # rows of one to eight bytes
        for k in (1, 2, 3, 4)
    }
    points = pr.Points(rng.random((50, 3)), attributes=wide | {"w6": rng.random((50, 6)).astype(np.float32)})
    losses, again = written(tmp_path / "a.glb", points)
    assert losses == ["stores the 6 columns of w6 separately, as w6_0 and so on"]
    for k in (2, 3, 4):
        np.testing.assert_array_equal(again.attributes[f"w{k}"], wide[f"w{k}"])
    np.testing.assert_array_equal(again.attributes["w6_5"], points.attributes["w6"][:, 5])
    check_rules(tmp_path / "a.glb")


def test_points_without_a_normal_come_last(rng, tmp_path):
    """They are a primitive of their own, because glTF has unit normals only."""
    points = exact_cloud(rng)
    normals = points.normals.copy()
    normals[[0, 7]], normals[9] = 0, np.nan
    losses, again = written(tmp_path / "a.glb", points.with_normals(normals))
    assert losses == ["stores points without a normal after the others"]
    order = np.concatenate([np.delete(np.arange(len(points)), [0, 7, 9]), [0, 7, 9]])
    normals[9] = 0
    check_same(points.with_normals(normals), again, rows=order)
    assert len(check_rules(tmp_path / "a.glb")["meshes"][0]["primitives"]) == 2
    losses, again = written(tmp_path / "b.glb", points.with_normals(np.zeros_like(normals)))
    assert losses == [] and again.normals is None


def test_normals_get_unit_length(rng, tmp_path):
    points = exact_cloud(rng)
    losses, again = written(tmp_path / "a.glb", points.with_normals(points.normals * 3))
    assert losses == ["stores normals with length 1"]
    np.testing.assert_allclose(again.normals, points.normals, rtol=0, atol=1e-6)
    check_rules(tmp_path / "a.glb")


def test_losses_are_reported(rng, tmp_path):
    n = 400
    columns = {
        "small": rng.integers(-(2**24), 2**24, n),
        "large": rng.integers(0, 2**32, n, np.uint32),
        "time": rng.random(n) + 3e8,
        "odd": np.where(np.arange(n) < 3, np.nan, np.arange(n)),
        "Own Name": np.arange(n, dtype=np.uint8),
    }
    known = pr.Georeference(crs="EPSG:25832", stations=[FAR])
    losses, again = written(tmp_path / "a.glb", with_nan(rich_cloud(rng, attributes=columns, georeference=known), [5]))
    assert losses == [
        "cannot store the coordinate system",
        "cannot store the scanner positions",
        "leaves out 1 row without a finite position",
        "rounds large to 32-bit floats",
        "rounds time to 32-bit floats",
        "stores 3 values of odd that are not finite numbers of 32 bits as 0",
        "stores Own Name as the attribute own_name",
    ]
    kept = np.delete(np.arange(n), 5)
    np.testing.assert_array_equal(again.attributes["small"], columns["small"][kept])
    np.testing.assert_array_equal(again.attributes["time"], columns["time"][kept].astype(np.float32))
    assert again.attributes["odd"][:4].tolist() == [0, 0, 0, 3]
    check_rules(tmp_path / "a.glb")


def test_other_cases_of_names_are_reported(rng, tmp_path):
    columns = {"Amplitude": np.arange(9, dtype=np.uint8), "amplitude": np.arange(9, dtype=np.uint8) + 1}
    losses, again = written(tmp_path / "a.glb", pr.Points(rng.random((9, 3)), attributes=columns))
    assert losses == ["stores Amplitude as the attribute amplitude", "stores amplitude as the attribute amplitude_2"]
    assert again.attributes["amplitude_2"].tolist() == list(range(1, 10))


def test_too_large_files_are_named(rng, tmp_path, monkeypatch):
    monkeypatch.setattr(_glb_write, "LARGEST", 100)
    with pytest.raises(ValueError, match=r"a\.glb: cannot be written: 108 bytes of points"):
        pr.write(tmp_path / "a.glb", pr.Points(rng.random((9, 3))))
    assert list(tmp_path.iterdir()) == []


def test_damaged_files_are_refused(rng, tmp_path):
    write_points(tmp_path / "a.glb", exact_cloud(rng))
    whole = (tmp_path / "a.glb").read_bytes()
    bad = tmp_path / "b.glb"
    for length in (40, 150, 1000, len(whole) - 1):
        bad.write_bytes(whole[:length])
        with pytest.raises(ValueError, match=r"b\.glb: (is cut off|is damaged|invalid)"):
            read(bad)
    bad.write_bytes(whole.replace(b'"count":400', b'"count":499'))  # of all attributes
    with pytest.raises(ValueError, match=r"b\.glb: is damaged: 499 values of the attribute"):
        read(bad)
    for old, new in (
        (b'"count":400', b'"count":-40'),
        (b'"count":400', b'"count":499'),
        (b'"VEC3"', b'"VEC9"'),
        (b'"VEC3"', b'"VEC2"'),
        (b'"meshes":[{', b'"meshes":["'),
        (b'"POSITION":0', b'"POSITION":9'),
        (b'"POSITION"', b'"_OSITION"'),
        (b'"translation":[', b'"translation":{'),
    ):
        assert old in whole
        bad.write_bytes(whole.replace(old, new, 1))
        with pytest.raises(ValueError, match=r"b\.glb: is damaged"):
            read(bad)


def test_meshes_are_read_as_before(tmp_path):
    trimesh = pytest.importorskip("trimesh")
    trimesh.creation.icosphere(2).export(tmp_path / "a.glb")
    assert len(read(tmp_path / "a.glb", sample=0)) == 162


@pytest.mark.scans
def test_a_real_scan_is_restored(tmp_path):
    points = read(shared_model("points/potree_lion_takanawa_rgb.ply"))
    losses, again = written(tmp_path / "a.glb", points)
    assert set(losses) <= {"stores normals with length 1"}
    np.testing.assert_array_equal(again.positions, points.positions)
    np.testing.assert_array_equal(again.colors, points.colors)
    check_rules(tmp_path / "a.glb")
