"""Points of meshes: OBJ files with many materials, and surface samples where vertices are few."""

from __future__ import annotations

import json
import re
import warnings
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import pointray as pr
from helpers.places import shared_model
from pointray.cli import execute

trimesh = pytest.importorskip("trimesh")

SAMPLES = 200_000


# --------------------------------------------------------------------------------------------------- materials of OBJ


def obj(folder: Path, shape: object, groups: int, word: str = "usemtl", loose: str = "") -> Path:
    """Write a mesh whose triangles form groups, each with its colour."""
    shades = np.linspace(0, 1, groups)
    (folder / "a.mtl").write_text("".join(f"newmtl m{k}\nKd {shade:.3f} 0.5 0.25\n" for k, shade in enumerate(shades)))
    lines = [
        "mtllib a.mtl",
        *("v {:.6f} {:.6f} {:.6f}".format(*row) for row in shape.vertices),
        *([loose] if loose else []),
    ]
    for k, some in enumerate(np.array_split(shape.faces, groups)):
        lines += [f"{word} m{k}", *("f {} {} {}".format(*row) for row in some + 1)]
    (folder / "a.obj").write_text("\n".join(lines) + "\n")
    return folder / "a.obj"


@pytest.mark.parametrize("word", ["usemtl", "g", "o"])
def test_vertices_of_many_materials_are_read_once(tmp_path, word):
    ball = trimesh.creation.icosphere(3)
    points = pr.read(obj(tmp_path, ball, 40, word))
    assert len(points) == len(ball.vertices)
    np.testing.assert_allclose(points.normals, points.world, atol=0.05)
    if word == "usemtl":
        assert len(np.unique(points.colors[:, 0])) > 35 and set(points.colors[:, 1]) <= {127, 128}


def test_vertices_without_triangles_are_kept(tmp_path):
    ball = trimesh.creation.icosphere(3)
    points = pr.read(obj(tmp_path, ball, 3, loose="v 9 9 9"))
    assert len(points) == len(ball.vertices) + 1 and points.world[-1].tolist() == [9, 9, 9]


def test_memory_does_not_grow_with_the_number_of_materials(tmp_path):
    """For 300 materials of one mesh, trimesh does not copy all vertices 300 times."""
    ball = trimesh.creation.icosphere(5)
    assert len(pr.read(obj(tmp_path, ball, 300))) == len(ball.vertices)


@pytest.mark.parametrize("absent", ["a.mtl", "paint.png"])
@pytest.mark.parametrize("groups", [1, 3])
@pytest.mark.parametrize("has_uv", [False, True])
def test_missing_material_files_are_named(tmp_path, absent, groups, has_uv):
    path = obj(tmp_path, trimesh.creation.icosphere(3), groups)
    (tmp_path / "a.mtl").write_text("".join(f"newmtl m{k}\nmap_Kd paint.png\n" for k in range(groups)))
    if absent == "a.mtl":
        (tmp_path / absent).unlink()
    if has_uv:
        faces = re.sub(r"(?m)^f (\d+) (\d+) (\d+)$", r"f \1/1 \2/1 \3/1", path.read_text())
        path.write_text(f"{faces}vt 0 0\n")
    points, notes = noted(path)
    assert points.colors is None
    assert notes == [f"{path}: refers to '{absent}', not found in its folder: colors may be missing"]


# ------------------------------------------------------------------------------------------------------------ sampling


def noted(path: Path, **options: object) -> tuple[pr.Points, list[str]]:
    """Return the points of a file, and the texts of all warnings."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        points = pr.read(path, **options)
    return points, [str(one.message) for one in caught]


@pytest.mark.parametrize("kind", ["obj", "stl", "glb", "off", "ply"])
def test_a_box_is_sampled(tmp_path, kind):
    path = tmp_path / f"a.{kind}"
    trimesh.creation.box((1, 2, 3)).export(str(path))
    points, caught = noted(path)
    assert len(points) == SAMPLES
    assert caught == [
        f"{path}: its {36 if kind == 'stl' else 8} vertices are too sparse: 200,000 points are sampled on its "
        "12 triangles; --sample 0 (in Python sample=0) reads the vertices instead"
    ]
    np.testing.assert_allclose(np.abs(points.world * [2, 1, 2 / 3]).max(axis=1), 1, atol=1e-5)  # on its faces
    vertices, caught = noted(path, sample=0)
    assert len(vertices) == 8 and caught == []
    assert len(pr.read(path, sample=77)) == 77


def divided_box(times: int) -> object:
    """Return a box whose triangles are repeatedly divided into four."""
    return trimesh.creation.box() if times == 0 else divided_box(times - 1).subdivide()


@pytest.mark.parametrize(
    ("shape", "is_sampled"),
    [
        (trimesh.creation.icosphere(2), False),  # 162 vertices represent a smooth surface
        (trimesh.creation.icosphere(1), True),
        (trimesh.creation.torus(1, 0.3, 40, 20), False),
        (trimesh.creation.cylinder(1, 5, sections=64), True),
        (divided_box(4), True),  # 1,538 vertices, too few near its edges
        (divided_box(5), False),  # 6,146, whose edges are short
    ],
)
def test_meshes_are_sampled_unless_their_vertices_represent_the_surface(tmp_path, shape, is_sampled):
    path = tmp_path / "a.ply"
    shape.export(str(path))
    points, caught = noted(path)
    assert len(points) == (SAMPLES if is_sampled else len(shape.vertices)) and len(caught) == is_sampled


def test_triangles_in_any_order_of_corners(rng, tmp_path):
    """Triangles of hulls have either winding: this is not a crease and gives no normals."""
    ball = trimesh.creation.icosphere(3)
    turned = rng.random(len(ball.faces)) < 0.5
    ball.faces = np.where(turned[:, None], ball.faces[:, ::-1], ball.faces)
    path = tmp_path / "a.off"
    path.write_text(ball.export(file_type="off"))
    points = pr.read(path)
    assert len(points) == len(ball.vertices) and points.normals is None


def test_a_cloud_with_a_few_triangles_is_a_cloud(rng, tmp_path):
    rows = rng.random((50, 3))
    trimesh.Trimesh(rows, [[0, 1, 2], [3, 4, 5]], process=False).export(str(tmp_path / "a.ply"))
    assert len(pr.read(tmp_path / "a.ply")) == 50


@pytest.mark.scans
@pytest.mark.parametrize("name", ["stanford_bunny_mesh", "stanford_dragon_mesh"])
def test_meshes_of_scans_keep_their_vertices(name):
    points = pr.read(shared_model(f"meshes/{name}.ply"))
    vertices = pr.read(shared_model(f"points/{name.removesuffix('_mesh')}.ply"))
    np.testing.assert_array_equal(points.world, vertices.world)


def test_material_colors_are_sampled(tmp_path):
    """Each material's triangles have its colour, up to their edges."""
    box = trimesh.creation.box()
    points, _ = noted(obj(tmp_path, box, 12))
    assert len(points) == SAMPLES and len(np.unique(points.colors[:, 0])) == 12
    assert set(points.colors[:, 1]) <= {127, 128}


def test_triangle_colors_are_sampled(tmp_path):
    box = trimesh.creation.box()
    box.visual.face_colors = np.arange(12)[:, None] * [20, 0, 0, 0] + [0, 7, 9, 255]
    box.export(str(tmp_path / "a.ply"))
    points, _ = noted(tmp_path / "a.ply")
    assert set(points.colors[:, 0]) == set(range(0, 240, 20)) and (points.colors[:, 1:] == [7, 9]).all()


def test_a_texture_is_sampled(tmp_path):
    """162 vertices represent the surface of a ball, but not its texture."""
    ball = trimesh.creation.icosphere(2)
    stripes = Image.fromarray(np.tile(np.uint8([[[0] * 3], [[255] * 3]]), (32, 4, 1)))
    uv = (ball.vertices[:, :2] + 1) / 2
    ball.visual = trimesh.visual.TextureVisuals(uv=uv, image=stripes)
    ball.export(str(tmp_path / "a.glb"))
    points, caught = noted(tmp_path / "a.glb")
    assert len(points) == SAMPLES and len(caught) == 1
    row = np.floor((1 - (points.world[:, 1] + 1) / 2) * 64)
    inner = np.abs((1 - (points.world[:, 1] + 1) / 2) * 64 % 1 - 0.5) < 0.2
    facing = np.abs(points.world[:, 1]) < 0.5
    assert (points.colors[:, 0] == 255 * (row % 2))[inner & facing].mean() > 0.95


def test_the_command_line_reports_sampling(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    trimesh.creation.box().export("a.glb")
    for options, count in (([], SAMPLES), (["--sample", "0"], 8), (["--sample", "50"], 50)):
        assert execute(["info", "a.glb", "--json", *options]) == 0
        out, err = capsys.readouterr()
        assert json.loads(out)["points"] == count
        assert err.count("--sample 0") == (not options)


def test_without_trimesh_the_vertices_of_ply_are_read(tmp_path, monkeypatch):
    trimesh.creation.box().export(str(tmp_path / "a.ply"))
    monkeypatch.setattr("pointray.io.formats.mesh.mesh.find_spec", lambda name: None)
    points, caught = noted(tmp_path / "a.ply")
    assert len(points) == 8 and len(caught) == 1 and "because trimesh is missing: pip install" in caught[0]
