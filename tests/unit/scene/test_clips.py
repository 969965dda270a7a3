"""Clip planes: compared with rays cut by hand, in pictures of what is cut open, and messages about bad ones."""

import numpy as np
import pytest

import pointray as pr

UP = np.array([0.0, 0.0, 1.0])


def turned(degrees, size, position):
    return pr.transform(rotate=degrees, axis=(1, 2, 3), scale=size, translate=position)


@pytest.fixture(scope="module")
def torus() -> pr.Model:
    return pr.Model(pr.procedural("torus", 8_000))


@pytest.fixture(scope="module")
def sphere() -> pr.Model:
    return pr.Model(pr.procedural("sphere", 20_000))


@pytest.fixture(scope="module")
def scene(torus, sphere) -> pr.Scene:
    out = pr.Scene()
    out.add(torus, turned(70, 0.7, (0, 0, 0.9)))
    out.add(torus, turned(50, (1, -0.7, 1.3), (2.5, 0.5, 0)))
    out.add(sphere, turned(20, 0.8, (-2, 0, 1)))
    out.add(pr.Plane((0, 0, -0.1), (0, 0.1, 1)))
    out.add(pr.Plane((0, 4, 0), (0, 1, 0)))
    return out


# ------------------------------------------------------------------------------------------------------- the twin


def interval(clips, origins, directions, t_min, t_max):
    """Return the part of each ray that no plane clips; low > high if nothing is left."""
    low, high = np.broadcast_to(t_min, origins.shape[:-1]).copy(), np.broadcast_to(t_max, origins.shape[:-1]).copy()
    for point, normal in clips:
        height, rise = (origins - point) @ normal, directions @ normal
        with np.errstate(all="ignore"):
            t = -height / rise
        low = np.where(rise < 0, np.maximum(low, t), low)
        high = np.where(rise > 0, np.minimum(high, t), high)
        high = np.where((rise == 0) & (height > 0), -np.inf, high)
    return low, high


def camera_rays(rng, scene):
    return [a.reshape(120, 160, 3) for a in pr.Camera.frame(scene.bounds, (0.3, -1, 0.4), size=(160, 120)).rays()]


def all_ways(rng, scene, count=10_000):
    low, high = scene.bounds
    origins, targets = rng.uniform(low - 1, high + 1, (count, 3)), rng.uniform(low, high, (count, 3))
    return origins, (targets - origins) * rng.uniform(0.3, 3, (count, 1))


CLIPS = {
    "one": [((0, 0, 1), (0, 0, 1))],
    "towards the camera": [((0.1, -0.2, 0), (0.3, -3, 0.2))],
    "all but a slice": [((0, 0, 0.9), (0, 0.1, 2)), ((0, 0, 0.5), (0, 0, -1))],
    "a corner": [((1, 0, 0), (1, 0, 0)), ((0, 0, 1.2), (0.1, 0.1, 1)), ((0, 0.1, 0), (0, -1, 0))],
    "all": [((0, 0, 1), (0, 0, 1)), ((0, 0, 1.1), (0, 0, -1))],
}


@pytest.mark.parametrize("limits", [(0, np.inf), (1.5, 9.5)])
@pytest.mark.parametrize("rays", [camera_rays, all_ways])
@pytest.mark.parametrize("name", CLIPS)
def test_the_same_as_rays_with_intervals(rng, scene, name, rays, limits):
    origins, directions = rays(rng, scene)
    clips = [(np.array(p, float), np.array(n, float)) for p, n in CLIPS[name]]
    low, high = interval(clips, origins, directions, *limits)
    cut = scene.copy()
    cut.clips = clips
    found, expected = cut.intersect(origins, directions, *limits), scene.intersect(origins, directions, low, high)
    # A ray may be traced in a group or singly: t may differ by a step of float32.
    same = (found.instance == expected.instance) & np.isclose(found.t, expected.t, rtol=2.4e-7, atol=0)
    assert np.array_equal(cut.occluded(origins, directions, *limits), found.instance >= 0)
    # An interval may start on a surface, a clipped ray may not: few rays start in splats close to it, on average 0.9 of
    # 10,000 random rays (Poisson). A plane that is ignored changes hundreds to thousands.
    assert (~same).sum() <= (10 if rays is all_ways else 5)
    around = scene.intersect(origins[~same], directions[~same], low[~same] - 0.05, low[~same] + 0.05)
    assert (around.instance >= 0).all()
    assert (name == "all") == (found.instance < 0).all()
    for point, normal in clips:
        assert ((found.position[found.instance >= 0] - point) @ normal < 1e-6).all()


def rim_rays(rng, shape, inwards, off):
    """Return rays across the unit sphere's surface through points `off` inside it at z = 0.3; and the points."""
    turn = rng.uniform(0, 2 * np.pi, 600) if len(shape) == 1 else np.linspace(0, 0.1, 600)
    out = np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=-1)
    through = out * (np.sqrt(1 - 0.3**2) - off) + 0.3 * UP
    directions = (-1.0 if inwards else 1.0) * out - 0.6 * UP
    return [a.reshape(*shape, 3) for a in (through - 2 * directions, directions, through)]


@pytest.mark.parametrize("shape", [(600,), (20, 30)])
@pytest.mark.parametrize("off", [-1e-4, -3e-5, 3e-5, 1e-4])
def test_a_ray_that_is_cut_beside_the_surface_does_not_start_on_it(rng, sphere, shape, off):
    """Radii are 0.05 here, so all rays are within the hundredth of a radius in which they start on a surface."""
    scene = pr.Scene()
    scene.add(sphere)
    scene.clips = [(0.3 * UP, UP)]
    origins, directions, through = rim_rays(rng, shape, False, off)
    hits = scene.intersect(origins, directions)
    met = hits.instance >= 0
    if off > 0:  # from just inside outwards
        assert met.all() and np.abs(hits.position - through).max() < 1e-3
        assert scene.occluded(origins, directions).all()
    else:
        assert not met.any() and not scene.occluded(origins, directions).any()
    origins, directions, through = rim_rays(rng, shape, True, off)
    hits = scene.intersect(origins, directions)
    distance = np.linalg.norm(hits.position - through, axis=-1)
    assert (distance > 0.5).all() if off > 0 else (distance < 1e-3).all()


def test_rays_parallel_to_a_clip_plane_are_kept_or_cut(sphere):
    scene = pr.Scene()
    scene.add(sphere)
    scene.add(pr.Plane((0, 3, 0), (0, 1, 0)))
    origins = [[0, -5, 0.25 + h] for h in (-0.1, -1e-9, 0, 1e-9, 0.1)]
    for normal in (UP, 1e30 * UP, 1e-30 * UP):
        scene.clips = [(0.25 * UP, normal)]
        assert (scene.intersect(origins, [0, 1, 0]).instance >= 0).tolist() == [True, True, True, False, False]
        assert not (scene.intersect(origins, [0, 1, 0], -np.inf).instance < 0)[:3].any()
    scene.clips = [(0.25 * UP, UP), (0.2 * UP, -UP)]
    assert scene.occluded(origins, [0, 1, 0]).tolist() == [False, True, True, False, False]
    wrong = scene.intersect([[0, 0, 0], [np.nan, 0, 0.2], [0, 0, 0.22]], [[0, 0, 0], [0, 1, 0], [0, np.inf, 0]])
    assert (wrong.instance < 0).all()


def test_a_plane_in_a_clip_plane_stays_for_rays_from_the_side_that_is_cut_away(rng):
    scene, normal = pr.Scene(), np.array([0.3, -0.2, 1.0])
    scene.add(pr.Plane((0.1, 0.2, 0.3), normal))
    scene.clips = [((0.1, 0.2, 0.3), normal)]
    origins = rng.uniform(-3, 3, (2000, 3)) + 9 * UP
    assert (scene.intersect(origins, [0.1, 0.2, -1]).instance == 0).all()


# --------------------------------------------------------------------------------------------------------- pictures


def luminance(image):
    return image[..., :3].mean(axis=-1)


@pytest.mark.parametrize("integrator", ["phong", "path"])
def test_clipping_shows_the_inside(sphere, integrator):
    scene = pr.Scene()
    scene.add(sphere, material=pr.Diffuse(0.5))
    scene.add_light(pr.PointLight((0, 0, 5), 20))
    camera = pr.Camera.look_at((0, -1e-3, 4), (0, 0, 0), fov=40, size=(60, 60))
    settings = pr.Settings(integrator, max_depth=1)
    closed = pr.render(scene, camera, settings)
    scene.clips = [(0.3 * UP, UP)]
    image = pr.render(scene, camera, settings)
    middle = luminance(image)[28:32, 28:32]
    assert np.allclose(luminance(closed)[28:32, 28:32], 0.5 / np.pi * 20 / 4**2, rtol=0.02)
    assert np.allclose(middle, 0.5 / np.pi * 20 / 6**2, rtol=0.02)  # the bottom, which the light now reaches
    assert np.array_equal(image[..., 3] > 0, scene.intersect(*camera.rays()).instance >= 0)
    scene.clips = ()
    assert np.array_equal(pr.render(scene, camera, settings), closed)


@pytest.mark.parametrize("integrator", ["phong", "path"])
def test_clipped_parts_cast_no_shadow(sphere, integrator):
    scene = pr.Scene()
    scene.add(sphere)
    ground = scene.add(pr.Plane((0, 0, -1.5), (0, 0, 1)))
    scene.add_light(pr.SunLight((0, 0, -1), 1))
    scene.clips = [((0, 0, 0), (1, 0, 0.5))]
    camera = pr.Camera.look_at((-0.5, -5, 5), (0, 0, -1.2), size=(120, 90))
    hits = scene.intersect(*camera.rays())
    light = luminance(pr.render(scene, camera, pr.Settings(integrator, max_depth=1)))
    x, r = hits.position[..., 0], np.hypot(hits.position[..., 0], hits.position[..., 1])
    on_ground = hits.instance == ground
    edge = 0.5 * np.sqrt(np.maximum(1 - r**2, 0))  # where the lower half of the sphere ends
    shadowed = on_ground & (r < 0.97) & (x < edge - 0.03)
    lit = on_ground & ((r > 1.03) | (x > edge + 0.03))
    assert shadowed.sum() > 50 and (lit & (r < 0.97)).sum() > 50
    assert (light[shadowed] < 1e-6).all() and np.allclose(light[lit], 0.5 / np.pi, rtol=1e-4)


def test_clipping_affects_ambient_occlusion(sphere):
    scene = pr.Scene()
    scene.add(sphere)
    scene.add(pr.Plane((0, 0, -1), (0, 0, 1), color=1))
    scene.clips = [((0, 0, -1), (0, 0, 1))]  # the ground is not cut
    camera = pr.Camera.look_at((0, -3, 3), (0, 0, -1), size=(20, 20))
    assert np.allclose(pr.render(scene, camera, pr.Settings("ao", spp=4)), 1)


def test_a_picture_under_way_keeps_its_planes(scene):
    scene = scene.copy()
    scene.clips = CLIPS["one"]
    world, before = scene.snapshot().world, scene.clips
    kept = world.clips.copy()
    scene.clips = CLIPS["a corner"]
    after = scene.snapshot().world
    assert np.array_equal(world.clips, kept) and len(before) == 1 and len(scene.clips) == 3
    assert after.clips.size == 12 and after.instances is world.instances  # nothing else is rebuilt
    scene.update(0, np.eye(4))
    assert np.array_equal(scene.snapshot().world.clips, after.clips)


# ---------------------------------------------------------------------------------------------- arguments and errors


def test_clip_planes_are_stored_as_given():
    scene = pr.Scene()
    assert scene.clips.shape == (0, 2, 3)
    pairs = [((1, 2, 3), (0, 0, 2)), ([4, 5, 6], np.array([0, 1, 0]))]
    rows = np.array([[1, 2, 3, 0, 0, 2], [4, 5, 6, 0, 1, 0]])
    for given in (pairs, tuple(pairs), rows, rows.astype(np.float32), rows.tolist(), rows.reshape(2, 2, 3)):
        scene.clips = given
        assert scene.clips.dtype == np.float64 and np.array_equal(scene.clips, rows.reshape(2, 2, 3))
    rows[:] = 0
    assert scene.clips[0, 0].tolist() == [1, 2, 3]
    with pytest.raises(ValueError, match="read-only"):
        scene.clips[0, 0, 0] = 3
    for none in ((), [], np.zeros((0, 6)), np.zeros((0, 2, 3))):
        scene.clips = none
        assert scene.clips.shape == (0, 2, 3)
    scene.clips = np.ones((16, 6))
    assert len(scene.clips) == 16


BAD = {
    "none": (None, "list of pairs"),
    "number": (3, "list of pairs"),
    "text": ("abc", "list of pairs"),
    "texts": ([("a", "b")], "list of pairs"),
    "one pair": ((np.zeros(3), UP), "even for one plane"),
    "one row": ([0, 0, 0, 0, 0, 1], "even for one plane"),
    "five": ([[0, 0, 0, 0, 1]], r"shape \(1, 5\)"),
    "ragged": ([((0, 0), (0, 0, 1))], "same length"),
    "nan": ([((0, np.nan, 0), (0, 0, 1))], r"clips\[0\]: point must be three finite"),
    "inf": ([((0, 0, 0), (0, 0, 1)), ((0, 0, 0), (0, np.inf, 1))], r"clips\[1\]: normal must be three finite"),
    "zero": ([((0, 0, 0), (0, 0, 0))], r"clips\[0\]: normal must not be zero"),
    "complex": ([((0, 0, 0), (0, 0, 1j))], "got complex128"),
    "many": (np.ones((17, 6)), "at most 16 planes, got 17"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_planes_are_refused_and_change_nothing(case):
    scene = pr.Scene()
    scene.clips = [(np.zeros(3), UP)]
    version, (wrong, message) = scene._version, BAD[case]
    with pytest.raises(ValueError, match=message):
        scene.clips = wrong
    assert len(scene.clips) == 1 and scene._version == version
