"""Meshes: vertices, and points scattered on triangles."""

import json
import sys

import numpy as np
import pytest
from PIL import Image
from plyfile import PlyData, PlyElement

from helpers.mesh_files import save
from pointray.io import files
from pointray.io.files import read
from pointray.io.formats.mesh import mesh

trimesh = pytest.importorskip("trimesh")

KINDS = ["obj", "stl", "ascii.stl", "glb", "gltf", "off"]


def ball():
    return trimesh.creation.icosphere(2, radius=3.0)


def save_ply(path, shape):
    vertices = np.array([tuple(row) for row in shape.vertices], [(axis, "f8") for axis in "xyz"])
    faces = np.empty(len(shape.faces), [("vertex_indices", object)])
    faces["vertex_indices"] = [np.array(face, np.int32) for face in shape.faces]
    PlyData([PlyElement.describe(vertices, "vertex"), PlyElement.describe(faces, "face")]).write(str(path))
    return path


def as_set(rows):
    return {tuple(row) for row in np.round(rows, 4) + 0.0}


@pytest.mark.parametrize("kind", KINDS)
def test_each_vertex_is_one_point(tmp_path, kind):
    shape = ball()
    points = read(save(tmp_path, shape, kind))
    assert len(points) == len(shape.vertices)
    assert as_set(points.world) == as_set(shape.vertices)
    np.testing.assert_allclose(points.normals, points.world / 3, atol=0.01)


@pytest.mark.parametrize("kind", [*KINDS, "ply"])
def test_points_are_scattered_by_area(tmp_path, kind):
    shape = trimesh.util.concatenate(
        [trimesh.creation.box((1, 1, 1)), trimesh.creation.box((4, 4, 4)).apply_translation((9, 0, 0))]
    )
    path = save_ply(tmp_path / "a.ply", shape) if kind == "ply" else save(tmp_path, shape, kind)
    points = read(path, sample=1700)
    assert len(points) == 1700
    large = points.world[:, 0] > 5
    assert abs(large.sum() - 1600) <= 1
    own = np.where(large[:, None], (points.world - (9, 0, 0)) / 2, points.world * 2)
    np.testing.assert_allclose(np.abs(own).max(axis=1), 1, atol=1e-5)  # on the surface
    np.testing.assert_allclose((own * points.normals).sum(axis=1), 1, atol=1e-5)
    np.testing.assert_array_equal(read(path, sample=1700).positions, points.positions)


def test_points_are_uniform_on_a_triangle(tmp_path):
    (tmp_path / "a.off").write_text("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n")
    points = read(tmp_path / "a.off", sample=4000)
    np.testing.assert_allclose(points.world.mean(axis=0), [1 / 3, 1 / 3, 0], atol=0.02)
    for axis in range(2):
        assert abs((points.world[:, axis] > 0.5).mean() - 0.25) < 0.03


def test_many_points_are_read_in_blocks(tmp_path, monkeypatch):
    from pointray.io.formats.mesh import _points as _mesh_points

    path = save(tmp_path, ball(), "stl")
    whole = read(path, sample=1000)
    monkeypatch.setattr(_mesh_points, "CHUNK", 300)
    points = read(path, sample=1000)
    assert len(points) == 1000
    assert abs(points.world.mean(axis=0) - whole.world.mean(axis=0)).max() < 0.1


@pytest.mark.parametrize("padding", [b"\0", b" "])
def test_a_binary_stl_file_may_begin_with_solid(tmp_path, padding):
    path = save(tmp_path, ball(), "stl")
    plain = read(path)
    data = b"solid SolidWorks".ljust(80, padding) + path.read_bytes()[80:]
    path.write_bytes(data)
    np.testing.assert_array_equal(read(path).world, plain.world)
    path.write_bytes(data[:-60])
    with pytest.warns(UserWarning, match="is cut off: 320 triangles .*: 2 of 320 are missing"):
        assert len(read(path)) > 0
    path.write_bytes(data[:60])
    with pytest.raises(ValueError, match=r"a\.stl"):
        read(path)


@pytest.mark.parametrize("end", ["\n", "\r\n", " \\\n \n"])
def test_negative_indices_count_back_from_the_face(tmp_path, end):
    """Each triangle stands after its own corners; every second one has positive indices."""
    shape, lines = ball(), []
    for k, (triangle, normal) in enumerate(zip(shape.triangles, shape.face_normals, strict=True)):
        lines += ["v {} {} {}".format(*row) for row in triangle]
        lines += [f"vt 0 {k / len(shape.faces)}", "vn {} {} {}".format(*normal)]
        corners = (f"{j}/-1/-1" if k % 2 else f"{3 * k + 4 + j}/{k + 1}/{k + 1}" for j in (-3, -2, -1))
        lines.append(f"f {' '.join(corners)}{end}f -1/-1/-1 -3/-1/-1 -3/-1/-1 # not -4")
    (tmp_path / "a.obj").write_bytes(end.join([*lines, ""]).encode())
    points = read(tmp_path / "a.obj", sample=0)
    assert as_set(points.world) == as_set(shape.vertices)
    np.testing.assert_allclose(points.normals, points.world / 3, atol=0.1)
    sampled = read(tmp_path / "a.obj", sample=2000)
    np.testing.assert_allclose(np.linalg.norm(sampled.world, axis=1), 3, atol=0.1)


def test_points_without_triangles_keep_their_order(rng, tmp_path):
    rows = np.repeat(rng.random((40, 3)).round(3), 2, axis=0)  # each twice; none is merged
    colors = rng.integers(0, 256, (80, 3))
    normals = rng.normal(size=(80, 3)).round(3)
    lines = ["# caf\xe9"]
    for xyz, rgb, n in zip(rows, colors / 255, normals, strict=True):
        lines += [f"v {' '.join(map(str, [*xyz, *rgb]))}", f"vn {' '.join(map(str, n))}"]
    path = tmp_path / "a.obj"
    path.write_bytes("\n".join(lines).encode("latin-1"))
    points = read(path)
    np.testing.assert_array_equal(points.positions, rows.astype(np.float32))
    np.testing.assert_array_equal(points.normals, normals.astype(np.float32))
    np.testing.assert_array_equal(points.colors, colors)
    with pytest.raises(ValueError, match="has no triangles to sample"):
        read(path, sample=10)


def test_normals_of_the_file_are_kept(tmp_path):
    shape = ball()
    wrong = np.roll(shape.vertex_normals, 1, axis=1)
    path = save(tmp_path, trimesh.Trimesh(shape.vertices, shape.faces, vertex_normals=wrong, process=False), "glb")
    points = read(path)
    np.testing.assert_allclose(points.normals, np.roll(points.world / 3, 1, axis=1), atol=0.01)


@pytest.mark.parametrize("sample", [None, 500])
def test_vertex_colors_are_read(tmp_path, sample):
    shape = ball()
    shape.visual.vertex_colors = np.where(shape.vertices[:, :1] > 0, [[200, 10, 30, 255]], [[200, 110, 30, 255]])
    points = read(save(tmp_path, shape, "glb"), sample=sample)
    assert set(points.colors[:, 0]) == {200}
    assert (points.colors[points.world[:, 0] > 1, 1] == 10).all()
    assert (points.colors[points.world[:, 0] < -1, 1] == 110).all()


@pytest.mark.parametrize("kind", ["glb", "obj"])
@pytest.mark.parametrize("sample", [0, 500])
def test_texture_colors_are_read(tmp_path, kind, sample):
    picture = Image.fromarray(np.repeat([[[250, 0, 0]], [[0, 0, 250]]], 2, axis=1).astype(np.uint8))
    square = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
    uv = [[0.1, 0.1], [0.9, 0.1], [0.9, 0.9], [0.1, 0.9]]
    visual = trimesh.visual.TextureVisuals(uv=uv, image=picture)
    shape = trimesh.Trimesh(square, [[0, 1, 2], [0, 2, 3]], visual=visual, process=False)
    if kind == "obj":
        for name, data in trimesh.exchange.obj.export_obj(shape, return_texture=True)[1].items():
            (tmp_path / name).write_bytes(data)
    points = read(save(tmp_path, shape, kind), sample=sample)
    top = points.world[:, 1]
    assert (points.colors[top > 0.8] == [250, 0, 0]).all()
    assert (points.colors[top < 0.2] == [0, 0, 250]).all()


def test_transforms_of_a_scene_are_applied(tmp_path):
    shape = ball()
    matrix = trimesh.transformations.rotation_matrix(0.7, (1, 2, 3), (4, 5, 6)) @ np.diag([1, 2, -3, 1])
    scene = trimesh.Scene()
    scene.add_geometry(shape, geom_name="a", node_name="first")
    scene.graph.update("second", matrix=matrix, geometry="a")
    points = read(save(tmp_path, scene, "glb"))
    n = len(shape.vertices)
    assert len(points) == 2 * n
    placed = shape.vertices @ matrix[:3, :3].T + matrix[:3, 3]
    assert as_set(points.world.round(3)) == as_set(np.concatenate([shape.vertices, placed]).round(3))
    own = (points.world - matrix[:3, 3]) @ np.linalg.inv(matrix[:3, :3]).T
    mirrored = np.abs(np.linalg.norm(own, axis=1) - 3) < 1e-3
    outward = points.world - np.where(mirrored[:, None], matrix[:3, 3], 0)
    assert ((outward * points.normals).sum(axis=1) > 0).all()


def test_a_count_is_reported(tmp_path):
    path = save(tmp_path, ball(), "stl")
    (_, _, listing) = next(files.headers(path))
    assert listing.count is None
    assert 0.5 < listing.rows / len(ball().vertices) < 2
    (_, _, listing) = next(files.headers(path, files.request_of(sample=7)))
    assert listing.count == 7


@pytest.mark.parametrize(
    ("head", "name", "kind"),
    [
        (b"# made by\n\nv 1 2 3\n", "a.txt", "obj"),
        (b"mtllib a.mtl\no x\n", "a.obj", "obj"),
        (b"v 1 2\n", "a.txt", ""),
        (b"1 2 3\n4 5 6\n", "a.obj", ""),
        (b"solid x\n facet normal 0 0 1\n", "a", "stl"),
        (b"OFF\n8 6 0\n", "a.txt", "off"),
        (b'{"asset": {"version": "2.0"}}', "a.json", "gltf"),
        (b'{"a": 1}', "a.json", ""),
    ],
)
def test_the_format_is_recognised_by_contents(tmp_path, head, name, kind):
    assert mesh.kind_of(head, tmp_path / name) == kind


# ---------------------------------------------------------------------------------------------------- what is wrong


@pytest.mark.parametrize("kind", ["stl", "glb", "off"])
def test_cut_files_are_refused(tmp_path, kind):
    path = save(tmp_path, ball(), kind)
    data = path.read_bytes()
    for size in (100, len(data) // 2, len(data) - 30):
        path.write_bytes(data[:size])
        with pytest.raises(ValueError, match="a." + kind):
            read(path, strict=True)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("v 1 2", "line 5 is 'v 1 2'"),
        ("v 1 2,5 3", "line 5 is"),
        ("vn 1 x 3", "line 5 is"),
        ("f 1 2 9", "damaged"),
        ("f 1 2 -4", "index -4, but only 3 rows"),
    ],
)
def test_a_wrong_line_is_named(tmp_path, line, message):
    (tmp_path / "a.obj").write_text(f"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3 # fine\n{line}\n")
    with pytest.raises(ValueError, match=message):
        read(tmp_path / "a.obj")


def test_accessors_without_data_are_refused(tmp_path):
    path = save(tmp_path, ball(), "gltf")
    tree = json.loads(path.read_text())
    for accessor in tree["accessors"]:
        del accessor["bufferView"]
        accessor["count"] = 10**9
    path.write_text(json.dumps(tree))
    with pytest.raises(ValueError, match="accessor 0 announces 1,000,000,000 rows without data"):
        read(path)


@pytest.mark.parametrize("name", ["../secret.bin", "http://localhost/a.bin", "/etc/passwd"])
def test_only_files_in_the_same_folder_are_opened(tmp_path, name):
    (tmp_path / "in").mkdir()
    path = save(tmp_path / "in", ball(), "gltf")
    tree = json.loads(path.read_text())
    (tmp_path / "in" / tree["buffers"][0]["uri"]).rename(tmp_path / "secret.bin")
    tree["buffers"][0]["uri"] = name
    path.write_text(json.dumps(tree))
    with pytest.raises(ValueError, match="which is not in its folder"):
        read(path)


def test_the_triangle_count_of_ply_is_checked_first(tmp_path):
    path = save_ply(tmp_path / "a.ply", ball())
    path.write_bytes(path.read_bytes().replace(b"element face 320", b"element face 999999999"))
    with pytest.raises(ValueError, match="999,999,999 rows of 'face' expected"):
        read(path, sample=10)


@pytest.mark.parametrize("name", ["a.stl", "a.ply"])
def test_a_missing_package_is_named(tmp_path, monkeypatch, name):
    path = save_ply(tmp_path / name, ball()) if name == "a.ply" else save(tmp_path, ball(), "stl")
    monkeypatch.setitem(sys.modules, "trimesh", None)
    with pytest.raises(ValueError, match=r"needs trimesh: pip install 'pointray\[mesh\]'"):
        read(path, sample=10)
