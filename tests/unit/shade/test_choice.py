"""Many lights: sampling follows its table, rays hit what a loop over all lights hits, and the mean is exact."""

import math

import numpy as np
import pytest
from scipy.special import gammainccinv

import pointray as pr
from helpers.marks import long
from pointray.engine.jit import borrow, kernel
from pointray.engine.kernels.records import LIGHT, LIGHT_AREA, LIGHT_KIND, LIGHT_POWER, POINT_LIGHT, SUN_LIGHT
from pointray.shade.choice import choose_light, light_probability, nearest_lamp, sun_after
from pointray.shade.emitters import intersect_light, sun_in


@kernel
def _choose(world, numbers, out):
    """Store the light that each number chooses, and its probability by both functions."""
    world = borrow(world)
    for i in range(len(numbers)):
        which, chance = choose_light(world, numbers[i])
        out[i, 0], out[i, 1] = which, chance
        out[i, 2] = light_probability(world, which) if which >= 0 else 0.0


@kernel
def _intersect_lamps(world, o, d, out):
    """Store t and index of the lamp that each ray hits, by the tree and by a loop; and the pdf of suns by both."""
    world = borrow(world)
    for i in range(len(o)):
        x, direction = (o[i, 0], o[i, 1], o[i, 2]), (d[i, 0], d[i, 1], d[i, 2])
        t, offset = nearest_lamp(world, (x, direction), np.inf)
        out[i, 0], out[i, 1], out[i, 2], out[i, 3] = t, offset // LIGHT, np.inf, -1
        out[i, 4], out[i, 5] = 0.0, 0.0
        k = 0
        while True:
            k, _, _, pdf = sun_after(world, k, direction)
            if k == 0:
                break
            out[i, 4] += pdf
        for offset in range(0, world.lights.size, LIGHT):
            t = intersect_light(world, offset, x, direction)
            if t < out[i, 2]:
                out[i, 2], out[i, 3] = t, offset // LIGHT
            out[i, 5] += sun_in(world, offset, direction)[1]


def lights_of(count, rng, spread=4.0):
    """Lights of all kinds whose powers differ by factors of thousands; some are black."""
    out = []
    for k in range(count):
        position, power = rng.uniform(-spread, spread, 3) + (0, 0, spread + 1), rng.lognormal(0, 2) * (k % 7 != 3)
        out.append(
            [
                pr.PointLight(position, power * rng.uniform(0, 1, 3)),
                pr.SphereLight(position, rng.uniform(0.05, 0.5), power),
                pr.DiskLight(position, rng.normal(size=3) - (0, 0, 1), rng.uniform(0.05, 0.5), power),
                pr.RectLight(position, rng.normal(0, 0.3, 3), rng.normal(0, 0.3, 3), power),
                pr.SunLight((*rng.normal(size=2), -rng.uniform(0.2, 2)), power, angle=rng.choice([0, 0.5, 20, 100])),
            ][k % 5]
        )
    return out


def world_of(lights, sky=None):
    scene = pr.Scene()
    scene.lights = [*lights, *([] if sky is None else [sky])]
    return scene.snapshot().world


def expected_shares(world, radius, sky=None):
    """The probability of each light, as documented."""
    power = []
    for record in world.lights.reshape(-1, LIGHT):
        kind, brightest = record[LIGHT_KIND], record[LIGHT_POWER : LIGHT_POWER + 3].max()
        factor = {POINT_LIGHT: 4 * math.pi, SUN_LIGHT: math.pi * radius**2}.get(kind, math.pi * record[LIGHT_AREA])
        power.append(factor * brightest)
    power = np.array(power if sky is None else [*power, sky * math.pi * radius**2])
    shines = power > 0
    even = max(0.5, min(1.0, 8 / shines.sum()))
    return even * shines / shines.sum() + (1 - even) * power / power.sum()


def half_diagonal_of(world):
    """Half the diagonal of the box around all lights except suns."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for record in world.lights.reshape(-1, LIGHT):
        if record[LIGHT_KIND] != SUN_LIGHT:
            u, v = record[7:10], record[10:13]
            aside = {2: np.abs(u) + np.abs(v), 3: np.sqrt(u * u + v * v)}.get(int(record[LIGHT_KIND]), record[16])
            low, high = np.minimum(low, record[1:4] - aside), np.maximum(high, record[1:4] + aside)
    return np.linalg.norm(high - low) / 2


@pytest.mark.parametrize("count", [5, 8, 12, 300])
@pytest.mark.parametrize("with_sky", [False, True])
def test_the_choice_follows_its_table(count, with_sky):
    """Chi-square of 200,000 numbers is below what one in 10^9 exceeds; one share of 20 that is a tenth off adds 100."""
    rng = np.random.default_rng(count)
    image = np.full((32, 64, 3), 2.0) * (0.5, 1, 0.25)
    world = world_of(lights_of(count, rng), pr.EnvironmentLight(image=image) if with_sky else None)
    want = expected_shares(world, half_diagonal_of(world), 4 * math.pi * 2.0 if with_sky else None)
    numbers, out = rng.random(200_000), np.empty((200_000, 3))
    _choose(world, numbers, out)
    which = out[:, 0].astype(int)
    np.testing.assert_allclose(out[:, 1], want[which], rtol=1e-5)
    np.testing.assert_array_equal(out[:, 1], out[:, 2])
    counts = np.bincount(which, minlength=len(want))
    assert not counts[want == 0].any()
    share = np.diff(world.light_shares)[want > 0]
    hoped = share / share.sum() * len(numbers)
    assert ((counts[want > 0] - hoped) ** 2 / hoped).sum() < 2 * gammainccinv((len(hoped) - 1) / 2, 1e-9)


def test_few_lights_are_chosen_evenly():
    """Few lights are chosen evenly, so that their pictures have no more noise than with an even choice."""
    world = world_of([pr.PointLight((k, 0, 1), 10.0**k) for k in range(8)])
    np.testing.assert_allclose(np.diff(world.light_shares), 1 / 8, rtol=1e-12)
    assert not world_of([pr.PointLight((0, 0, 1), 0), pr.SphereLight((0, 0, 3), 1, 0)]).light_shares.size


def test_lights_of_huge_power_do_not_overflow():
    world = world_of([pr.SphereLight((k, 0, 0), 1e200 if k == 0 else 1, 1e308 if k < 3 else 1) for k in range(20)])
    share = np.diff(world.light_shares)
    assert np.isfinite(share).all() and (share > 0.4 / 20).all() and share.sum() == pytest.approx(1)


@pytest.mark.parametrize("count", [1, 4, 20, 25, 60, long(1000)])
def test_rays_hit_the_same_lights_as_a_loop_over_all(count):
    rng = np.random.default_rng(count)
    lights = lights_of(count, rng)
    if count == 25:  # all at one position
        lights = [pr.SphereLight((0, 0, 5), 0.1 + 0.01 * k, 1) for k in range(count)]
    world = world_of(lights)
    o, d = rng.uniform(-6, 6, (30_000, 3)), rng.normal(size=(30_000, 3))
    aims = world.lights.reshape(-1, LIGHT)[rng.integers(len(lights), size=20_000), 1:4]  # the directions of suns
    d[10_000:] = aims + rng.normal(0, 0.2, (20_000, 3)) - o[10_000:] * (rng.random((20_000, 1)) < 0.8)
    d[10_000::2] *= np.sign(rng.random((10_000, 1)) - 0.3)
    d[:3000, 0] = 0.0  # along faces of boxes
    d[1000:5000, 2] = 0.0
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    boxes = world.lamps.boxes.reshape(-1, 6)[world.lamps.lights < 0]
    if len(boxes):  # rays in the planes of their faces, too
        o[:2000, 0], o[2000:3000, 0] = rng.choice(boxes[:, 0], 2000), rng.choice(boxes[:, 3], 1000)
    out = np.empty((len(o), 6))
    _intersect_lamps(world, o, d, out)
    np.testing.assert_allclose(out[:, 0], out[:, 2], rtol=1e-9)
    np.testing.assert_array_equal(out[:, 1], out[:, 3])
    np.testing.assert_allclose(out[:, 4], out[:, 5], rtol=1e-12)
    assert count < 20 or ((out[:, 1] >= 0).sum() > 100 and (count == 25 or (out[:, 4] > 0).sum() > 100))
    if count == 1000:  # the boxes fit their contents: most rays skip most of them
        assert (world.lamps.lights < 0).sum() > 100 and (world.lamps.skips[world.lamps.lights < 0] > 0).all()


def means(ball, lights, seeds, **settings):
    """Mean radiance in the halves (upper, lower, left, right) of pictures of a floor with a ball: (seeds, 4)."""
    scene = pr.Scene()
    scene.add(pr.Plane((0, 0, 0), (0, 0, 1), 0.6), material=pr.Phong(specular=0.5, exponent=60))
    scene.add(ball, np.array([[1, 0, 0, 0], [0, 1, 0, 1], [0, 0, 1, 1.0], [0, 0, 0, 1]]))
    scene.lights = lights
    camera = pr.Camera.look_at((0, -5, 2.5), (0, 0.5, 0), fov=40, size=(16, 16))
    out = []
    for seed in seeds:
        image = pr.render(scene, camera, pr.Settings("path", filter="box", seed=seed, **settings))[..., :3]
        out.append([image[:8].mean(), image[8:].mean(), image[:, :8].mean(), image[:, 8:].mean()])
    return np.array(out)


@pytest.mark.long
def test_the_mean_is_the_sum_over_all_lights():
    """Different lights, some hidden by the ball, the floor and each other, are also hit by reflected rays.

    The sum is over pictures with one light each. The others are black: they still hide things, and are never chosen.
    """
    rng, ball = np.random.default_rng(5), pr.Model(pr.procedural("sphere", 2000))
    sky = pr.EnvironmentLight(image=np.kron(rng.lognormal(-2, 1, (4, 8, 3)), np.ones((4, 4, 1))))
    lights = [light for light in lights_of(30, rng, 2.0) if not isinstance(light, pr.SunLight)]
    lights += [pr.SunLight((1, 1, -1.5), 0.5, angle=30), pr.SunLight((-1, 1, -1), 0.3, angle=0)]
    lights += [pr.RectLight((-2, 3, 2), (1.5, 0, 0), (0, -0.3, 1.5), 1.0)]  # large, with a highlight on the floor
    lights += [pr.PointLight((0, 0, -1), 30), pr.SphereLight((0, 1, 1), 0.3, 50)]  # below the floor; inside the ball

    def black(light):
        fields = {name: getattr(light, name) for name in light.__dataclass_fields__}
        return type(light)(**{k: 0 if k in ("intensity", "radiance", "irradiance") else v for k, v in fields.items()})

    each, error = np.zeros(4), np.zeros(4)
    for k in range(len(lights)):
        one_shines = [light if j == k else black(light) for j, light in enumerate(lights)]
        one = means(ball, one_shines, range(4), spp=64, max_depth=2)
        each, error = each + one.mean(axis=0), error + one.var(axis=0, ddof=1) / 4
    one = means(ball, [*map(black, lights), sky], range(4), spp=64, max_depth=2)
    each, error = each + one.mean(axis=0), error + one.var(axis=0, ddof=1) / 4
    together = means(ball, [*lights, sky], range(100, 108), spp=512, max_depth=2)
    error = np.sqrt(error + together.var(axis=0, ddof=1) / len(together))
    assert (error < 0.006 * each).all()
    assert (np.abs(together.mean(axis=0) - each) < 3.5 * error).all()


def test_points_add_up_to_their_formula():
    """200 point lights over a diffuse floor, direct light only."""
    rng = np.random.default_rng(2)
    positions, powers = rng.uniform((-3, -3, 1), (3, 3, 3), (200, 3)), rng.lognormal(0, 2, 200)
    scene = pr.Scene()
    scene.add(pr.Plane((0, 0, 0), (0, 0, 1), 0.5))
    scene.lights = [pr.PointLight(x, power) for x, power in zip(positions, powers, strict=True)]
    camera = pr.Camera.look_at((0, 0, 10), (0, 0, 0), up=(0, 1, 0), fov=20, size=(16, 16))
    o, d = camera.rays()
    x = o - d * (o[..., 2:] / d[..., 2:])
    v = positions - x[..., None, :]
    want = (0.5 / np.pi * powers * v[..., 2] / (v**2).sum(axis=-1) ** 1.5).sum(axis=-1)
    image = pr.render(scene, camera, pr.Settings("path", spp=4096, max_depth=1, filter="box"))[..., 0]
    assert image.mean() == pytest.approx(want.mean(), rel=2e-3)
    assert np.abs(image / want - 1).max() < 0.06
