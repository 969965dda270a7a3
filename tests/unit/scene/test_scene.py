"""Scenes: shapes of batches, the meaning of hits, transforms, lights, threads, and bad input."""

import threading

import numpy as np
import pytest

import pointray as pr
from pointray.engine import jit


@pytest.fixture(scope="module")
def model():
    return pr.Model(pr.procedural("sphere", 20_000))


@pytest.fixture(scope="module")
def scene(model):
    scene = pr.Scene()
    scene.add(model)
    return scene


def matrix(linear, shift=(0, 0, 0)):
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = linear, shift
    return out


TURN = np.linalg.qr(np.random.default_rng(7).normal(size=(3, 3)))[0]
TRANSFORMS = {
    "rigid": matrix(TURN * np.sign(np.linalg.det(TURN)), (5, 1, -2)),
    "scaled": matrix(np.diag([3, 3, 3])),
    "mirrored": matrix(np.diag([-1, 1, 1]), (1, 0, 0)),
    "sheared": matrix([[1, 0.5, 0], [0, 1.3, 0.2], [0, 0, 0.7]], (0, 0, 3)),
}


@pytest.mark.parametrize("name", TRANSFORMS)
def test_transforms_and_their_normals(model, name):
    transform = TRANSFORMS[name]
    scene = pr.Scene()
    number = scene.add(model, transform)
    camera = pr.Camera.frame(scene.bounds, size=(60, 60))
    hits = scene.intersect(*camera.rays())
    hit = np.isfinite(hits.t)
    assert hit.mean() > 0.15 and (hits.instance[hit] == number).all()
    local = (hits.position[hit] - transform[:3, 3]) @ np.linalg.inv(transform[:3, :3]).T
    assert np.abs(np.linalg.norm(local, axis=1) - 1).max() < 1e-3
    normal = local @ np.linalg.inv(transform[:3, :3])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    assert (normal * hits.normal[hit]).sum(axis=1).min() > 0.999


def test_instances_can_be_moved_and_removed(model):
    scene = pr.Scene()
    a, b = scene.add(model), scene.add(model, matrix(np.eye(3), (5, 0, 0)))
    rays = [[0, -9, 0], [5, -9, 0]], [0, 1, 0]
    assert scene.intersect(*rays).instance.tolist() == [a, b]
    scene.update(b, transform=matrix(np.eye(3), (0, -4, 0)))
    assert scene.intersect(*rays).instance.tolist() == [b, -1]
    scene.remove(b)
    assert scene.intersect(*rays).instance.tolist() == [a, -1]
    with pytest.raises(ValueError, match="no instance"):
        scene.remove(b)


@pytest.mark.parametrize("shape", [(), (1,), (0,), (7,), (3, 4), (2, 3, 4)])
def test_hits_have_the_shape_of_the_rays(scene, shape):
    hits = scene.intersect(np.broadcast_to([0.0, -4, 0], (*shape, 3)), [0, 1, 0])
    assert hits.t.shape == hits.point.shape == hits.instance.shape == shape
    assert hits.position.shape == hits.normal.shape == hits.color.shape == (*shape, 3)
    assert scene.occluded([0, -4, 0], np.broadcast_to([0.0, 1, 0], (*shape, 3))).shape == shape
    assert (hits.normal.dtype, hits.color.dtype, hits.point.dtype) == (np.float32, np.float32, np.int64)


@pytest.mark.parametrize("shape", [(37, 53), (5, 70), (64, 33)])
def test_a_picture_of_rays_hits_what_a_row_of_them_hits(scene, shape):
    """Arrays with two axes are traced in squares along a curve, but each ray's result keeps its position."""
    origins, directions = pr.Camera.look_at((0.3, -4, 0.2), (0, 0, 0), size=shape[::-1]).rays()
    square, row = (
        scene.intersect(origins, directions),
        scene.intersect(origins.reshape(-1, 3), directions.reshape(-1, 3)),
    )
    hit = np.isfinite(row.t)
    assert 0.01 < hit.mean() < 0.99
    for name in ("t", "position", "normal", "color", "instance"):
        want = getattr(row, name)
        assert np.allclose(getattr(square, name).reshape(want.shape), want, atol=1e-4, equal_nan=True), name
    assert (square.point.reshape(-1) == row.point).mean() > 0.99  # two points may have equal weights
    blocked = scene.occluded(origins, directions)
    assert blocked.shape == shape and np.array_equal(blocked.reshape(-1), hit)


def test_t_min_and_t_max_limit_hits_and_broadcast(scene):
    t_max = np.array([2.0, 2.99, 3.01, 9.0])
    assert scene.occluded([0, -4, 0], [0, 1, 0], t_max=t_max).tolist() == [False, False, True, True]
    hits = scene.intersect([0, -4, 0], [0, 2, 0], t_min=[0.0, 2.0])
    assert hits.t == pytest.approx([1.5, 2.5], abs=1e-3)


def test_every_kind_of_array_compiles_one_kernel(scene, tmp_path):
    origins, directions = pr.Camera.look_at((0, -4, 0), (0, 0, 0), size=(8, 8)).rays()
    want = scene.intersect(origins, directions).t
    frozen = origins.copy()
    frozen.flags.writeable = False
    mapped = np.memmap(tmp_path / "rays", np.float64, "w+", shape=directions.shape)
    mapped[:] = directions
    for o, d in (
        (frozen, directions),
        (origins, mapped),
        (origins.astype(np.float32), directions.astype(np.float32)),
        (np.asfortranarray(origins), np.repeat(directions, 2, axis=0)[::2]),
        (origins.astype(">f8"), directions),
    ):
        assert np.array_equal(np.isfinite(scene.intersect(o, d).t), np.isfinite(want))
        scene.occluded(o, d)
    frozen_points = np.array(pr.procedural("sphere", 1000).positions)
    frozen_points.flags.writeable = False
    pr.Model(pr.Points(frozen_points, frozen_points))
    pr.Model(pr.Points(np.repeat(frozen_points, 2, axis=0)[::2], frozen_points))
    many = {name: len(k.signatures) for name, k in jit.KERNELS.items() if len(k.signatures) > 1}
    assert not many


def test_point_is_the_callers_row(rng):
    points = pr.procedural("sphere", 5000)
    order = rng.permutation(5000)
    x = points.positions[order].astype(float)
    x[::10] = np.nan
    with pytest.warns(UserWarning, match="500 of 5,000"):
        model = pr.Model(pr.Points(x, points.normals[order]))
    scene = pr.Scene()
    scene.add(model)
    hits = scene.intersect(*pr.Camera.look_at((0, -4, 0), (0, 0, 0), size=(50, 50)).rays())
    hit = hits.point >= 0
    away = np.linalg.norm(x[hits.point[hit]] - hits.position[hit], axis=1)
    assert away.max() < model.radii.max()
    assert np.median(away) < 0.6 * np.median(model.radii)


def test_colors_and_attributes_are_blended():
    points = pr.procedural("sphere", 20_000)
    x = points.positions
    grey = np.repeat(np.rint(255 * (0.5 + 0.5 * x[:, 2:])).astype(np.uint8), 3, axis=1)
    cloud = pr.Points(x, points.normals, grey, {"height": x[:, 2], "place": x})
    scene = pr.Scene()
    scene.add(pr.Model(cloud))
    hits = scene.intersect(
        *pr.Camera.look_at((0, -4, 0), (0, 0, 0), size=(50, 50)).rays(), attributes=["height", "place"]
    )
    hit = hits.point >= 0
    assert np.abs(hits.attributes["height"][hit] - hits.position[hit][:, 2]).max() < 0.01
    assert np.abs(hits.attributes["place"][hit] - hits.position[hit]).max() < 0.02
    assert np.isnan(hits.attributes["height"][~hit]).all()
    srgb = 0.5 + 0.5 * hits.position[hit][:, 2]
    assert (
        np.abs(hits.color[hit][:, 0] - np.where(srgb > 0.04, ((srgb + 0.055) / 1.055) ** 2.4, srgb / 12.92)).max()
        < 0.02
    )
    with pytest.raises(ValueError, match="height, place"):
        scene.intersect([0, -4, 0], [0, 1, 0], attributes=["width"])


def test_one_ray_and_one_name_of_an_attribute():
    points = pr.procedural("sphere", 5_000)
    x = points.positions
    scene = pr.Scene()
    scene.add(pr.Model(pr.Points(x, points.normals, attributes={"intensity": x[:, 2], "place": x})))
    ray = [0.0, -4.0, 0.5], [0.0, 1.0, 0.0]
    hit = scene.intersect(*ray, attributes=["intensity", "place"])
    assert hit.attributes["intensity"].shape == () and hit.attributes["place"].shape == (3,)
    assert abs(hit.attributes["intensity"] - 0.5) < 0.02 and np.abs(hit.attributes["place"] - hit.position).max() < 0.03
    # A single name is not split into letters.
    assert scene.intersect(*ray, attributes="intensity").attributes == {"intensity": hit.attributes["intensity"]}
    assert np.isnan(scene.intersect([0, -4, 9], [0, 1, 0], attributes="intensity").attributes["intensity"])
    with pytest.raises(ValueError, match="no model has an attribute 'width'"):
        scene.intersect(*ray, attributes="width")


def test_unlit_colors_are_exact_to_one_level(tmp_path):
    points = pr.procedural("sphere", 5000)
    color = np.tile(np.array([[200, 3, 77]], np.uint8), (5000, 1))
    scene = pr.Scene()
    scene.add(pr.Model(pr.Points(points.positions, points.normals, color)))
    image = pr.render(scene, pr.Camera.look_at((0, -3, 0), (0, 0, 0), fov=20, size=(16, 16)), pr.Settings("color"))
    pr.write_image(tmp_path / "c.png", image)
    from PIL import Image

    got = np.asarray(Image.open(tmp_path / "c.png"))[..., :3].astype(int)
    assert np.abs(got - color[0]).max() <= 1


def test_a_point_light_over_a_diffuse_plane():
    scene = pr.Scene()
    scene.add(pr.Plane((0, 0, 0), (0, 0, 1), color=0.6))
    scene.add_light(pr.PointLight((0.5, 0, 2), 10))
    camera = pr.Camera.look_at((0, -3, 3), (0, 0, 0), size=(20, 20))
    image = pr.render(scene, camera)
    x = scene.intersect(*camera.rays()).position
    v = np.array([0.5, 0, 2]) - x
    square = (v * v).sum(-1)
    want = 0.6 / np.pi * 10 / square * v[..., 2] / np.sqrt(square)
    assert np.allclose(image[..., 0], want, rtol=1e-5)
    assert (image[..., 3] == 1).all()


def test_shadow_of_a_sphere_on_a_plane(model):
    scene = pr.Scene()
    scene.add(model)
    scene.add(pr.Plane((0, 0, -1), (0, 0, 1), checker=0.5))
    scene.add_light(pr.SunLight((0, 0, -1), 2))
    camera = pr.Camera.look_at((0, -6, 4), (0, 0, -1), size=(80, 80))
    hits = scene.intersect(*camera.rays())
    ground = hits.point < 0
    distance = np.linalg.norm(hits.position[..., :2], axis=-1)
    image = pr.render(scene, camera)[..., 0]
    assert (image[ground & (distance < 0.97)] == 0).all() and (ground & (distance < 0.97)).sum() > 10
    assert (image[ground & (distance > 1.03) & np.isfinite(distance)] > 0).all()
    assert (image[~ground & (hits.normal[..., 2] > 0.02)] > 0).all()  # no acne


def test_background_and_alpha(model):
    camera = pr.Camera.look_at((0, -4, 0), (0, 0, 0), fov=60, size=(40, 40))
    scene = pr.Scene()
    scene.add(model)
    scene.background = None
    image = pr.render(scene, camera, pr.Settings(spp=4))
    assert image[0, 0].tolist() == [0, 0, 0, 0] and image[20, 20, 3] == 1
    assert ((image[..., 3] > 0) & (image[..., 3] < 1)).any()
    scene.background = (0.2, 0.4, 0.6)
    image = pr.render(scene, camera)
    assert image[0, 0] == pytest.approx([0.2, 0.4, 0.6, 1])


def test_debug_views_show_normal_depth_and_cost(scene):
    camera = pr.Camera.look_at((0, -4, 0), (0, 0, 0), size=(31, 31))
    assert pr.render(scene, camera, pr.Settings("normal"))[15, 15, :3] == pytest.approx([0.5, 0, 0.5], abs=0.02)
    assert pr.render(scene, camera, pr.Settings("depth"))[15, 15, 0] == pytest.approx(3, abs=1e-3)
    assert pr.render(scene, camera, pr.Settings("cost"))[15, 15, 1] >= 1


def test_the_picture_does_not_depend_on_threads(scene):
    camera = pr.Camera.look_at((0, -4, 1), (0, 0, 0), size=(70, 50))
    one, two, five = (pr.render(scene, camera, pr.Settings(spp=2, threads=n)) for n in (1, 2, 5))
    assert np.array_equal(one, two) and np.array_equal(one, five)


def test_several_python_threads_at_once(scene):
    origins, directions = pr.Camera.look_at((0, -4, 1), (0, 0, 0), size=(100, 100)).rays()
    want = scene.intersect(origins, directions).t
    got = [None] * 6

    def work(k):
        got[k] = scene.intersect(origins, directions).t

    threads = [threading.Thread(target=work, args=(k,)) for k in range(6)]
    for t in threads:
        t.start()
    for t in threads:
        t.join()
    assert all(np.array_equal(g, want) for g in got)


def test_an_empty_scene():
    scene = pr.Scene()
    assert np.isinf(scene.intersect([0, 0, 0], [0, 1, 0]).t)
    assert not scene.occluded([0, 0, 0], [0, 1, 0])
    with pytest.raises(ValueError, match="no model"):
        _ = scene.bounds


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda s, m: s.intersect([0, 0], [0, 1, 0]), "origins"),
        (lambda s, m: s.intersect([0, 0, 0], "up"), "directions"),
        (lambda s, m: s.intersect(np.zeros((3, 3)), np.zeros((4, 3))), "broadcast"),
        (lambda s, m: s.intersect([0, 0, 1j], [0, 1, 0]), "real numbers"),
        (lambda s, m: s.add(m, np.zeros((4, 4))), "last row|singular"),
        (lambda s, m: s.add(m, matrix(np.diag([1, 1, 0]))), "singular"),
        (lambda s, m: s.add(m, np.eye(3)), "4, 4"),
        (lambda s, m: s.add("statue"), "a Model or a Plane"),
        (lambda s, m: s.add(m, material="wood"), "material"),
        (lambda s, m: s.add_light("sun"), "light"),
        (lambda s, m: s.add_light(pr.SunLight((0, 0, 0))), "zero"),
        (lambda s, m: s.add_light(pr.PointLight((0, 0, 0), -1)), "negative"),
        (lambda s, m: pr.Plane((0, 0, 0), (0, 0, 0)), "normal"),
        (lambda s, m: pr.Settings("magic"), "integrator"),
        (lambda s, m: pr.Settings(spp=0), "spp"),
        (lambda s, m: pr.Model(m.points, surface="flat"), "surface"),
        (lambda s, m: pr.Model(m.points, samples=1), "samples"),
        (lambda s, m: pr.Model(m.points, trim=-1), "trim"),
        (lambda s, m: pr.Model(m.points, radius_scale=0), "radius_scale"),
        (lambda s, m: pr.Model(m.points, radii=np.zeros(20_000)), "radi"),
        (lambda s, m: pr.Model(m.points, radii=np.ones(3)), "radi"),
        (lambda s, m: pr.Model(pr.Points([[0, 0, 0]], [[0, 0, 1]])), "radi"),
        (lambda s, m: pr.Model(pr.Points(np.zeros((1000, 3)), np.ones((1000, 3)))), "radi|place"),
    ],
)
def test_a_scene_refuses_bad_input(model, call, says):
    with pytest.raises(ValueError, match=says):
        call(pr.Scene(), model)


def test_one_point_with_a_radius_is_a_disc():
    scene = pr.Scene()
    scene.add(pr.Model(pr.Points([[0, 0, 0]], [[0, -1, 0]]), [1.0], surface="disc"))
    hits = scene.intersect([[0, -3, 0.9], [0, -3, 1.1]], [0, 1, 0])
    assert hits.t == pytest.approx([3, np.inf]) and hits.point.tolist() == [0, -1]


def in_shadow(scene, sun, camera):
    """The camera's hits, (m, 3), and whether each that faces the sun is dark."""
    scene.lights = [pr.SunLight(-np.asarray(sun))]
    hits = scene.intersect(*camera.rays())
    lit, dark = (pr.render(scene, camera, pr.Settings(shadows=shadows))[..., 0] for shadows in (False, True))
    seen = (hits.instance >= 0) & (lit > 0)
    return hits.position[seen], dark[seen] == 0


def test_overlapping_discs_cast_no_shadow_on_each_other():
    """The lit half of a sphere has no shadows, except under a disc that hovers above."""
    points, radius = pr.procedural("sphere", 5_000), 0.12
    scene, sun = pr.Scene(), np.array([0.6, -0.48, 0.64])
    scene.add(pr.Model(points, surface="disc"))
    scene.add(pr.Model(pr.Points([1.1 * sun], [sun]), [radius], surface="disc"))
    camera = pr.Camera.look_at((0, -4, 0), (0, 0, 0), size=(300, 300))
    hit_points, shadow = in_shadow(scene, sun, camera)
    on_ball = np.abs(np.linalg.norm(hit_points, axis=1) - 1) < 0.02
    height, aside = hit_points @ sun, np.linalg.norm(hit_points - (hit_points @ sun)[:, None] * sun, axis=1)
    lit = on_ball & (height > 0.05) & (aside > 1.1 * radius)
    assert lit.sum() > 10_000 and shadow[lit].mean() < 0.002
    assert shadow[on_ball & (height > 0) & (aside < 0.9 * radius)].mean() > 0.99


def test_discs_of_another_sheet_cast_shadows():
    """The sheets are of one model, and as close as half a radius."""
    grid = np.stack(np.meshgrid(np.arange(20.0), np.arange(20.0)), axis=-1).reshape(-1, 2)
    floor, above = np.insert(grid, 2, 0.0, axis=1), np.insert(grid[grid[:, 0] < 8], 2, 0.7, axis=1)
    positions = np.concatenate([floor, above])
    points = pr.Points(positions, np.tile([0.0, 0, 1], (len(positions), 1)))
    scene = pr.Scene()
    scene.add(pr.Model(points, np.full(len(positions), 1.4), surface="disc"))
    sun = (0.1, 0.2, 1.0)
    between = pr.Camera.look_at((-6, 9.6, 0.35), (4, 9.6, 0), fov=10, size=(200, 200))
    hit_points, shadow = in_shadow(scene, sun, between)
    inner = (np.abs(hit_points[:, 2]) < 0.01) & (hit_points[:, 0] > 1) & (hit_points[:, 0] < 6)
    assert inner.sum() > 500 and shadow[inner].all()
    hit_points, shadow = in_shadow(scene, sun, pr.Camera.look_at((26, 9.6, 4), (8, 9.6, 0), fov=20, size=(200, 200)))
    lit = (hit_points[:, 0] > 10) | (hit_points[:, 2] > 0.69)
    assert lit.sum() > 500 and not shadow[lit].any()


def test_nbytes_counts_all_arrays(model):
    assert 50 < model.nbytes / 20_000 < 300


def random_rays(rng, n):
    a, b = rng.uniform(-2.5, 2.5, (2, n, 3))
    return a, b - a


def test_occluded_is_where_intersect_hits(scene, rng):
    """This holds also with intervals and for directions of any length."""
    origins, directions = random_rays(rng, 50_000)
    t_min, t_max = np.sort(rng.uniform(0, 3, (2, len(origins))), axis=0)
    hits = scene.intersect(origins, directions, t_min, t_max)
    hit = np.isfinite(hits.t)
    assert np.array_equal(scene.occluded(origins, directions, t_min, t_max), hit)
    assert 0.05 < hit.mean() < 0.9
    assert ((hits.t >= np.float32(t_min)) & (hits.t <= np.float32(t_max)))[hit].all()
    where = origins + hits.t[:, None] * directions
    assert np.abs(where - hits.position)[hit].max() < 1e-6  # t is float32


def test_t_min_behind_a_hit_finds_the_next_one(scene):
    """A ray from behind the first hit finds the sphere's second hit, and then nothing."""
    origins, directions = pr.Camera.look_at((0, -4, 1), (0, 0, 0), fov=24, size=(60, 60)).rays()
    b = (origins * directions).sum(-1)
    root = np.sqrt(np.maximum(b * b - (origins * origins).sum(-1) + 1, 0))
    sure = root > 0.2
    first = scene.intersect(origins, directions).t
    second = scene.intersect(origins, directions, t_min=first + 0.1).t
    assert np.abs(first - (-b - root))[sure].max() < 1e-3
    assert np.abs(second - (-b + root))[sure].max() < 1e-3
    assert np.isinf(scene.intersect(origins, directions, t_min=second + 0.1).t[sure]).all()
    assert not scene.occluded(origins, directions, t_max=first - 1e-3)[sure].any()
    assert scene.occluded(origins, directions, t_max=first + 1e-3)[sure].all()


def test_the_length_of_a_direction_only_scales_t(scene, rng):
    origins, directions = random_rays(rng, 5000)
    t = scene.intersect(origins, directions).t
    for factor in (1e-6, 1e-3, 1e4):
        scaled = scene.intersect(origins, directions * factor).t * factor
        assert np.array_equal(np.isfinite(scaled), np.isfinite(t))
        hit = np.isfinite(t)
        assert np.abs(scaled[hit] - t[hit]).max() < 1e-5


def test_whole_numbers_and_lists_are_rays(scene):
    want = scene.intersect(np.array([0.0, -4.0, 0.0]), np.array([0.0, 1.0, 0.0])).t
    for kind in (np.int8, np.int64, np.uint16, np.float16, np.float32):
        assert scene.intersect(np.array([0, 4, 0], kind), np.array([0, 1, 0]) * -1.0).t == pytest.approx(want, abs=1e-3)
    assert scene.intersect([0, -4, 0], (0, 1, 0)).t == want


def test_two_models_are_as_the_nearer_of_each(model, rng):
    torus = pr.Model(pr.procedural("torus", 20_000))
    shift = matrix(np.diag([0.5, 0.5, 2.0]), (0.4, 0.3, 0.2))
    origins, directions = random_rays(rng, 20_000)
    both, alone = pr.Scene(), []
    for k, (shape, transform) in enumerate([(model, None), (torus, shift), (model, shift)]):
        assert both.add(shape, transform) == k
        alone.append(pr.Scene())
        alone[k].add(shape, transform)
    each = np.stack([s.intersect(origins, directions).t for s in alone])
    hits = both.intersect(origins, directions)
    nearest, found = each.min(axis=0), np.isfinite(hits.t)
    assert np.array_equal(found, np.isfinite(nearest))
    # Rays do not look behind a hit, so that their samples end elsewhere.
    assert np.abs(hits.t[found] - nearest[found]).max() < 1e-4
    assert (hits.instance == each.argmin(axis=0))[found].mean() > 0.999
    assert (hits.instance[~found] == -1).all()


@pytest.mark.parametrize("scale", [1e-6, 1e5])
def test_a_scaled_instance_is_as_a_scaled_cloud(model, scale, rng):
    """Nothing depends on the unit of length, except rounding."""
    one, other = pr.Scene(), pr.Scene()
    one.add(model, matrix(np.eye(3) * scale))
    points = model.points
    other.add(pr.Model(pr.Points(points.positions * scale, points.normals)))
    origins, directions = (a * scale for a in random_rays(rng, 20_000))
    a, b = one.intersect(origins, directions), other.intersect(origins, directions)
    assert (np.isfinite(a.t) != np.isfinite(b.t)).sum() <= 2
    hit = np.isfinite(a.t) & np.isfinite(b.t)
    assert np.quantile(np.abs(a.t[hit] - b.t[hit]), 0.999) < 1e-4
    assert np.quantile((a.normal[hit] * b.normal[hit]).sum(axis=1), 0.001) > 0.999


def test_a_mirrored_instance_lets_rays_leave_outside(model):
    """The start rule follows the normals, not the handedness of the transform."""
    for name in ("mirrored", "sheared"):
        scene = pr.Scene()
        scene.add(model, TRANSFORMS[name])
        hits = scene.intersect(*pr.Camera.frame(scene.bounds, size=(60, 60)).rays())
        hit = hits.point >= 0
        assert not scene.occluded(hits.position[hit], hits.normal[hit]).any()
        assert scene.occluded(hits.position[hit], -hits.normal[hit]).all()


def test_a_plane_and_its_checker(rng):
    scene = pr.Scene()
    number = scene.add(pr.Plane((0.5, 0, -1), (0, 0, 2), color=(0.8, 0.4, 0.2), checker=0.5))
    x, y = rng.uniform(-4, 4, (2, 4000))
    hits = scene.intersect(np.stack([x, y, np.full(4000, 2.0)], axis=1), [0, 0, -2])
    assert hits.t == pytest.approx(np.full(4000, 1.5)) and (hits.instance == number).all() and (hits.point == -1).all()
    assert (hits.normal == [0, 0, 1]).all()
    shade = hits.color[:, 0] / 0.8
    assert np.isin(np.rint(shade * 2), (1, 2)).all() and shade == pytest.approx(np.rint(shade * 2) / 2, abs=1e-6)
    # Both kinds of squares are equally frequent, and neighbours along an axis are of different kinds.
    assert 0.45 < (shade > 0.75).mean() < 0.55
    for step in ([0.5, 0, 0], [0, 0.5, 0]):
        moved = scene.intersect(np.stack([x, y, np.full(4000, 2.0)], axis=1) + step, [0, 0, -1]).color[:, 0] / 0.8
        assert ((moved > 0.75) != (shade > 0.75)).mean() > 0.999
    assert np.isinf(scene.intersect([0, 0, 2], [[0, 0, 1], [1, 0, 0]]).t).all()


def test_hits_of_a_miss(scene):
    hits = scene.intersect([0, -4, 0], [0, -1, 0])
    assert hits.t == np.inf and np.isnan(hits.position).all() and not hits.normal.any() and not hits.color.any()
    assert hits.point == -1 and hits.instance == -1


def test_shapes_and_models_are_identified_by_number() -> None:
    model, other = pr.Model(pr.procedural("sphere", 500)), pr.Model(pr.procedural("torus", 500))
    scene, plane = pr.Scene(), pr.Plane([0, 0, 0], [0, 0, 1])
    numbers = [scene.add(shape) for shape in (model, plane, other, model)]
    scene.remove(numbers[0])
    assert scene.shapes == {numbers[1]: plane, numbers[2]: other, numbers[3]: model}
    assert scene.models == [other, model]


def test_exchange_replaces_models() -> None:
    points = pr.procedural("sphere", 2_000)
    model, discs = pr.Model(points), pr.Model(points, surface="disc")
    scene = pr.Scene()
    scene.add(model)
    moved = scene.add(model, pr.transform((5, 0, 0)))
    other, expected = scene.exchange({model: discs}), pr.Scene()
    expected.add(discs)
    expected.add(discs, pr.transform((5, 0, 0)))
    origins, directions = (
        np.array([[-9.0, 0.1, 0.2], [9.0, 0.1, 0.2], [5.1, -3.0, 0.3]]),
        [[1, 0, 0], [-1, 0, 0], [0, 1, 0]],
    )
    assert np.array_equal(other.intersect(origins, directions).t, expected.intersect(origins, directions).t)
    assert scene.models == [model] and other.models == [discs] and moved in other.shapes
    assert not np.array_equal(other.intersect(origins, directions).t, scene.intersect(origins, directions).t)


def test_a_plane_reflects_at_most_all_light():
    """Otherwise repeatedly reflected light would overflow."""
    with pytest.raises(ValueError, match="color must be a reflectance from 0 to 1"):
        pr.Plane((0, 0, 0), (0, 0, 1), color=(0.5, 1.5, 0.5))
