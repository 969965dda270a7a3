"""Strays of each kind are found, and surfaces keep their points."""

import numpy as np
import pytest

import pointray as pr
from helpers.marks import long
from helpers.places import shared_model
from pointray.cli import execute
from pointray.cloud.outliers import without_strays

N = 10_000
H = np.sqrt(4 / N)  # the spacing on the wall


def wall(n, seed=0, noise=0.1):
    """Return points of a curved wall and its normals."""
    draw = np.random.default_rng(seed)
    u, v = draw.uniform(-1, 1, (2, n))
    normals = np.stack([-0.3 * np.cos(2 * u) * np.cos(1.5 * v), np.ones(n), 0.225 * np.sin(2 * u) * np.sin(1.5 * v)], 1)
    normals /= -np.linalg.norm(normals, axis=1)[:, None]
    places = np.stack([u, 0.15 * np.sin(2 * u) * np.cos(1.5 * v), v], axis=1)
    return places + draw.normal(size=(n, 3)) * noise * H, normals


def layered(off, share=0.1):
    rows, _ = wall(N)
    front, normals = wall(int(N * share), 1)
    return pr.Points(np.vstack([rows, front + off * H * normals])), np.arange(len(rows) + len(front)) >= N


def veiled(step=0.0045):
    """Return a pole before a wall, seen from the origin; each row has a mixed return at each edge of the pole."""
    a, e = np.meshgrid(np.arange(-0.35, 0.35, step), np.arange(-0.35, 0.35, step))
    rays = np.stack([np.sin(a) * np.cos(e), np.cos(a) * np.cos(e), np.sin(e)], axis=2)
    flat, ahead = np.hypot(rays[..., 0], rays[..., 1]), rays[..., 1]
    under = (3 * ahead) ** 2 - flat**2 * (9 - 0.12**2)
    pole = (3 * ahead - np.sqrt(np.maximum(under, 0))) / flat**2
    behind = 5 / ahead
    edge = np.zeros(a.shape, bool)
    edge[:, 1:] = (under[:, 1:] > 0) != (under[:, :-1] > 0)
    share = np.random.default_rng(0).uniform(0.03, 0.97, a.shape)
    mixed = 3 / ahead * (1 - share) + behind * share
    ranges = np.where(edge, mixed, np.where(under > 0, pole, behind))
    return (rays * ranges[..., None]).reshape(-1, 3), edge.reshape(-1)


@pytest.mark.parametrize("off", [long(0.75), 1.5, long(3), 4])
def test_a_sparse_second_layer_is_found(off):
    points, sparse = layered(off)
    strays = pr.find_strays(points)
    assert strays.any[sparse].mean() > 0.94
    assert strays.any[~sparse].mean() < 0.005
    assert strays.layer.sum() > 0.8 * strays.any.sum()


def test_layers_are_merged_with_the_surface():
    points, sparse = layered(2)
    merged = pr.merge_layers(points.changed(attributes={"row": np.arange(len(points))}))
    x, y, z = merged.positions[sparse].T
    off = np.abs(y - 0.15 * np.sin(2 * x) * np.cos(1.5 * z)) / H
    assert np.quantile(off, 0.9) < 0.2 and len(merged) == len(points)
    moved = (merged.positions != points.positions).any(axis=1)
    assert moved[~sparse].mean() < 0.005 and (merged.attributes["row"] == np.arange(len(points))).all()
    clean = pr.Points(wall(N, noise=0)[0])
    assert pr.merge_layers(clean) is clean


def test_isolated_points_are_found():
    rows, _ = wall(N)
    strays = np.random.default_rng(5).uniform(rows.min(axis=0), rows.max(axis=0), (N // 100, 3))
    off = np.abs(strays[:, 1] - 0.15 * np.sin(2 * strays[:, 0]) * np.cos(1.5 * strays[:, 2])) > H
    found = pr.find_strays(pr.Points(np.vstack([rows, strays]))).any
    assert found[N:][off].mean() > 0.95 and found[:N].mean() < 0.002


def test_mixed_returns_are_found_from_the_scanner():
    rows, edge = veiled()
    points = pr.Points(rows)
    strays = pr.find_strays(points, (0, 0, 0))
    assert strays.any[edge].mean() > 0.95 and strays.veil[edge].mean() > 0.8
    assert strays.any[~edge].mean() < 0.001
    assert not pr.find_strays(points).veil.any()
    stations = np.full((len(rows), 3), np.nan)
    assert not pr.find_strays(points, stations).veil.any()
    georeferenced = points.changed(georeference=pr.Georeference(stations=[(0, 0, 0)]))
    assert (pr.find_strays(georeferenced).veil == strays.veil).all()


@pytest.mark.parametrize(("model", "count"), [("torus", 8_000), long("statue", 30_000)])
@pytest.mark.parametrize("place", ["outside", "middle", "at a point"])
def test_a_body_seen_from_one_place_has_no_mixed_returns(place, model, count):
    points = pr.procedural(model, count)
    low, high = points.bounds
    eye = {"outside": low - 3 * (high - low), "middle": (low + high) / 2, "at a point": points.world[7]}[place]
    assert pr.find_strays(points, eye).veil.mean() < 0.001


def test_a_group_that_floats_is_found():
    bird = np.random.default_rng(2).normal(size=(15, 3)) * H + (0.2, -1, 0.3)
    strays = pr.find_strays(pr.Points(np.vstack([wall(N)[0], bird])))
    assert (strays.floating | strays.lone)[N:].all() and strays.floating[N:].sum() > 10
    assert not strays.floating[:N].any()


@pytest.mark.parametrize("noise", [0, long(0.1), 0.5, long(1)])
def test_noisy_surfaces_keep_their_points(noise):
    assert pr.find_strays(pr.Points(wall(N, noise=noise)[0])).any.mean() < 0.005


def test_thin_bodies_keep_both_sides():
    draw = np.random.default_rng(1)
    rows, side = draw.uniform(-1, 1, (N, 3)), np.where(np.arange(N) % 2, 1.0, -1.0)
    rows[:, 2] = side * np.sqrt(4 / (N / 2))
    assert pr.find_strays(pr.Points(rows)).any.mean() < 0.005
    side = np.where(draw.uniform(size=N) < 0.1, 1.0, -1.0)
    rows[:, 2] = side * np.sqrt(4 / N)
    normals = np.stack([0 * side, 0 * side, side], axis=1)
    strays = pr.find_strays(pr.Points(rows, normals)).any
    assert strays[side > 0].mean() < 0.05 and pr.find_strays(pr.Points(rows)).any[side > 0].mean() > 0.5


@pytest.mark.parametrize(("model", "count"), [("torus", 8_000), long("statue", 30_000), long("lattice", 30_000)])
def test_models_keep_their_points(model, count):
    assert pr.find_strays(pr.procedural(model, count)).any.mean() < 0.002


@pytest.mark.scans
def test_a_mesh_keeps_its_points():
    assert pr.find_strays(shared_model("stanford_bunny")).any.mean() < 0.001


@pytest.mark.parametrize(
    "rows",
    [
        np.random.default_rng(0).uniform(-1, 1, (19, 3)),
        np.ones((100, 3)),
        np.stack([np.arange(500.0), np.zeros(500), np.zeros(500)], axis=1),
        np.stack(np.meshgrid(*[np.arange(10.0)] * 3), axis=-1).reshape(-1, 3),
    ],
    ids=["few", "equal", "line", "grid"],
)
def test_degenerate_clouds_have_no_strays(rows):
    assert not pr.find_strays(pr.Points(rows)).any.any()


def test_a_cloud_of_strays_only_is_not_changed():
    assert pr.find_strays(pr.Points(np.random.default_rng(0).uniform(-1, 1, (3000, 3)))).any.mean() < 0.01


def test_rows_that_are_not_finite_are_no_strays_and_equal_ones_share_their_kind():
    points, _ = layered(2)
    whole = pr.find_strays(points)
    rows = np.vstack([points.positions, np.full((3, 3), np.nan), points.positions[::-1]])
    strays = pr.find_strays(pr.Points(rows))
    assert not strays.any[len(points) : len(points) + 3].any()
    assert (strays.any[: len(points)] == whole.any).all()
    assert (strays.any[len(points) + 3 :] == whole.any[::-1]).all()


def test_a_wrong_viewpoint_is_refused():
    points, _ = layered(2)
    with pytest.raises(ValueError, match="viewpoint"):
        pr.find_strays(points, (0, np.nan, 0))
    with pytest.raises(ValueError, match="viewpoint"):
        pr.find_strays(points, np.zeros((5, 3)))
    assert len(pr.find_strays(points, points.positions[0]).any) == len(points)  # at a point


def test_each_kind_of_stray_is_described():
    points, _ = layered(2)
    with pytest.warns(UserWarning, match=r"^scan: 1,0\d\d strays \(.* in second layers, .*\) removed$"):
        left = without_strays(points, "scan")
    assert len(left) < N + 10


@pytest.mark.long
def test_commands_remove_strays(tmp_path, capsys):
    scan, small = tmp_path / "a.ply", tmp_path / "b.ply"
    points, _ = layered(2)
    pr.write(scan, points)
    assert (
        execute(["prepare", str(scan), "-o", str(small), "--drop-strays", "--viewpoint=0,-9,0", "--normals=auto"]) == 0
    )
    assert f"{scan}: 1,0" in capsys.readouterr().err
    assert len(pr.read(small)) < N + 10
    assert (
        execute(
            ["render", str(scan), "-o", str(tmp_path / "a.png"), "--size=32x32", "--drop-strays", "--light=headlight"]
        )
        == 0
    )
    assert "in second layers" in capsys.readouterr().err
    model = tmp_path / "m.pointray"
    pr.Model(points).save(model)
    assert execute(["info", str(model), "--drop-strays"]) != 0
    assert "--drop-strays is for scans" in capsys.readouterr().err
