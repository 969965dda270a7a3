"""Scattered points as spheres and discs: the same hits as the brute-force reference, with and without a surface."""

import pickle

import numpy as np
import pytest

import pointray as pr
from helpers.marks import long
from helpers.naive import intersect_scattered, walk
from helpers.tree_check import check_tree
from pointray.cloud.kd_ordering import compute_kd_ordering
from pointray.cloud.statistics import CloudStatistics
from pointray.engine.kernels.tree import NO_CHILD, SCATTERED, first_scattered
from pointray.surface.splats.scattered.levels import covering_radius
from pointray.surface.splats.scattered.spheres import Drawing, shapes_of
from pointray.surface.tree.indices import check_indices
from pointray.surface.tree.scattered import scattered_of

UP = np.array([0.0, 0.0, 1.0])


def unit(rows):
    return rows / np.linalg.norm(rows, axis=-1, keepdims=True)


def crown(rng, n=1500):
    """Return points scattered in a cube, (n, 3)."""
    return rng.uniform(-1, 1, (n, 3))


def model_of(positions, mask=None, scatter="spheres", **options):
    mask = np.ones(len(positions), np.bool_) if mask is None else mask
    normals = options.pop("normals", np.tile(UP, (len(positions), 1)))
    points = pr.Points(positions, normals, **{k: options.pop(k) for k in ("colors", "attributes") if k in options})
    return pr.Model(points, scatter=scatter, _scattered=mask, **options)


def tree_on_ground(rng, scatter="spheres", n=4000):
    """Return flat ground with scattered points above it, some touching it; and which points are scattered."""
    side = int(np.sqrt(n))
    ground = np.stack(np.meshgrid(*2 * [np.linspace(-2, 2, side)]), axis=-1).reshape(-1, 2)
    ground = np.column_stack([ground, 0.1 * np.sin(2 * ground[:, 0])])
    above = crown(rng, n // 4) + [0, 0, 1]
    positions = np.concatenate([ground, above])
    mask = np.arange(len(positions)) >= len(ground)
    return model_of(positions, mask, scatter, smooth=0.0)


def scene_of(model, *args):
    scene = pr.Scene()
    scene.add(model, *args)
    return scene


def rays_at(rng, n, size=1.2, away=5.0):
    """Return rays from all directions at a cube, and coherent camera rays: (2 n, 3) each."""
    ends, directions = rng.uniform(-size, size, (n, 3)), unit(rng.normal(size=(n, 3)))
    side = int(np.ceil(np.sqrt(n)))
    screen = np.stack(np.meshgrid(*2 * [np.linspace(-size, size, side)]), axis=-1).reshape(-1, 2)[:n]
    alike = unit(np.column_stack([screen[:, 0], np.full(n, 5.0), screen[:, 1]]))
    origins = np.concatenate([ends - away * directions, np.tile([0.0, -5, 0.1], (n, 1))])
    return origins, np.concatenate([directions, alike])


def check_scattered(model, origins, directions):
    """Check that rays hit what they hit in the reference, and return the hits."""
    scene = scene_of(model)
    hits, twin = scene.intersect(origins, directions), intersect_scattered(model, origins, directions)
    sure = ~twin.doubtful
    assert 0.1 < np.isfinite(twin.t).mean()
    assert sure.mean() > 0.8
    assert (hits.point == twin.row)[sure].all()
    both = sure & np.isfinite(twin.t)
    assert np.abs(hits.t[both] - twin.t[both]).max() < 1e-5
    assert (scene.occluded(origins, directions) == np.isfinite(hits.t)).all()
    return hits


@pytest.mark.filterwarnings("ignore:.* of neighbouring normals face opposite sides")
@pytest.mark.parametrize("scatter", ["spheres", "discs"])
def test_rays_meet_what_the_twin_meets(rng, scatter):
    model = model_of(crown(rng), scatter=scatter, normals=unit(rng.normal(size=(1500, 3))))
    assert check_tree(model.tree) == [] and check_indices(model.tree, 1500) == []
    hits = check_scattered(model, *rays_at(rng, 1500))
    there = np.isfinite(hits.t)
    normals = hits.normal[there]
    if scatter == "spheres":
        exact = unit(hits.position[there] - model.points.positions[hits.point[there]])
    else:
        exact = model.points.normals[hits.point[there]]
    assert np.abs(normals - exact).max() < 1e-3


def test_points_off_any_surface_are_spheres_unless_radii_are_given(rng):
    cloud = np.concatenate([pr.procedural("sphere", 3000).positions, crown(rng) + [4, 0, 0]])
    model = pr.Model(cloud)
    assert model.drawing.scatter == "spheres"
    assert not model.scattered[:3000].any() and model.scattered[3000:].mean() > 0.9
    given = pr.Model(cloud, np.full(len(cloud), 0.05))
    assert given.drawing.scatter == "surface" and not given.scattered.any()
    assert pr.Model(cloud, np.full(len(cloud), 0.05), scatter="spheres").scattered[3000:].mean() > 0.9


def check_both(model, origins, directions):
    """Check that rays hit the surface or the scattered point that the references hit first."""
    hits = scene_of(model).intersect(origins, directions)
    surface, met = walk(model, origins, directions), intersect_scattered(model, origins, directions)
    t = np.minimum(surface.t, met.t)
    spacing = np.median(model.radii)
    close = np.abs(np.minimum(surface.t, 1e3) - np.minimum(met.t, 1e3)) < 0.05 * spacing
    close &= np.isfinite(t)
    sure = ~(surface.doubtful | met.doubtful | close)
    assert sure.mean() > 0.8
    assert (np.isfinite(t) == np.isfinite(hits.t))[sure].all()
    both = sure & np.isfinite(t)
    scattered = met.t < surface.t
    assert scattered[both].mean() > 0.1 and (~scattered[both]).mean() > 0.1
    assert (model.scattered[hits.point] == scattered)[both].all()
    assert (hits.point == met.row)[both & scattered].all()
    one, other = both & scattered, both & ~scattered
    assert np.abs(hits.t[one] - t[one]).max() < 1e-5
    assert (np.abs(hits.t[other] - t[other]) / surface.radius[other]).max() < 0.02


def test_surface_and_spheres_together(rng):
    model = tree_on_ground(rng)
    assert check_tree(model.tree) == [] and check_indices(model.tree, len(model.points)) == []
    origins, directions = rays_at(rng, 300)
    check_both(model, origins + [0, 0, 0.7], directions)


@pytest.mark.long
def test_many_rays_at_surface_and_spheres(rng):
    """120,000 rays, in parts for which the reference has enough memory."""
    model = tree_on_ground(rng, n=3000)
    for _ in range(4):
        origins, directions = rays_at(rng, 15_000)
        check_both(model, origins + [0, 0, 0.7], directions)


@pytest.mark.parametrize("scatter", ["spheres", long("discs")])
def test_occlusion_and_limits_agree_with_the_closest_hit(rng, scatter):
    scene = scene_of(tree_on_ground(rng, scatter))
    origins, directions = rays_at(rng, 2000)
    origins[:500] += directions[:500] * 5  # they start between the points
    hits = scene.intersect(origins, directions)
    assert (scene.occluded(origins, directions) == np.isfinite(hits.t)).all()
    some = np.isfinite(hits.t)
    t, o, d = hits.t[some].astype(np.float64), origins[some], directions[some]
    gap = 1e-5 * (1 + t)
    assert scene.occluded(o, d, 0, t + gap).all() and not scene.occluded(o, d, 0, t - gap).any()
    again = scene.intersect(o, d, 0, t + gap)
    assert (again.t == hits.t[some]).all() and (again.point == hits.point[some]).all()


def test_alone_or_in_a_tile_the_hits_are_the_same(rng):
    scene = scene_of(tree_on_ground(rng))
    origins, directions = (a[2000:] for a in rays_at(rng, 2000))
    together = scene.intersect(origins, directions)
    mixed = rng.permutation(len(origins))
    apart = scene.intersect(origins[mixed], directions[mixed])
    assert (together.point[mixed] == apart.point).all()
    both = np.isfinite(apart.t)
    np.testing.assert_allclose(together.t[mixed][both], apart.t[both], rtol=1e-5)


def test_instances_are_moved_and_scaled_spheres(rng):
    model = model_of(crown(rng, 500))
    transform = np.diag([2.0, 0.5, 1.0, 1.0])
    transform[:3, 3] = 3, 1, -2
    scene = scene_of(model, transform)
    scene.add(model)
    origins, directions = rays_at(rng, 400)
    ends = origins * np.diag(transform)[:3] + transform[:3, 3]
    hits = scene.intersect(ends, directions * np.diag(transform)[:3])
    plain = scene_of(model).intersect(origins, directions)
    first = hits.instance == 0
    assert first.sum() > 100
    np.testing.assert_allclose(hits.t[first], plain.t[first], rtol=1e-5)
    assert (hits.point == plain.point)[first].all()
    exact = unit(plain.normal[first] / np.diag(transform)[:3])
    np.testing.assert_allclose(hits.normal[first], exact, atol=1e-4)


def test_a_ray_that_starts_inside_a_sphere_hits_its_far_side():
    model = model_of(np.zeros((1, 3)), radii=np.ones(1))
    scene = scene_of(model)
    hits = scene.intersect([[0, 0, 0], [0, 0, 0.5], [0, 0, -3], [0, 0, 3]], UP)
    np.testing.assert_allclose(hits.t, [1, 0.5, 2, np.inf], rtol=1e-6)
    np.testing.assert_allclose(hits.normal[:3], [UP, UP, -UP], atol=1e-6)


def test_a_ray_that_starts_on_a_sphere_does_not_meet_it(rng):
    model = model_of(crown(rng, 800))
    scene = scene_of(model)
    hits = scene.intersect(*rays_at(rng, 2000))
    some = np.isfinite(hits.t)
    x, rows = hits.position[some], hits.point[some]
    for _ in range(3):
        second = scene.intersect(x, unit(rng.normal(size=x.shape)))
        assert not (second.point == rows).any()


def test_a_clipped_sphere_shows_its_inside():
    model = model_of(np.zeros((1, 3)), radii=np.ones(1))
    scene = scene_of(model)
    scene.clips = [((0, 0, 0), (0, 0, 1))]
    hits = scene.intersect([0, 0, 3], -UP)
    assert hits.t == pytest.approx(4, rel=1e-6)


def test_spheres_have_the_colours_and_attributes_of_their_points(rng):
    n = 300
    colors, level = rng.integers(0, 256, (n, 3)).astype(np.uint8), np.arange(n, dtype=np.float32)
    model = model_of(crown(rng, n), colors=colors, attributes={"level": level})
    hits = scene_of(model).intersect(*rays_at(rng, 500), attributes=["level"])
    some = np.isfinite(hits.t)
    assert (hits.attributes["level"][some] == level[hits.point[some]]).all()
    linear = colors[hits.point[some]] / 255.0
    linear = np.where(linear <= 0.04045, linear / 12.92, ((linear + 0.055) / 1.055) ** 2.4)
    np.testing.assert_allclose(hits.color[some], linear, atol=1e-5)


@pytest.mark.parametrize("count", [1, 2, 3, 9])
def test_few_spheres_are_hit(count):
    positions = np.arange(count)[:, None] * np.array([[1.0, 0, 0]])
    model = model_of(positions, radii=np.full(count, 0.25))
    hits = scene_of(model).intersect(positions + [0, 0, 2], -UP)
    np.testing.assert_allclose(hits.t, 1.75, rtol=1e-6)
    assert (hits.point == np.arange(count)).all()
    assert model.scattered.all()


def test_two_points_have_their_distance_as_radii():
    model = model_of(np.array([[0.0, 0, 0], [1, 0, 0]]))
    np.testing.assert_allclose(model.radii, 0.35, rtol=1e-6)


def test_one_point_needs_a_radius():
    with pytest.raises(ValueError, match="radii"):
        model_of(np.zeros((1, 3)))


def test_a_million_points_at_one_place_make_a_model():
    positions = np.zeros((1_000_000, 3), np.float32)
    with pytest.raises(ValueError, match="radii"):
        model_of(positions)
    model = model_of(positions, radii=np.ones(len(positions)))
    assert check_indices(model.tree, len(positions)) == []
    hits = scene_of(model).intersect([[0, 0, 3], [0, 3, 0]], [-UP, [0, -1, 0]])
    np.testing.assert_allclose(hits.t, 2, rtol=1e-6)
    assert hits.point[0] == hits.point[1]


def test_radii_follow_the_spacing_and_its_neighbours(rng):
    positions = np.concatenate([crown(rng, 2000), [[30.0, 0, 0], [0.0, 0, 0], [1e-5, 0, 0]]])
    model = model_of(positions)
    spacing = (8 / 2000) ** (1 / 3)
    assert 0.2 * spacing < np.median(model.radii) < 0.4 * spacing
    assert model.radii[2000] < 3 * spacing  # far from all others
    assert model.radii[2001:].min() > 0.1 * spacing  # two points nearly at one place
    larger = model_of(positions, scatter_size=2.0)
    np.testing.assert_allclose(larger.radii, 2 * model.radii, rtol=1e-6)


def test_a_few_points_far_off_are_no_balloons(rng):
    """Their spacing is either that between them or the distance to the others."""
    positions = np.concatenate([crown(rng), rng.uniform(-1, 1, (12, 3)) * 20 + [100, 0, 0]])
    radii = model_of(positions).radii
    assert radii[-12:].max() <= 1.005 * np.quantile(radii, 0.98) < 0.1  # to 8 bits


def test_points_that_are_left_out_are_not_hit(rng):
    positions = crown(rng, 400) + [0, 0, 3]
    ground = np.column_stack([rng.uniform(-2, 2, (2000, 2)), np.zeros(2000)])
    mask = np.arange(2400) >= 2000
    model = model_of(np.concatenate([ground, positions]), mask, "none", smooth=0.0)
    hits = scene_of(model).intersect(positions + [0, 0, 5], -UP)
    assert (hits.point < 2000).all() and not model.scattered.any()


def test_something_must_be_left(rng):
    with pytest.raises(ValueError, match="scatter: all points are scattered"):
        model_of(crown(rng), scatter="none")


def test_as_surface_nothing_changes(rng):
    points = pr.procedural("torus", 2000)
    mask = rng.random(2000) < 0.3
    plain, same = pr.Model(points), pr.Model(points, scatter="surface", _scattered=mask)
    unclassified = pr.Model(points, scatter="spheres", _scattered=np.zeros(2000, np.bool_))
    for model in (same, unclassified):
        assert all(np.array_equal(a, b, equal_nan=True) for a, b in zip(plain.tree, model.tree, strict=True))


@pytest.mark.parametrize("scatter", ["spheres", "discs"])
def test_saved_models_are_the_same(rng, tmp_path, scatter):
    model = tree_on_ground(rng, scatter)
    model.save(tmp_path / "a.pointray")
    loaded = pr.Model.load(tmp_path / "a.pointray")
    copy = pickle.loads(pickle.dumps(model))
    rays = rays_at(rng, 1000)
    hits = scene_of(model).intersect(*rays)
    for other in (loaded, copy):
        assert (other.scattered == model.scattered).all() and other.drawing == model.drawing
        found = scene_of(other).intersect(*rays)
        assert (found.t == hits.t).all() and (found.point == hits.point).all()
    again = loaded.rebuild(0.0, surface="imls")
    assert (again.scattered == model.scattered).all()
    np.testing.assert_allclose(again.radii[model.scattered], model.radii[model.scattered])


def test_damaged_leaves_of_spheres_are_noticed(rng):
    model = model_of(crown(rng, 500))
    at = np.flatnonzero((model.tree.children < 0) & (model.tree.children != NO_CHILD))[3]
    for leaf in (SCATTERED + model.tree.blocks.size // 28, SCATTERED - 1):
        children = model.tree.children.copy()
        children[at] = ~leaf
        assert check_indices(model.tree._replace(children=children), 500)
    head = model.tree.head.copy()
    head[11] = 7
    assert check_indices(model.tree._replace(head=head), 500)
    boxes = model.tree.boxes * np.float32(0.5)
    assert check_tree(model.tree._replace(boxes=boxes))


@pytest.mark.parametrize("size", [0, -1, np.nan, np.inf, "large", True])
def test_scatter_size_must_be_positive(size):
    with pytest.raises(ValueError, match="scatter_size"):
        pr.Model(crown(np.random.default_rng(0), 10), scatter="spheres", scatter_size=size)


def test_the_scatter_option_and_mask_are_validated():
    points = crown(np.random.default_rng(0), 10)
    with pytest.raises(ValueError, match="scatter"):
        pr.Model(points, scatter="balls")
    for mask in (np.ones(9, np.bool_), np.ones(10)):
        with pytest.raises(ValueError, match="scattered"):
            pr.Model(points, scatter="spheres", _scattered=mask)


def test_the_scattered_points_are_read_back(rng):
    model = tree_on_ground(rng)
    found = scattered_of(model.tree, model.radii)
    assert np.isin(found.rows, np.flatnonzero(model.scattered)).all() and len(found.rows) == model.scattered.sum()
    np.testing.assert_allclose(found.positions, model.points.positions[found.rows])
    assert first_scattered(model.tree) > 0


@pytest.mark.parametrize("scatter", ["spheres", long("discs")])
def test_levels_hide_as_much_as_all_points(rng, tmp_path, scatter):
    positions = crown(rng, 20_000)
    model = model_of(positions, scatter=scatter, colors=np.full((20_000, 3), 90, np.uint8))
    model.make_levels()
    assert len(model.levels) >= 1
    origins, directions = rays_at(rng, 3000)
    seen = scene_of(model).occluded(origins, directions).mean()
    for level in model.levels:
        assert level.scattered.all() and check_tree(level.tree) == []
        assert scene_of(level).occluded(origins, directions).mean() == pytest.approx(seen, abs=0.08)
    model.save(tmp_path / "a.pointray")
    loaded = pr.Model.load(tmp_path / "a.pointray")
    assert [level.spacing for level in loaded.levels] == [level.spacing for level in model.levels]
    spacings = [model.spacing, *(level.spacing for level in model.levels)]
    np.testing.assert_allclose(np.diff(np.log2(spacings)), 1, atol=0.01)


def test_levels_of_surface_and_spheres(rng):
    model = tree_on_ground(rng, n=20_000)
    model.make_levels()
    for level in model.levels:
        assert 0.02 < level.scattered.mean() < 0.9 or level is model.levels[-1]
        assert check_indices(level.tree, len(level.points)) == []
    assert model.levels[-1].scattered.all() and 50 <= len(model.levels[-1].points) < 700


def plate():
    """Points on both sides of a thin plate of 2 x 2, 10,000 a side, in random order."""
    x, y = (a.ravel() for a in np.meshgrid(*[np.linspace(-1, 1, 100)] * 2))
    body = np.concatenate([np.column_stack([x, y, np.full(len(x), z)]) for z in (-0.02, 0.02)]).astype(np.float32)
    normals = np.repeat(np.float32([[0, 0, -1], [0, 0, 1]]), len(x), axis=0)
    return pr.Points(body, normals)


@pytest.mark.parametrize("points", [plate(), pr.procedural("sphere", 20_000)], ids=["plate", "ball"])
def test_the_last_level_of_a_surface_hides_most_of_what_the_model_hides(points):
    """Seen along the axes: spheres leave few holes, and hardly widen the outline."""
    model = pr.Model(points)
    model.make_levels()
    level, size = model.levels[-1], (96, 96)
    assert level.scattered.all() and level.spacing == pytest.approx(1.4 * model.levels[-2].spacing, rel=0.01)
    seen = []
    for shown in (model, level):
        scene = scene_of(shown)
        cameras = [pr.Camera.frame(model.bounds, side, fov=3, size=size) for side in ((0.01, 0, 1), (0.01, 0, -1))]
        seen.append(np.array([np.isfinite(scene.intersect(*camera.rays()).t) for camera in cameras]))
    whole, spheres = seen
    assert whole.mean() > 0.4
    assert (spheres & whole).sum() > 0.8 * whole.sum() and (spheres & ~whole).sum() < 0.2 * whole.sum()


def test_spheres_cover_nine_tenths_of_a_square():
    """Centres on a grid of width 1: discs of radius 0.557 cover nine tenths of it (by quadrature)."""
    rng = np.random.default_rng(5)
    square = np.column_stack([*rng.uniform(0, 20, (2, 100_000)), np.zeros(100_000)]).astype(np.float32)
    grid = np.stack(np.meshgrid(np.arange(20) + 0.5, np.arange(20) + 0.5, [0.0]), axis=-1).reshape(-1, 3)
    radius = covering_radius(square, grid.astype(np.float32), 0.2)
    assert radius == pytest.approx(0.557, abs=0.01)


@pytest.mark.parametrize("scatter", ["spheres", "discs"])
def test_shapes_of_some_points_are_those_of_all(rng, scatter):
    """The statistics are those of a sample of the whole cloud."""
    points = pr.Points(np.concatenate([crown(rng, 3000), crown(rng, 100) * 9]))
    along, drawing, mask = compute_kd_ordering(points), Drawing(scatter), rng.random(3100) < 0.02
    first = CloudStatistics(np.arange(500, 900))
    wanted = shapes_of(points, along, drawing, None, first)
    for statistics in (CloudStatistics(np.arange(500, 900)), CloudStatistics(None, first.known, is_complete=True)):
        found = shapes_of(points, along, drawing, None, statistics, mask)
        for one, other in zip(wanted, found, strict=True):
            assert np.array_equal(one[mask], other[mask]) and not np.array_equal(one, other)
