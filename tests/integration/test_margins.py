"""Rays leave a smoothed surface with a margin: bumps do not shade each other, edges do."""

from functools import cache

import numpy as np
import pytest

import pointray as pr
from helpers.marks import long
from pointray.baking.surfaces import find_surfaces
from pointray.model.model import PrebuiltModel
from pointray.surface.tree.indices import check_indices

WIDE = 120.0  # in spacings, which are 1
LOW = WIDE / 2 - 10  # lower bound of a box of 20 in its middle


def ground(noise, box=0.0, seed=1):
    """A random plane, and a box in its middle, in spacings, with noise in all directions."""
    rng = np.random.default_rng(seed)
    rows = np.c_[rng.uniform(0, WIDE, (int(WIDE**2), 2)), np.zeros(int(WIDE**2))]
    if box:
        count, low, parts = int(box**2), WIDE / 2 - box / 2, []
        for axis, at in ((0, low), (0, low + box), (1, low), (1, low + box), (2, box)):
            side = rng.uniform(0, box, (count, 3)) + [low, low, 0]
            side[:, axis] = at
            parts.append(side)
        under = (np.abs(rows[:, :2] - WIDE / 2) < box / 2).all(axis=1)
        rows = np.concatenate([rows[~under], *parts])
    return rows + rng.normal(size=rows.shape) * noise


@cache
def smooth_ground(noise, box=0.0):
    """Return a model that tests share and do not change."""
    return pr.Model(ground(noise, box), smooth="auto")


def without_margin(model):
    """A copy of the model whose tree has no noise."""
    tree = model.tree._replace(noise=np.zeros_like(model.tree.noise))
    return PrebuiltModel(model.data._replace(tree=tree), model.levels)


def seen_from_above(model, elevation, shadows=True, integrator="phong", **options):
    """Return the brightness of the ground's middle part under a sun at this elevation in degrees."""
    scene, angle = pr.Scene(), np.radians(elevation)
    scene.add(model)
    if integrator != "ao":
        scene.add_light(pr.SunLight((-np.cos(angle), 0, -np.sin(angle)), (1, 1, 1)))
    camera = pr.Camera((WIDE / 2, WIDE / 2, 1000), (WIDE / 2, WIDE / 2, 0), (0, 1, 0), 4.6, (160, 160), "orthographic")
    settings = pr.Settings(spp=1, integrator=integrator, shadows=shadows, levels=False, **options)
    return pr.render(scene, camera, settings)[..., 0]


def shaded_share(model, elevation, **options):
    """Return the share of shadowed pixels."""
    lit, shaded = (seen_from_above(model, elevation, shadows, **options) for shadows in (False, True))
    return np.mean(shaded < 0.5 * lit)


@pytest.mark.parametrize("noise", [long(0.1), 0.3, long(0.5)])
@pytest.mark.parametrize("integrator", ["phong", "path"])
def test_a_noisy_wall_under_a_grazing_sun_is_evenly_lit(noise, integrator):
    model = smooth_ground(noise)
    assert shaded_share(model, 3.0, integrator=integrator) <= 0.001


def test_without_the_margin_bumps_would_shade_it():
    assert shaded_share(without_margin(smooth_ground(0.3)), 3.0) > 0.05


def test_ambient_occlusion_does_not_see_the_noise():
    model = smooth_ground(0.5)
    assert seen_from_above(model, 0, integrator="ao").mean() > 0.9999
    assert seen_from_above(without_margin(model), 0, integrator="ao").mean() < 0.9995


def shadow_of_box(model):
    """Return start and end of the box's shadow to the left in nine lines, with the sun at 45 degrees."""
    scene, found = pr.Scene(), []
    scene.add(model)
    scene.add_light(pr.SunLight((-1, 0, -1), (1, 1, 1)))
    at = LOW - 12 + (np.arange(240) - 119.5) / 3 * 2 * 1000 * np.tan(np.radians(0.01))
    for y in np.linspace(LOW + 4, LOW + 16, 9):
        camera = pr.Camera((LOW - 12, y, 1000), (LOW - 12, y, 0), (0, 1, 0), 0.02, (240, 3), "orthographic")
        dark = pr.render(scene, camera, pr.Settings(integrator="phong", levels=False))[1, :, 0] < 0.05
        found.append((at[dark].min(), at[dark & (at < LOW - 0.6)].max()))
    return np.array(found).T


def test_the_shadow_of_a_box_begins_at_its_foot():
    model = smooth_ground(0.3, box=20.0)
    tips, feet = shadow_of_box(model)
    assert np.abs(feet - LOW).max() < 1.5  # no light between the box and its shadow
    assert np.abs(tips - (LOW - 20)).max() < 2.2  # more than a spacing is noise at the box's upper edge
    others, _ = shadow_of_box(without_margin(model))
    assert np.abs(tips - others).max() < 0.6


def test_files_levels_and_other_settings_keep_the_margin(tmp_path):
    model = pr.Model(ground(0.3))
    assert np.median(model.tree.noise) == pytest.approx(0.3, rel=0.25)
    model.make_levels()
    assert np.median(model.levels[0].tree.noise) == pytest.approx(0.3, rel=0.25)
    model.save(tmp_path / "a.pointray")
    assert np.array_equal(pr.Model.load(tmp_path / "a.pointray").tree.noise, model.tree.noise)
    other = model.rebuild("auto", surface="imls")
    assert np.median(other.tree.noise) == pytest.approx(np.median(model.tree.noise), rel=0.1)


def test_noise_from_a_file_is_checked(tmp_path):
    model = pr.Model(ground(0.3))
    noise = model.tree.noise
    for wrong in (noise[:-1], noise * np.float32(np.nan), -noise, noise + np.float32(np.inf)):
        assert check_indices(model.tree._replace(noise=wrong), len(model.points))
    PrebuiltModel(model.data._replace(tree=model.tree._replace(noise=noise[:-1]))).save(tmp_path / "a.pointray")
    with pytest.raises(ValueError, match="damaged: noise"):
        pr.Model.load(tmp_path / "a.pointray")


def test_clean_points_have_no_margin():
    assert pr.Model(pr.procedural("torus", 5000)).tree.noise.size == 0
    assert pr.Model(ground(0.3), smooth=0).tree.noise.size == 0


def test_baked_light_uses_the_margin():
    model, scene = smooth_ground(0.3), pr.Scene()
    scene.add(model, np.diag([2.0, 2.0, 2.0, 1.0]))
    sheet = find_surfaces(scene.snapshot(), 500, 1.0)[0]
    assert np.median(sheet.margins) == pytest.approx(2 * np.median(model.tree.noise), rel=0.05)


def test_noise_larger_than_the_model_still_leaves_shadows():
    model = pr.Model(ground(0.3, box=20.0), smooth=1e6)
    assert model.tree.noise.max() <= model.radii.max()
