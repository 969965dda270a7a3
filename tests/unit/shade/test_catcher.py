"""Shadow catchers show how much light is missing, in every integrator; and planes with materials."""

import numpy as np
import pytest

import pointray as pr

ABOVE = pr.Camera.look_at((0, 0, 20), (0, 0, 0), up=(0, 1, 0), fov=30, size=(40, 40))


@pytest.fixture(scope="module")
def ball():
    return pr.Model(pr.procedural("sphere", 4000))


@pytest.fixture(scope="module")
def roof():
    """Return a flat square from -2 to 2 with enough points for sharp edges."""
    x, y = np.meshgrid(*[np.linspace(-2, 2, 201)] * 2)
    rows = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1)
    return pr.Model(pr.Points(rows, np.tile([0.0, 0, 1], (len(rows), 1))))


def lifted(height, x=0.0):
    out = np.eye(4)
    out[0, 3], out[2, 3] = x, height
    return out


def caught(*lights, model=None, transform=None, **plane):
    scene = pr.Scene()
    scene.add(pr.Plane((0, 0, 0), (0, 0, 1), shadow_catcher=True, **plane))
    if model is not None:
        scene.add(model, transform)
    for light in lights:
        scene.add_light(light)
    return scene


def alpha_at(scene, x, y, integrator="path", spp=256, size=8):
    """Alpha of a tiny picture of a point on the plane, seen from close by."""
    camera = pr.Camera.look_at((x, y, 0.5), (x, y, 0), up=(0, 1, 0), fov=1, size=(size, size))
    image = pr.render(scene, camera, pr.Settings(integrator, spp=spp, filter="box"))
    assert not image[..., :3].any()
    return image[..., 3].mean()


ALL = {
    "point": pr.PointLight((3, 1, 4), 10),
    "sun": pr.SunLight((1, 0.3, -1), 3),
    "rect": pr.RectLight((3, 0, 4), (0, 1, 0), (0.8, 0, -0.6), 5),
    "disk": pr.DiskLight((-3, 2, 4), (1, -0.5, -1), 0.7, 5),
    "sphere": pr.SphereLight((0, -5, 4), 0.5, 5),
    "sky": pr.EnvironmentLight(),
    "picture": pr.EnvironmentLight(image=np.random.default_rng(0).uniform(0, 2, (8, 16, 3)) ** 4),
    "below": pr.SunLight((0, 0, 1), 3),
}


@pytest.mark.parametrize("name", ALL)
@pytest.mark.parametrize("integrator", ["phong", "path"])
def test_an_unshadowed_catcher_is_transparent(name, integrator):
    image = pr.render(caught(ALL[name]), ABOVE, pr.Settings(integrator, spp=4))
    lamps = (image[..., :3] > 0).any(axis=2)  # the lights hang above the plane; none shines at the camera
    assert not lamps.any() and np.abs(image[..., 3]).max() < 1e-6


def test_ambient_occlusion_is_caught(ball):
    """A sphere of radius 1 at height h has the form factor h / (h^2 + r^2)^1.5 at r if all of it is visible."""
    scene = caught(model=ball, transform=lifted(3))
    settings = pr.Settings("ao", ao_distance=20.0, spp=256, filter="box")
    for r in (0.0, 1.5, 4.0):
        camera = pr.Camera.look_at((r, 0, 0.1), (r, 0, 0), up=(0, 1, 0), fov=1, size=(8, 8))
        image = pr.render(scene, camera, settings)
        assert not image[..., :3].any()
        assert image[..., 3].mean() == pytest.approx(3 / (9 + r * r) ** 1.5, rel=0.03)


def test_the_shadow_of_a_sun(ball):
    """Phong gives alpha 1 in the shadow and 0 beside it; two suns each have their share."""
    scene = caught(pr.SunLight((0, 0, -1), 3), model=ball, transform=lifted(5))
    camera = pr.Camera.look_at((0, 0, 2), (0, 0, 0), up=(0, 1, 0), fov=90, size=(60, 60))  # below the ball
    radius = np.linalg.norm(scene.intersect(*camera.rays()).position[..., :2], axis=-1)
    image = pr.render(scene, camera)
    assert (image[radius < 0.95, 3] == 1).all() and (image[radius > 1.05, 3] == 0).all() and not image[..., :3].any()
    scene.add_light(pr.SunLight((1, 0, -1), np.sqrt(2)))  # gives irradiance 1 to the ground; its shadow falls elsewhere
    assert pr.render(scene, camera)[radius < 0.95, 3] == pytest.approx(0.75)
    scene.add_light(pr.EnvironmentLight(1 / np.pi))
    assert pr.render(scene, camera)[radius < 0.95, 3] == pytest.approx(0.6, abs=1e-4)  # unshadowed, of 5 in all
    assert not pr.render(scene, camera, pr.Settings(shadows=False))[..., 3].any()


def test_colored_light_counts_by_its_luminance(ball):
    red, green = pr.SunLight((0, 0, -1), (1, 0, 0), angle=0), pr.SunLight((1, 0, -1), (0, np.sqrt(2), 0), angle=0)
    for integrator in ("phong", "path"):
        scene = caught(red, green, model=ball, transform=lifted(5))
        assert alpha_at(scene, 0, 0, integrator) == pytest.approx(0.2126 / (0.2126 + 0.7152), rel=0.02)


def test_half_a_rectangle_light_is_hidden(roof):
    """A roof hides all of a light beyond x = 0; the rest is found by integrating over the light."""
    half = caught(pr.RectLight((0, 0, 4), (3, 0, 0), (0, -1, 0), 5), model=roof, transform=lifted(2, 2.0))
    u, v = np.meshgrid(np.linspace(-3, 3, 601), np.linspace(-1, 1, 201))
    x = -0.6
    d2 = (u - x) ** 2 + v**2 + 16
    form = 16 / d2**2
    hidden = (x + u) / 2 > 0  # where the ray to the light crosses z = 2
    want = form[hidden].sum() / form.sum()
    assert 0.2 < want < 0.8
    assert alpha_at(half, x, 0) == pytest.approx(want, rel=0.02)


@pytest.mark.parametrize("spp", [1, 4, 64])
def test_the_mean_does_not_depend_on_the_samples(spp, roof):
    """A sun's penumbra has the same mean for any number of samples: the roof's straight edge cuts the sun's disk."""
    scene = caught(pr.SunLight((0, 0, -1), 3, angle=20), model=roof, transform=lifted(2, 2.0))
    radius = np.tan(np.radians(10))
    for share in (-0.5, 0.0, 0.4):
        x = 2 * radius * share
        # Directions in a cone, weighted by the cosine, fill a disk in the plane of their sines.
        s = np.sin(np.radians(10))
        a, b = np.meshgrid(np.linspace(-s, s, 801), np.linspace(-s, s, 801))
        disk = a * a + b * b < s * s
        crosses = x + 2 * a / np.sqrt(np.maximum(1 - a * a - b * b, 1e-9)) > 0
        want = (disk & crosses).sum() / disk.sum()
        got = alpha_at(scene, x, 0, spp=spp, size=int(128 / spp**0.5))
        assert got == pytest.approx(want, abs=0.015), share


def test_an_even_sky_below_a_roof(roof):
    """The value below the middle of a square roof is the form factor of a rectangle."""
    scene = caught(pr.EnvironmentLight(), model=roof, transform=lifted(2))
    a = 1.0  # half the edge divided by the height
    root = np.sqrt(1 + a * a)
    want = 4 / (2 * np.pi) * 2 * (a / root * np.arctan(a / root))
    assert alpha_at(scene, 0, 0, spp=1024) == pytest.approx(want, rel=0.02)


def test_lights_hide_the_sky(roof):
    """A light that shines like the sky behind it makes no difference."""
    lamp = pr.RectLight((0, 0, 4), (3, 0, 0), (0, -3, 0), 1)
    alone, both = (caught(pr.EnvironmentLight(), *more, model=roof, transform=lifted(2)) for more in ((), (lamp,)))
    assert alpha_at(both, 1.5, 0, spp=1024) == pytest.approx(alpha_at(alone, 1.5, 0, spp=1024), rel=0.02)


def test_passes_and_threads_do_not_change_the_picture(ball):
    """The picture depends neither on the number of threads nor on ending by noise."""
    scene = caught(pr.SunLight((0.3, 0, -1), 3, angle=10), model=ball, transform=lifted(2))
    one, two = (pr.render(scene, ABOVE, pr.Settings("path", spp=8, threads=n)) for n in (1, 2))
    assert np.array_equal(one, two)
    several = pr.render(scene, ABOVE, pr.Settings("path", spp=8, noise=1e-9))
    assert np.allclose(one, several, atol=1e-6)
    assert ((one[..., 3] > 0.05) & (one[..., 3] < 0.95)).any()


def test_backgrounds_show_through(ball):
    scene = caught(pr.SunLight((0, 0, -1), 3, angle=0), model=ball, transform=lifted(5))
    scene.background = (0.2, 0.4, 0.6)
    camera = pr.Camera.look_at((0, 0, 2), (0, 0, 0), up=(0, 1, 0), fov=90, size=(40, 40))
    for integrator in ("phong", "path"):
        image = pr.render(scene, camera, pr.Settings(integrator))
        assert image[20, 20] == pytest.approx([0, 0, 0, 1]) and image[2, 2] == pytest.approx([0.2, 0.4, 0.6, 1])
    sky = pr.Scene()
    sky.add(pr.Plane((0, 0, 0), (0, 0, 1), shadow_catcher=True))
    sky.add(ball, lifted(5))
    sky.add_light(pr.SunLight((0, 0, -1), np.pi, angle=0))
    sky.add_light(pr.EnvironmentLight((1, 2, 3)))
    sky.background = "environment"
    lit = np.pi * (0.2126 + 2 * 0.7152 + 3 * 0.0722)
    # The ball hides 1 / h^2 of the sky, nothing of it for direct light only, and all of the sun.
    for settings, hidden in ((pr.Settings("path", spp=256), 1 / 25), (pr.Settings("phong"), 0)):
        image = pr.render(sky, camera, settings)
        assert (image[..., 3] == 1).all()
        free = lit * (1 - hidden) / (lit + np.pi)
        assert image[20, 20, :3] == pytest.approx(np.array([1, 2, 3]) * free, rel=0.1)
        assert image[0, 0, :3] == pytest.approx([1, 2, 3], rel=0.1)
    image = pr.render(sky, camera, pr.Settings("ao", spp=256, ao_distance=100))  # this integrator needs an even sky
    assert (image[..., 3] == 1).all()
    assert image[20, 20, :3] == pytest.approx(np.array([1, 2, 3]) * 24 / 25, rel=0.01)


def test_a_catcher_is_an_ordinary_plane_in_reflections(ball):
    """In mirrors and for reflected light, the catcher is a plane in its own colour."""
    pictures = []
    for catcher in (False, True):
        scene = pr.Scene()
        scene.add(pr.Plane((0, 0, -1), (0, 0, 1), color=(0.8, 0.2, 0.2), shadow_catcher=catcher))
        scene.add(ball, material=pr.Mirror())
        scene.add(ball, lifted(0, 3), pr.Diffuse(0.5))
        scene.add_light(pr.SunLight((1, 1, -1)))
        camera = pr.Camera.look_at((1.5, -8, 1), (1.5, 0, 0), size=(60, 40))
        on_ball = scene.intersect(*camera.rays()).instance > 0
        pictures.append([pr.render(scene, camera, pr.Settings(i, spp=1)) for i in ("phong", "path")])
    for plain, shown in zip(*pictures, strict=True):
        assert on_ball.sum() > 100
        np.testing.assert_allclose(shown[on_ball], plain[on_ball], atol=1e-6)
        assert (plain[..., 3] == 1)[~on_ball & (plain[..., 3] > 0)].all() and (shown[..., 3] < 1)[~on_ball].any()


def test_debug_integrators_and_ray_queries_hit_the_plane():
    scene = caught(ALL["sun"])
    for integrator in ("normal", "depth", "color", "cost"):
        assert (pr.render(scene, ABOVE, pr.Settings(integrator))[..., 3] == 1).all()
    assert (scene.intersect(*ABOVE.rays()).instance == 0).all()


def test_lights_in_front_of_a_catcher_are_visible():
    scene = caught(pr.DiskLight((0, 0, 2), (0, 0, 1), 1, 5))
    image = pr.render(scene, ABOVE, pr.Settings("path"))
    assert image[20, 20] == pytest.approx([5, 5, 5, 1]) and image[0, 0, 3] == 0


@pytest.mark.parametrize("wrong", ["yes", 1, None])
def test_a_shadow_catcher_is_true_or_false(wrong):
    with pytest.raises(ValueError, match="shadow_catcher"):
        pr.Plane((0, 0, 0), (0, 0, 1), shadow_catcher=wrong)


# -------------------------------------------------------------------------------------------- planes in materials


@pytest.mark.parametrize(
    ("material", "seen"),
    [
        (None, {0.4, 0.8}),
        (pr.Diffuse(), {0.4, 0.8}),
        (pr.Phong(specular=0), {0.4, 0.8}),
        (pr.Diffuse(0.3), {0.3}),
        (pr.Phong(0.3, specular=0), {0.3}),
    ],
)
def test_a_checker_shows_where_the_material_has_no_color(material, seen):
    scene = pr.Scene()
    scene.add(pr.Plane((0, 0, 0), (0, 0, 1), color=0.8, checker=1.0), material=material)
    scene.add_light(pr.SunLight((0, 0, -1), np.pi))
    image = pr.render(scene, ABOVE, pr.Settings(filter="box"))
    assert {round(float(x), 4) for x in np.unique(image[..., 0].round(4))} == seen


@pytest.mark.parametrize("integrator", ["phong", "path"])
def test_a_mirror_plane_reflects(ball, integrator):
    """The reflection of the ball is what the mirrored camera sees."""
    scene = pr.Scene()
    scene.add(ball, lifted(1.5), pr.Emissive((1, 2, 3)))
    scene.add(pr.Plane((0, 0, 0), (0, 0, 1), checker=1.0), material=pr.Mirror((0.5, 0.5, 1)))
    camera = pr.Camera.look_at((0, -6, 3), (0, 0, -1.5), fov=30, size=(40, 40))
    image = pr.render(scene, camera, pr.Settings(integrator))
    eye, d = camera.rays()
    mirrored = np.linalg.norm(np.cross(d, np.array([0, 0, -1.5]) - eye), axis=-1)
    assert (mirrored < 0.9).sum() > 50
    assert image[mirrored < 0.9, :3] == pytest.approx(np.tile([0.5, 1, 3], ((mirrored < 0.9).sum(), 1)), abs=1e-4)
