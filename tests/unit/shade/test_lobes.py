"""Directional moments of baked light, and their reflection by glossy lobes, compared with sums over directions."""

import numpy as np
import pytest

import pointray as pr
from bench.light.baked_records import LUMINANCE, harmonics, pack_values, reflected, values_of
from helpers.marks import long
from pointray.baking.bounces import GRAY, SEES_SKY
from pointray.baking.pack import PER_PATCH
from pointray.baking.surfaces import _shares
from pointray.engine.jit import kernel
from pointray.engine.kernels.records import MOMENTS, PHONG, PRINCIPLED
from pointray.engine.kernels.scratch import ARRIVING_COLORS, ARRIVING_MOMENTS, COUNT_NEAR, TILE, new_scratch
from pointray.shade.baked_code import COLOR_LEVELS, LEVELS, LINEAR, REACH_1, REACH_2, REACH_COLOR
from pointray.shade.baked_sums import SUM_WEIGHTS, list_record, store_moments, sum_moments
from pointray.shade.lobe_tables import facet_lobes, phong_lobes
from pointray.shade.lobes import WIDE, WIDE_FACETS

NORMAL = np.array([0.36, -0.48, 0.8])
REACHES = np.repeat([REACH_1, REACH_2, REACH_COLOR], [3, 5, 6])
STEPS = np.repeat([LEVELS, COLOR_LEVELS], [8, 6])


def _unit(a):
    return a / np.linalg.norm(a)


def hemisphere(normal, count=200):
    """Directions (n, 3) above a surface, and their cosines times solid angles: even over the disc below them."""
    square = (np.arange(count) + 0.5) / count
    radius, turn = np.sqrt(square), (np.arange(count) + 0.5) * 2 * np.pi / count
    x, y = radius[:, None] * np.cos(turn), radius[:, None] * np.sin(turn)
    z = np.sqrt(1 - x * x - y * y)
    tangent = _unit(np.cross(normal, [0.6, 0, 0.8]))
    frame = np.array([tangent, np.cross(normal, tangent), normal])
    return np.stack([x, y, z], axis=-1).reshape(-1, 3) @ frame, np.full(count * count, np.pi / count**2)


W, FLUX = hemisphere(NORMAL)


def mirrored(count=40):
    """Unit directions above the surface, from the normal to the horizon, (count, 3)."""
    at = np.random.default_rng(2).integers(0, len(W), count)
    return np.concatenate([[NORMAL], W[at]])


R = mirrored()


def phong(exponent, r, light):
    """Return the sum over directions of light reflected by Phong lobes of weight 1, (k, 3)."""
    along = np.maximum(W @ r.T, 0.0)
    lobe = (exponent + 2) / (2 * np.pi) * (along**exponent if exponent > 0 else 1.0 * (along > 0)) * FLUX[:, None]
    return lobe.T @ light


def facets(exponent, r, light):
    """Return the same for a GGX lobe that reflects all even light."""
    out = []
    for one in r:
        tangent = one - (one @ NORMAL) * NORMAL
        tangent /= max(np.linalg.norm(tangent), 1e-9)
        own = np.stack([W @ tangent, W @ np.cross(NORMAL, tangent), W @ NORMAL], axis=1)
        lobe = facet_lobes(own, np.array([one @ NORMAL]), exponent)[:, 0] / own[:, 2] * FLUX
        out.append(lobe @ light / lobe.sum())
    return np.array(out)


def reflect(light, kind, exponent):
    """Return pointray's reflection of radiance (n, 3) from the directions W, (k, 3)."""
    records = pack_values(values_of(light, W, FLUX, NORMAL)[None])
    return reflected(records, (float(kind), float(exponent)), NORMAL[None], R[None])[0]


def gradient():
    """A sky that is blue above, bright at the horizon and dark below, (n, 3)."""
    up = np.clip(W[:, 2:], -1, 1)
    return np.where(up > 0, (1 - up) * [0.9, 0.85, 0.8] + up * [0.3, 0.5, 1.0], 0.2 + 0.6 * np.exp(4 * up))


def wall():
    """A red wall on one side of an even sky, (n, 3)."""
    return np.where(W[:, :1] < 0.2 * W[:, 2:], [0.7, 0.06, 0.05], [0.9, 0.9, 1.0])


@pytest.mark.parametrize("exponent", [0, 0.3, 1, 2, 3.3, WIDE])
def test_even_light_is_reflected_unchanged(exponent):
    light = np.broadcast_to([0.5, 1.0, 2.0], W.shape)
    assert reflect(light, PHONG, exponent) == pytest.approx(phong(exponent, R, light), rel=0.015, abs=3e-3)
    assert reflect(light, PRINCIPLED, exponent) == pytest.approx(np.broadcast_to(light[0], R.shape), abs=3e-3)


@pytest.mark.parametrize(
    "light, exponent, most", [(gradient, 1, 2), (gradient, WIDE, 5), (wall, 1, 4), (wall, WIDE, 10)]
)
def test_lobes_are_close_to_sums_over_directions(light, exponent, most):
    """Root mean square errors in percent of the mean."""
    light = light()
    found, true = reflect(light, PHONG, exponent), phong(exponent, R, light)
    assert 100 * np.sqrt(np.mean((found - true) ** 2)) / true.mean() < most
    exponent = min(exponent, WIDE_FACETS)
    found, true = reflect(light, PRINCIPLED, exponent), facets(exponent, R, light)
    assert 100 * np.sqrt(np.mean((found - true) ** 2)) / true.mean() < most


def test_black_and_monochromatic_light_are_reflected():
    assert (reflect(np.zeros_like(W), PHONG, 4) == 0).all()
    red = gradient() * [1, 0, 0]
    found = reflect(red, PHONG, 2)
    assert np.abs(found - phong(2, R, red)).max() < 0.05
    assert (found[:, 1:] < 0.02).all()


@pytest.mark.parametrize("height", [0.02, 0.5, 1.0])
def test_light_from_one_direction_is_reflected_in_bounds(height):
    """The moments cannot represent it: lobes get wider and fainter, not black or brighter."""
    tangent = np.cross(NORMAL, [0.6, 0, 0.8])
    light = np.where(W @ _unit(height * NORMAL + np.sqrt(1 - height**2) * _unit(tangent)) > 0.995, 1.0, 0.0)
    light = np.repeat(light[:, None], 3, axis=1)
    for exponent in (1, WIDE):
        found, true = reflect(light, PHONG, exponent), phong(exponent, R, light)
        assert np.isfinite(found).all() and (found >= 0).all()
        assert 0.5 * true.max() < found.max() < 1.3 * true.max()


@kernel
def _unpack(records, out):
    """Moments of each record, of luminance and of red and blue, (n, 14)."""
    scratch = new_scratch(1)
    for p in range(len(out)):
        scratch.counts[COUNT_NEAR] = 0
        list_record(p // 4, 2, p % 4, 3.0, scratch)
        scratch.part[SUM_WEIGHTS + 8] = 3.0
        sum_moments(records, scratch)
        store_moments(5, 2, 1.0, scratch)
        for k in range(8):
            out[p, k] = scratch.shading_points[ARRIVING_MOMENTS + k * TILE + 5]
        for k in range(6):
            out[p, 8 + k] = scratch.shading_points[ARRIVING_COLORS + k * TILE + 5]


def steps_in(records):
    """The numbers of steps of records' words, by the layout that `shade/baked_code.py` describes, (n, 14)."""
    words = records[:, MOMENTS : MOMENTS + 2].view(np.uint32)
    five = [(words[:, k // 4] >> (5 * (k % 4))) & 31 for k in range(8)]
    four = [(words[:, k // 3] >> (20 + 4 * (k % 3))) & 15 for k in range(6)]
    return np.stack([*five, *four], axis=1).astype(int) - STEPS


def share_of(steps):
    """Return the values of numbers of steps, (..., 14)."""
    x = steps / STEPS
    return REACHES * x * (LINEAR + (1 - LINEAR) * np.abs(x))


def test_moments_are_quantized_to_half_a_step():
    rng = np.random.default_rng(1)
    n = 1001
    values = np.zeros((n, PER_PATCH))
    values[:, :3] = np.exp(rng.normal(size=(n, 3)))
    gray = values[:, :3] @ LUMINANCE
    shares = rng.uniform(-1.1, 1.1, (n, 14)) * REACHES
    values[:, 6:14] = shares[:, :8] * gray[:, None]
    values[:, 14:17] = (shares[:, :3] + shares[:, 8:11]) * values[:, :1]
    values[:, 17:20] = (shares[:, :3] + shares[:, 11:]) * values[:, 2:3]
    records = pack_values(values, unit=0.01)
    assert len(records) == 1004 and (records[n:] == 0).all()
    steps = steps_in(records[:n])
    assert (np.abs(steps) <= STEPS).all() and (np.abs(steps) == STEPS).any(axis=0).all()
    kept, inside = share_of(steps), np.clip(shares, -REACHES, REACHES)
    up, down = np.abs(share_of(steps + 1) - kept), np.abs(share_of(steps - 1) - kept)
    assert (np.abs(kept - inside) <= 0.5 * np.where(inside > kept, up, down) + 1e-6).all()
    found = np.zeros((n, 14))
    _unpack(records.reshape(-1), found)
    irradiance = np.concatenate([np.repeat(gray[:, None], 8, axis=1), np.repeat(values[:, [0, 2]], 3, axis=1)], axis=1)
    assert found * 0.01 == pytest.approx(kept * irradiance, rel=0.01, abs=0.01)


@pytest.fixture(scope="module")
def ball():
    return pr.Model(pr.procedural("sphere", 5_000))


def sky(up=1.0, horizon=0.0, ground=0.0):
    return pr.EnvironmentLight(up, horizon=horizon, ground=ground)


@pytest.mark.long
def test_moments_equal_those_of_the_sky_and_are_additive(ball):
    """A plane under a sky has the moments of the sky's gradient; those of two skies add up to those of their sum."""
    scene = pr.Scene()
    scene.add(ball, pr.transform(translate=(0, 0, 1)), material=pr.Diffuse(0.0))
    scene.add(pr.Plane((0, 0, -30), (0, 0, 1), color=0.0))
    skies = (0.3, 0.5, 1.0), (0.9, 0.85, 0.8)
    facts = []
    scene.lights = [sky((1.2, 1.35, 1.8), (1.2, 1.35, 1.8))]
    baked = pr.bake(scene, pr.BakeSettings(patches=3_000))
    for lights in (sky(skies[0], 0.0), sky(0.0, skies[1]), sky(skies[0], skies[1])):
        scene.lights = [lights]
        baked.update()
        facts.append(baked._exchange.arrived.facts[:, GRAY:SEES_SKY])
    assert facts[0] + facts[1] == pytest.approx(facts[2], abs=1e-5)
    assert np.abs(facts[2]).max() > 0.1
    w, flux = hemisphere(np.array([0.0, 0.0, 1.0]))
    radiance = pr.Scene()
    radiance.lights = [sky(*skies)]
    up = w[:, 2:]
    seen = (1 - up) * skies[1] + up * skies[0]
    rows = baked._exchange.sides[1, 1].span
    want = values_of(seen, w, flux, np.array([0.0, 0.0, 1.0]))[6:]
    assert np.median(facts[2][rows], axis=0) == pytest.approx(want, abs=0.02)


def test_moments_equal_those_of_a_bright_spot_of_the_sky(ball):
    """Its light is not found by links. Its direction follows from the irradiance, cosine by cosine."""
    image = np.zeros((64, 128, 3))
    image[20, 40] = 3000.0, 1000.0, 300.0
    scene = pr.Scene()
    scene.add(ball, material=pr.Diffuse(0.0))
    scene.lights = [pr.EnvironmentLight(image=image)]
    baked = pr.bake(scene)
    span = baked._exchange.sides[0, 1].span
    light, facts = baked._exchange.arrived.indirect[span], baked._exchange.arrived.facts[span, GRAY:SEES_SKY]
    normals = baked._exchange.transport.normals[span].astype(float)
    lit = light[:, 0] > 0.2 * light[:, 0].max()
    spot = _unit(np.linalg.lstsq(normals[lit], light[lit, 0], rcond=None)[0])
    more = harmonics(spot) - harmonics(normals[lit]) * np.repeat([2 / 3, 1 / 4], [3, 5])
    gray, red, blue = light[lit] @ LUMINANCE, light[lit, 0], light[lit, 2]
    want = np.concatenate([gray[:, None] * more, red[:, None] * more[:, :3], blue[:, None] * more[:, :3]], axis=1)
    assert facts[lit] == pytest.approx(want, abs=0.03 * np.abs(want).max())


def test_plane_cells_are_padded_to_multiples_of_four(ball):
    """Records are read four at a time."""
    scene = pr.Scene()
    scene.add(ball)
    scene.add(pr.Plane((0, 0, -1), (0, 0, 1)))
    edges = {_shares(scene.snapshot(), most)[1] for most in range(20_000, 200_000, 1000)}
    assert len(edges) > 10 and all(edge % 2 == 0 for edge in edges)


def shares(material, cosine):
    """The share of even light that a lobe reflects to an eye, by the cosine at the normal, (k,)."""
    w, flux = hemisphere(np.array([0.0, 0.0, 1.0]))
    if isinstance(material, pr.Phong):
        lobes = phong_lobes(w, cosine, material.exponent)
    else:
        lobes = facet_lobes(w, cosine, 0.5 / material.roughness**4 - 0.5)
    return (flux / w[:, 2]) @ lobes


@pytest.mark.parametrize(
    "material", [long(pr.Phong(0.0, 1.0, 4.0)), long(pr.Principled(1.0, 0.8, 1.0)), pr.Principled(1.0, 0.5, 1.0)]
)
def test_a_glossy_ball_under_an_even_sky_is_even(ball, material):
    """Blended over splats whose normals differ, even light is still even. The last lobe is narrow: it sends rays."""
    scene = pr.Scene()
    scene.add(ball, material=material)
    scene.lights = [sky(1.0, 1.0, 1.0)]
    scene.baked = pr.bake(scene)
    camera = pr.frame(scene, size=(48, 48))
    hits = scene.intersect(*camera.rays())
    met = np.isfinite(hits.t)
    cosine, steps = -np.sum(hits.normal * camera.rays()[1], axis=-1)[met], np.linspace(0.001, 1, 60)
    found = pr.render(scene, camera, pr.Settings("baked"))[met]
    assert met.sum() > 700
    assert found[:, 0] == pytest.approx(np.interp(cosine, steps, shares(material, steps)), abs=0.02)


@pytest.mark.long
@pytest.mark.parametrize("material", [pr.Phong((0.6, 0.5, 0.4), 0.5, 3.0), pr.Principled((0.6, 0.5, 0.4), 0.8, 1.0)])
def test_glossy_pictures_equal_path_traced_ones(material):
    model = pr.Model(pr.procedural("statue", 30_000))
    scene = pr.Scene()
    scene.add(model, material=material)
    scene.add(pr.Plane((0, 0, model.bounds[0, 2]), (0, 0, 1), color=0.5))
    scene.add(pr.Plane((model.bounds[0, 0] - 0.3, 0, 0), (1, 0, 0), color=(0.8, 0.1, 0.1)))
    scene.lights = [pr.EnvironmentLight((0.3, 0.5, 1.0), horizon=(0.9, 0.85, 0.8), ground=0.2)]
    scene.baked = pr.bake(scene)
    camera = pr.frame(scene, size=(96, 96))
    baked = pr.render(scene, camera, pr.Settings("baked", spp=16))[..., :3]
    path = pr.render(scene, camera, pr.Settings("path", spp=512, max_depth=None))[..., :3]
    assert np.sqrt(np.mean((baked - path) ** 2)) / path.mean() < 0.05


def test_harmonics_of_the_benchmark_equal_those_of_the_kernels():
    from pointray.engine.jit import uncompiled
    from pointray.shade import harmonics as own

    for w in R[:5]:
        first = uncompiled(own.band_1)(tuple(w))
        second = uncompiled(own.band_2)(np.outer(w, w)[np.triu_indices(3)])
        assert harmonics(w) == pytest.approx([*first, *second])
        assert second[3] == pytest.approx(own.BAND_2_CROSS * 2 * w[0] * w[2])
        for k in range(5):
            unit = tuple(1.0 if j == k else 0.0 for j in range(5))
            assert w @ uncompiled(own.times_matrix)(unit, tuple(w)) == pytest.approx(second[k])
