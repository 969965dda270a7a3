"""The first picture of a scan: its up direction, camera, lights and exposure."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import pointray as pr
from helpers.marks import long
from helpers.places import shared_model
from pointray.auto_view.direction import angles_of, direction_of, find_outlook
from pointray.auto_view.first_view import Scan, ViewChoice
from pointray.auto_view.framing import MARGIN, STRAY, Lens, frame_points, frame_turning
from pointray.auto_view.sample import sample_of
from pointray.auto_view.stability import Ends, carries, outline
from pointray.auto_view.upright import axis_direction, find_up
from pointray.base.choices import VIEWS
from pointray.image.exposure import auto_exposure

# The up directions of the shared scans, as a human sees them; of these few in the fast tests.
FEW = "stanford_bunny", "outcrop_qcompass_rgb", "rgbd_kinect_chair_rgb", "sfm_garden_rgb_nonormals"
STANDING = {
    "stanford_bunny": "y",
    "stanford_dragon": "y",
    "stanford_bunny_rangescans": "y",
    "stanford_dragon_stand_rangescans": "y",
    "stanford_lucy_50k": "y",
    "nefertiti_50k": "z",
    "potree_lion_takanawa_rgb": "z",
    "outcrop_qcompass_rgb": "z",
    "autzen_stadium_crop_rgb": "z",
    "rgbd_kinect_chair_rgb": "-y",
    "tls_pumpA_rgb": "z",
    "sfm_garden_rgb_nonormals": "z",
    "tls_tower_wall_ghost_nonormals": "z",
}


@cache
def statue(count):
    return pr.procedural("statue", count)


@cache
def scan(name):
    return pr.read(shared_model(f"points/{name}.ply"))


@pytest.fixture(scope="module")
def small_statue():
    return pr.Model(statue(5_000))


def seen(camera, points):
    """Return picture positions of points, (2, n) from -1 to 1 (right, up), and depths along the view, (n,)."""
    eye, forward, right, up = camera.record()[:12].reshape(4, 3)
    offset = points - eye
    depth = offset @ forward
    scale = 1.0 if camera.projection == "orthographic" else depth
    return np.stack([offset @ right / (right @ right) / scale, offset @ up / (up @ up) / scale]), depth


def filled(camera, points, stray=STRAY):
    """Return the centre and half size of the points' box in the picture."""
    low, high = np.quantile(seen(camera, points)[0], [stray, 1 - stray], axis=1)
    return (low + high) / 2, (high - low) / 2


# ------------------------------------------------------------------------------------------------------ framing


@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
@pytest.mark.parametrize("size", [(400, 300), (100, 400)])
@pytest.mark.parametrize("direction", [(0.4, -1, 0.3), (1, 0, 0), (0, 0.001, -1)])
def test_points_fill_the_picture_and_are_in_its_middle(direction, size, projection):
    points = statue(5_000)
    camera = frame_points(sample_of(points), direction, (0, 0, 1), Lens(35, size, projection))
    middle, half = filled(camera, points.positions)
    assert np.abs(middle).max() < 0.01
    np.testing.assert_allclose(half.max(), 1 - 2 * MARGIN, atol=0.005)
    away = np.subtract(camera.eye, camera.target)
    np.testing.assert_allclose(away / np.linalg.norm(away), direction / np.linalg.norm(direction), atol=1e-9)


@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
@pytest.mark.parametrize("free", [(0, 0, 0.7, 1), (0.5, 0.25, 1, 0.75), (0, 0, 1, 0.6)])
def test_points_fill_the_free_part_of_the_picture(free, projection):
    points = statue(5_000)
    camera = frame_points(sample_of(points), (0.4, -1, 0.3), (0, 0, 1), Lens(35, (400, 300), projection), free)
    middle, half = filled(camera, points.positions)
    left, top, right, bottom = free
    np.testing.assert_allclose(middle, [left + right - 1, 1 - top - bottom], atol=0.01)
    np.testing.assert_allclose((half / (right - left, bottom - top)).max(), 1 - 2 * MARGIN, atol=0.01)


def test_strays_do_not_count(rng):
    clean = pr.procedural("torus", 20_000)
    strays = rng.normal(size=(8, 3)) * 50
    dirty = pr.Points(np.concatenate([clean.positions, strays]))
    cameras = [frame_points(sample_of(points), (0.4, -1, 0.3)) for points in (clean, dirty)]
    np.testing.assert_allclose(cameras[0].eye, cameras[1].eye, atol=0.02)


def test_islands_of_strays_do_not_count_and_a_pair_of_bodies_does(rng):
    torus = pr.procedural("torus", 20_000)
    island = rng.normal(size=(45, 3)) * 0.1 + (9, 3, 2)
    clean, dirty, pair = (
        sample_of(pr.Points(np.concatenate([torus.positions, *more])))
        for more in ([], [island], [torus.positions[:2000] + (9, 3, 2)])
    )
    assert clean.without_islands() is clean and pair.without_islands() is pair
    np.testing.assert_array_equal(dirty.without_islands().positions, clean.positions)
    sparse = sample_of(pr.Points(rng.random((300, 3)) * 50))
    assert sparse.without_islands() is sparse


def test_points_far_from_zero_are_framed_like_near_ones():
    points = statue(5_000)
    far = np.array([596_700.0, 5_243_700.0, 100.0])
    near = frame_points(sample_of(points), (0.4, -1, 0.3))
    moved = frame_points(sample_of(pr.Points(points.positions + far, points.normals)), (0.4, -1, 0.3))
    np.testing.assert_allclose(np.subtract(moved.eye, far), near.eye, atol=1e-3)


def test_instances_are_framed_at_their_place_in_the_scene():
    model = pr.Model(pr.procedural("torus", 2_000))
    scene = pr.Scene()
    for x in (0.0, 9.0):
        scene.add(model, pr.transform(scale=2, translate=(x, 0, 0)))
    scene.add(pr.Plane((0, 0, -1), (0, 0, 1)))
    everything = np.concatenate([2 * model.points.positions + (x, 0, 0) for x in (0.0, 9.0)])
    middle, half = filled(pr.frame(scene, "front", "z"), everything)
    assert np.abs(middle).max() < 0.02 and half.max() == pytest.approx(0.9, abs=0.02)


@pytest.mark.parametrize("up", [(0, 0, 1), (0, 1, 0), (1, 2, 3)])
@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
def test_a_turntable_keeps_the_scan_in_the_picture(up, projection):
    points = statue(5_000)
    first = frame_turning(sample_of(points), direction_of(25, 18, up), up, Lens(35, (400, 300), projection))
    sides = np.array([np.abs(seen(camera, points.positions)[0]) for camera in pr.turntable(first, 24)])
    assert np.quantile(sides, 1 - 2 * STRAY) < 0.92
    assert np.quantile(sides, 1 - 2 * STRAY) > 0.8
    assert all(seen(camera, points.positions)[1].min() > 0 for camera in pr.turntable(first, 24))


@pytest.mark.parametrize("fov", [35, 100])
@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
def test_what_turns_turns_about_its_own_axis(projection, fov, rng):
    """A cone seen from above has its centre off its axis; the eye may also be inside the cloud."""
    height, angle = 3 * np.sqrt(rng.random(20_000)), 2 * np.pi * rng.random(20_000)
    cone = np.stack([height * np.cos(angle) + 5, height * np.sin(angle), 3 - height], axis=1)
    first = frame_turning(
        sample_of(pr.Points(cone)), direction_of(25, 50, (0, 0, 1)), lens=Lens(fov, (400, 300), projection)
    )
    assert first.target[:2] == pytest.approx((5, 0), abs=0.02)
    sides = [filled(camera, cone) for camera in pr.turntable(first, 12)]
    np.testing.assert_allclose([half.max() for _, half in sides], 0.9, atol=0.02)
    assert np.abs([middle for middle, _ in sides]).max() < 0.03


def test_a_zoomed_parallel_view_has_nothing_behind_the_eye():
    points = statue(5_000)
    wide, near = (pr.frame(points, projection="orthographic", zoom=zoom) for zoom in (1, 20))
    np.testing.assert_allclose(filled(near, points.positions)[1], 20 * filled(wide, points.positions)[1])
    assert seen(near, points.positions)[1].min() > 0


def test_zoom_moves_the_eye_closer():
    points = pr.procedural("torus", 5_000)
    far, near = (pr.frame(points, zoom=zoom) for zoom in (1, 2))
    assert np.linalg.norm(np.subtract(near.eye, near.target)) == pytest.approx(
        np.linalg.norm(np.subtract(far.eye, far.target)) / 2
    )


# ------------------------------------------------------------------------------------------------- up and view


@pytest.mark.scans
@pytest.mark.parametrize(("name", "up"), [item if item[0] in FEW else long(*item) for item in STANDING.items()])
def test_scans_stand_upright(name, up):
    assert find_up(sample_of(scan(name))).axis == up


@pytest.mark.scans
@pytest.mark.parametrize(
    "name", ["stanford_bunny", *map(long, ("stanford_dragon", "stanford_lucy_50k", "nefertiti_50k"))]
)
@pytest.mark.parametrize("axis", ["y", "z"])
def test_a_body_stands_with_any_common_up_axis(name, axis):
    points = scan(name)
    old, new = (np.array(axis_direction(a)) for a in (STANDING[name], axis))
    about = np.cross(old, new)
    turn = np.eye(3)
    if about.any():
        turn = np.stack([about, new, np.cross(about, new)]).T @ np.stack([about, old, np.cross(about, old)])
    turned = pr.Points(points.positions @ turn.T, points.normals @ turn.T)
    assert find_up(sample_of(turned)).axis == axis


def test_maps_and_flat_scans_have_z_upwards(rng):
    wall = rng.random((3000, 3)) * (10, 0.1, 10)
    assert find_up(sample_of(pr.Points(wall + (6e5, 5e6, 0)))).axis == "z"
    assert find_up(sample_of(pr.Points(rng.random((3000, 3)) * (10, 10, 1.9)))).why == "the scan is flat"


@pytest.mark.scans
def test_splats_stand_with_y_downwards_unless_they_would_stand_better_otherwise():
    sphere = pr.procedural("sphere", 2000)
    about = {"opacity": np.ones(2000, np.float32), "scale_0": np.ones(2000, np.float32)}
    splats = pr.Points(sphere.positions, sphere.normals, attributes=about)
    assert find_up(sample_of(sphere)).axis == "z" and find_up(sample_of(splats)).axis == "-y"
    bunny = scan("stanford_bunny")
    for axis, turn in (("y", (1, 1, 1)), ("-y", (1, -1, -1))):
        about = {"opacity": np.ones(len(bunny)), "scale": np.ones((len(bunny), 3))}
        assert find_up(sample_of(pr.Points(bunny.positions * turn, bunny.normals * turn, None, about))).axis == axis


@pytest.mark.scans
@pytest.mark.long
def test_a_scan_of_splats_stands_with_y_downwards():
    man = pr.read(shared_model("raw/3dgs_biker.compressed.ply"))
    assert find_up(sample_of(man)).axis == "-y"  # z, if it was no cloud of splats


def test_terrain_is_seen_from_above_and_a_side_from_before_it(rng):
    flat = pr.Points(rng.random((3000, 3)) * (10, 10, 1))
    assert 35 <= find_outlook(sample_of(flat), (0, 0, 1)).elevation <= 45
    for facing in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (-0.6, -0.8, 0.0)):
        along = np.cross((0, 0, 1), facing)
        positions = rng.random((3000, 2)) @ np.stack([along, (0, 0, 1)])
        wall = pr.Points(positions, np.broadcast_to(facing, positions.shape))
        outlook = find_outlook(sample_of(wall), (0, 0, 1))
        assert direction_of(outlook.azimuth, 0, (0, 0, 1)) @ facing > 0.9


def room(ceiling, rng):
    """Points on the inside of a box, with normals that point inwards."""
    sides = []
    for axis in range(3):
        for side in (0, 1):
            if axis == 2 and side == 1 and not ceiling:
                continue
            positions, normal = rng.random((4000, 3)), np.zeros(3)
            positions[:, axis], normal[axis] = side, 1 - 2 * side
            sides.append((positions * (8, 6, 3), np.broadcast_to(normal, positions.shape)))
    return pr.Points(*(np.concatenate(arrays) for arrays in zip(*sides, strict=True)))


def test_a_room_is_seen_from_within_and_a_yard_from_above(rng):
    inside = pr.frame(room(True, rng), up="z")
    assert (np.array(inside.eye) > 0).all() and (np.array(inside.eye) < (8, 6, 3)).all()
    yard = Scan(room(False, rng), ViewChoice((0, 0, 1)))
    assert not yard.outlook.within and yard.outlook.elevation > 30


@pytest.mark.parametrize("up", [(0, 0, 1), (0, 1, 0), (0, -1, 0), (1, 2, 3)])
@pytest.mark.parametrize("view", VIEWS)
def test_named_views_look_from_their_side(view, up):
    camera = pr.frame(pr.procedural("torus", 2_000), view, up)
    away = np.subtract(camera.eye, camera.target)
    azimuth, elevation = angles_of(away, up)
    assert elevation == pytest.approx(VIEWS[view][1], abs=0.1)
    if abs(elevation) < 80:
        assert np.cos(np.radians(azimuth - VIEWS[view][0])) == pytest.approx(1)


def test_a_top_view_has_north_up():
    assert pr.frame(pr.procedural("torus", 2_000), "top", "z").record()[9:12] @ (0, 1, 0) > 0


@pytest.mark.parametrize(
    "wrong",
    [
        *({"view": "inside"}, {"up": "w"}, {"up": (0, 0, 0)}, {"zoom": 0}, {"azimuth": np.nan}, {"elevation": 91}),
        *({"fov": 200}, {"size": (0, 1)}, {"projection": "fisheye"}),
    ],
)
def test_an_invalid_view_is_reported(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        pr.frame(pr.procedural("torus", 2_000), **wrong)


def test_the_chosen_view_is_described():
    found = Scan(statue(5_000), ViewChoice()).found
    assert found.endswith(" Change with --view and --up.") and "\n" not in found
    assert Scan(statue(5_000), ViewChoice((0, 0, 1), "front")).found == ""


# ------------------------------------------------------------------------------------------------------- light


@pytest.mark.parametrize("kind", ["sun", "point"])
@pytest.mark.parametrize("integrator", ["phong", "path"])
def test_camera_lights_light_every_side_equally(kind, integrator):
    scene = pr.Scene()
    scene.add(pr.Model(pr.procedural("sphere", 5_000)), material=pr.Diffuse(1.0))
    scene.background = (0, 0, 0)
    along = {
        "sun": pr.SunLight((0.5, -0.6, -0.6), 3.0, camera=True),
        "point": pr.PointLight((-3, 4, 1), 40.0, camera=True),
    }
    scene.add_light(along[kind])
    settings = pr.Settings(integrator, spp=16, max_depth=1)
    cameras = [
        pr.Camera.look_at(eye, (0, 0, 0), up, size=(48, 48))
        for eye, up in (((0, -4, 0), (0, 0, 1)), ((2, 2, -2.83), (1, 0, 0)))
    ]
    pictures = [pr.render(scene, camera, settings)[..., 0] for camera in cameras]
    assert np.abs(pictures[0] - pictures[1]).mean() < 0.02 * pictures[0].mean()
    left, right = pictures[0][:, :24].mean(), pictures[0][:, 24:].mean()
    assert left > 1.2 * right and pictures[0][:24].mean() > 1.2 * pictures[0][24:].mean()


def test_a_camera_light_equals_the_same_light_in_the_world():
    scene, twin = pr.Scene(), pr.Scene()
    model = pr.Model(pr.procedural("torus", 5_000))
    camera = pr.Camera.look_at((1, -5, 2), (0, 0, 0), size=(32, 24))
    for either in (scene, twin):
        either.add(model)
    scene.add_light(pr.PointLight((1, 2, 3), 50.0, camera=True))
    forward, right, up = (camera.record()[k : k + 3] / np.linalg.norm(camera.record()[k : k + 3]) for k in (3, 6, 9))
    twin.add_light(pr.PointLight(np.array(camera.eye) + right + 2 * up - 3 * forward, 50.0))
    np.testing.assert_array_equal(pr.render(scene, camera), pr.render(twin, camera))


def test_sky_rays_measure_visibility_in_a_corner():
    """Half of the sky is hidden at the foot of a wall, and none far from it."""
    x, y = np.meshgrid(np.linspace(-1, 1, 60), np.linspace(-1, 1, 60))
    flat, zero, one = np.ravel(x), np.zeros(3600), np.ones(3600)
    floor = np.stack([flat, y.ravel(), zero], axis=1), np.stack([zero, zero, one], axis=1)
    wall = np.stack([flat, zero, y.ravel() + 1], axis=1), np.stack([zero, -one, zero], axis=1)
    scene = pr.Scene()
    for positions, normals in (floor, wall):
        scene.add(pr.Model(pr.Points(positions, normals)))
    scene.add_light(pr.EnvironmentLight(1.0))
    camera = pr.Camera.look_at((0, -0.5, 3), (0, -0.5, 0), (0, 1, 0), fov=8, size=(16, 16), projection="orthographic")
    near = replace(camera, eye=(0, -0.02, 3), target=(0, -0.02, 0))
    shares = [
        [
            pr.render(scene, c, pr.Settings(spp=4, sky_rays=rays, ao_distance=distance))[..., 0].mean()
            for c in (near, camera)
        ]
        for rays, distance in ((0, 1.0), (16, 1.0), (16, 0.25))
    ]
    np.testing.assert_allclose(shares[0], 1.0, atol=0.02)
    assert shares[1][0] == pytest.approx(0.6, abs=0.12) and shares[1][1] > shares[1][0] + 0.1
    assert shares[2][1] == pytest.approx(1.0, abs=0.02)  # the wall is farther away than the distance


def test_studio_light_neither_blackens_nor_clips():
    scene = pr.Scene()
    scene.add(pr.Model(statue(5_000)), material=pr.Diffuse(0.65))
    scene.lights = pr.studio()
    image = pr.render(scene, pr.frame(scene, size=(80, 60)), pr.Settings(spp=4, sky_rays=4))
    shown = image[image[..., 3] > 0.99, :3] * 2 ** auto_exposure(image)
    assert np.quantile(shown, 0.02) > 0.01 and np.quantile(shown, 0.99) < 0.96


@pytest.mark.parametrize("up", [(0, 0, 1), (0, -1, 0), (1, 1, 0)])
@pytest.mark.parametrize("azimuth", [0.0, 25.0, -170.0])
def test_the_fixed_studio_equals_the_camera_studio_of_its_side(small_statue, up, azimuth):
    """It equals the light that follows a level camera on that side of the scan."""
    scene = pr.Scene()
    scene.add(small_statue, material=pr.Diffuse(0.65))
    camera = pr.frame(scene, up=up, azimuth=azimuth, elevation=0, size=(48, 36))
    pictures = []
    for lights in (pr.studio(up), pr.studio(up, azimuth)):
        scene.lights = lights
        pictures.append(pr.render(scene, camera))
    np.testing.assert_allclose(*pictures, atol=1e-5)
    assert scene.snapshot() is scene.snapshot().without_camera_lights()
    turned = pr.frame(scene, up=up, azimuth=azimuth + 90, elevation=0, size=(48, 36))
    still = pr.render(scene, turned)
    scene.lights = pr.studio(up)
    assert np.abs(pr.render(scene, turned) - still).max() > 0.3


# ---------------------------------------------------------------------------------------------------- exposure


def test_exposure_brings_any_light_to_the_same_brightness(rng):
    image = rng.random((40, 50, 4)).astype(np.float32) * 0.2 + 0.2
    image[..., 3] = 1.0
    image[:10] = 0.0  # nothing is there
    stops = auto_exposure(image)
    for power in (-9, 3, 12):
        scaled = image * np.array([2.0**power] * 3 + [1.0], np.float32)
        assert auto_exposure(scaled) + power == pytest.approx(stops, abs=1e-9)


def test_exposure_keeps_highlights():
    image = np.full((100, 100, 4), 0.01, np.float32)
    image[..., 3] = 1.0
    image[:2] = 1.0  # 2 of 100 pixels
    assert 2 ** auto_exposure(image) <= 0.93
    image[:2] = 0.01
    image[0, :20] = 1e6  # one pixel of 500 may clip
    assert 2 ** auto_exposure(image) * 0.01 == pytest.approx(0.24, rel=0.05)


@pytest.mark.parametrize("value", [0.0, np.nan, np.inf])
def test_empty_or_black_images_have_the_default_exposure(value):
    assert auto_exposure(np.full((4, 4, 4), value, np.float32)) == 0.0


def test_a_backdrop_does_not_affect_exposure(tmp_path):
    from PIL import Image

    image = np.zeros((8, 4, 4), np.float32)
    image[:, 2:] = 1.0
    pr.write_image(tmp_path / "a.png", image, exposure=-2, backdrop=((0, 0, 0), (1, 0.5, 0)))
    pixels = np.asarray(Image.open(tmp_path / "a.png")).astype(int)
    assert pixels.shape == (8, 4, 3) and (pixels[:, 3] == 137).all()
    np.testing.assert_allclose(pixels[:, 0, 0], (np.arange(8) + 0.5) / 8 * 255, atol=1)
    with pytest.raises(ValueError, match="backdrop"):
        pr.write_image(tmp_path / "a.png", image, backdrop=((0, 0, 2), (0, 0, 0)))


@pytest.mark.parametrize("angle", [0.0, 11.25, 30.0, 45.0])
def test_a_wall_stands_wherever_it_is(angle, rng):
    """Seen from above it is a line, whose outline is 0."""
    u, height = rng.random((2, 400))
    a = np.radians(angle)
    for offset in (0.0, 0.1, 1.0, 7.7):
        wall = np.stack([u * np.cos(a) - offset * np.sin(a), u * np.sin(a) + offset * np.cos(a), height], axis=1)
        scores = np.concatenate([Ends.of(wall, axis).stances() for axis in range(3)])
        assert np.isfinite(scores).all()
        if offset == 0.0:
            first = scores
        assert scores == pytest.approx(first, abs=1e-6)


def test_the_up_direction_of_bodies_over_a_thin_base():
    along, across = np.array([np.cos(0.098), np.sin(0.098)]), np.array([-np.sin(0.098), np.cos(0.098)])
    base = np.array([x * along + y * across for x in np.linspace(-1, 1, 50) for y in (-0.005, 0.005)])
    for far, carried in ((0.0, True), (0.004, True), (0.006, False), (0.05, False)):
        assert carries(base, 0.3 * along + far * across) == carried
    assert not carries(base[:0], np.zeros(2)) and not carries(base[:1], np.zeros(2))
    assert outline(base) == pytest.approx(0.02, rel=1e-6)
    assert outline(base[::2]) == 0.0


@pytest.mark.parametrize("height", [10.2, 10.6])
def test_an_island_in_the_last_cell_is_not_beside_the_first(height, rng):
    box = rng.random((100_000, 3)) * (10, 10, 2)
    below = (5, 5, -0.05) + rng.random((30, 3)) * 0.01  # in the first cell, of the points that may be strays
    island = (5, 5, height) + rng.random((40, 3)) * 0.1
    found = sample_of(pr.Points(np.concatenate([box, below, island]))).without_islands()
    assert len(found.positions) == 100_030
