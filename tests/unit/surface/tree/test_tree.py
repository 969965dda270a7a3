"""Trees are valid, the validator detects corruption, and hits do not depend on slabs, boxes or voxels."""

from functools import cache

import numpy as np
import pytest

import pointray as pr
from helpers.clouds import sphere_points, uneven_points
from helpers.marks import long, long_scan
from helpers.places import shared_model
from helpers.tree_check import check_tree
from pointray.cloud.neighbors import kd_order
from pointray.engine.kernels.tree import LEAF, LEAST, NO_SURFACE, STEP
from pointray.model.model import PrebuiltModel
from pointray.model.model_data import ModelData
from pointray.surface.splats.scattered.spheres import Drawing
from pointray.surface.tree.build import Splats, build_tree
from pointray.surface.tree.cells import MOST_LEAST
from pointray.surface.tree.settings import LEAF_WIDTH, TreeSettings, check_settings
from pointray.surface.tree.stored import stored_splats

COUNTS = {"torus": 10_000, "sphere": 40_000, "lattice": 40_000, "statue": 200_000}


def sweep(rings=24, columns=400):
    """Return points of a rotating scanner on the ground, a wall and its own mount, 1 cm to 60 m away."""
    rng = np.random.default_rng(7)
    up, around = (
        a.ravel() for a in np.meshgrid(np.radians(np.linspace(-30, 10, rings)), np.linspace(0, 6.28, columns))
    )
    d = np.column_stack([np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)])
    t = np.minimum(1.8 / np.maximum(-d[:, 2], 0.03), 12 / np.maximum(d[:, 0], 0.2))
    t = np.where((up < -0.25) & (np.sin(9 * around) > 0), 0.01 / -d[:, 2], t)
    return d * (t * (1 + 0.002 * rng.normal(size=len(t))))[:, None]


@cache
def splats(name):
    if name == "wide among narrow":
        x = (np.random.default_rng(1).random((2000, 3)) * [0.01, 0.01, 0]).astype(np.float32)
        radii = np.where(np.arange(2000) % 400, 0.001, 1).astype(np.float32)
        return Splats(x, np.tile(np.float32([0, 0, 1]), (2000, 1)), radii, np.arange(2000, dtype=np.int32), None)
    if name == "wide beside narrow":
        rng = np.random.default_rng(1)
        x = np.concatenate([rng.normal(size=(2000, 3)) * 1e-4, rng.uniform(-10, 10, (2000, 3))]) * [1, 1, 0]
        radii = np.repeat(np.float32([1e-5, 1]), 2000)
        return Splats(
            x.astype(np.float32),
            np.tile(np.float32([0, 0, 1]), (4000, 1)),
            radii,
            np.arange(4000, dtype=np.int32),
            None,
        )
    if name == "sweep":
        points = pr.estimate_normals(pr.Points(sweep()))
    elif name == "uneven":
        points = pr.Points(uneven_points(10_000), uneven_points(10_000))
    elif name in COUNTS:
        points = pr.procedural(name, COUNTS[name])
    else:
        points = pr.read(shared_model(f"points/{name}.ply"))
    model = pr.Model(points)
    return Splats(points.positions, points.normals, model.radii, np.arange(len(points), dtype=np.int32), points.colors)


@pytest.fixture(scope="module")
def torus():
    return splats("torus")


@pytest.mark.parametrize(
    "name", [*map(long, ("sphere", "torus", "lattice", "statue")), long_scan("stanford_bunny"), "uneven"]
)
@pytest.mark.parametrize("surface", ["paper", "imls", "apss", "disc"])
def test_trees_are_valid(name, surface):
    positions = 4000 if name not in ("torus", "uneven") else 1000
    assert check_tree(build_tree(splats(name), TreeSettings(surface)), positions) == []


@pytest.mark.parametrize("name", ["sweep", "wide beside narrow"])
def test_a_narrow_splat_does_not_decide_the_step_far_away(name):
    """Without a limit a ray takes 500 samples in one voxel of the sweep, and 34,000 beside the narrow splats."""
    cloud = splats(name)
    tree = build_tree(cloud, TreeSettings("apss"))
    leaves = tree.leaves.reshape(-1, LEAF)[tree.leaves[STEP::LEAF] > 0]
    edges = (leaves[:, 3:6] - leaves[:, :3]).max(axis=1)
    assert (edges <= 1.001 * MOST_LEAST * leaves[:, LEAST]).all()
    assert len(leaves) < len(cloud.radii) / 4


@pytest.mark.parametrize("width", [long(LEAF_WIDTH / 4), long(LEAF_WIDTH / 2), LEAF_WIDTH])
@pytest.mark.parametrize(
    "name", ["torus", *map(long_scan, ("stanford_bunny", "nefertiti_50k", "stanford_dragon_stand_rangescans"))]
)
def test_trees_over_uneven_splats_are_valid(name, width):
    cloud = splats(name)
    radii = cloud.radii.copy()
    radii[::500] *= 4
    tree = build_tree(cloud._replace(radii=radii), TreeSettings("apss", leaf_width=width))
    assert check_tree(tree, positions=1000) == []


def test_columns_are_thinner_than_their_leaf(torus):
    tree = build_tree(torus, TreeSettings("apss"))
    full = tree.spans[1::2] > 0
    slab = np.diff(tree.leaves.reshape(-1, 16)[full, 9:11])[:, 0]
    low, high = (tree.patches.reshape(-1, 4, 16)[full, row] for row in (2, 3))
    limited, held = np.isfinite(low).all(axis=1), low != NO_SURFACE
    assert limited.mean() > 0.9 and held.mean() > 0.5
    assert ((high - low)[limited].sum(axis=1) / held[limited].sum(axis=1) / slab[limited]).mean() < 0.5


@pytest.mark.long
def test_a_tree_does_not_depend_on_the_number_of_threads():
    cloud = splats("statue")
    one, three = (build_tree(cloud, TreeSettings("apss"), threads) for threads in (1, 3))
    for name in one._fields:
        assert np.array_equal(getattr(one, name), getattr(three, name), equal_nan=True), name


def copied(tree):
    return tree._replace(**{name: getattr(tree, name).copy() for name in tree._fields})


def shift_box(tree):
    node = int(np.flatnonzero(tree.children.reshape(-1, 8)[0] >= 0)[0])
    tree.boxes.reshape(-1, 6, 8)[0, 3, node] -= 0.1


def forget_blocks(tree):
    tree.refs[:] = np.roll(tree.refs, 160)


def move_slabs(tree):
    tree.leaves.reshape(-1, 16)[:, 9:11] += tree.leaves.reshape(-1, 16)[:, 12:13]


def shrink_spheres(tree):
    tree.spheres.reshape(-1, 4, 16)[5, 3] *= 0.5


def cut_child(tree):
    leaf = int(np.flatnonzero(tree.children < 0)[0])
    tree.children[leaf] = -(2**31)


def double_row(tree):
    tree.order[7] = tree.order[8]


def point_outside(tree):
    tree.refs[0] = tree.blocks.size


def thin_slabs(tree):
    """Cut nearly half of their thickness off on one side."""
    leaves = tree.leaves.reshape(-1, 16)
    full = np.isfinite(leaves[:, 10])  # slabs of an empty leaf are unlimited
    leaves[full, 10] -= 0.45 * (leaves[full, 10] - leaves[full, 9])


def thin_patches(tree):
    """Cut nearly half of their thickness off on one side."""
    low, high = tree.patches.reshape(-1, 4, 16)[:, 2], tree.patches.reshape(-1, 4, 16)[:, 3]
    full = np.isfinite(high - low)  # columns of empty leaves are unlimited
    high[full] -= 0.45 * (high - low)[full]


def turn_patches(tree):
    """Let the columns lie along other axes."""
    patches = tree.patches.reshape(-1, 4, 4, 4)
    patches[:] = patches.swapaxes(2, 3).copy()


def thin_boxes(tree):
    """Shrink the leaves' boxes by a twentieth."""
    rows, leaf = (
        tree.boxes.reshape(-1, 6, 8),
        (tree.children.reshape(-1, 8) < 0) & (tree.children.reshape(-1, 8) > -(2**31)),
    )
    node, k = np.nonzero(leaf)
    rows[node, 3:, k] -= 0.05 * (rows[node, 3:, k] - rows[node, :3, k])


def widen_voxels(tree):
    tree.leaves.reshape(-1, 16)[:, 3] += 0.2 * tree.leaves.reshape(-1, 16)[:, 12]


def narrow_voxels(tree):
    tree.leaves.reshape(-1, 16)[:, 3] -= 0.5 * tree.leaves.reshape(-1, 16)[:, 12]


def empty_a_leaf(tree):
    """Remove a leaf with its splats, as if it had been proved empty."""
    rows, children = tree.boxes.reshape(-1, 6, 8), tree.children.reshape(-1, 8)
    node, k = np.argwhere((children < 0) & (children > -(2**31)))[len(tree.leaves) // 32]
    tree.spans[2 * ~children[node, k] + 1] = 0
    children[node, k], rows[node, :3, k], rows[node, 3:, k] = -(2**31), np.inf, -np.inf


def visit_twice(tree):
    children = tree.children.reshape(-1, 8)
    a, b = np.argwhere((children < 0) & (children > -(2**31)))[:2]
    children[tuple(a)] = children[tuple(b)]


CORRUPTIONS = {
    shift_box: "does not enclose",
    forget_blocks: "do not list every splat",
    move_slabs: "outside of the slab",
    thin_slabs: "outside of the slab",
    thin_boxes: "outside of the box",
    thin_patches: "outside of the slab of their column",
    turn_patches: "outside of the slab of their column",
    widen_voxels: "more than one voxel",
    narrow_voxels: "in no voxel",
    shrink_spheres: "sphere does not enclose",
    cut_child: "never reached",
    empty_a_leaf: "in an empty leaf",
    visit_twice: "exactly once",
    double_row: "two slots",
    point_outside: "not a block",
}


@pytest.mark.parametrize("corrupt", CORRUPTIONS, ids=lambda c: c.__name__)
def test_the_validator_detects_a_corrupted_tree(torus, corrupt):
    tree = copied(build_tree(torus, TreeSettings("apss")))
    corrupt(tree)
    assert any(CORRUPTIONS[corrupt] in problem for problem in check_tree(tree, positions=1000))


def scene_of(cloud, **changes):
    """Return a scene of the cloud with its own tree."""
    points, settings = pr.Points(cloud.positions, cloud.normals), TreeSettings("apss", trim=0.6, **changes)
    tree, scene = build_tree(cloud, settings), pr.Scene()
    scene.add(PrebuiltModel(ModelData(settings, 0.0, Drawing(), points, cloud.radii, points.bounds, tree)))
    return scene


def random_rays(rng, cloud):
    """Return origins and unit directions of rays through the cloud's bounds."""
    low, high = pr.Points(cloud.positions).bounds
    a, b = rng.uniform(low, high, (2, 200_000, 3))
    return a - 3 * (b - a), (b - a) / np.linalg.norm(b - a, axis=1, keepdims=True)


def seen(cloud, rays, **changes):
    """Return t of rays, traced with a tree over the cloud."""
    return scene_of(cloud, **changes).intersect(*rays).t


@pytest.mark.parametrize(
    "name",
    ["torus", long("statue"), *map(long_scan, ("stanford_bunny", "stanford_bunny_rangescans")), "uneven", "sweep"],
)
def test_slabs_and_boxes_lose_nothing(name, rng):
    cloud = splats(name)
    rays = random_rays(rng, cloud)
    tight, loose = seen(cloud, rays), seen(cloud, rays, cut=False)
    assert (np.isfinite(tight) != np.isfinite(loose)).sum() <= 6  # 230 if boxes are 5% thinner
    both = np.isfinite(tight) & np.isfinite(loose)
    assert (np.abs(tight[both] - loose[both]) > 0.02 * np.median(cloud.radii)).sum() <= 6  # 7,415


@pytest.mark.parametrize("factor", [0.5, 2.0])
@pytest.mark.parametrize("name", [*map(long, ("torus", "statue")), long_scan("stanford_bunny"), "uneven", "sweep"])
def test_the_size_of_voxels_changes_nothing(name, factor, rng):
    cloud = splats(name)
    rays = random_rays(rng, cloud)
    one, other = seen(cloud, rays), seen(cloud, rays, leaf_width=LEAF_WIDTH * factor)
    assert (np.isfinite(one) != np.isfinite(other)).sum() <= 6
    both = np.isfinite(one) & np.isfinite(other)
    assert (np.abs(one[both] - other[both]) > 0.02 * np.median(cloud.radii)).sum() <= 20


def crumpled(extra):
    """Return splats of a noisy double wall, and copies of some of them far away, which shift all blocks."""
    rng = np.random.default_rng(5)
    x, side = rng.uniform(0, 1, (20_000, 3)), rng.choice([-1.0, 1.0], (20_000, 1))
    u, v = 9 * x[:, 0], 7 * x[:, 1]
    x[:, 2] = 0.05 * np.sin(u) * np.cos(v) + 0.006 * side[:, 0]
    n = side * np.column_stack([-0.45 * np.cos(u) * np.cos(v), 0.35 * np.sin(u) * np.sin(v), np.ones(len(x))])
    n += 0.3 * rng.normal(size=n.shape)
    x, n = np.concatenate([x, x[:extra] + [5, 0, 0]]), np.concatenate([n, n[:extra]])
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    rows = np.arange(len(x), dtype=np.int32)
    radii, sheets = np.full(len(x), 0.02, np.float32), np.ones(len(x), np.int8)
    return Splats(x.astype(np.float32), n.astype(np.float32), radii, rows, None, None, sheets)


def test_which_sheet_is_seen_does_not_depend_on_blocks(rng):
    above, below = (np.c_[rng.uniform(0, 1, (100_000, 2)), np.full(100_000, z)] for z in (1.0, 0.0))
    one, other = (scene_of(crumpled(extra)).intersect(above, below - above).t for extra in (0, 777))
    assert np.isfinite(one).mean() > 0.99
    assert (np.isfinite(one) != np.isfinite(other)).sum() <= 2
    both = np.isfinite(one) & np.isfinite(other)
    assert (np.abs(one[both] - other[both]) > 1e-3).sum() <= 2  # 363 if whole blocks are left out


def test_coincident_and_huge_supports_are_no_trouble(rng):
    x = rng.normal(size=(500, 3)).astype(np.float32)
    n = x / np.linalg.norm(x, axis=1, keepdims=True)
    radii = np.full(500, 50, np.float32)
    rows = np.arange(500, dtype=np.int32)
    tree = build_tree(Splats(np.repeat(x[:1], 500, axis=0), n, radii, rows, None), TreeSettings("imls"))
    assert tree.blocks.size == 125 * 28
    assert check_tree(build_tree(Splats(x, n, radii, rows, None), TreeSettings("imls")), positions=500) == []


def test_splats_that_are_in_order_need_no_sort(rng):
    """The tree is the same, row numbers included, for any order of splats."""
    x = sphere_points(2000)
    out = rng.normal(size=(2000, 3)).astype(np.float32)
    extras = {
        "colors": rng.integers(0, 256, (2000, 3)).astype(np.uint8),
        "borders": np.where(rng.random((2000, 1)) < 0.1, out / np.linalg.norm(out, axis=1, keepdims=True), 0),
        "sheets": (rng.random(2000) < 0.1).astype(np.int8),
        "noise": rng.random(2000).astype(np.float32) / 100,
    }
    extras["borders"] = extras["borders"].astype(np.float32)
    splats = Splats(x, x, np.full(2000, 0.1, np.float32), np.arange(2000, dtype=np.int32), **extras)
    order, settings = kd_order(x), check_settings("apss", 4, 1, "auto")
    ordered = Splats(*(np.ascontiguousarray(array[order]) for array in splats))
    for one, other in zip(build_tree(splats, settings), build_tree(ordered, settings, in_order=True), strict=True):
        assert np.array_equal(one, other, equal_nan=True)
    assert check_tree(build_tree(splats, settings, in_order=True)) == []


@pytest.mark.parametrize("by_row", [True, False])
def test_the_tree_keeps_the_splats(torus, by_row, rng):
    rows = rng.permutation(3 * len(torus.radii)).astype(np.int32)[: len(torus.radii)]
    noise = np.linspace(0, 1e-3, len(rows)).astype(np.float32)
    tree = build_tree(torus._replace(rows=rows, noise=noise), TreeSettings("apss"))
    found = stored_splats(tree, by_row)
    at = np.argsort(rows)[np.searchsorted(np.sort(rows), found.rows)]
    assert sorted(found.rows) == sorted(rows) and (not by_row or (np.diff(found.rows) > 0).all())
    np.testing.assert_array_equal(found.positions, torus.positions[at])
    np.testing.assert_array_equal(found.normals, torus.normals[at])
    assert (found.noise >= noise[at]).all() and (found.noise > noise[at]).mean() < 0.8


@pytest.mark.parametrize("samples", [4, 32])
@pytest.mark.parametrize("name", ["torus", "uneven", "sweep", "wide among narrow", "wide beside narrow"])
def test_leaves_list_all_splats_within_a_sample_step(name, samples, rng):
    """Samples beside a voxel's face are thus the same from both sides."""
    cloud = splats(name)
    tree = build_tree(cloud, TreeSettings("apss", samples=samples))
    leaves, spans = tree.leaves.reshape(-1, LEAF), tree.spans.reshape(-1, 2)
    is_full = np.isfinite(tree.spheres.reshape(-1, 4, 16)[:, 3]).ravel()
    for leaf in rng.permutation(np.flatnonzero(spans[:, 1] > 0))[:200]:
        step = leaves[leaf, STEP]
        low, high = leaves[leaf, :3] - 0.999 * step, leaves[leaf, 3:6] + 0.999 * step
        away = np.maximum(np.maximum(low - cloud.positions, cloud.positions - high), 0)
        wanted = np.flatnonzero(np.linalg.norm(away, axis=1) < 0.999 * cloud.radii)
        part = slice(16 * spans[leaf, 0], 16 * spans[leaf].sum())
        listed = tree.order.reshape(-1, 4)[tree.refs[part][is_full[part]]]
        assert np.isin(wanted, listed).all()
