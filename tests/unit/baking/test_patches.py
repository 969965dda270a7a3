"""Patches: which of them light a splat, which are neighbours, which are valid."""

import numpy as np
import pytest

import pointray as pr
from pointray.baking.baked import Baked
from pointray.baking.exchange import PROBE_SHARE
from pointray.baking.patches import AROUND, NEAR, choose_patches
from pointray.baking.planes import Grid, grid_neighbors, grid_positions
from pointray.baking.settings import BakeSettings
from pointray.baking.transport import Transport
from pointray.engine.kernels.records import PLANE_SIZE

FEW = BakeSettings(patches=256)


@pytest.fixture(scope="module")
def wall():
    """A wall whose back has few points, whose nearest patches are on its front."""
    front, back = _sheet(64, 0.0), _sheet(24, -0.1)
    normals = np.repeat([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]], [len(front), len(back)], axis=0)
    radii = np.repeat([0.03, 0.08], [len(front), len(back)])
    return pr.Model(pr.Points(np.concatenate([front, back]), normals), radii=radii)


def _sheet(edge, z):
    u, v = (x.reshape(-1) for x in np.meshgrid(*[np.arange(edge) / edge] * 2))
    return np.stack([u, v, np.full(len(u), z)], axis=1)


def test_a_splat_of_a_thin_wall_gets_the_light_of_its_own_side(wall):
    patches = choose_patches([wall.tree], 64)
    (blend,) = patches.blends
    slots = np.flatnonzero(wall.tree.order >= 0)
    normals = np.asarray(wall.points.normals)[wall.tree.order[slots]]
    assert (np.einsum("ij,ij->i", patches.normals[blend.patch_of[slots]], normals) > 0.9).all()
    weights, around = blend.weights.reshape(-1, AROUND)[slots], blend.around[slots // 4]
    away = np.einsum("ikj,ij->ik", patches.normals[around], normals) < 0.0
    assert (weights[away] == 0).all() and (weights.max(axis=1) == 255).all()


def test_the_back_of_a_lit_wall_is_dark(wall):
    scene = pr.Scene()
    id = scene.add(wall, material=pr.Diffuse(0.5))
    scene.add_light(pr.SunLight((0.0, 0.0, -1.0), 3.0))
    light = pr.bake(scene, FEW).irradiance(id)[:, 0]
    lit = np.asarray(wall.points.normals)[:, 2] > 0
    assert light[lit].mean() == pytest.approx(3.0, rel=0.05)
    assert light[~lit].max() < 1e-3


def test_cells_behind_a_wall_are_no_neighbours():
    scene = pr.Scene()
    scene.add(pr.Plane((0, 0, 0), (0, 0, 1)))
    scene.add(pr.Plane((0.1, 0, 0), (1, 0, 0)))
    floor, standing = scene.snapshot().world.planes.reshape(-1, PLANE_SIZE)
    grid = Grid(32, (0.0, 0.0), 1.0)
    middles = grid_positions(floor, grid)
    alone, parted = (grid_neighbors(grid, NEAR, middles, walls) for walls in ([], [standing]))
    before = middles[:, 0] < 0.1
    across = (alone >= 0) & (before[alone] != before[:, None])
    assert across.any() and (alone == parted)[~across].all() and (parted[across] == -1).all()


def test_the_floor_below_a_body_has_the_light_beside_it():
    """Cells of a plane inside a closed body see nothing; cells near its edge must not be darkened by them."""
    scene = pr.Scene()
    scene.add(pr.Model(pr.procedural("sphere", 4_000)), material=pr.Diffuse(0.5))
    scene.add(pr.Plane((0, 0, 0), (0, 0, 1), 0.5))
    scene.add_light(pr.EnvironmentLight())
    baked = Baked(scene, FEW, None)
    transport = baked._exchange.transport
    (floor,) = (side for side in transport.sides if isinstance(side.surface.patches, Grid) and side.sign > 0)
    away = np.linalg.norm(transport.positions[floor.span], axis=1)
    trusted = transport.trusted[floor.span]
    assert trusted[away > 1.05].all() and not trusted[away < 0.95].any()
    rim = (away > 0.85) & (away < 0.95)
    light = transport.fill_untrusted(np.where(transport.trusted, 1.0, 0.0).astype(np.float32)[:, None])[floor.span]
    assert rim.any() and (light[rim] == 1.0).mean() > 0.5


def test_light_on_planes_far_from_zero_is_the_same():
    """A ray that starts on a plane far from zero must not ignore the floor beside it as its own start."""
    light = []
    for offset in (0.0, 5e6):
        scene = pr.Scene()
        middle = np.array([offset, -offset, offset])
        scene.add(pr.Model(pr.Points(pr.procedural("sphere", 4_000).world + middle)), material=pr.Diffuse(0.5))
        scene.add(pr.Plane(middle - (0, 0, 1), (0, 0, 1), 0.5))
        scene.add(pr.Plane(middle + (1.2, 0, 0), (-1, 0, 0), 0.5))
        scene.add_light(pr.EnvironmentLight())
        camera = pr.Camera.look_at(middle + (-4, -4, 2), middle, size=(48, 48))
        light.append(pr.render(scene, camera, pr.Settings("path", spp=64))[..., 0])
    assert light[1].mean() == pytest.approx(light[0].mean(), rel=0.01)


def test_the_rays_of_a_bake_are_in_proportion_to_its_patches(rng, monkeypatch):
    """Random points, lit on both sides: a quarter of the patches finds which sides are dark."""
    sent = []
    send = Transport.send

    def counted(self, rows, links, progress=None):
        sent.append(len(rows) * links)
        send(self, rows, links, progress)

    monkeypatch.setattr(Transport, "send", counted)
    scene = pr.Scene()
    scene.add(pr.Model(rng.random((14_000, 3)), smooth=0))
    scene.lights = pr.studio(azimuth=0)
    pr.bake(scene, pr.BakeSettings(patches=12_000, links=4, noise=1.0))
    probe, first, *more = sent
    assert probe <= 2 * 16 * 12_000 / PROBE_SHARE * 1.1
    assert first <= 2 * 4 * 12_000 * 1.1
    assert sum(more) < 0.1 * first
