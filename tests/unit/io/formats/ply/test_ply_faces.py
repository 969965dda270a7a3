"""Triangles of PLY files, read without trimesh."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from plyfile import PlyData, PlyElement

import pointray as pr
from pointray.io.formats.ply._faces import read_triangles
from pointray.io.formats.ply._header import read_header

trimesh = pytest.importorskip("trimesh")


def ply(path: Path, positions: np.ndarray, faces: list, text: bool, order: str, is_first: bool = False) -> Path:
    """Write a PLY file whose faces have a colour before and a float after their corners."""
    rows = np.empty(len(faces), [("red", "u1"), ("vertex_indices", object), ("quality", "f4")])
    rows["red"], rows["quality"] = 200, 0.5
    rows["vertex_indices"] = [face.astype(np.int32) for face in faces]
    vertices = np.array([tuple(row) for row in positions], [(axis, "f8") for axis in "xyz"])
    elements = [PlyElement.describe(vertices, "vertex"), PlyElement.describe(rows, "face")]
    PlyData(elements[::-1] if is_first else elements, text, order).write(str(path))
    return path


@pytest.mark.parametrize(("text", "order"), [(True, "="), (False, "<"), (False, ">")])
@pytest.mark.parametrize("corners", [3, 4, 5])
@pytest.mark.parametrize("is_first", [False, True])
def test_triangles_of_ply_are_those_of_trimesh(rng, tmp_path, text, order, corners, is_first):
    faces = [rng.choice(90, corners, replace=False) for _ in range(60)]
    path = ply(tmp_path / "a.ply", rng.random((90, 3)), faces, text, order, is_first)
    with path.open("rb") as file:
        triangles = read_triangles(path, read_header(file))
    expected = trimesh.load(str(path), process=False).faces
    assert {tuple(np.sort(row)) for row in triangles} == {tuple(np.sort(row)) for row in expected}
    assert len(triangles) == len(expected) == 60 * (corners - 2)


@pytest.mark.parametrize(("text", "order"), [(True, "="), (False, "<")])
def test_faces_of_different_numbers_of_corners_are_left_to_trimesh(rng, tmp_path, text, order):
    faces = [rng.choice(90, k, replace=False) for k in (3, 3, 4, 3)]
    path = ply(tmp_path / "a.ply", rng.random((90, 3)), faces, text, order)
    with path.open("rb") as file:
        assert read_triangles(path, read_header(file)) is None
    assert len(pr.read(path)) == 90


@pytest.mark.parametrize(("text", "order"), [(True, "="), (False, "<")])
def test_vertices_of_ply_are_read_without_trimesh(tmp_path, text, order):
    """Its import takes a second: it is imported only to sample triangles."""
    ball = trimesh.creation.icosphere(3)
    path = ply(tmp_path / "a.ply", ball.vertices, list(ball.faces), text, order)
    code = f"import sys, pointray as pr; assert len(pr.read({str(path)!r})) == 642; assert 'trimesh' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)
