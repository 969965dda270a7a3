"""Points that the automatic view frames: distant clusters, strays and repeated positions are ignored."""

from __future__ import annotations

import numpy as np
import pytest

import pointray as pr
from helpers.places import case_file
from pointray.auto_view.clusters import find_main, largest_cluster, places
from pointray.auto_view.coverage import coverage
from pointray.auto_view.first_view import Scan, ViewChoice
from pointray.cli import execute


def ball(rng, n, radius=1.0, center=(0, 0, 0)):
    v = rng.normal(size=(n, 3))
    return radius * v / np.linalg.norm(v, axis=1, keepdims=True) * rng.random((n, 1)) ** (1 / 3) + center


@pytest.mark.parametrize("distance", [5, 100, 1e5, 1e8])
@pytest.mark.parametrize("share", [0.0003, 0.0025, 0.015])
def test_a_distant_cluster_is_left_out(rng, distance, share):
    n = 20_000
    main, far = ball(rng, n), ball(rng, round(share * n), 0.3, np.array((0.6, -0.7, 0.4)) * distance)
    framed, distant = find_main(np.concatenate([main, far]))
    assert framed[:n].mean() > 0.999 and not framed[n:].any()
    assert not distant[:n].any() and distant[n:].all()


def test_clusters_at_several_distances(rng):
    parts = [ball(rng, 10_000), *(ball(rng, 30, 0.2, (d, -d, 0.1 * d)) for d in (8, 100, 1e4, 1e6))]
    framed, distant = find_main(np.concatenate(parts))
    assert framed[:10_000].mean() > 0.999 and not framed[10_000:].any() and distant[10_000:].all()


@pytest.mark.parametrize("count", [1, 3, 8])
def test_single_points_far_away(rng, count):
    rows = np.concatenate([ball(rng, 4000), 1e6 * rng.normal(size=(count, 3))])
    framed, distant = find_main(rows)
    assert framed[:4000].mean() > 0.97 and distant[4000:].all() and not framed[4000:].any()


def scenes(rng):
    line = np.linspace(0, 1, 500)[:, None] * (3, 2, 1)
    return {
        "a ball": ball(rng, 5000),
        "a pair of bodies": np.concatenate([ball(rng, 5000), ball(rng, 500, 0.5, (30, 0, 0))]),
        "a small body close by": np.concatenate([ball(rng, 5000), ball(rng, 60, 0.2, (2.5, 0, 0))]),
        "many bodies": np.concatenate([ball(rng, 100, 1, center) for center in 50 * rng.normal(size=(80, 3))]),
        "sparse": rng.random((300, 3)) * 50,
        "a line": line,
        "one place": np.ones((1, 3)),
        "two places": np.array([[0, 0, 0], [1e6, 0, 0]]),
        "a flat map": rng.random((3000, 3)) * (1000, 1000, 0) + (5e5, 5e6, 300),
    }


@pytest.mark.parametrize("name", scenes(np.random.default_rng(0)))
def test_scenes_are_framed_whole(rng, name):
    rows = scenes(rng)[name]
    framed, distant = find_main(rows)
    assert framed.mean() > 0.97 and not distant.any()


def test_places_count_once(rng):
    rows = np.concatenate([ball(rng, 100), np.zeros((70, 3)), -np.zeros((30, 3)), ball(rng, 5, 1, (9, 9, 9))])
    rows = np.concatenate([rows, rows[:50]])
    assert places(rows).tolist() == [*range(101), *range(200, 205)]
    framed, distant = find_main(np.concatenate([ball(rng, 3000) + (5e5, 5e6, 300), np.zeros((1, 3))]))
    assert framed[:-1].all() and distant.tolist() == [False] * 3000 + [True]


def test_the_largest_group_is_framed_where_all_would_be_dots(rng):
    """Bodies are so small and far apart that their picture would be blank."""
    bodies = [ball(rng, n, 0.001, center) for n, center in zip((300, 200, 250), rng.normal(size=(3, 3)), strict=True)]
    points = pr.Points(np.concatenate(bodies))
    with pytest.warns(UserWarning, match=r"would cover only 0\.\d% of the image: the largest cluster is framed"):
        camera = pr.frame(points)
    np.testing.assert_allclose(camera.target, bodies[0].mean(axis=0), atol=2e-3)
    assert coverage(points.world, camera) > 0.05
    assert np.array_equal(largest_cluster(points.world), np.arange(300))


@pytest.mark.parametrize("share", [0.025, 0.1])
def test_a_sky_of_far_points_is_not_framed(rng, share):
    """There are more than may be ignored silently, spread over the whole picture."""
    sky = rng.normal(size=(round(20_000 * share), 3))
    sky *= 500 / np.linalg.norm(sky, axis=1, keepdims=True)
    points = pr.Points(np.concatenate([ball(rng, 20_000), sky]))
    with pytest.warns(UserWarning, match="the largest cluster is framed"):
        camera = pr.frame(points)
    assert np.linalg.norm(camera.target) < 0.2 and np.linalg.norm(camera.eye) < 10


@pytest.mark.parametrize("n", [1, 2, 5, 60])
def test_few_points_cover_their_picture(rng, n):
    points = pr.Points(ball(rng, n))
    assert coverage(points.world, pr.frame(points)) > 0.005


def test_coverage_is_the_share_of_a_sheet(rng):
    sheet = pr.Points(rng.uniform(-1, 1, (100_000, 3)) * (1, 0, 1))
    for projection in ("perspective", "orthographic"):
        camera = pr.Camera.look_at((0, -4, 0), (0, 0, 0), fov=2 * np.degrees(np.arctan(0.5)), projection=projection)
        assert coverage(sheet.world, camera) == pytest.approx(0.75 * 0.25, rel=0.15)
        away = pr.Camera.look_at((0, -4, 0), (0, -8, 0), projection=projection)
        assert coverage(sheet.world, away) == 0.0
    assert coverage(sheet.world, pr.Camera.look_at((0, -4, 0), (0, -8, 0), projection="panorama")) == 1.0


def test_a_camera_that_looks_away_is_reported(rng, tmp_path, capsys):
    pr.write(tmp_path / "a.ply", pr.Points(ball(rng, 500)))
    arguments = [
        "render",
        str(tmp_path / "a.ply"),
        "-o",
        str(tmp_path / "a.png"),
        "--size",
        "32x24",
        "--light",
        "headlight",
    ]
    assert execute([*arguments, "--eye", "0,-9,0", "--target", "0,-20,0"]) == 0
    assert (
        "note: the points cover only 0.0% of the image; without --eye and --target all are visible"
        in capsys.readouterr().err
    )
    assert execute(arguments) == 0
    assert "cover" not in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "output"),
    [
        ("gs_far_floaters.ply", "Not framed: 0.29% of the points lie far from all others"),
        ("outlier_1e6.ply", "Not framed: 0.025% of the points lie far from all others"),
        ("e57_phantom_zeros_world.e57", "Not framed: 50% of the points lie at 0, 0, 0 far from all others"),
    ],
)
def test_scans_that_failed_once_are_framed(name, output):
    points = pr.read(case_file(name))
    scan = Scan(points, ViewChoice())
    assert output in scan.found
    assert np.ptp(scan.bounds, axis=0).max() < 10
    assert coverage(points.world, scan.camera()) > 0.1
