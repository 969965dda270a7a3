"""Signs of normals that are made part by part are those of the whole, to the bit."""

from functools import lru_cache

import numpy as np
import pytest

import pointray as pr
from conftest import shared_model, slow, sphere_points
from pointray.neighbors import NeighborTree, distinct, kd_order
from pointray.parts import signs as by_parts
from pointray.parts.signs import Labels, Local, sign_all
from pointray.points.normals.jets import fit_normals
from pointray.points.normals.joins import join
from pointray.points.normals.layers import Layers, sides
from pointray.points.normals.orientation import NEAR, agree, orient
from pointray.points.normals.outward import LARGE, SAMPLE, take_sample
from pointray.points.normals.votes import STEPS, Votes

STRETCH = 2048  # points that a margin consists of


class Held:
    """A column in memory, which begins with nonsense."""

    def __init__(self, rows, dtype):
        self.array = np.full(rows, 77, dtype)

    def __getitem__(self, rows):
        return self.array[rows].copy()

    def write(self, start, rows):
        assert rows.dtype == self.array.dtype
        self.array[start : start + len(rows)] = rows


class Cloud:
    """Points in kd order with what signs are asked for: places and normals, which may be moved, and neighbours."""

    def __init__(self, path, positions, normals, near, size):
        self.path, self.positions, self.normals, self.near, self.size = path, positions, normals, near, size
        starts = np.arange(0, len(path), STRETCH)
        self.low, self.high = np.minimum.reduceat(path, starts), np.maximum.reduceat(path, starts)
        self.parts = -(-len(path) // size)
        self.loaded = []

    def core(self, part):
        return slice(part * self.size, min((part + 1) * self.size, len(self.path)))

    def load(self, part):
        """A part with all stretches that its points' neighbours may be in."""
        core = self.core(part)
        own = self.path[core]
        reach = 1.0001 * np.linalg.norm(self.path[self.near[core, -1]] - own, axis=1).max()
        far = np.maximum(np.maximum(self.low - own.max(axis=0), own.min(axis=0) - self.high), 0)
        stretches = np.flatnonzero(np.linalg.norm(far, axis=1) <= reach)
        rows = (stretches[:, None] * STRETCH + np.arange(STRETCH)).ravel()
        rows = rows[rows < len(self.path)]
        begin = int(np.searchsorted(rows, core.start))
        place = slice(begin, begin + len(own))
        near = NeighborTree(self.path[rows], in_order=True).rows(self.near.shape[1], place)
        np.testing.assert_array_equal(rows[near], self.near[core])
        self.loaded.append(len(rows))
        return Local(rows, place, self.positions[rows], self.normals[rows], near)

    def loaders(self):
        return [lambda part=part: self.load(part) for part in range(self.parts)]

    def labels(self):
        return Labels(Held(len(self.path), np.int32), Held(len(self.path), np.int8))


def cloud_of(positions, size, scramble=True):
    """The cloud of some points with fitted normals of random signs."""
    positions = np.asarray(positions, np.float32)
    path = positions[distinct(positions)[0]]
    path = path[kd_order(path)]
    found = fit_normals(path, NEAR)
    flips = np.random.default_rng(0).choice(np.float32([-1, 1]), len(path))
    return Cloud(path, path, found.normals * flips[:, None], found.near, size)


def crossing():
    """Two sheets through each other, one of them open ground."""
    x, y = np.random.default_rng(1).uniform(-1, 1, (2, 40_000))
    z = np.where(np.arange(40_000) % 2, 0.3 * x, 0.1 * np.sin(5 * x) - 0.2 * y)
    return np.column_stack([x, y, z])


def bubbles():
    """Spheres of 100 to 5,000 points, small ones inside larger ones, many of which lie in two parts."""
    dice, spheres = np.random.default_rng(2), []
    for k in range(60):
        size = dice.uniform(0.2, 1)
        spheres.append(sphere_points(int(dice.integers(100, 5000)), k) * size + dice.uniform(0, 12, 3))
    return np.concatenate(spheres)


def terrain():
    x, y = np.random.default_rng(3).uniform(0, 10, (2, 60_000))
    return np.column_stack([x, y, 0.5 * np.sin(3 * x) * np.cos(2 * y) + 0.05 * np.abs(np.sin(40 * x))])


@lru_cache(None)
def made(name):
    if name == "statue":
        return cloud_of(pr.procedural("statue", 200_000).positions, 1 << 16)
    if name == "lucy":
        return cloud_of(pr.read(shared_model("points/stanford_lucy_50k.ply")).positions, 1 << 13)
    return cloud_of({"crossing": crossing, "bubbles": bubbles, "terrain": terrain}[name](), 1 << 13)


def signs_of(cloud, progress=None):
    signs = Held(len(cloud.path), np.int8)
    sign_all(cloud.loaders(), cloud.labels(), signs, progress)
    return signs.array


@pytest.mark.parametrize("name", ["bubbles", "crossing", "terrain", "lucy", slow("statue")])
def test_parts_have_the_signs_of_the_whole(name):
    cloud = made(name)
    signs = signs_of(cloud)
    assert cloud.parts > 3 and min(cloud.loaded) < len(cloud.path)
    np.testing.assert_array_equal(signs, orient(cloud.positions, cloud.normals, cloud.near))
    assert 0.3 < (signs == 1).mean() < 0.7  # as normals were flipped by chance


def test_groups_of_all_kinds_are_asked():
    """The clouds above have groups that lie in one part and in several, small, large, and larger than a sample."""
    cloud = made("bubbles")
    labels, kinds = cloud.labels(), set()
    sizes = [by_parts.find(load(), labels) for load in cloud.loaders()]
    groups = by_parts.gather(sizes, [by_parts.vote(load(), labels, sizes) for load in cloud.loaders()])
    for part in range(cloud.parts):
        here = groups.among(slice(*groups.first_piece[part : part + 2]))
        kinds |= set(zip(here[here > 0] == groups.points[here > 0], groups.points[here > 0] < LARGE, strict=True))
    assert len(kinds) == 4
    assert groups.points.sum() == len(cloud.path)
    _, each = agree(cloud.positions, cloud.normals, cloud.near)
    np.testing.assert_array_equal(groups.points, np.bincount(each))
    terrain = made("terrain")
    assert np.bincount(agree(terrain.positions, terrain.normals, terrain.near)[1]).max() > SAMPLE


def test_samples_of_parts_are_those_of_the_whole():
    """Each n-th point of a group is taken as it is counted over all parts."""
    cloud = made("terrain")
    groups = np.random.default_rng(4).choice(3, len(cloud.path), p=(0.9, 0.08, 0.02)).astype(np.int32)
    signs, sizes = np.ones(len(groups), np.int8), np.bincount(groups)
    assert sizes[0] > SAMPLE > sizes[1]
    whole = take_sample(cloud.positions, cloud.normals, signs, groups, sizes)
    assert np.bincount(whole.groups).tolist() == [-(-sizes[0] // 2), *sizes[1:]]
    parts = []
    for first, last in ((0, 4097), (4097, 4098), (4098, 30_000), (30_000, len(groups))):
        arrays = (array[first:last] for array in (cloud.positions, cloud.normals, signs, groups))
        parts.append(take_sample(*arrays, sizes, np.bincount(groups[:first], minlength=3)))
    for expected, found in zip(whole, zip(*parts, strict=True), strict=True):
        np.testing.assert_array_equal(np.concatenate(found), expected)


def test_a_noisy_torus_follows_its_planes():
    """Planes through 64 points get signs, with points moved onto them, and normals follow those around them."""
    torus = pr.procedural("torus", 40_000)
    noise = 0.7 * np.sqrt(4 * np.pi**2 * 0.4 / 40_000) * np.random.default_rng(0).normal(size=(40_000, 3))
    path = np.float32(torus.positions + noise)
    path = path[kd_order(path)]
    layers = Layers(path)
    found = fit_normals(path, NEAR, planes=layers)
    assert layers.noisy
    cloud = Cloud(path, layers.moved, layers.planes, layers.near, 1 << 13)
    signs = Held(len(path), np.int8)
    sign_all(cloud.loaders(), cloud.labels(), signs)
    whole = orient(layers.moved, layers.planes, layers.near)
    np.testing.assert_array_equal(signs.array, whole)
    expected = sides(found.normals, layers.planes * whole[:, None], layers.near)
    for part, load in enumerate(cloud.loaders()):
        local, core = load(), cloud.core(part)
        planes = local.normals * signs[local.rows][:, None]
        np.testing.assert_array_equal(sides(found.normals[core], planes, local.near), expected[core])


def test_passes_go_in_any_order_and_again():
    """As several machines take them, some of which die."""
    cloud = made("bubbles")
    dice, labels, loaders = np.random.default_rng(5), cloud.labels(), cloud.loaders()

    def each(task):
        results = {part: task(part) for part in [*dice.permutation(cloud.parts), *dice.permutation(cloud.parts)[:3]]}
        return [results[part] for part in range(cloud.parts)]

    sizes = each(lambda part: by_parts.find(loaders[part](), labels))
    groups = by_parts.gather(sizes, each(lambda part: by_parts.vote(loaders[part](), labels, sizes)))
    facing = by_parts.face(groups, each(lambda part: by_parts.look(loaders[part](), part, labels, groups)))
    signs = Held(len(cloud.path), np.int8)
    each(lambda part: by_parts.write(part, labels, groups, facing, signs))
    np.testing.assert_array_equal(signs.array, orient(cloud.positions, cloud.normals, cloud.near))


def test_one_part_is_the_whole_and_progress_is_told():
    ball = sphere_points(3000)
    cloud, shares = cloud_of(ball, 1 << 13), []
    signs = signs_of(cloud, shares.append)
    assert shares == sorted(shares) and shares[-1] == 1 and shares[0] > 0
    assert (np.einsum("ij,ij->i", cloud.path, cloud.normals * signs[:, None]) > 0).all()


def test_a_part_begins_with_a_tile():
    cloud = made("terrain")
    cloud = Cloud(cloud.path, cloud.positions, cloud.normals, cloud.near, 5000)
    with pytest.raises(ValueError, match="a part begins at a multiple of 2,048 rows, not at row 5,000"):
        by_parts.find(cloud.load(1), cloud.labels())


def votes_of(rows):
    """Votes (one, other, sum, mass), in full ones."""
    table = np.array(sorted(rows), np.float64).reshape(-1, 4)
    sums, masses = (np.rint(table[:, c] * STEPS).astype(np.int64) for c in (2, 3))
    return Votes(table[:, 0].astype(np.int64) << 32 | table[:, 1].astype(np.int64), sums, masses)


def test_joins_follow_the_clearest_votes():
    """Piece 2 has a large vote for 0, much of which is contradicted, and a clearer one for 1; 5 has none."""
    votes = [(0, 1, -3, 3), (0, 2, 5, 20), (1, 2, 4, 4), (3, 4, -0.5, 0.5)]
    for shared in ([votes], [votes[:2], votes[2:]], [votes[::2], [], votes[1::2]]):
        group, turn = join(6, [votes_of(rows) for rows in shared])
        assert group.tolist() == [0, 0, 0, 1, 1, 2]
        assert (turn[:3] * turn[0]).tolist() == [1, -1, -1]
        assert turn[3] == -turn[4]


def test_votes_of_one_pair_are_added_whatever_their_order():
    """Sums of float64 would be 0 or what the small one says, by their order."""
    big, less, small = (0, 1, 2.0**30, 2.0**30), (0, 1, -(2.0**30), 2.0**30), (0, 1, -1 / STEPS, 1 / STEPS)
    for rows in ([big, small, less], [small, big, less], [big, less, small]):
        _, turn = join(2, [votes_of([row]) for row in rows])
        assert turn[0] == -turn[1]
