"""Models and baked light that earlier versions have written are read: a ball of 300 points, with its light.

`python tests/integration/test_stored_files.py` writes the files of this version, for a release.
"""

from pathlib import Path

import numpy as np
import pytest

import pointray as pr

FOLDERS = sorted(path for path in Path(__file__).with_name("stored_files").iterdir() if path.is_dir())


def write_files(folder: Path) -> None:
    """Write a model, a model in parts, and baked light."""
    folder.mkdir()
    ball = pr.procedural("sphere", 300)
    colors = np.full((len(ball), 3), (200, 120, 40), np.uint8)
    points = pr.Points(ball.world, ball.normals, colors, {"row": np.arange(len(ball), dtype=np.uint16)})
    model = pr.Model(points)
    model.save(folder / "ball.pointray")
    pr.prepare(points, folder / "parts.pointray", in_parts=True)
    scene = pr.Scene()
    scene.add(model)
    scene.add_light(pr.EnvironmentLight(1.0))
    pr.bake(scene, pr.BakeSettings(patches=256, links=8)).save(folder / "ball.bake")


@pytest.mark.parametrize("name", ["ball.pointray", "parts.pointray"])
@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: folder.name)
def test_a_model_is_read(folder, name):
    model = pr.Model.load(folder / name)
    assert len(model.points) == 300
    assert sorted(model.points.attributes["row"]) == list(range(300))
    assert (np.asarray(model.points.colors) == (200, 120, 40)).all()
    assert np.allclose(np.linalg.norm(model.points.world, axis=1), 1, atol=1e-6)
    scene = pr.Scene()
    scene.add(model)
    hits = scene.intersect([[-3, 0, 0], [0, 0.3, 3], [0, 1.5, 3]], [[1, 0, 0], [0, 0, -1], [0, 0, -1]])
    assert np.allclose(hits.t[:2], [2, 3 - np.sqrt(1 - 0.3**2)], atol=0.02) and hits.t[2] == np.inf


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: folder.name)
def test_baked_light_is_read(folder):
    scene = pr.Scene()
    ball = scene.add(pr.Model.load(folder / "ball.pointray"))
    baked = pr.Baked.load(folder / "ball.bake", scene)
    assert np.allclose(baked.ambient_occlusion(ball), 1, atol=0.01)
    assert np.allclose(baked.irradiance(ball), np.pi, atol=0.03)


def test_files_of_the_candidates_are_stored():
    assert "1.0.0rc1" in [folder.name for folder in FOLDERS]


if __name__ == "__main__":
    write_files(Path(__file__).with_name("stored_files") / pr.__version__)
