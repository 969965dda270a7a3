"""The examples after Open3D's tutorials give the same with Open3D's class and with ours, on a sphere."""

import runpy

import numpy as np
import pytest

import pointray as pr
from helpers.places import ROOT

POINTS = 20_000
SPACING = np.sqrt(4 * np.pi / POINTS)


@pytest.fixture(scope="module")
def scenes():
    """Ours, of points, and Open3D's, of triangles."""
    open3d = pytest.importorskip("open3d", exc_type=ImportError)
    ours, theirs = pr.compat.RaycastingScene(), open3d.t.geometry.RaycastingScene()
    ours.add_points(pr.procedural("sphere", POINTS))
    theirs.add_triangles(open3d.t.geometry.TriangleMesh.create_sphere(1.0, 200))
    return ours, theirs


def test_ray_casting(scenes):
    example = runpy.run_path(str(ROOT / "examples" / "08_ray_casting.py"), run_name="example")
    one, other = (example["answers"](scene, 60, 40) for scene in scenes)
    hit = np.isfinite(other["t_hit"])
    assert 0.1 < hit.mean() < 0.9 and (np.isfinite(one["t_hit"]) == hit).mean() > 0.998
    both = hit & np.isfinite(one["t_hit"])
    steep = both & (np.abs(other["primitive_normals"][..., 1]) > 0.3)  # not at the silhouette
    assert np.abs(one["t_hit"][steep] - other["t_hit"][steep]).max() < 0.1 * SPACING
    assert (one["crossings"] == other["crossings"]).mean() > 0.998
    assert (one["shadow"] == other["shadow"])[both].mean() > 0.97 and 0.1 < one["shadow"][both].mean() < 0.9
    assert np.abs(example["picture"](one) - example["picture"](other))[both].mean() < 0.02


def test_distance_queries(scenes):
    example = runpy.run_path(str(ROOT / "examples" / "09_distance_queries.py"), run_name="example")
    queries = example["slice_through"]((-1.5, -1.5), (1.5, 1.5), 40, 40)
    one, other = (example["answers"](scene, queries) for scene in scenes)
    for name in ("distance", "signed"):
        assert np.abs(one[name] - other[name]).max() < 0.1 * SPACING
    assert (one["inside"] == other["inside"]).all() and 0.2 < one["inside"].mean() < 0.5
    assert np.abs(np.linalg.norm(one["nearest"], axis=-1) - 1).max() < 0.1 * SPACING
