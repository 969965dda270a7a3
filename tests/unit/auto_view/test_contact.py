"""Contact shadows of standing objects, compared with an analytic sphere and plain loops."""

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

import pointray as pr
from helpers.marks import long
from helpers.places import shared_model
from pointray.auto_view import contact
from pointray.auto_view.contact import CELLS, contact_shadow
from pointray.auto_view.first_view import Scan, ViewChoice
from pointray.cli import execute
from pointray.engine.kernels.records import PROJECTION
from pointray.viewer.contacts import Contacts
from pointray.viewer.view_settings import ViewSettings

UP = (0.0, 0.0, 1.0)
KEY = (0.5, 0.3, -0.8)


@pytest.fixture(scope="module")
def ball():
    """A sphere of radius 1 about (3, 1, 2), and some of its points."""
    points = pr.procedural("sphere", 4_000)
    moved = pr.Points(points.positions.astype(np.float64) + [3, 1, 2], points.normals)
    scene = pr.Scene()
    scene.add(pr.Model(moved))
    return scene, moved.positions + moved.origin


@pytest.fixture(scope="module", params=[None, KEY], ids=["sky", "key"])
def shadow(ball, request):
    return contact_shadow(*ball, UP, request.param), request.param


def blocked_by_sphere(origins, directions, middle, most):
    """Return whether rays hit a sphere of radius 1, from outside or inside, by the quadratic equation."""
    offset = origins - middle
    b, c = (offset * directions).sum(axis=-1), (offset**2).sum(axis=-1) - 1
    root = b * b - c
    near, far = -b - np.sqrt(np.maximum(root, 0)), -b + np.sqrt(np.maximum(root, 0))
    return (root > 0) & (((near > 0) & (near < most)) | ((far > 0) & (far < most)))


def test_the_grid_equals_that_of_an_analytic_sphere(shadow):
    found, key = shadow
    np.testing.assert_allclose(found.middle, [3, 1, 1], atol=0.02)
    side = ((np.arange(CELLS) + 0.5) / CELLS * 2 - 1) * found.half
    ground = np.stack([*np.meshgrid(side, side, indexing="ij"), np.zeros((CELLS, CELLS))], axis=-1)
    directions, weights = contact._directions(None if key is None else -(found.axes @ key))
    assert weights.sum() == pytest.approx(1) and (directions[..., 2] > 0).all()
    np.testing.assert_allclose(np.linalg.norm(directions, axis=-1), 1)
    center = found.axes @ ([3, 1, 2] - found.middle)
    blocked = blocked_by_sphere(ground[:, :, None], directions, center, contact.LENGTH * 2)
    expected = contact._smooth_and_fade((blocked * weights).sum(axis=-1), ground / found.half)
    assert expected.max() > 0.5
    np.testing.assert_allclose(found.shadow, expected, atol=0.05)
    assert np.abs(found.shadow - expected).mean() < 2e-3


def test_the_shadow_is_dark_below_and_ends_before_the_edge(shadow):
    grid, key = shadow[0].shadow, shadow[1]
    assert grid[CELLS // 2, CELLS // 2] > 0.6 * contact.STRENGTH and grid.max() <= contact.STRENGTH
    assert max(grid[[0, -1]].max(), grid[:, [0, -1]].max()) < 1e-3
    away = (grid.sum(axis=1) * np.arange(CELLS)).sum() / grid.sum() - (CELLS - 1) / 2
    sideways = shadow[0].axes[0] @ np.array(KEY)
    assert abs(away) < 0.3 if key is None else away * sideways > 0  # it falls away from the key light


@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
def test_a_picture_shows_the_shadow_where_rays_hit_the_ground(shadow, projection):
    found = shadow[0]
    camera = pr.Camera.look_at((7, -4, 4), (3, 1, 1.5), fov=50, size=(24, 18), projection=projection)
    alpha = found.put_under(np.zeros((18, 24, 4), np.float32), camera)[..., 3]
    origins, directions = camera.rays()
    for y in range(18):
        for x in range(24):
            t = (found.middle[2] - origins[y, x, 2]) / directions[y, x, 2]
            local = found.axes @ (origins[y, x] + t * directions[y, x] - found.middle)
            expected = 0.0
            if t > 0 and abs(local[:2]).max() < found.half:
                i, j = np.clip((local[:2] / found.half + 1) * CELLS / 2 - 0.5, 0, CELLS - 1.001)
                (p, u), (q, v) = divmod(i, 1), divmod(j, 1)
                p, q = int(p), int(q)
                a, b = found.shadow[p, q : q + 2] @ (1 - v, v), found.shadow[p + 1, q : q + 2] @ (1 - v, v)
                expected = a * (1 - u) + b * u
            assert alpha[y, x] == pytest.approx(expected, abs=1e-5)
    assert alpha.max() > 0.3


def test_the_shadow_is_not_shown_from_below_or_in_a_panorama(shadow):
    below = pr.Camera.look_at((7, -4, 0.5), (3, 1, 2))
    panorama = pr.Camera.look_at((7, -4, 4), (3, 1, 2), projection="panorama")
    assert panorama.record()[PROJECTION] != below.record()[PROJECTION]
    image = np.zeros((panorama.size[1], panorama.size[0], 4), np.float32)
    for camera in (below, panorama):
        assert shadow[0].put_under(image, camera) is image


def test_it_lies_under_the_picture(shadow, rng):
    camera = pr.Camera.look_at((7, -4, 4), (3, 1, 1.5), size=(20, 16))
    image = rng.random((16, 20, 4)).astype(np.float32)
    image[:8, :, 3] = 1
    before, out = image.copy(), shadow[0].put_under(image, camera)
    np.testing.assert_array_equal(image, before)
    np.testing.assert_array_equal(out[..., :3], image[..., :3])
    np.testing.assert_array_equal(out[:8], image[:8])
    image.flags.writeable = False  # as arrays from workers are
    np.testing.assert_array_equal(shadow[0].put_under(image, camera), out)
    share = 1 - (1 - image[..., 3]) * (1 - shadow[0].put_under(np.zeros_like(image), camera)[..., 3])
    np.testing.assert_allclose(out[..., 3], share, atol=1e-6)


def bowl(n, rng):
    """Return half a sphere that lies on its round side."""
    x = rng.normal(size=(n, 3))
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    x[:, 2] = -np.abs(x[:, 2])
    return pr.Points(x, x)


def test_only_objects_that_stand_have_one(rng):
    flat = rng.random((4_000, 3)) * [10, 10, 0.2]
    ground = pr.Points(flat, np.tile(UP, (4_000, 1)))
    statue = pr.procedural("statue", 5_000)
    assert Scan(statue, ViewChoice()).stands and Scan(statue, ViewChoice(up=UP)).stands
    assert not Scan(statue, ViewChoice(up=(1.0, 0.0, 0.0))).stands  # as it lies on its side
    assert not Scan(statue, ViewChoice(up=(0.0, 0.6, 0.8))).stands
    for points in (ground, pr.procedural("sphere", 5_000), bowl(5_000, rng)):
        assert not Scan(points, ViewChoice(up=UP)).stands


@pytest.mark.scans
@pytest.mark.parametrize(
    "name", ["stanford_bunny", *map(long, ["stanford_lucy_50k", "nefertiti_50k", "stanford_dragon_stand_rangescans"])]
)
def test_scans_that_stand(name):
    assert Scan(pr.read(shared_model(f"points/{name}.ply")), ViewChoice()).stands


@pytest.mark.scans
@pytest.mark.parametrize(
    "name",
    [
        "rgbd_kinect_chair_rgb",
        *map(long, ["autzen_stadium_crop_rgb", "tls_tower_wall_ghost_nonormals", "outcrop_qcompass_rgb"]),
        *map(long, ["tls_pumpA_rgb", "potree_lion_takanawa_rgb", "sfm_garden_rgb_nonormals"]),
    ],
)
def test_rooms_terrain_and_scans_of_one_side_do_not_stand(name):
    assert not Scan(pr.read(shared_model(f"points/{name}.ply")), ViewChoice()).stands


# ------------------------------------------------------------------------------------------ commands and the viewer


@pytest.fixture(scope="module")
def standing(tmp_path_factory):
    """A file of a statue."""
    path = tmp_path_factory.mktemp("standing") / "statue.ply"
    pr.write(path, pr.procedural("statue", 3_000))
    return path


def shaded(path, camera, options):
    """Return the share of darkened white background around the scan."""
    levels = []
    for more in (options, ALPHA):
        out = path.with_suffix(".png")
        assert execute(["render", str(path), "-o", str(out), *SMALL, *camera, *more]) == 0
        levels.append(np.asarray(Image.open(out).convert("RGBA")))
    dark = (levels[0][..., :3] < 245).all(axis=-1) & (levels[0][..., 3] > 0)
    return float(dark[levels[1][..., 3] == 0].mean())


SMALL = ("--size", "48x36", "--spp", "1")
ALPHA = ("--background", "none", "--integrator", "color")
WHITE = ("--background", "1,1,1")


@pytest.mark.parametrize(
    ("camera", "options", "least", "most"),
    [
        ((), WHITE, 0.02, 0.5),
        ((), (*WHITE, "--integrator", "phong"), 0.02, 0.5),  # the key light goes with the camera: the sky's shadow
        ((), (*WHITE, "--light", "headlight"), 0, 0),
        long((), (*WHITE, "--integrator", "color"), 0, 0),
        long((), ("--background", "none"), 0, 0),
        ((), (*WHITE, "--no-contact-shadow"), 0, 0),
        (("--up", "x"), WHITE, 0, 0),
        (("--elevation", "-20"), WHITE, 0, 0),
    ],
)
def test_commands_draw_the_shadow_with_a_backdrop_and_studio_light(standing, camera, options, least, most):
    assert least <= shaded(standing, camera, options) <= most


@pytest.mark.long
def test_a_film_has_the_shadow(standing):
    folder = standing.parent / "film"
    arguments = ["--seconds", "0.1", "--fps", "20", "--size", "48x36", "--spp", "1", *WHITE]
    assert execute(["animate", str(standing), "-o", str(folder), *arguments]) == 0
    frames = [np.asarray(Image.open(path)) for path in sorted(folder.glob("*.png"))]
    assert len(frames) == 2 and all((frame[30:, :, :3] < 245).all(axis=-1).mean() > 0.05 for frame in frames)


def test_the_viewer_computes_the_shadow_while_it_refines():
    model = pr.Model(pr.procedural("statue", 3_000))
    scene, contacts, asked = pr.Scene(), Contacts(), []
    scene.add(model)
    scene.lights = pr.studio(UP, 25.0)

    def scan():
        asked.append(1)
        return Scan(scene, ViewChoice(up=UP))

    view = ViewSettings(exposes=True).in_studio(scene.lights, UP)
    assert contacts.of(scan, (scene, (1, 0)), view, False) is None and not asked
    found = contacts.of(scan, (scene, (1, 0)), view)
    assert found.shadow.max() > 0.3
    assert contacts.of(scan, (scene, (1, 0)), view, False) is found and len(asked) == 1
    assert contacts.of(scan, (scene, (2, 0)), view, False) is None  # another scene
    for change in ({"ground": True}, {"around": "sky"}, {"integrator": "normal"}, {"contact_shadow": False}):
        assert contacts.of(scan, (scene, (1, 0)), replace(view, **change)) is None
    assert contacts.of(None, (scene, (1, 0)), view) is None
    assert contacts.of(scan, (scene, (1, 0)), view.lit_by([], UP, "phong")) is None  # a headlight
