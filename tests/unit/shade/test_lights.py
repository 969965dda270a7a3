"""Lights compared with their formulas: irradiance, sampling, intersection with rays; and the sky."""

import math

import numpy as np
import pytest

import pointray as pr
from pointray.engine.jit import borrow, kernel
from pointray.engine.kernels.records import LIGHT_KIND, World
from pointray.engine.kernels.sampling import pixel_key, sample_pair
from pointray.shade.emitters import from_center, intersect_light, light_pdf, sample_light, sun_in
from pointray.shade.sky import sample_sky, sky_irradiance, sky_pdf, sky_radiance

COUNT = 4096


@kernel
def _sample(world, x, out):
    """Samples of light 0 at x: direction, distance, light, pdf; then t and pdf of a ray in that direction."""
    world = borrow(world)
    x = (x[0], x[1], x[2])
    for i in range(len(out)):
        u, v = sample_pair(pixel_key(3, 4, 5), i, 1)
        a = sample_light(world, 0, x, u, v)
        t = intersect_light(world, 0, x, a.wi)
        d = light_pdf(world, 0, x, a.wi, a.distance) if t < np.inf else sun_in(world, 0, a.wi)[1]
        for c in range(3):
            out[i, c], out[i, 4 + c] = a.wi[c], a.light[c]
        out[i, 3], out[i, 7], out[i, 8], out[i, 9] = a.distance, a.pdf, t, d


@kernel
def _middle(world, x, out):
    a = from_center(borrow(world), 0, world.lights[LIGHT_KIND], (x[0], x[1], x[2]))
    for c in range(3):
        out[c], out[3 + c] = a.wi[c], a.light[c]
    out[6] = a.distance


@kernel
def _intersect_light(world, o, d, out):
    """Store t of rays with light 0, and the pdf of sampling them."""
    world = borrow(world)
    for i in range(len(out)):
        ray = (o[0], o[1], o[2]), (d[i, 0], d[i, 1], d[i, 2])
        out[i, 0] = intersect_light(world, 0, ray[0], ray[1])
        out[i, 1] = light_pdf(world, 0, ray[0], ray[1], out[i, 0]) if out[i, 0] < np.inf else 0.0


@kernel
def _sky(world, d, out):
    world = borrow(world)
    for i in range(len(out)):
        v = d[i, 0], d[i, 1], d[i, 2]
        light, even = sky_radiance(world, v), sky_irradiance(world, v)
        for c in range(3):
            out[i, c], out[i, 4 + c] = light[c], even[c]
        out[i, 3] = sky_pdf(world, v)


@kernel
def _sample_sky(world, out):
    world = borrow(world)
    for i in range(len(out)):
        u, v = sample_pair(pixel_key(3, 4, 5), i, 1)
        a = sample_sky(world, u, v)
        for c in range(3):
            out[i, c], out[i, 3 + c] = a.wi[c], a.light[c]
        out[i, 6], out[i, 7] = a.pdf, sky_pdf(world, a.wi)


def world_of(light) -> World:
    scene = pr.Scene()
    scene.add_light(light)
    return scene.snapshot().world


def samples(light, x, count=COUNT):
    out = np.empty((count, 10))
    _sample(world_of(light), np.array(x, float), out)
    return out


def even_directions(count):
    """Unit directions, evenly over the sphere (Fibonacci)."""
    z = 1 - (2 * np.arange(count) + 1) / count
    turn = np.arange(count) * math.pi * (3 - math.sqrt(5))
    return np.stack([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z], axis=1)


LIGHTS = {
    "rectangle": pr.RectLight((0.5, 0.2, 3), (1, 0.3, 0), (0.2, -0.8, 0.1), 2),
    "disk": pr.DiskLight((0.5, -0.4, 3), (0.2, 0.1, -1), 0.9, (1, 2, 3)),
    "sphere": pr.SphereLight((1, 0.3, 3), 1.2, 1.5),
    "sun": pr.SunLight((0.2, 0.1, -1), (1, 2, 3), angle=40),
}
FLAT_NORMAL = np.array([0.0, 0, 1])


def exact_irradiance(light, x):
    """The irradiance of a surface at x that faces up, by a sum over many small pieces of the light."""
    if isinstance(light, pr.SunLight):  # a disk of even radiance at infinity, all of it above the horizon
        middle = -np.asarray(light.direction) / np.linalg.norm(light.direction)
        return middle[2] * np.broadcast_to(np.asarray(light.irradiance, float), 3)
    if isinstance(light, pr.SphereLight):
        v = np.asarray(light.center) - x
        return np.pi * light.radiance * light.radius**2 / (v @ v) * v[2] / np.linalg.norm(v) * np.ones(3)
    a, b = ((np.arange(400) + 0.5) / 200 - 1)[:, None], ((np.arange(400) + 0.5) / 200 - 1)[None, :]
    if isinstance(light, pr.RectLight):
        u, v, inside, normal = np.asarray(light.u), np.asarray(light.v), np.ones((400, 400)), None
    else:
        normal = np.asarray(light.normal) / np.linalg.norm(light.normal)
        u = np.cross(normal, [1, 0, 0])
        u *= light.radius / np.linalg.norm(u)
        v, inside = np.cross(normal, u), a * a + b * b <= 1
    normal = np.cross(u, v) / np.linalg.norm(np.cross(u, v))
    toward = np.asarray(light.center) + a[..., None] * u + b[..., None] * v - x
    square = (toward**2).sum(axis=-1)
    piece = np.linalg.norm(np.cross(u, v)) / 200**2
    share = (inside * np.maximum(-toward @ normal, 0) * np.maximum(toward[..., 2], 0) / square**2 * piece).sum()
    return share * np.broadcast_to(np.asarray(light.radiance, float), 3)


@pytest.mark.parametrize("name", LIGHTS)
def test_samples_sum_to_the_irradiance(name):
    light, x = LIGHTS[name], np.array([0.1, -0.2, 0.3])
    out = samples(light, x)
    assert np.allclose(np.linalg.norm(out[:, :3], axis=1), 1)
    mean = (out[:, 4:7] * np.maximum(out[:, 2:3], 0)).mean(axis=0)
    assert mean == pytest.approx(exact_irradiance(light, x), rel=2e-3)


@pytest.mark.parametrize("name", LIGHTS)
def test_a_ray_to_a_sample_hits_the_light_there(name):
    out = samples(LIGHTS[name], (0.1, -0.2, 0.3))
    if name != "sun":
        assert out[:, 8] == pytest.approx(out[:, 3], rel=1e-9)
    assert out[:, 9] == pytest.approx(out[:, 7], rel=1e-6)
    assert (out[:, 7] > 0).all()


@pytest.mark.parametrize("name", [name for name in LIGHTS if name != "sun"])
def test_pdfs_sum_to_one(name):
    """The pdf integrates to one over all directions in which rays hit the light."""
    d = even_directions(400_000)
    out = np.empty((len(d), 2))
    _intersect_light(world_of(LIGHTS[name]), np.array([0.1, -0.2, 0.3]), d, out)
    assert 4 * np.pi * out[:, 1].mean() == pytest.approx(1, rel=1e-2)
    assert (out[:, 0] < np.inf).mean() > 0.005


def test_backs_of_lights_are_invisible():
    for name, x in {"rectangle": (0, 0, 5), "disk": (0, 0, 5), "sphere": (1.1, 0.3, 3)}.items():
        out = samples(LIGHTS[name], x, 64)
        assert not out[:, 4:7].any(), name
        met = np.empty((1000, 2))
        _intersect_light(world_of(LIGHTS[name]), np.array(x, float), even_directions(1000), met)
        assert np.isinf(met[:, 0]).all(), name


@pytest.mark.parametrize("name", ["rectangle", "disk", "sphere", "sun"])
def test_a_distant_light_equals_a_point_light(name):
    light, x = LIGHTS[name], np.array([3.0, 1, -60])
    out = np.empty(7)
    _middle(world_of(light), x, out)
    assert out[3:6] * out[2] == pytest.approx(exact_irradiance(light, x), rel=0.02)


def test_a_point_light_falls_off_with_the_square():
    out = np.empty(7)
    _middle(world_of(pr.PointLight((0, 0, 5), (4, 8, 12))), np.array([0, 0, 3.0]), out)
    assert out.tolist() == [0, 0, 1, 1, 2, 3, 2]


UPS = [(0, 0, 1), (0, 1, 0), (1, 2, -0.5), (0, 0, -1)]


def picture(rng, height=32, width=64):
    image = rng.uniform(0, 0.1, (height, width, 3))
    image[5, 40], image[20, 3] = (50, 30, 10), (1, 20, 40)
    return image


@pytest.mark.parametrize("up", UPS)
def test_the_pictures_light_is_chosen_by_its_brightness(rng, up):
    light = pr.EnvironmentLight(image=picture(rng), up=up, radiance=(1, 2, 0.5))
    world = world_of(light)
    out = np.empty((COUNT, 8))
    _sample_sky(world, out)
    assert np.allclose(np.linalg.norm(out[:, :3], axis=1), 1)
    assert np.median(np.abs(out[:, 7] / out[:, 6] - 1)) < 1e-9  # except at the very edge of a pixel
    d = even_directions(400_000)
    sky = np.empty((len(d), 7))
    _sky(world, d, sky)
    assert 4 * np.pi * sky[:, 3].mean() == pytest.approx(1, rel=5e-3)
    total = 4 * np.pi * sky[:, :3].mean(axis=0)
    assert out[:, 3:6].mean(axis=0) == pytest.approx(total, rel=0.035)  # the samples' noise is 0.005
    assert (sky[sky[:, :3].any(axis=1), 3] > 0).all()


@pytest.mark.parametrize("up", UPS)
def test_irradiance_of_the_sky(up):
    """For a smooth sky it is within 2% of the sum over all directions."""
    image = np.empty((64, 128, 3))
    image[:] = np.linspace(2, 0.1, 64)[:, None, None] * (1, 0.5, 0.2)
    for light in (
        pr.EnvironmentLight(image=image, up=up),
        pr.EnvironmentLight((0.2, 0.4, 1), horizon=0.8, ground=0.1, up=up),
    ):
        d = even_directions(20_000)
        sky = np.empty((len(d), 7))
        _sky(world_of(light), d, sky)
        for n in d[::2000]:
            want = 4 * np.pi * (sky[:, :3] * np.maximum(d @ n, 0)[:, None]).mean(axis=0)
            got = np.empty((1, 7))
            _sky(world_of(light), n[None], got)
            assert got[0, 4:] == pytest.approx(want, rel=0.02, abs=0.02)


def test_environment_pictures_are_oriented():
    """The picture's middle is ahead, its right side to the right, its row 0 up; a gradient's zenith is up."""
    height, width = 16, 32
    image = np.zeros((height, width, 3))
    image[7:9, 15:17], image[7:9, 23:25], image[0] = (1, 0, 0), (0, 1, 0), (0, 0, 1)
    directions = np.array([[0, 1, 0], [1, 0, 0], [0, 0, 1], [0, 0, -1], [0, -1, 0]], float)
    out = np.empty((5, 7))
    _sky(world_of(pr.EnvironmentLight(image=image)), directions, out)
    assert out[:, :3].tolist() == [[1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, 0], [0, 0, 0]]
    _sky(world_of(pr.EnvironmentLight((1, 2, 3), horizon=0.5, ground=0.25, up=(0, 2, 0))), directions, out)
    assert out[:, 0].tolist() == [1, 0.5, 0.5, 0.5, 0.25]


@pytest.mark.parametrize("suffix", [".hdr", ".exr"])
def test_pictures_from_files(rng, tmp_path, suffix):
    oiio = pytest.importorskip("OpenImageIO")
    image = rng.uniform(0, 30, (8, 16, 3)).astype(np.float32)
    path = tmp_path / f"sky{suffix}"
    out = oiio.ImageOutput.create(str(path))
    out.open(str(path), oiio.ImageSpec(16, 8, 3, "float"))
    out.write_image(image)
    out.close()
    assert np.abs(pr.EnvironmentLight(image=path).image - image).max() < 0.13  # .hdr has 8 bits a channel
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(ValueError, match=path.name):
        pr.EnvironmentLight(image=path)
    with pytest.raises(FileNotFoundError):
        pr.EnvironmentLight(image=tmp_path / "none.hdr")


BAD = {
    "position": lambda: pr.PointLight((0, np.nan, 0), 1),
    "intensity": lambda: pr.PointLight((0, 0, 0), -1),
    "direction": lambda: pr.SunLight((0, 0, 0)),
    "angle": lambda: pr.SunLight((0, 0, 1), angle=181),
    "parallel": lambda: pr.RectLight((0, 0, 0), (1, 0, 0), (2, 0, 0), 1),
    "radius": lambda: pr.SphereLight((0, 0, 0), 0, 1),
    "radius ": lambda: pr.DiskLight((0, 0, 0), (0, 0, 1), np.inf, 1),
    "normal": lambda: pr.DiskLight((0, 0, 0), (0, 0, 0), 1, 1),
    "radiance": lambda: pr.EnvironmentLight(-1),
    "shape": lambda: pr.EnvironmentLight(image=np.ones((4, 8))),
    "row 1, column 2": lambda: pr.EnvironmentLight(image=np.where(np.arange(96).reshape(4, 8, 3) == 31, np.nan, 1)),
    "row 0, column 0": lambda: pr.EnvironmentLight(image=-np.ones((4, 8, 3))),
    "not both": lambda: pr.EnvironmentLight(image=np.ones((4, 8, 3)), ground=1),
    "pixels a side": lambda: pr.EnvironmentLight(image=np.ones((1, 8, 3))),
}


@pytest.mark.parametrize("what", BAD)
def test_bad_lights_are_refused(what):
    with pytest.raises(ValueError, match=what.strip()):
        pr.Scene().add_light(BAD[what]())


def test_one_environment_only():
    scene = pr.Scene()
    scene.add_light(pr.EnvironmentLight())
    with pytest.raises(ValueError, match="already"):
        scene.add_light(pr.EnvironmentLight())


@pytest.mark.parametrize("integrator", ["phong", "ao", "path"])
def test_the_sky_behind_is_the_same_in_every_integrator(integrator):
    """This holds beside a sphere and in an empty scene. Without any light the sky is white, except by `phong`."""
    scene, camera = pr.Scene(), pr.Camera.look_at((0, -6, 1), (0, 0, 0), fov=40, size=(40, 40))
    scene.add(pr.Model(pr.procedural("sphere", 3000)))
    scene.background = "environment"
    image = pr.render(scene, camera, pr.Settings(integrator, spp=4))
    assert (image[..., 3] == 1).all() and image[2, 2, :3] == pytest.approx(0 if integrator == "phong" else 1)
    scene.add_light(pr.EnvironmentLight((0.2, 0.4, 0.9), horizon=(0.8, 0.8, 0.8), ground=(0.3, 0.2, 0.1)))
    image = pr.render(scene, camera, pr.Settings(integrator, spp=4, filter="box"))
    up = camera.rays()[1][..., 2:]
    free = np.ones((40, 40), bool)
    free[8:32, 8:32] = False
    wanted = np.where(up > 0, 0.8 + up * (np.array([0.2, 0.4, 0.9]) - 0.8), [0.3, 0.2, 0.1])
    assert (image[..., 3] == 1).all()
    assert np.abs(image[..., :3] - wanted)[free & (np.abs(up[..., 0]) > 0.02)].max() < 0.01


class Counted(pr.PointLight):
    """A light that counts calls of `record`."""

    asked = 0

    def record(self):
        Counted.asked += 1
        return super().record()


@pytest.mark.parametrize("count", [10, 1000])
def test_adding_a_light_takes_constant_work(monkeypatch, count):
    """Each light is checked when it is added, and read once when something is rendered."""
    monkeypatch.setattr(Counted, "asked", 0)
    scene = pr.Scene()
    for k in range(count):
        assert scene.add_light(Counted((k, 0, 1), 1)) == k
    assert Counted.asked == count
    scene.snapshot()
    assert Counted.asked == 2 * count and len(scene.lights) == count


def test_adding_a_light_does_not_copy_the_others():
    """Memory grows in proportion to the number of lights."""
    scene, light, held = pr.Scene(), pr.PointLight((0, 0, 1), 1), []
    for _ in range(5000):
        scene.add_light(light)
        held.append(scene._lights)
    assert len({id(lights._items) for lights in held}) == 1
    assert [len(lights) for lights in held] == list(range(1, 5001))


def test_copies_of_light_lists_grow_independently():
    a, b, c, d = (pr.PointLight((k, 0, 1), 1) for k in range(4))
    scene = pr.Scene()
    scene.add_light(a)
    twin, before = scene.copy(), scene.lights
    scene.add_light(b)
    twin.add_light(c)
    twin.add_light(d)
    scene.add_light(d)
    assert scene.lights == (a, b, d) and twin.lights == (a, c, d) and before == (a,)
    with pytest.raises(ValueError, match="one of PointLight"):
        scene.add_light("sun")
    with pytest.raises(ValueError, match="already"):
        scene.lights = [pr.EnvironmentLight(), pr.EnvironmentLight()]
    assert scene.lights == (a, b, d)
