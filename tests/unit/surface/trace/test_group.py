"""Rays of a tile are traced in groups: their hits do not depend on the other rays of the tile."""

import numpy as np
import pytest

import pointray as pr


@pytest.fixture(scope="module")
def scene():
    scene = pr.Scene()
    model = pr.Model(pr.procedural("torus", 8_000))
    scene.add(model)
    away = np.diag([1.0, -1.0, 1.0, 1.0])  # mirrored, beside the other one
    away[:3, 3] = 3.2, 0.3, 0.1
    scene.add(model, away)
    return scene


def view(scene, eye):
    """Rays of 64 x 64 pixels, in the order of tiles."""
    camera = pr.Camera.look_at(eye, scene.bounds.mean(axis=0), fov=22, size=(64, 64))
    tiles = [a.reshape(8, 8, 8, 8, 3).swapaxes(1, 2).reshape(-1, 3) for a in camera.rays()]
    return tiles[0], tiles[1]


def mixed(groups, order):
    return (np.concatenate(rays)[order] for rays in zip(*groups, strict=True))


ORDERS = {
    "in turn": lambda rng, n, g: np.arange(n * g).reshape(g, n).T.reshape(-1),
    "two in three": lambda rng, n, g: np.argsort(np.concatenate([np.arange(n) * 1.5, *[np.arange(n) * 3.0] * (g - 1)])),
    "at random": lambda rng, n, g: rng.permutation(n * g),
}


@pytest.mark.parametrize("order", ORDERS)
def test_groups_that_share_tiles(rng, scene, order):
    """Tiles mix rays of several views: each hits what it hits together with rays of its own view."""
    eyes = (5.0, -6.0, 3.0), (-5.0, -4.0, 2.0), (1.0, 7.0, 0.5), (1.25, -7.0, 0.0)
    groups = [view(scene, eye) for eye in eyes]
    n = len(groups[0][0])
    order = ORDERS[order](rng, n, len(groups))
    origins, directions = mixed(groups, order)
    together = scene.intersect(origins, directions)
    alone = [scene.intersect(*rays) for rays in groups]
    instance, point, t, normal = (
        np.concatenate([getattr(hits, name) for hits in alone])[order] for name in ("instance", "point", "t", "normal")
    )
    hit = np.isfinite(t)
    assert 0.1 < hit.mean() < 0.9, hit.mean()
    assert np.array_equal(together.instance, instance)
    assert np.array_equal(together.point, point)
    assert np.allclose(together.t, t, rtol=1e-6)
    assert np.abs(together.normal - normal).max() < 1e-4
    assert np.array_equal(scene.occluded(origins, directions), hit)
    assert not scene.occluded(origins, directions, t_max=0.5).any()


def test_shadow_rays_of_pixels_beside_a_silhouette(rng, scene):
    """Neighbouring pixels see different parts of the shape; their shadow rays are traced in tiles and singly."""
    origins, directions = view(scene, (5.0, -6.0, 3.0))
    hits = scene.intersect(origins, directions)
    hit = np.isfinite(hits.t)
    starts = hits.position[hit]
    towards = np.array([-8.0, -9.0, 6.0]) - starts
    blocked = scene.occluded(starts, towards, t_max=1.0)
    assert 0.05 < blocked.mean() < 0.95, blocked.mean()
    order = rng.permutation(len(starts))
    assert np.array_equal(scene.occluded(starts[order], towards[order], t_max=1.0), blocked[order])


@pytest.fixture(scope="module")
def sphere():
    return pr.Model(pr.procedural("sphere", 20_000))


def test_rays_that_a_clip_plane_cuts_beside_others(rng, sphere):
    """Cut rays begin at the plane, close to a surface but not on it; the tile's other rays are not cut."""
    scene = pr.Scene()
    scene.add(sphere)
    scene.clips = [((0, 0, 0.3), (0, 0, 1))]
    turn = np.linspace(0, 0.1, 600)
    out = np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=-1)
    through, directions = out * (np.sqrt(1 - 0.3**2) - 3e-5) + (0, 0, 0.3), out - (0, 0, 0.6)
    cut = through - 2 * directions, directions  # from inside, 0.0006 radii below the surface
    whole = 3 * out - (0, 0, 0.4), -out
    origins, directions = mixed((cut, whole), ORDERS["in turn"](rng, 600, 2))
    hits = scene.intersect(origins, directions)
    assert (hits.instance == 0).all() and scene.occluded(origins, directions).all()
    assert np.abs(hits.position[::2] - through).max() < 1e-3
    assert np.abs(np.linalg.norm(hits.position[1::2], axis=-1) - 1).max() < 1e-3


@pytest.fixture(scope="module")
def bowl():
    return pr.Model(pr.procedural("sphere", 50_000))


@pytest.mark.parametrize("integrator", ["phong", "path"])
def test_both_sides_of_a_surface_may_share_a_tile(bowl, integrator):
    """A light at the eye casts no visible shadow, neither on the outside of a bowl nor on its inside."""
    scene, eye = pr.Scene(), (0.3, -5.0, 3.0)
    scene.add(bowl, material=pr.Diffuse(0.5))
    scene.clips = [((0, 0, 0.3), (0.1, 0, 1))]
    scene.add_light(pr.PointLight(eye, 20))
    camera = pr.Camera.look_at(eye, (0, 0, 0), fov=25, size=(160, 160))
    lit, bare = (pr.render(scene, camera, pr.Settings(integrator, max_depth=1, shadows=s)) for s in (True, False))
    assert 0.2 < (bare[..., 3] > 0).mean() < 0.9
    assert (np.abs(lit - bare)[..., :3].max(axis=-1) > 1e-4).mean() < 1e-3
