"""Path tracing and its relatives, compared with light that can be computed by formulas."""

import math

import numpy as np
import pytest

import pointray as pr
from helpers.marks import long


@pytest.fixture(scope="module")
def sphere():
    return pr.Model(pr.procedural("sphere", 50_000))


def floor_scene(color=0.5):
    """An endless diffuse plane, and a camera that looks straight down at it."""
    scene = pr.Scene()
    scene.add(pr.Plane((0, 0, 0), (0, 0, 1), color))
    return scene, pr.Camera.look_at((0, 0, 10), (0, 0, 0), up=(0, 1, 0), fov=20, size=(48, 48))


def floor_points(camera):
    """Points at which the camera's rays meet the plane z = 0, (h, w, 3)."""
    o, d = camera.rays()
    return o - d * (o[..., 2:] / d[..., 2:])


def path(scene, camera, spp, **options):
    return pr.render(scene, camera, pr.Settings(integrator="path", spp=spp, filter="box", **options))


@pytest.mark.long
def test_radiance_in_a_closed_emitting_sphere_is_the_series(sphere):
    """Radiance 1 + 0.5 + 0.25 + ... = 2 in every pixel."""
    scene = pr.Scene()
    scene.add(sphere, material=pr.Emissive(1.0, color=0.5))
    camera = pr.Camera.look_at((0.2, 0.1, 0.3), (1, 0.2, 0), fov=80, size=(64, 64))
    image = path(scene, camera, 256, max_depth=64)
    assert np.abs(image[..., :3] / 2 - 1).max() < 0.01
    assert (image[..., 3] == 1).all()


@pytest.mark.parametrize("depth, want", [(0, 1.0), (1, 1.5), (2, 1.75), (3, 1.875)])
def test_depth_counts_scatterings(sphere, depth, want):
    scene = pr.Scene()
    scene.add(sphere, material=pr.Emissive(1.0, color=0.5))
    camera = pr.Camera.look_at((0, 0, 0), (1, 0, 0), fov=80, size=(16, 16))
    assert path(scene, camera, 64, max_depth=depth)[..., :3].mean() == pytest.approx(want, rel=0.005)


@pytest.mark.parametrize("integrator", ["phong", "path"])
def test_a_point_light_over_a_plane(integrator):
    scene, camera = floor_scene(0.5)
    scene.add_light(pr.PointLight((0.5, -0.3, 2), (10, 20, 30)))
    image = pr.render(scene, camera, pr.Settings(integrator=integrator))
    v = np.array([0.5, -0.3, 2]) - floor_points(camera)
    square = (v**2).sum(axis=-1)
    want = 0.5 / np.pi * 2 / square**1.5
    assert np.abs(image[..., :3] / (want[..., None] * (10, 20, 30)) - 1).max() < 0.005


@pytest.mark.parametrize("integrator", ["phong", "path"])
def test_a_sun_over_a_plane(integrator):
    scene, camera = floor_scene((0.2, 0.5, 0.8))
    scene.add_light(pr.SunLight((0, 0.6, -0.8), math.pi, angle=10))
    image = pr.render(scene, camera, pr.Settings(integrator=integrator, spp=64))
    assert image[..., :3].mean(axis=(0, 1)) == pytest.approx(np.array([0.2, 0.5, 0.8]) * 0.8, rel=0.002)


SIZED = {
    "rectangle": pr.RectLight((0.4, 0, 2), (0.5, 0, 0), (0, -0.6, 0), 3),
    "disk": pr.DiskLight((0.4, 0, 2), (0.3, 0.2, -1), 0.7, 3),
    "sphere": pr.SphereLight((0.4, 0, 2), 0.5, 3),
}


def emitting_piece(light):
    """The light's contribution to a plane at 0, by many small pieces of it that shine as points."""
    positions, normals, area = pieces(light)
    v = positions[None] - np.zeros(3)
    square = (v**2).sum(axis=-1)
    facing = np.maximum(-(normals * v).sum(axis=-1), 0)
    return (light.radiance * area * facing * np.maximum(v[..., 2], 0) / square**2).sum()


def pieces(light):
    n = 200
    a, b = np.meshgrid((np.arange(n) + 0.5) / n, (np.arange(n) + 0.5) / n, indexing="ij")
    a, b = a.ravel()[:, None], b.ravel()[:, None]
    center = np.asarray(light.center)
    if isinstance(light, pr.RectLight):
        u, v = np.asarray(light.u), np.asarray(light.v)
        normal = np.cross(u, v)
        area = 4 * np.linalg.norm(normal) / n**2
        return center + (2 * a - 1) * u + (2 * b - 1) * v, normal / np.linalg.norm(normal), area
    if isinstance(light, pr.DiskLight):
        normal = np.asarray(light.normal) / np.linalg.norm(light.normal)
        u = np.cross(normal, (1, 0, 0))
        u /= np.linalg.norm(u)
        turn, radius = 2 * np.pi * b, light.radius * np.sqrt(a)
        return (
            center + radius * (np.cos(turn) * u + np.sin(turn) * np.cross(normal, u)),
            normal,
            np.pi * light.radius**2 / n**2,
        )
    z, turn = 1 - 2 * a, 2 * np.pi * b
    n_out = np.concatenate([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z], axis=1)
    return center + light.radius * n_out, n_out, 4 * np.pi * light.radius**2 / n**2


@pytest.mark.parametrize("name", SIZED)
def test_area_lights_equal_the_sum_of_their_pieces(name):
    """The plane below is lit by either way of finding a light. The light itself is seen from its front only."""
    light = SIZED[name]
    scene, _ = floor_scene(0.5)
    scene.add_light(light)
    camera = pr.Camera.look_at((0, -1e-3, 0.01), (0, 0, 0), fov=1, size=(16, 16))
    image = path(scene, camera, 256, max_depth=1)
    assert image[..., :3].mean() == pytest.approx(0.5 / np.pi * emitting_piece(light), rel=0.005)
    seen = path(scene, pr.Camera.look_at((0.2, 0.1, 0.1), light.center, fov=1, size=(4, 4)), 4)
    assert seen[..., :3] == pytest.approx(3) and (seen[..., 3] == 1).all()
    if name != "sphere":
        behind = path(scene, pr.Camera.look_at((0.4, 0, 3), light.center, up=(0, 1, 0), fov=1, size=(4, 4)), 4)
        assert behind[..., :3].max() < 1.5  # the plane is seen through the light's back


def test_the_penumbra_of_a_sphere_light():
    """The edge of a wide upright plate casts a soft shadow, as wide as the sphere projected through the edge."""
    plate = np.stack(np.meshgrid(np.linspace(-3, 0, 75), np.linspace(-3, 3, 150), indexing="ij"), axis=-1).reshape(
        -1, 2
    )
    points = pr.Points(np.c_[plate, np.full(len(plate), 2.0)], np.tile([0.0, 0, 1], (len(plate), 1)))
    scene, _ = floor_scene(1.0)
    scene.add(pr.Model(points))
    radius, height = 0.5, 4.0
    scene.add_light(pr.SphereLight((0, 0, height), radius, 10))
    camera = pr.Camera.look_at((0, 0, 1.5), (0, 0, 0), up=(0, 1, 0), fov=1.6, size=(96, 2))
    shadow = path(scene, camera, 512, max_depth=1)[..., 0].mean(axis=0)
    free = pr.Scene()
    free.add(pr.Plane((0, 0, 0), (0, 0, 1), 1.0))
    free.add_light(pr.SphereLight((0, 0, height), radius, 10))
    share = shadow / path(free, camera, 128, max_depth=1)[..., 0].mean(axis=0)
    x = floor_points(camera)[0, :, 0]
    # Halfway half of the sphere is seen. Its share is that of a disk cut by a straight edge: 10% and 90% of its area.
    begin, end = (float(np.interp(q, share, x)) for q in (0.1, 0.9))
    disk = np.sqrt(1 - np.linspace(-1, 1, 200_001) ** 2)
    quantile = np.interp(0.9, np.cumsum(disk) / disk.sum(), np.linspace(-1, 1, 200_001))
    want = 2 * quantile * 2.0 * math.tan(math.asin(radius / 2.0))  # the edge is 2 below the light and 2 above the floor
    assert end - begin == pytest.approx(want, rel=0.05)


def test_a_mirror_reflects_its_surroundings(sphere):
    """The sphere's pixels show the gradient in the mirrored direction."""
    scene = pr.Scene()
    scene.add(sphere, material=pr.Mirror((0.9, 0.8, 0.7)))
    scene.add_light(pr.EnvironmentLight((1, 2, 3), horizon=(3, 1, 0.5), ground=0.25))
    camera = pr.Camera.look_at((0, -4, 1), (0, 0, 0), size=(64, 64))
    o, d = camera.rays()
    hits = scene.intersect(o, d)
    hit = hits.instance >= 0
    n = hits.position / np.linalg.norm(hits.position, axis=-1, keepdims=True)
    r = d - 2 * (d * n).sum(axis=-1, keepdims=True) * n
    up = r[..., 2:]
    sky = np.where(up > 0, (3, 1, 0.5) + up * (np.array([1, 2, 3]) - (3, 1, 0.5)), 0.25)
    sure = hit & (np.abs(up[..., 0]) > 0.01)
    for integrator in ("path", "phong"):
        image = pr.render(scene, camera, pr.Settings(integrator=integrator))
        assert np.abs(image[sure, :3] / (sky * (0.9, 0.8, 0.7))[sure] - 1).max() < 0.01, integrator


@pytest.mark.parametrize("integrator", [long("path"), "phong"])
def test_glass_obeys_snell(sphere, integrator):
    """A glass sphere bends rays by the right angle, read from a sky whose colour is its direction."""
    scene = pr.Scene()
    scene.add(sphere, material=pr.Dielectric(1.5))
    height, width = 360, 720
    polar = (np.arange(height) + 0.5) / height * np.pi
    around = ((np.arange(width) + 0.5) / width - 0.5) * 2 * np.pi
    direction = np.stack(
        [
            np.sin(around) * np.sin(polar)[:, None],
            np.cos(around) * np.sin(polar)[:, None],
            np.cos(polar)[:, None] + 0 * around,
        ],
        axis=-1,
    )
    scene.add_light(pr.EnvironmentLight(image=direction + 1))
    camera = pr.Camera.look_at((0, -6, 0), (0, 0, 0), fov=16, size=(48, 48), projection="orthographic")
    o, d = camera.rays()
    offset = np.hypot(o[..., 0], o[..., 2])
    middle = (offset > 0.1) & (offset < 0.6)
    spp = 1 if integrator == "phong" else 4096
    image = pr.render(scene, camera, pr.Settings(integrator=integrator, spp=spp, filter="box", max_depth=2))
    # The light that passes both surfaces, (1 - F)^2, comes from one direction; the rest is reflected by the first.
    cosine = np.sqrt(1 - offset[middle] ** 2)
    inner = np.sqrt(1 - (offset[middle] / 1.5) ** 2)
    reflect = 0.5 * (
        ((cosine - 1.5 * inner) / (cosine + 1.5 * inner)) ** 2 + ((1.5 * cosine - inner) / (1.5 * cosine + inner)) ** 2
    )
    n = np.stack([o[..., 0], -np.sqrt(np.maximum(1 - offset**2, 0)), o[..., 2]], axis=-1)[middle]
    mirrored = np.array([0, 1, 0]) - 2 * n[:, 1:2] * n
    through = image[middle, :3] - reflect[:, None] * (mirrored + 1)
    seen = through / ((1 - reflect) ** 2)[:, None] - 1
    seen /= np.linalg.norm(seen, axis=1, keepdims=True)
    bend = 2 * (np.arcsin(offset[middle]) - np.arcsin(offset[middle] / 1.5))
    away = np.stack([o[..., 0], 0 * offset, o[..., 2]], axis=-1)[middle] / offset[middle][:, None]
    want = np.cos(bend)[:, None] * (0, 1, 0) - np.sin(bend)[:, None] * away
    off = np.degrees(np.arccos(np.clip((seen * want).sum(axis=1), -1, 1)))
    assert np.median(off) < 0.5 if integrator == "path" else off.max() < 0.5


def test_the_sky_behind_is_the_same_for_direct_light(sphere):
    scene = pr.Scene()
    scene.add(sphere, material=pr.Mirror())
    scene.add_light(pr.EnvironmentLight((0.1, 0.2, 1), horizon=0.8, ground=0.3))
    camera = pr.Camera.look_at((0, -4, 1), (0, 0, 0), size=(32, 32))
    through = pr.render(scene, camera)[..., 3] == 0
    scene.background = "environment"
    direct = pr.render(scene, camera)
    assert through.mean() > 0.3 and (direct[..., 3] == 1).all()
    np.testing.assert_allclose(direct, path(scene, camera, 1), rtol=1e-6)


def test_mirrors_do_not_change_objects_beside_them(sphere):
    """Objects beside a mirror, before the same sky, look as if the mirror were black."""
    scene = pr.Scene()
    scene.add(sphere, material=pr.Mirror())
    scene.add(pr.Plane((0, 0, -1), (0, 0, 1), 0.5))
    scene.add_light(pr.EnvironmentLight((0.1, 0.2, 1), horizon=0.8, ground=0.3))
    camera = pr.Camera.look_at((0, -4, 1), (0, 0, 0), size=(32, 32))
    beside = scene.intersect(*camera.rays()).point < 0
    black = pr.render(scene, camera, pr.Settings(max_depth=0))
    assert 0.3 < beside.mean() < 0.9
    np.testing.assert_array_equal(pr.render(scene, camera)[beside], black[beside])


def test_glass_in_even_light_is_invisible(sphere):
    """A body of glass cannot be seen in even light from all around."""
    scene = pr.Scene()
    scene.add(sphere, material=pr.Dielectric(1.5))
    scene.add_light(pr.EnvironmentLight(1.0))
    scene.background = "environment"
    camera = pr.Camera.look_at((0, -4, 1), (0, 0, 0), size=(32, 32))
    assert path(scene, camera, 16, max_depth=None)[..., :3] == pytest.approx(1, abs=1e-4)


@pytest.mark.parametrize("color", [1.0, 0.5])
def test_a_white_furnace_has_the_radiance_of_the_colour(sphere, color):
    """In even light a convex diffuse body has the radiance of its colour, and so has a white plane."""
    scene = pr.Scene()
    scene.add(sphere, material=pr.Diffuse(color))
    scene.add_light(pr.EnvironmentLight(1.0))
    camera = pr.Camera.look_at((0, -4, 1), (0, 0, 0), size=(32, 32))
    image = path(scene, camera, 64)
    assert image[..., :3].sum() / image[..., 3].sum() / 3 == pytest.approx(color, rel=0.005)
    even = pr.render(scene, camera)  # phong has no shadows here, nor has a convex body
    assert even[even[..., 3] == 1, :3] == pytest.approx(color, rel=0.01)


def test_both_ways_of_finding_a_light_agree(sphere):
    """A glossy floor finds a large light by shadow rays too, or by reflected rays only."""
    camera = pr.Camera.look_at((0, -3, 1), (0, 0.5, 0), size=(24, 24))
    pictures = []
    for light in (pr.RectLight((0, 2, 1.5), (1.5, 0, 0), (0, 0, 1), 2), None):
        scene = pr.Scene()
        scene.add(pr.Plane((0, 0, 0), (0, 0, 1), 0.5), material=pr.Phong(specular=0.6, exponent=200))
        if light is not None:
            scene.add_light(light)
        else:  # the same rectangle as points that emit
            x, z = np.meshgrid(np.linspace(-1.5, 1.5, 150), np.linspace(0.5, 2.5, 100))
            shape = pr.Points(
                np.stack([x.ravel(), np.full(x.size, 2.0), z.ravel()], axis=1), np.tile([0, -1, 0], (x.size, 1))
            )
            scene.add(pr.Model(shape), material=pr.Emissive(2.0))
        pictures.append(path(scene, camera, 1024, max_depth=1)[..., :3])
    floor = np.s_[14:, :]
    a, b = pictures[0][floor], pictures[1][floor]
    assert abs(a.sum() / b.sum() - 1) < 0.02
    assert np.abs(a - b).mean() / b.mean() < 0.06


@pytest.mark.long
def test_lights_add_up(sphere):
    """One of several lights is sampled at each bounce: in the mean the picture is the sum of their pictures."""
    sky = np.full((16, 32, 3), 0.1)
    sky[3, 8] = 60
    lights = [
        pr.PointLight((2, -3, 2), 10),
        pr.RectLight((-1, -3, 2), (0.5, 0, 0), (0, -0.3, -0.5), (2, 4, 6)),  # with its back to the camera
        pr.SunLight((1, 1, -2), 0.5, angle=5),
        pr.EnvironmentLight(image=sky),
    ]
    camera = pr.Camera.frame([(-1, -1, -1), (1, 1, 1)], size=(24, 24))
    pictures = []
    dark = pr.RectLight((-1, -3, 2), (0.5, 0, 0), (0, -0.3, -0.5), 0)  # a black light that hides what the panel hides
    for some in ([lights[0], dark], [lights[1]], [lights[2], dark], [lights[3], dark], lights):
        scene = pr.Scene()
        scene.add(sphere, material=pr.Phong(0.7, specular=0.3, exponent=30))
        scene.add(pr.Plane((0, 0, -1), (0, 0, 1), 0.6))
        for light in some:
            scene.add_light(light)
        pictures.append(path(scene, camera, 1024, max_depth=3)[..., :3])
    *each, together = pictures
    assert together.sum() == pytest.approx(sum(each).sum(), rel=0.005)
    assert np.abs(together - sum(each)).mean() < 0.06 * together.mean()  # noise


def test_lights_block_light_from_behind():
    """Light from above the back of a wide panel does not arrive at the floor by either way of finding lights."""
    camera = pr.Camera.look_at((0, -0.5, 0.3), (0, 0, 0), fov=10, size=(12, 12))
    pictures = []
    for others in ([], [pr.SphereLight((0, 0, 4), 0.5, 500), pr.PointLight((0.3, 0, 5), 100)]):
        scene, _ = floor_scene(0.5)
        scene.add_light(pr.RectLight((0, 0, 1), (30, 0, 0), (0, -30, 0), 1))
        for light in others:
            scene.add_light(light)
        pictures.append(path(scene, camera, 512, max_depth=1)[..., :3])
    assert pictures[1].mean() == pytest.approx(pictures[0].mean(), rel=0.01)


def test_the_same_seed_gives_the_same_picture(sphere):
    scene = pr.Scene()
    scene.add(sphere)
    scene.add(pr.Plane((0, 0, -1), (0, 0, 1)))
    scene.add_light(pr.SphereLight((2, -2, 3), 0.5, 20))
    camera = pr.Camera.frame(scene.bounds, size=(50, 40))
    for integrator in ("path", "ao"):
        first, *others = (
            pr.render(scene, camera, pr.Settings(integrator=integrator, spp=3, seed=seed, threads=threads))
            for threads, seed in ((1, 0), (2, 0), (3, 0), (2, 1))
        )
        assert np.array_equal(first, others[0]) and np.array_equal(first, others[1])
        assert not np.array_equal(first, others[2])


def test_passes_make_the_same_picture(sphere):
    """Samples are summed in their own order, however many are made at a time. A noise target only stops early."""
    scene = pr.Scene()
    scene.add(sphere)
    camera = pr.Camera.frame(scene.bounds, size=(40, 30))
    whole = pr.render(scene, camera, pr.Settings(integrator="path", spp=21))
    pieces = pr.render(scene, camera, pr.Settings(integrator="path", spp=21, time_limit=1e4))
    assert np.array_equal(whole, pieces)


@pytest.mark.long
def test_noise_and_time_limits_stop_sampling(sphere):
    scene = pr.Scene()
    scene.add(sphere)
    scene.add(pr.Plane((0, 0, -1), (0, 0, 1)))
    scene.add_light(pr.SphereLight((2, -2, 3), 1, 20))
    camera = pr.Camera.frame(scene.bounds, size=(40, 30))
    exact = path(scene, camera, 2048)

    def error(**options):
        image = pr.render(scene, camera, pr.Settings(integrator="path", filter="box", **options))
        return np.sqrt(((image - exact)[..., :3] ** 2).mean()) / exact[..., :3].mean()

    assert 0.002 < error(noise=0.02) < 0.03
    assert error(noise=0.2) > 0.02
    assert error(time_limit=1e-9) > error(noise=0.02)


def test_a_sphere_occludes_its_part_of_the_sky(sphere):
    """The sky above a plane is open, except for the part that a sphere covers."""
    scene, camera = floor_scene(0.8)
    open_plane = pr.render(scene, camera, pr.Settings(integrator="ao", spp=4, ao_distance=5))
    assert open_plane[..., :3] == pytest.approx(0.8, abs=1e-6)
    scene.add(sphere, np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 2.0], [0, 0, 0, 1]]))
    camera = pr.Camera.look_at((3, 0, 0.5), (0.0, 0, 0), fov=2, size=(8, 8))
    shaded = pr.render(scene, camera, pr.Settings(integrator="ao", spp=1024, filter="box", ao_distance=50))
    # A sphere of radius 1 at height 2 covers sin^2 of its half angle, 1/4, of the irradiance.
    assert shaded[3:5, 3:5, :3].mean() == pytest.approx(0.8 * 0.75, rel=0.01)
    near = pr.render(scene, camera, pr.Settings(integrator="ao", spp=64, ao_distance=0.9))
    assert near[3:5, 3:5, :3] == pytest.approx(0.8, abs=1e-6)


def test_without_any_light_there_is_an_even_sky(sphere):
    scene = pr.Scene()
    scene.add(sphere, material=pr.Diffuse(0.6))
    camera = pr.Camera.look_at((0, -4, 1), (0, 0, 0), size=(32, 32))
    image = path(scene, camera, 64)
    assert image[..., :3].sum() / image[..., 3].sum() / 3 == pytest.approx(0.6, rel=0.005)
    assert (image[0, 0] == 0).all()


@pytest.mark.parametrize(
    "options",
    [
        {"max_depth": -1},
        {"max_depth": 1.5},
        {"ao_distance": 0},
        {"time_limit": float("nan")},
        {"noise": -0.1},
        {"integrator": "pathh"},
    ],
)
def test_bad_settings_are_refused(options):
    with pytest.raises(ValueError, match=next(iter(options))):
        pr.Settings(**options)
