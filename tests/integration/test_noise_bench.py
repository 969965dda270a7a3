"""`bench/noise/compare.py`: exact surfaces, faulty scans, and a run at a small size."""

import csv
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from bench.helpers.measure import lines
from bench.noise import compare as noise, surfaces as noise_surfaces
from bench.noise.clouds import Cube, Procedural, Torus, noisy
from bench.noise.measure import aimed, found_by, row_of
from bench.noise.scans import found_strays, rays_of
from bench.noise.scenes import Plate, Room, Wall, drift, layers, strays, veil
from bench.noise.surfaces import OURS, POISSON, Surface, peers
from bench.noise.tables import Figure, Limit, grouped, number, table_of, verdict


def exact_rays(exact, error=0.0):
    """Return a surface whose rays end `error` outside the exact one, found in small steps."""

    def cast(origins, directions):
        t, hit = np.zeros(len(origins)), np.zeros(len(origins), np.bool_)
        for _ in range(400):
            f = exact.compare(origins + t[:, None] * directions)[0] - error
            hit |= f < 1e-5
            t += np.where(hit, 0, f)
        return np.where(hit, t, np.inf), exact.compare(origins + t[:, None] * directions)[1]

    return Surface("exact", cast, 0.0)


@pytest.mark.parametrize("exact", [Torus(), Cube(), Wall(0.02, 0.5), Plate(0.1)], ids=lambda exact: exact.name)
def test_points_lie_on_the_surface_and_distances_are_to_the_nearest(rng, exact):
    x, normals = exact.points(40_000, rng)
    distance, same = exact.compare(x)
    assert x.shape == normals.shape == (40_000, 3) and np.abs(distance).max() < 1e-9
    assert (normals * same).sum(axis=1).min() > 0.99 or exact.name == "cube"  # a cube's edge has two
    inner, tree = np.abs(x[:200, :2]).max(axis=1) < 0.9, cKDTree(x)
    for side in (-0.03, 0.03):
        off = x[:200][inner] + side * normals[:200][inner]
        nearest = tree.query(off)[0]
        assert (np.abs(exact.compare(off)[0]) <= nearest + 1e-9).all()
        assert np.abs(nearest - np.abs(exact.compare(off)[0])).max() < 0.02
        assert (np.sign(exact.compare(off)[0]) == np.sign(side)).mean() > 0.99


def test_random_points_are_uniform_in_area(rng):
    x = Torus().points(100_000, rng)[0]
    outer = (np.hypot(x[:, 0], x[:, 1]) > 1).mean()  # the outer half has (pi + 0.8) / (2 pi) of the area
    assert abs(outer - (np.pi + 0.8) / (2 * np.pi)) < 0.01  # noise: 0.0015; even angles: a share of 0.5
    x = Cube().points(100_000, rng)[0]
    assert np.abs((np.abs(x) == 1).mean(axis=0) - 1 / 3).max() < 0.01


def test_noise_is_isotropic():
    clean, moved = noisy(Torus(), 20_000, 0.0), noisy(Torus(), 20_000, 0.5)
    assert np.allclose((moved.positions - clean.positions).std(axis=0) / clean.h, 0.5, atol=0.01)


def test_distance_to_the_edges_of_a_cube():
    x = np.array([[0.9, 0.95, 0.2], [1.1, 0.95, 0.2], [1.0, 1.0, 1.3], [0.0, 0.0, 1.0]])
    assert np.allclose(Cube().edges(x), [0.1118034, 0.1118034, 0.3, 1.0])


@pytest.mark.parametrize("exact", [Torus(), Cube()], ids=lambda exact: exact.name)
def test_an_offset_surface_has_its_offset_as_bias(exact):
    """Hits 0.3 h outside have that bias, no roughness and exact normals; rays that miss are not lost."""
    cloud = noisy(exact, 10_000, 0.0)
    found = found_by(exact_rays(exact, 0.3 * cloud.h), cloud, lines(cloud.bounds, 4000, 1))
    row = row_of(exact_rays(exact), cloud, found)
    assert row.hits > 800 and row.bias == pytest.approx(0.3, abs=0.002) and row.depth == pytest.approx(0.3, abs=0.002)
    assert row.roughness < 0.002 and row.normals < 1e-3 and row.lost == row.far == 0


def test_rays_through_a_hole_are_lost():
    cloud = noisy(Torus(), 10_000, 0.0)
    whole = exact_rays(cloud.exact)

    def cast(origins, directions):
        t, normals = whole.cast(origins, directions)
        return np.where(np.arange(len(t)) % 10 == 0, np.inf, t), normals

    found = found_by(Surface("holes", cast, 0.0), cloud, lines(cloud.bounds, 4000, 1))
    assert 8 < found.lost < 12


def test_rays_come_from_the_front(rng):
    targets, normals = Wall().points(500, rng)
    origins, d = aimed(targets, normals, 1.0)
    assert ((-d * normals).sum(axis=1) > 0.49).all() and np.allclose(origins + d, targets)


def test_faulty_scans_have_the_intended_faults():
    made = layers(2, n=5000)
    ghost = made.cloud.exact.compare(made.cloud.positions)[0][-500:]
    assert made.strays.sum() == 500 and abs(ghost.mean() / made.cloud.h - 2) < 0.05
    made = strays("close", n=50_000)
    away = np.abs(made.cloud.exact.compare(made.cloud.positions)[0]) / made.cloud.h
    assert made.strays.sum() == 500 and 4 <= away[made.strays].min() and away[made.strays].max() <= 20
    made = drift(n=4000)
    ends = [float(wall.compare(np.array([[1.0, 0, -0.1]]))[0][0]) for wall in made.others]
    assert abs(ends[0] - ends[1]) == pytest.approx(2 * np.sin(np.radians(0.5)), abs=0.002)
    origins, directions = rays_of(made, 100)[0]
    assert len(origins) == 100 and np.allclose(np.linalg.norm(directions, axis=1), 1)


@pytest.mark.long
def test_mixed_returns_lie_at_foreground_edges():
    made = veil()
    x = made.cloud.positions[made.strays]
    assert 500 < len(x) < 5000 and made.good.mean() > 0.97
    assert (np.linalg.norm(x, axis=1) < 11.5).all() and (x[:, 1] > 4).all()
    room = Room()
    d = made.cloud.positions / np.linalg.norm(made.cloud.positions, axis=1, keepdims=True)
    distance, normals = room.compare(d * room.ranges(d)[:, None])
    assert np.abs(distance).max() < 1e-9 and ((normals * d).sum(axis=1) < 1e-6).all()  # what is hit first faces us


def test_shares_of_strays_found():
    made = strays("anywhere", n=2000)
    found, lost = found_strays(made, made.strays)
    assert (found.value, lost.value) == (100, 0) and found.limit.least
    found, lost = found_strays(made, ~made.strays)
    assert found.value == 0 and lost.value == 100


@pytest.mark.parametrize(("value", "word"), [(-0.09, "aim"), (0.1, "met"), (0.12, "NOT met")])
def test_a_value_is_compared_with_its_target_and_limit(value, word):
    found = [Figure("torus", "a", "bias", OURS, value, Limit(1.0, 0.9, times=POISSON))]
    assert verdict(grouped(found)["torus", "a", "bias"]) == ""
    found.append(Figure("torus", "a", "bias", POISSON, -0.1))
    assert verdict(grouped(found)["torus", "a", "bias"]) == word
    assert table_of(found).row_count == 1 and number(np.nan) == "-"
    least = Figure("layers", "a", "found", OURS, 100 * abs(value), Limit(9.5, 11, least=True))
    assert verdict({OURS: least}) == {"aim": "NOT met", "met": "met", "NOT met": "aim"}[word]


@pytest.mark.long
def test_a_run_writes_its_table_and_plot(tmp_path, capsys, monkeypatch):
    pytest.importorskip("matplotlib")
    monkeypatch.setattr(noise, "QUICK", 3000)
    table, plot = tmp_path / "a.csv", tmp_path / "a.png"
    noise.main(["--quick", "--peers", "none", "--rays", "8000", "--csv", str(table), "--plot", str(plot)])
    rows = {row["what"]: row for row in csv.DictReader(table.open()) if row["surface"] == OURS}
    depth = rows["depth rms, h"]
    assert (depth["cloud"], float(depth["asked"]), float(depth["aim"])) == ("torus 0.3 h", 0.1, 0.07)
    assert 0.01 < float(depth["value"]) < 0.3 and float(rows["rays lost, %"]["value"]) < 0.1
    assert noise.torus_case(0.3, n=3000, rays=8000).depth == pytest.approx(float(depth["value"]))
    assert plot.stat().st_size > 5000 and sorted(tmp_path.iterdir()) == [table, plot]
    assert "asked" in capsys.readouterr().out


def test_a_smoothed_surface_has_its_own_column(monkeypatch):
    cloud = replace(noisy(Torus(), 2000, 0.1))
    assert [make().name for make in noise_surfaces.surfaces(cloud, [])][0] == OURS
    monkeypatch.setattr(noise_surfaces, "smooths", lambda: True)
    assert len(noise_surfaces.surfaces(cloud, [])) == 2


@pytest.mark.long
def test_missing_packages_are_reported(monkeypatch, tmp_path, capsys):
    monkeypatch.setitem(noise_surfaces.PEERS, POISSON, ("no_such_module",))
    here, messages = peers([POISSON])
    assert here == [] and "pip install no_such_module" in messages[0]
    noise.main(["--only", "wall", "--models", str(tmp_path), "--peers", "none", "--csv", str(tmp_path / "a.csv")])
    assert "not found in" in capsys.readouterr().out
    with pytest.raises(SystemExit):
        noise.parsed(["--noise", "-1"])


@pytest.mark.long
def test_the_statue_and_its_noise():
    exact = Procedural("statue")
    cloud = noisy(exact, 20_000, 0.0)
    distance, normals = exact.compare(cloud.positions + 0.2 * cloud.h * cloud.normals)
    assert abs(np.median(distance) / cloud.h - 0.2) < 0.01 and (normals * cloud.normals).sum(axis=1).mean() > 0.95
