"""Normals of noisy and layered scans agree with each other and face the viewpoint."""

import numpy as np
import pytest

import pointray as pr
from helpers.marks import long
from helpers.places import shared_model
from pointray import Points
from pointray.cloud.neighbors import kd_order
from pointray.cloud.normals.jets import fit_normals
from pointray.cloud.normals.layers import Layers

TOWER = (-3, -30, 0)


def layered_wall(n=12_000, gap=2.5, step=0.15):
    """Return a wall of two noisy layers (a tenth of the points in front) with a step in its middle; and the spacing."""
    rng = np.random.default_rng(6)
    spacing = 1 / np.sqrt(n)
    x, z = rng.random((2, n))
    y = step * (x > 0.5) + 0.4 * spacing * rng.normal(size=n) - gap * spacing * (rng.random(n) < 0.1)
    side = np.column_stack([np.full(n // 10, 0.5), step * rng.random(n // 10), rng.random(n // 10)])
    return np.concatenate([np.column_stack([x, y, z]), side])


def away(normals, positions, eye):
    """Return the share of normals that face away, and the share that do so at no grazing angle."""
    view = eye - positions
    cosine = np.sum(normals * view, axis=1) / np.linalg.norm(view, axis=1)
    return (cosine < 0).mean(), (cosine < -0.2).mean()


def test_normals_of_two_layers_agree():
    """Measured: 0.1%; 5.4% with edges between single points."""
    positions = layered_wall()
    found = pr.estimate_normals(Points(positions)).normals
    wall = len(positions) - len(positions) // 11
    assert min((found[:wall, 1] < 0).mean(), (found[:wall, 1] > 0).mean()) < 0.005


def test_only_noisy_points_are_projected_onto_planes():
    torus = pr.procedural("torus", 8000)
    spacing = np.sqrt(4 * np.pi**2 * 0.4 / 8000)
    noise = np.random.default_rng(0).normal(size=(8000, 3)) * spacing
    for share, noisy in ((0, False), (0.1, False), (0.3, True), (1, True)):
        path = np.float32(torus.positions + share * noise)
        path = path[kd_order(path)]
        layers = Layers(path)
        fit_normals(path, 11, planes=layers)
        assert layers.noisy == noisy


@pytest.mark.parametrize(("noise", "flipped"), [long(0.3, 0.001), (0.7, 0.09)])
def test_a_noisy_torus_faces_outward(noise, flipped):
    torus = pr.procedural("torus", 12_000)
    shift = noise * np.sqrt(4 * np.pi**2 * 0.4 / 12_000) * np.random.default_rng(0).normal(size=(12_000, 3))
    found = pr.estimate_normals(Points(torus.positions + shift)).normals
    assert (np.sum(found * torus.normals, axis=1) < 0).mean() < flipped


@pytest.mark.scans
@pytest.mark.long
def test_normals_of_the_wall_of_a_tower_face_the_viewpoint():
    """It has a sparse second layer in front, and some ledges face away. Measured: 0.28%, 4.1% and 1.2%."""
    points = read_wall()
    seen = pr.estimate_normals(points, viewpoint=TOWER).normals
    assert away(seen, points.positions, TOWER)[0] < 0.003
    found = pr.estimate_normals(points).normals
    view = np.array(TOWER) - points.positions
    if (np.sum(found * view, axis=1) < 0).mean() > 0.5:
        found = -found
    share, clear = away(found, points.positions, TOWER)
    assert share < 0.05 and clear < 0.018


def read_wall():
    return pr.read(shared_model("points/tls_tower_wall_ghost_nonormals.ply"))


@pytest.mark.scans
@pytest.mark.parametrize("name", [long("stanford_dragon_stand_rangescans"), long("stanford_bunny_rangescans")])
def test_normals_of_range_scans_face_the_viewpoint(name):
    points = pr.read(shared_model(f"points/{name}.ply"))
    found = pr.estimate_normals(points).normals
    assert (np.sum(found * points.normals, axis=1) < 0).mean() < 0.004
