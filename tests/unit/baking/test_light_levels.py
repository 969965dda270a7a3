"""Coarser light levels are used where light of all splats of all instances exceeds the memory budget."""

from functools import cache

import numpy as np
import pytest

import pointray as pr
from helpers.marks import long
from helpers.model_bytes import copied, join, split
from pointray.baking.levels import LightCost, LitInstance, choose_levels, coarsest_level, knots_at, padded_count

SKY, SUN = pr.EnvironmentLight((1, 0.9, 0.8)), pr.SunLight((1, -0.5, -2))
SIZES = {"torus": (2000, 8000), "statue": (6000, 16_000)}  # points, and patches of a scene with them


def settings(name="torus", **changes):
    return pr.BakeSettings(patches=SIZES[name][1], links=16, noise=1.0, max_depth=2, **changes)


@cache
def body(name="torus"):
    return pr.Model(pr.procedural(name, SIZES[name][0]))


@cache
def sheet():
    """Return an open curved sheet; its sides are lit differently."""
    x, y = np.meshgrid(np.linspace(-1, 1, 50), np.linspace(-1, 1, 50))
    slope = 0.5 * np.cos(2.0 * x)
    normals = np.stack([-slope, 0 * x, 1 + 0 * x], axis=-1).reshape(-1, 3)
    positions = np.stack([x, y, 0.25 * np.sin(2.0 * x)], axis=-1).reshape(-1, 3)
    return pr.Model(pr.Points(positions, normals / np.linalg.norm(normals, axis=1, keepdims=True)))


def room(name="torus", models=()):
    """Return instances of two models, or of the given ones, side by side on a plane."""
    one, other = body(name), sheet()
    scene = pr.Scene()
    for k, model in enumerate(models or (one, one, other, one, other)):
        scene.add(model, pr.transform(translate=(2.2 * k, 0, 0.3 * (k % 2))), material=pr.Diffuse(0.6))
    scene.add(pr.Plane((0, 0, -1.2), (0, 0, 1)))
    scene.lights = (SKY, SUN)
    return scene


def picture(scene, baked):
    scene.baked = baked
    camera = pr.Camera.frame(scene.bounds, size=(160, 80))
    return pr.render(scene, camera, pr.Settings("baked", spp=4))


def baked_at(scene, budget, name="torus", **changes):
    return pr.bake(scene, settings(name, memory=budget, **changes))


@cache
def full(name="torus"):
    """Return the light of all splats of all instances, and its picture."""
    scene = room(name)
    baked = pr.bake(scene, settings(name))
    assert set(baked.levels.values()) == {0} and baked.coarser == ""
    assert (4, -1) in baked._exchange.sides  # the sheet's back is lit
    return baked, picture(scene, baked)


def planes_of(baked):
    return sum(baked._kept.records[key].nbytes for key in baked._kept.records if key[0] in baked._kept.grids)


def least_of(scene):
    """Return the least sufficient budget, as the error states it."""
    with pytest.raises(ValueError, match=r"at least [\d,]+ bytes, more than memory=1,000") as error:
        baked_at(scene, 1000)
    return int(str(error.value).split("at least ")[1].split(" ")[0].replace(",", ""))


def error(got, want):
    return np.sqrt(np.mean((got - want) ** 2)) / want.mean()


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "level", "in_picture", "on_body", "on_sheet"),
    [
        ("torus", 2, 0.004, 0.12, 0.08),
        long("torus", 1, 0.001, 0.04, 0.02),
        long("torus", 3, 0.008, 0.2, 0.12),
        long("statue", 1, 0.001, 0.04, 0.007),
        long("statue", 2, 0.005, 0.17, 0.025),
        long("statue", 3, 0.007, 0.2, 0.036),
    ],
)
def test_coarser_light_is_nearly_the_same(tmp_path, name, level, in_picture, on_body, on_sheet):
    """It fits the budget, is nearly that of all splats, and can be saved and loaded.

    The statue has few splats for its folds. Weights or records in a wrong order exceed the bounds.
    """
    scene, (finest, shown) = room(name), full(name)
    budget = budget_of(finest, level, name)
    baked = baked_at(scene, budget, name)
    assert baked.nbytes <= budget and max(baked.levels.values()) == level
    assert f"levels 0 to {level}" in repr(baked) or f"level {level}" in repr(baked)
    got = picture(scene, baked)
    assert error(got, shown) < in_picture
    baked.save(tmp_path / "a.bake")
    again = pr.Baked.load(tmp_path / "a.bake", scene)
    np.testing.assert_array_equal(picture(scene, again), got)
    assert again.levels == baked.levels and again.nbytes == baked.nbytes
    for id in range(5):
        for side in (1, -1):
            want = finest.irradiance(id, side)
            np.testing.assert_array_equal(baked.irradiance(id, side), want)
            if want.any():
                assert error(again.irradiance(id, side), want) < (on_sheet if id in (2, 4) else on_body)


def budget_of(full, level, name="torus"):
    """Return the bytes that just suffice for this level of all instances."""
    total = planes_of(full)
    for id in range(5):
        for sign in (1, -1):
            if (id, sign) in full._exchange.sides:
                total += 16 * padded_count(len(knots_at(level, full._exchange.sides[id, sign].size)))
    return total + 32 * sum(len(model.tree.order) // 4 for model in (body(name), sheet()))


def test_the_least_budget_is_reported_and_suffices():
    scene = room()
    least = least_of(scene)
    baked = baked_at(scene, least)
    assert baked.nbytes == least
    with pytest.raises(ValueError, match=f"at least {least:,} bytes, more than memory={least - 1:,}"):
        baked_at(scene, least - 1)


@pytest.mark.long
def test_lights_may_change_at_any_level():
    scene = room()
    baked = baked_at(scene, budget_of(full()[0], 2))
    before = dict(baked.levels)
    scene.lights = (SKY, pr.SunLight((-1, 0.3, -1), 5.0))
    baked.update()
    assert baked.levels == before
    fresh = baked_at(scene, budget_of(full()[0], 2))
    np.testing.assert_array_equal(picture(scene, baked), picture(scene, fresh))
    assert error(picture(scene, baked), full()[1]) > 0.2


@pytest.mark.long
def test_coarser_light_does_not_depend_on_threads():
    one, two = (baked_at(room(), full()[0].nbytes - 20_000, threads=threads) for threads in (1, 2))
    assert one.levels == two.levels and len(set(one.levels.values())) > 1
    for key, records in one._kept.records.items():
        np.testing.assert_array_equal(records, two._kept.records[key])


@pytest.mark.long
def test_levels_of_detail_share_the_records_of_coarser_light(tmp_path):
    model = pr.Model(pr.procedural("torus", 6000))
    model.make_levels()
    assert model.levels
    scene = room(models=[model] * 3)
    wide = pr.bake(scene, settings())
    budget = least_of(scene)
    baked = baked_at(scene, budget)
    assert baked.nbytes <= budget < wide.nbytes and min(baked.levels.values()) > 0
    baked.save(tmp_path / "a.bake")
    again = pr.Baked.load(tmp_path / "a.bake", scene)
    levels = np.array([0, 1, 1, 0])
    for of in (baked, again):
        table = of.tables(scene.snapshot(), levels)[0].reshape(-1, 5)
        assert (table[:3, [0, 3]] != 0).all() and table[0, 0] != table[1, 0]
        assert table[1, 3] == table[2, 3] != table[0, 3]


def test_levels_fit_any_budget():
    """They are as fine as possible: with more memory, instances are not coarser on average."""
    rng = np.random.default_rng(4)
    shapes = [LightCost(4 * int(n), 32 * int(n), int(n)) for n in rng.integers(20, 50_000, 6)]
    wanted = [LitInstance(int(rng.integers(6)), int(rng.integers(1, 3))) for _ in range(40)]
    least = choose_levels(shapes, wanted, 0)
    whole = sum(16 * item.sides * shapes[item.shape].records for item in wanted)
    assert isinstance(least, int) and isinstance(choose_levels(shapes, wanted, least - 1), int)
    assert choose_levels(shapes, wanted, whole) == [0] * 40
    for budget in np.geomspace(least, whole - 1, 20).astype(int).tolist():
        levels = choose_levels(shapes, wanted, budget)
        assert bytes_of(shapes, wanted, levels) <= budget and max(levels) > 0
        assert all(
            level <= coarsest_level(shapes[item.shape].patches) for item, level in zip(wanted, levels, strict=True)
        )


def bytes_of(shapes, wanted, levels):
    """Return the bytes that `choose_levels` counts: a slow reference."""
    total, spreads = 0, set()
    for item, level in zip(wanted, levels, strict=True):
        shape = shapes[item.shape]
        total += 16 * item.sides * (len(knots_at(level, shape.patches)) if level else shape.records)
        if level and (item.shape, level) not in spreads:
            spreads.add((item.shape, level))
            total += shape.spread
    return total


def test_the_number_of_patches_has_a_bound():
    """The bound holds for many instances."""
    scene = pr.Scene()
    ball = pr.Model(pr.procedural("sphere", 300))
    for k in range(100):
        scene.add(ball, pr.transform(translate=(3 * (k % 10), 3 * (k // 10), 0)))
    scene.add_light(SKY)
    baked = pr.bake(scene, pr.BakeSettings(patches=2000, links=4, noise=1.0, max_depth=1))
    assert len(baked._exchange.transport) <= 2000


def put(index, value):
    def change(array):
        array[index] = value
        return array

    return change


@pytest.mark.parametrize(
    ("name", "change"),
    [
        *(("coarse", put((0, k), value)) for k, value in ((0, 5), (0, -1), (1, 0), (1, 99), (2, -1), (2, 2), (3, 0))),
        *(("coarse", put((0, k), value)) for k, value in ((0, 1), (2, 1), (3, 3), (3, 2**31 - 1))),
        ("coarse", lambda coarse: coarse[::-1].copy()),
        ("coarse", lambda coarse: coarse[:-1].copy()),
        ("coarse", lambda coarse: coarse[:, :3].copy()),
        ("spreads", lambda spreads: spreads[:-8].copy()),
        *(("spreads", put(k, value)) for k in (0, 3, -5) for value in (-1, 2**31 - 1)),
        *(("spreads", put(k, value)) for k in (4, -1) for value in (0, -1)),
    ],
)
def test_a_damaged_file_of_coarser_light_is_refused(tmp_path, coarse_file, name, change):
    parts = copied(split(coarse_file))
    parts.arrays[name] = change(parts.arrays[name])
    (tmp_path / "a").write_bytes(join(parts))
    with pytest.raises(ValueError, match="bake again"):
        pr.Baked.load(tmp_path / "a", room())


@pytest.fixture(scope="module")
def coarse_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("coarse") / "a.bake"
    baked_at(room(), budget_of(full()[0], 2)).save(path)
    return path.read_bytes()
