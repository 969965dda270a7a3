"""glTF files: quantized and sparse attributes, extensions, textures and colours."""

from __future__ import annotations

import base64
import json
import struct
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import pointray as pr
from helpers.places import MODELS

trimesh = pytest.importorskip("trimesh")

TYPES = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
KINDS = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}


def gltf(path: Path, arrays: dict[str, np.ndarray], **tree: object) -> Path:
    """Write a .gltf or .glb file of one primitive; integers are normalized, except for its indices."""
    data, views, accessors = b"", [], []
    for name, values in arrays.items():
        values = np.ascontiguousarray(values)
        kind = {"componentType": TYPES[values.dtype.str[1:]], "type": KINDS[values.shape[1]], "count": len(values)}
        accessors.append(
            {"bufferView": len(views), **kind, "normalized": values.dtype.kind in "iu" and name != "indices"}
        )
        views.append({"buffer": 0, "byteOffset": len(data), "byteLength": values.nbytes})
        data += values.tobytes() + bytes(-values.nbytes % 4)
    attributes = {name: k for k, name in enumerate(arrays) if name != "indices"}
    primitive = {"attributes": attributes, **({"material": 0} if "materials" in tree else {})}
    primitive |= {"indices": list(arrays).index("indices")} if "indices" in arrays else {"mode": 0}
    whole = {"asset": {"version": "2.0"}, "meshes": [{"primitives": [primitive]}], "bufferViews": views}
    whole |= {"accessors": accessors, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}], **tree}
    if path.suffix == ".gltf":
        uri = "data:application/octet-stream;base64," + base64.b64encode(data).decode()
        path.write_text(json.dumps({**whole, "buffers": [{"byteLength": len(data), "uri": uri}]}))
        return path
    text = json.dumps({**whole, "buffers": [{"byteLength": len(data)}]}).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(data), b"BIN\0") + data
    path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)
    return path


@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
@pytest.mark.parametrize("dtype", ["i1", "u1", "i2", "u2"])
def test_quantized_points_are_where_they_belong(rng, tmp_path, suffix, dtype):
    limits = np.iinfo(dtype)
    rows = rng.integers(limits.min, limits.max + 1, (90, 3)).astype(dtype)
    colors = rng.integers(0, 65536, (90, 3)).astype("u2")
    path = gltf(tmp_path / f"a{suffix}", {"POSITION": rows, "COLOR_0": colors}, nodes=[{"mesh": 0, "scale": [6, 6, 6]}])
    points = pr.read(path, sample=0)
    np.testing.assert_allclose(points.world, 6 * np.maximum(rows / limits.max, -1), atol=1e-5)
    np.testing.assert_allclose(points.colors, colors / 257, atol=0.51)


def test_a_quantized_mesh_with_all_attributes_is_read(tmp_path):
    """Normals have unit length, and the texture's transform is applied."""
    ball = trimesh.creation.icosphere(3)
    picture = Image.fromarray(np.repeat([[[250, 0, 0]], [[0, 0, 250]]], 2, axis=1).astype(np.uint8))
    picture.save(tmp_path / "a.png")
    transform = {"offset": [0, 0.25], "scale": [1, 0.5]}  # 0 to 1 becomes 0.25 to 0.75, and the picture changes at 0.5
    texture = {"index": 0, "extensions": {"KHR_texture_transform": transform}}
    path = gltf(
        tmp_path / "a.gltf",
        {
            "POSITION": np.rint(ball.vertices * 32767).astype("i2"),
            "NORMAL": np.rint(ball.vertex_normals * 127).astype("i1"),
            "TEXCOORD_0": np.rint((ball.vertices[:, :2] + 1) / 2 * 65535).astype("u2"),
            "indices": ball.faces.reshape(-1, 1).astype("u4"),
        },
        materials=[{"pbrMetallicRoughness": {"baseColorTexture": texture}}],
        textures=[{"source": 0}],
        images=[{"uri": "a.png"}],
        extensionsRequired=["KHR_mesh_quantization", "KHR_texture_transform"],
    )
    for sample in (0, 3000):
        points = pr.read(path, sample=sample)
        np.testing.assert_allclose(np.linalg.norm(points.world, axis=1), 1, atol=0.01)
        np.testing.assert_allclose(points.normals, points.world, atol=0.1)
        assert (points.colors[points.world[:, 1] < -0.6] == [250, 0, 0]).all()
        assert (points.colors[points.world[:, 1] > 0.6] == [0, 0, 250]).all()
    (tmp_path / "a.png").unlink()
    with pytest.warns(
        UserWarning, match=r"a\.gltf: refers to 'a\.png', not found in its folder: colors may be missing"
    ):
        assert pr.read(path).colors is None
    with pytest.raises(ValueError, match=r"refers to 'a\.png', not found in its folder"):
        pr.read(path, strict=True)


def test_a_quantized_file_of_another_program_is_read():
    path = MODELS.parent / "cases" / "glb_quantized.glb"
    if not path.exists():
        pytest.skip("no shared files here")
    points = pr.read(path)
    assert len(points) == 4100
    np.testing.assert_allclose(points.bounds, [[0, 0, 0], [6, 6 * 31360 / 65535, 6]], atol=1e-4)


@pytest.mark.parametrize("is_stored", [True, False])
@pytest.mark.parametrize("dtype", ["f4", "i2"])
def test_sparse_values_replace_those_stored(rng, tmp_path, dtype, is_stored):
    """Without a buffer view, the other values are 0."""
    rows, values = (rng.integers(-32767, 32768, (n, 3)).astype(dtype) for n in (90, 40))
    places = np.sort(rng.choice(90, 40, replace=False))[:, None].astype("u2")
    path = gltf(tmp_path / "a.gltf", {"POSITION": rows, "_PLACES": places, "_VALUES": values})
    tree = json.loads(path.read_text())
    sparse = {"indices": {"bufferView": 1, "componentType": TYPES["u2"]}, "values": {"bufferView": 2}, "count": 40}
    tree["accessors"][0] |= {"sparse": sparse}
    if not is_stored:
        del tree["accessors"][0]["bufferView"]
    path.write_text(json.dumps(tree))
    expected = rows * is_stored
    expected[places[:, 0]] = values
    np.testing.assert_allclose(pr.read(path).world, expected / (1 if dtype == "f4" else 32767), atol=1e-5)
    tree["meshes"][0]["primitives"][0] |= {"indices": 0, "mode": 4}
    path.write_text(json.dumps(tree))
    with pytest.raises(ValueError, match="has sparse triangle indices, which are unsupported"):
        pr.read(path)


@pytest.mark.parametrize("name", ["KHR_draco_mesh_compression", "EXT_meshopt_compression"])
def test_unsupported_compression_is_named(tmp_path, name):
    path = gltf(tmp_path / "a.glb", {"POSITION": np.eye(3, dtype="f4")}, extensionsRequired=[name])
    with pytest.raises(ValueError, match=rf"a\.glb: is compressed with {name}, which is unsupported: save it without"):
        pr.read(path)


def test_unsupported_required_extensions_are_named(tmp_path):
    path = gltf(tmp_path / "a.glb", {"POSITION": np.eye(3, dtype="f4")}, extensionsRequired=["XY_odd"])
    with pytest.warns(UserWarning, match="requires XY_odd, which is unsupported"):
        pr.read(path)
    with pytest.raises(ValueError, match="requires XY_odd"):
        pr.read(path, strict=True)


def test_colors_of_vertices_beside_a_material(rng, tmp_path):
    colors = rng.integers(0, 256, (162, 4)).astype("u1")
    ball = trimesh.creation.icosphere(2)
    path = gltf(
        tmp_path / "a.glb",
        {"POSITION": ball.vertices.astype("f4"), "COLOR_0": colors, "indices": ball.faces.reshape(-1, 1).astype("u4")},
        materials=[{"pbrMetallicRoughness": {"baseColorFactor": [1, 0.5, 1, 1]}}],
    )
    np.testing.assert_allclose(pr.read(path).colors, colors[:, :3] * [1, 0.5, 1], atol=1)
