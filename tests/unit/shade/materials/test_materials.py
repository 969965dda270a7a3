"""Materials: energy, reciprocity, pdfs and their samples, Fresnel and Snell, and bad input."""

import numpy as np
import pytest
from scipy.special import gammainccinv

import pointray as pr
from helpers.marks import long
from helpers.material_surface import RINGS, SECTORS, Surface, bins_of, integrals, quadrature, upper, wo_at

OPAQUE = {
    "diffuse": pr.Diffuse(),
    "emissive": pr.Emissive(3.0, color=None),
    "phong": pr.Phong(),
    "phong, no highlight": pr.Phong(specular=0),
    "phong, exponent 0": pr.Phong(specular=0.5, exponent=0),
    "phong, only highlight": pr.Phong(specular=1, exponent=300),
    "phong, narrow": pr.Phong(specular=0.4, exponent=10_000),
    "glossy": pr.Principled(roughness=0.3),
    "half rough": pr.Principled(roughness=0.5),
    "rough": pr.Principled(roughness=1),
    "polished": pr.Principled(roughness=0),
    "metal": pr.Principled(roughness=0.4, metallic=1),
    "rough metal": pr.Principled(roughness=1, metallic=1),
    "half metal": pr.Principled(roughness=0.2, metallic=0.5),
    "black metal": pr.Principled(0, roughness=0.3, metallic=1),
}
CLEAR = {"mirror": pr.Mirror(), "glass": pr.Dielectric(), "bubble": pr.Dielectric(0.75), "nothing": pr.Dielectric(1)}


@pytest.mark.parametrize("name", OPAQUE)
@pytest.mark.parametrize("degrees", [60, *map(long, (0, 35, 80, 88))])
def test_energy_and_pdf(rng, name, degrees):
    """No more than all light is reflected, and weights and pdfs agree with the samples."""
    surface, wo, count = Surface(OPAQUE[name]), wo_at(degrees), 200_000
    albedo, probability = integrals(surface, wo)
    assert 0 < albedo.max() <= 1 + 1e-3
    direction, weight, pdf, side = surface.sample(wo, rng.random((count, 3)))
    assert (side == 1).all() and np.abs(np.linalg.norm(direction, axis=1) - 1).max() < 1e-12
    produced = pdf > 0
    # The quadrature is up to 0.7% off, where the horizon cuts its rings; the samples' noise is 0.1%.
    assert probability == pytest.approx(produced.mean(), abs=1.3e-2) and probability <= 1 + 1e-2
    assert not weight[~produced].any() and (direction[produced, 2] > 0).all()
    noise = weight.std(axis=0) / np.sqrt(count)
    assert (np.abs(weight.mean(axis=0) - albedo) < 6 * noise + 1e-3).all()
    assert weight.max() < 12
    rgb, again = surface.eval_bsdf(wo, direction[produced])
    np.testing.assert_allclose(again, pdf[produced], rtol=1e-12)
    np.testing.assert_allclose(rgb / again[:, None], weight[produced], rtol=1e-12)


@pytest.mark.parametrize("name", OPAQUE)
@pytest.mark.parametrize("degrees", [60, *map(long, (0, 85))])
def test_samples_lie_where_their_pdf_says(rng, monkeypatch, name, degrees):
    """Chi-square test over rings and sectors around the mirrored direction."""
    surface, wo, count = Surface(OPAQUE[name]), wo_at(degrees), 200_000
    nodes = 32  # with 8, sums over bins that the horizon cuts are 5% off, more than the noise
    monkeypatch.setattr("helpers.material_surface.NODES", nodes)
    directions, solid = quadrature(wo)
    mass = (surface.eval_bsdf(wo, directions)[1] * solid).reshape(len(RINGS) - 1, nodes, SECTORS, -1).sum(axis=(1, 3))
    direction, _, pdf, _ = surface.sample(wo, rng.random((count, 3)))
    found = np.bincount(bins_of(wo, direction[pdf > 0]), minlength=mass.size)
    expected = mass.ravel() * count
    some = expected > 20
    assert expected[some].sum() > 0.99 * expected.sum() and some.sum() >= 4
    assert ((found - expected)[some] ** 2 / expected[some]).sum() < 2 * gammainccinv(some.sum() / 2, 1e-9)  # chi-square
    assert found[~some].sum() < 20 * (~some).sum()


@pytest.mark.parametrize("name", OPAQUE)
def test_reciprocity(rng, name):
    """Eye and light are exchanged. Half of the pairs lie close to the mirrored direction, where lobes are."""
    surface = Surface(OPAQUE[name], color=(0.9, 0.5, 0.1))
    a = upper(rng.normal(size=(400, 3)))
    b = upper(rng.normal(size=(400, 3)))
    b[:200] = upper(a[:200] * (-1, -1, 1) + 0.01 * b[:200])
    there = np.array([surface.eval_bsdf(np.append(x, 1.0), y[None])[0][0] / y[2] for x, y in zip(a, b, strict=True)])
    back = np.array([surface.eval_bsdf(np.append(y, 1.0), x[None])[0][0] / x[2] for x, y in zip(a, b, strict=True)])
    np.testing.assert_allclose(there, back, rtol=1e-6, atol=1e-12)
    assert there.max() > 0


@pytest.mark.parametrize("exponent", [0, 1, 100, 10_000, *map(long, (0.5, 5, 20, 1000))])
def test_phongs_highlight_is_normalised(exponent):
    surface = Surface(pr.Phong(0, specular=1, exponent=exponent))
    albedo = [integrals(surface, wo_at(degrees))[0][0] for degrees in (0, 20, 40, 60, 75, 85, 89)]
    assert albedo[0] == pytest.approx(1, abs=1e-4)
    assert (np.diff(albedo) < 1e-4).all() and albedo[2] > 0.999 * np.cos(np.radians(40))


def facets(wo, wi, alpha, color, metallic):
    """Return D F G2 / (4 c c') of Walter et al. 2007 (33), Heitz 2014 (72, 99), Schlick 1994."""
    half = wo + wi
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    tan2 = lambda v: (v[:, 0] ** 2 + v[:, 1] ** 2) / v[:, 2] ** 2  # noqa: E731
    spread = alpha**2 / (np.pi * half[:, 2] ** 4 * (alpha**2 + tan2(half)) ** 2)
    hidden = [(np.sqrt(1 + alpha**2 * tan2(v)) - 1) / 2 for v in (wo, wi)]
    at_normal = 0.04 + metallic * (np.array(color) - 0.04)
    fresnel = at_normal + (1 - at_normal) * (1 - (wo * half).sum(axis=1)[:, None]) ** 5
    return (spread / (1 + hidden[0] + hidden[1]) / (4 * wo[:, 2] * wi[:, 2]))[:, None] * fresnel


@pytest.mark.parametrize("roughness", [0.1, 0.5, 1])
@pytest.mark.parametrize("metallic", [0, 0.3, 1])
def test_principled_is_what_the_papers_say(rng, roughness, metallic):
    color = (0.9, 0.5, 0.1)
    surface, wo = Surface(pr.Principled(None, roughness, metallic), color), wo_at(50)
    wi = upper(rng.normal(size=(2000, 3)))
    wi[:1000] = upper((-wo[0], 0, wo[2]) + 0.1 * wi[:1000])
    glossy = facets(np.broadcast_to(wo[:3], wi.shape), wi, roughness**2, color, metallic)
    base = surface.eval_bsdf(wo, wi)[0] / wi[:, 2:] - glossy
    if metallic == 1:
        np.testing.assert_allclose(base, 0, atol=1e-9 * glossy.max())
    else:  # the base has one colour, and at most Lambert's share of the light that enters
        tint = base / np.array(color)
        np.testing.assert_allclose(tint, tint[:, :1] * np.ones(3), atol=1e-8 * glossy.max())
        assert (tint > -1e-9 * glossy.max()).all() and tint.max() < 1.1 * (1 - metallic) / np.pi


@pytest.mark.parametrize("steps", [4, long(20)])
def test_the_energy_loss_in_white_furnaces_is_bounded(steps):
    """Light is lost between facets, by the figures in Principled's docstring."""
    for roughness, reflected in ((0.1, 0.999), (0.5, 0.92), (1, 0.31)):
        albedo = integrals(Surface(pr.Principled(1, roughness, 1)), wo_at(0))[0]
        assert albedo == pytest.approx(np.full(3, reflected), abs=0.01)
    for roughness in np.linspace(0, 1, steps + 1):
        surface = Surface(pr.Principled(1, roughness))
        albedo = [integrals(surface, wo_at(degrees))[0][0] for degrees in (0, 20, 40, 50, 60, 70, 78, 84)]
        assert max(albedo) < 1 + 1e-5 and min(albedo[:-1]) > 0.98 and albedo[-1] > 0.95


def test_a_black_dielectric_reflects_4_percent():
    albedo = integrals(Surface(pr.Principled(0, roughness=0)), wo_at(0))[0]
    assert albedo == pytest.approx(np.full(3, 0.04), abs=1e-4)


def test_metal_tints_its_reflection_and_less_where_it_grazes():
    gold = (1.0, 0.77, 0.34)
    surface = Surface(pr.Principled(None, 0.1, 1), gold)
    assert integrals(surface, wo_at(0))[0] == pytest.approx(np.array(gold), abs=2e-3)
    grazing = integrals(surface, wo_at(85))[0]
    assert grazing[2] / grazing[0] > 0.7


def test_a_mirror_reflects():
    mirror = Surface(pr.Mirror((0.9, 0.5, 0.1)))
    for side in (1.0, -1.0):
        direction, weight, pdf, left = mirror.sample(wo_at(30, side), np.zeros((1, 3)))
        np.testing.assert_allclose(direction, [[-0.5, 0, np.sqrt(0.75)]], atol=1e-15)
        assert weight.tolist() == [[0.9, 0.5, 0.1]] and pdf == 0 and left == side
    assert not mirror.eval_bsdf(wo_at(30), direction)[0].any()


def wos_at(degrees, side=1.0):
    return np.array([wo_at(d, side) for d in degrees])


@pytest.mark.parametrize("ior", [1.5, 1.33, 0.75, 2.4, 1])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_glass_refracts(ior, side):
    """Snell's law, total reflection if it has no solution, directions of unit length within one plane."""
    degrees = np.linspace(0, 89.9, 500)
    wos = wos_at(degrees, side)
    reflected, refracted, share = Surface(pr.Dielectric(ior)).glass(wos)
    ratio = ior if side > 0 else 1 / ior
    sine = np.sin(np.radians(degrees)) / ratio
    through = sine < 1
    np.testing.assert_allclose(reflected, wos[:, :3] * (-1, -1, 1), atol=1e-15)
    np.testing.assert_allclose(-refracted[through, 0], sine[through], atol=1e-9)
    assert (refracted[through, 2] < 0).all() and not refracted[:, 1].any()
    np.testing.assert_allclose(np.linalg.norm(refracted, axis=1), 1, atol=1e-12)
    assert (share[~through] == 1).all() and (refracted[~through] == reflected[~through]).all()
    assert through.all() == (ratio >= 1)
    # Fresnel's equations by angles: sine and tangent of the sum and the difference.
    a, b = np.radians(degrees[through][1:]), np.arcsin(sine[through][1:])
    textbook = ((np.sin(a - b) / np.sin(a + b)) ** 2 + (np.tan(a - b) / np.tan(a + b)) ** 2) / 2
    np.testing.assert_allclose(share[through][1:], textbook, atol=1e-9)


def test_glass_reflects_by_the_equations_of_fresnel():
    glass = Surface(pr.Dielectric(1.5))
    brewster, critical = np.degrees(np.arctan(1.5)), np.degrees(np.arcsin(1 / 1.5))
    _, _, share = glass.glass(wos_at([0, brewster, 90]))
    # At Brewster's angle all light polarised in the plane passes: the other half's reflection remains.
    assert share == pytest.approx([0.04, ((1.5**2 - 1) / (1.5**2 + 1)) ** 2 / 2, 1], abs=1e-12)
    _, _, inside = glass.glass(wos_at([0, critical - 1e-3, critical + 1e-3, 60], side=-1.0))
    assert inside[0] == pytest.approx(0.04) and inside[1] < 1 and (inside[2:] == 1).all()
    assert Surface(pr.Dielectric(1)).glass(wos_at([0, 45, 89]))[2] == pytest.approx([0, 0, 0], abs=1e-12)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_glass_keeps_all_light(rng, side):
    """A path continues with weight 1, is reflected with the Fresnel probability, and tracks its side."""
    glass, wo, count = Surface(pr.Dielectric(1.5)), wo_at(40, side), 100_000
    reflected, refracted, share = glass.glass(wo[None])
    direction, weight, pdf, left = glass.sample(wo, rng.random((count, 3)))
    assert (weight == 1).all() and (pdf == 0).all()
    back = left == side
    assert back.mean() == pytest.approx(share[0], abs=6 * np.sqrt(share[0] / count))
    assert (direction[back] == reflected).all() and (direction[~back] == refracted).all()
    assert (left[~back] == -side).all() and not glass.eval_bsdf(wo, refracted)[0].any()
    # The reverse path, for which the normal is turned to the eye, reflects the same share.
    home = glass.glass(np.array([[refracted[0, 0], 0, -refracted[0, 2], -side]]))
    assert home[2] == pytest.approx(share) and home[1][0] == pytest.approx(wo[:3] * (1, 1, -1))


@pytest.mark.parametrize("name", [*OPAQUE, *CLEAR])
def test_extreme_arguments_give_finite_results(name):
    """Eyes graze the surface or are behind it; random numbers are the least and the greatest."""
    surface = Surface((OPAQUE | CLEAR)[name])
    ends = [0.0, 2.0**-32, 0.5, 1 - 2.0**-32, 1 - 2.0**-53]
    numbers = np.stack(np.meshgrid(ends, ends, ends), axis=-1).reshape(-1, 3)
    for degrees in (0, 1e-6, 45, 89.99, 89.9999999, 90.0001, 120):
        direction, weight, pdf, side = surface.sample(wo_at(degrees, -1.0), numbers)
        assert np.isfinite(direction).all() and np.isfinite(weight).all() and np.isfinite(pdf).all()
        assert np.abs(np.linalg.norm(direction, axis=1) - 1).max() < 1e-9
        assert (weight >= 0).all() and weight.max() < 1e4 and np.isin(side, (-1, 1)).all()
        assert degrees < 90 or not weight.any()
        rgb, pdf = surface.eval_bsdf(wo_at(degrees), direction)
        assert np.isfinite(rgb).all() and np.isfinite(pdf).all() and (degrees < 90 or not rgb.any())
    below = surface.eval_bsdf(wo_at(30), np.array([[0.6, 0, -0.8], [1, 0, 0]]))
    assert not below[0].any() and not below[1].any()


def test_only_emissive_materials_emit():
    shines, specular = Surface(pr.Emissive((1, 2, 3), 0.5)).own_light()
    assert shines.tolist() == [1, 2, 3] and not specular
    for material in (pr.Diffuse(), pr.Phong(), pr.Principled(), pr.Mirror(), pr.Dielectric()):
        shines, specular = Surface(material).own_light()
        assert not shines.any() and specular == isinstance(material, pr.Mirror | pr.Dielectric)


def test_materials_have_a_color_or_that_of_the_points():
    own, wi = (0.2, 0.4, 0.8), np.array([[0.0, 0, 1]])
    for material, color in ((pr.Diffuse(), own), (pr.Diffuse(0.5), (0.5,) * 3), (pr.Emissive(1), (0, 0, 0))):
        rgb, _ = Surface(material, own).eval_bsdf(wo_at(10), wi)
        assert rgb[0] * np.pi == pytest.approx(color)


@pytest.mark.parametrize(
    ("material", "radiance"),
    [
        (pr.Diffuse((0.5, 0.2, 0.1)), (0.5, 0.2, 0.1)),
        (pr.Phong((0.5, 0.2, 0.1), specular=0.2, exponent=8), (1.4, 1.16, 1.08)),  # 0.8 color + 0.2 (8 + 2) / 2
        (pr.Emissive((1, 2, 3), color=0.25), (1.25, 2.25, 3.25)),
        (pr.Mirror(), (0, 0, 0)),  # direct light only
    ],
)
def test_materials_under_the_headlight_have_known_radiance(material, radiance):
    scene = pr.Scene()
    scene.add(pr.Plane((0, 0, 0), (0, 0, 1)), material=material)
    for eye in ((0, 0, 5), (0, 0, -5)):
        camera = pr.Camera.look_at(eye, (0, 0, 0), up=(0, 1, 0), fov=1, size=(1, 1))
        assert pr.render(scene, camera)[0, 0, :3] == pytest.approx(radiance, rel=1e-5)


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: pr.Diffuse("red"), "color"),
        (lambda: pr.Diffuse((1, 2)), "color"),
        (lambda: pr.Diffuse(1.5), "reflectance from 0 to 1"),
        (lambda: pr.Diffuse(-0.1), "color"),
        (lambda: pr.Diffuse(np.nan), "color"),
        (lambda: pr.Phong(specular=1.1), "specular"),
        (lambda: pr.Phong(specular=None), "specular"),
        (lambda: pr.Phong(exponent=-1), "exponent"),
        (lambda: pr.Phong(exponent=np.inf), "exponent"),
        (lambda: pr.Mirror((1, 1, 2)), "color"),
        (lambda: pr.Dielectric(0), "ior"),
        (lambda: pr.Dielectric(np.nan), "ior"),
        (lambda: pr.Dielectric("glass"), "ior"),
        (lambda: pr.Principled(2), "base_color"),
        (lambda: pr.Principled(roughness=-0.1), "roughness"),
        (lambda: pr.Principled(metallic=1.5), "metallic"),
        (lambda: pr.Emissive(-1), "radiance"),
        (lambda: pr.Emissive(np.inf), "radiance"),
        (lambda: pr.Emissive(1, color=3), "color"),
        (lambda: pr.Scene().add(pr.Plane((0, 0, 0), (0, 0, 1)), material="glass"), "Dielectric.*not 'glass'"),
    ],
)
def test_bad_materials_are_refused(make, says):
    with pytest.raises(ValueError, match=says):
        make()


def test_materials_are_frozen():
    with pytest.raises(AttributeError):
        pr.Phong().specular = 0.5
