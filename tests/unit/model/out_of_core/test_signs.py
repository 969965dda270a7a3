"""Signs of normals computed part by part equal those of the whole, to the bit."""

import tracemalloc
from functools import lru_cache
from itertools import pairwise

import numpy as np
import pytest

import pointray as pr
from helpers.clouds import sphere_points
from helpers.marks import long, long_scan
from helpers.places import shared_model
from pointray.base.disk_columns import Columns
from pointray.cloud.neighbors import NeighborTree, distinct, kd_order
from pointray.cloud.normals.jets import fit_normals
from pointray.cloud.normals.joins import InMemoryVotes, join
from pointray.cloud.normals.layers import Layers, signs_facing
from pointray.cloud.normals.orientation import NEAR, agree, orient
from pointray.cloud.normals.outward import LARGE, SAMPLE, take_sample
from pointray.cloud.normals.votes import STEPS, Votes, sum_votes
from pointray.model.out_of_core import disk_votes as ballots
from pointray.model.out_of_core.disk_votes import OnDiskVotes, drop_all, keep, name_of
from pointray.model.out_of_core.signs import GROUP, PIECE, POINTS, SIGN, SIGNED, Local, Signs, firsts_of

STRETCH = 2048  # points of one range of a margin


class Cloud:
    """Points in kd order with the input of signs: positions and normals, which may be moved, and neighbours."""

    def __init__(self, path, positions, normals, near, size):
        self.path, self.positions, self.normals, self.near, self.size = path, positions, normals, near, size
        starts = np.arange(0, len(path), STRETCH)
        self.low, self.high = np.minimum.reduceat(path, starts), np.maximum.reduceat(path, starts)
        self.parts = -(-len(path) // size)
        self.loaded = []

    def core(self, part):
        return slice(part * self.size, min((part + 1) * self.size, len(self.path)))

    def load(self, part):
        """Return a part with all ranges that may contain neighbours of its points."""
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

    def passes(self, folder):
        """Return the passes, with columns initialised to garbage."""
        columns = Columns(folder)
        for name, dtype in ((PIECE, np.int32), (SIGN, np.int8), (SIGNED, np.int8)):
            columns.make(name, dtype).append(np.full(len(self.path), 77, dtype))
        return Signs(columns, np.array([*range(0, len(self.path), self.size), len(self.path)])), columns[SIGNED]


def cloud_of(positions, size, scramble=True):
    """Return the cloud of points with fitted normals of random signs."""
    positions = np.asarray(positions, np.float32)
    path = positions[distinct(positions)[0]]
    path = path[kd_order(path)]
    found = fit_normals(path, NEAR)
    flips = np.random.default_rng(0).choice(np.float32([-1, 1]), len(path))
    return Cloud(path, path, found.normals * flips[:, None], found.near, size)


def crossing():
    """Return two intersecting sheets, one of them open ground."""
    x, y = np.random.default_rng(1).uniform(-1, 1, (2, 40_000))
    z = np.where(np.arange(40_000) % 2, 0.3 * x, 0.1 * np.sin(5 * x) - 0.2 * y)
    return np.column_stack([x, y, z])


def bubbles():
    """Return nested spheres of 100 to 5,000 points, many of which lie in two parts."""
    dice, spheres = np.random.default_rng(2), []
    for k in range(24):
        size = dice.uniform(0.2, 1)
        spheres.append(sphere_points(int(dice.integers(100, 5000)), k) * size + dice.uniform(0, 9, 3))
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


def signs_of(cloud, folder, order=lambda parts: parts):
    """Return the signs; order : order of the parts in each pass"""
    (signs, out), load, parts = cloud.passes(folder), cloud.load, range(cloud.parts)

    def each(task):
        results = {part: task(part) for part in order(parts)}
        return [results[part] for part in parts]

    firsts = firsts_of(each(lambda part: signs.find(load(part))))
    shared = signs.gather(firsts, each(lambda part: signs.vote(load(part), part, firsts)))
    inward = signs.face(each(lambda part: signs.examine(load(part), part, firsts, shared[part])))
    each(lambda part: signs.write(part, firsts, inward))
    return out[:]


@pytest.mark.parametrize("name", ["bubbles", "crossing", long("terrain"), long_scan("lucy"), long("statue")])
def test_parts_have_the_signs_of_the_whole(name, tmp_path, monkeypatch):
    monkeypatch.setattr("pointray.model.out_of_core.disk_votes.PIECES", 1000)
    cloud = made(name)
    signs = signs_of(cloud, tmp_path)
    assert cloud.parts > 3 and min(cloud.loaded) < len(cloud.path)
    np.testing.assert_array_equal(signs, orient(cloud.positions, cloud.normals, cloud.near))
    assert 0.3 < (signs == 1).mean() < 0.7  # as normals were flipped by chance


def test_groups_of_all_kinds_occur(tmp_path):
    """The clouds above have groups in one part and in several, small, large, and larger than a sample."""
    cloud = made("bubbles")
    signs_of(cloud, tmp_path)
    columns, kinds = Columns(tmp_path), set()
    group, points = columns[GROUP][:], columns[POINTS][:]
    ends = [np.unique(columns[PIECE][cloud.core(part)]).size for part in range(cloud.parts)]
    each = [
        group[start:end][columns[PIECE][cloud.core(part)]]
        for part, (start, end) in enumerate(pairwise(firsts_of(ends)))
    ]
    for rows in each:
        here = np.bincount(rows, minlength=len(points))
        kinds |= set(zip(here[here > 0] == points[here > 0], points[here > 0] < LARGE, strict=True))
    assert len(kinds) == 4
    np.testing.assert_array_equal(points, np.bincount(np.concatenate(each)))
    _, groups = agree(cloud.positions, cloud.normals, cloud.near)
    np.testing.assert_array_equal(points, np.bincount(groups))
    terrain = made("terrain")
    assert np.bincount(agree(terrain.positions, terrain.normals, terrain.near)[1]).max() > SAMPLE


def test_samples_of_parts_equal_those_of_the_whole():
    """Each n-th point of a group is sampled, counted over all parts."""
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


def test_a_noisy_torus_follows_its_planes(tmp_path):
    """Planes through 64 points get signs, with points projected onto them, and normals follow nearby planes."""
    torus = pr.procedural("torus", 40_000)
    noise = 0.7 * np.sqrt(4 * np.pi**2 * 0.4 / 40_000) * np.random.default_rng(0).normal(size=(40_000, 3))
    path = np.float32(torus.positions + noise)
    path = path[kd_order(path)]
    layers = Layers(path)
    found = fit_normals(path, NEAR, planes=layers)
    assert layers.noisy
    cloud = Cloud(path, layers.moved, layers.planes, layers.near, 1 << 13)
    signs = signs_of(cloud, tmp_path)
    whole = orient(layers.moved, layers.planes, layers.near)
    np.testing.assert_array_equal(signs, whole)
    expected = signs_facing(found.normals, layers.planes * whole[:, None], layers.near)
    for part in range(cloud.parts):
        local, core = cloud.load(part), cloud.core(part)
        planes = local.normals * signs[local.rows][:, None]
        np.testing.assert_array_equal(signs_facing(found.normals[core], planes, local.near), expected[core])


def test_passes_may_run_in_any_order_and_repeatedly(tmp_path):
    """As with several workers, some of which are lost."""
    cloud, dice = made("bubbles"), np.random.default_rng(5)
    signs = signs_of(cloud, tmp_path, lambda parts: [*dice.permutation(parts), *dice.permutation(parts)[:3]])
    np.testing.assert_array_equal(signs, orient(cloud.positions, cloud.normals, cloud.near))
    assert not [name for name in Columns(tmp_path).names if "votes" in name]


def test_a_single_part_equals_the_whole(tmp_path):
    ball = sphere_points(3000)
    cloud = cloud_of(ball, 1 << 13)
    signs = signs_of(cloud, tmp_path)
    assert (np.einsum("ij,ij->i", cloud.path, cloud.normals * signs[:, None]) > 0).all()


def test_a_part_begins_with_a_tile(tmp_path):
    cloud = made("terrain")
    cloud = Cloud(cloud.path, cloud.positions, cloud.normals, cloud.near, 5000)
    with pytest.raises(ValueError, match="a part must begin at a multiple of 2,048 rows, not at row 5,000"):
        cloud.passes(tmp_path)[0].find(cloud.load(1))


def votes_of(rows):
    """Return votes (one, other, sum, mass) in fixed point."""
    table = np.array(sorted(rows), np.float64).reshape(-1, 4)
    sums, masses = (np.rint(table[:, c] * STEPS).astype(np.int64) for c in (2, 3))
    return Votes(table[:, 0].astype(np.int64) << 32 | table[:, 1].astype(np.int64), sums, masses)


def test_joins_follow_the_clearest_votes():
    """Piece 2 has a large but contradicted vote for 0 and a clearer one for 1; piece 5 has none."""
    votes = [(0, 1, -3, 3), (0, 2, 5, 20), (1, 2, 4, 4), (3, 4, -0.5, 0.5)]
    for shared in ([votes], [votes[:2], votes[2:]], [votes[::2], [], votes[1::2]]):
        group, turn = join(6, InMemoryVotes([votes_of(rows) for rows in shared]))
        assert group.tolist() == [0, 0, 0, 1, 1, 2]
        assert (turn[:3] * turn[0]).tolist() == [1, -1, -1]
        assert turn[3] == -turn[4]


def test_the_sum_of_votes_does_not_depend_on_their_order():
    """Sums of float64 would be 0 or the small vote, depending on the order."""
    big, less, small = (0, 1, 2.0**30, 2.0**30), (0, 1, -(2.0**30), 2.0**30), (0, 1, -1 / STEPS, 1 / STEPS)
    for rows in ([big, small, less], [small, big, less], [big, less, small]):
        _, turn = join(2, InMemoryVotes([votes_of([row]) for row in rows]))
        assert turn[0] == -turn[1]


def dice_votes(seed):
    """Return the number of pieces and votes of parts on them, many of them equally clear."""
    dice = np.random.default_rng(seed)
    pieces = int(dice.integers(2, 400))
    some = dice.integers(pieces, size=(int(dice.integers(1, 4 * pieces)), 2))
    some = np.sort(some[some[:, 0] != some[:, 1]], axis=1)
    sums = dice.integers(-3, 4, len(some)) * (STEPS if seed % 2 else dice.integers(1, STEPS))
    each = [Votes(some[[k], 0] << 32 | some[[k], 1], sums[[k]], np.abs(sums[[k]])) for k in range(len(some))]
    none = Votes(*np.zeros((3, 0), np.int64))
    return pieces, [sum_votes([none, *each[k::3]]) for k in range(3)]


@pytest.mark.parametrize("seed", range(4))
def test_tables_on_disk_join_like_one_in_memory(seed, tmp_path, monkeypatch):
    """This holds for tables of any size; temporary files are removed."""
    pieces, votes = dice_votes(seed)
    expected = join(pieces, InMemoryVotes(votes))
    for size in (9, 50, 1000):
        monkeypatch.setattr(ballots, "PIECES", size)
        columns = Columns(tmp_path)
        cuts = [keep(columns, name_of(k), some, pieces) for k, some in enumerate(votes)]
        found = join(pieces, OnDiskVotes(columns, [name_of(k) for k in range(3)], cuts))
        for one, other in zip(found, expected, strict=True):
            np.testing.assert_array_equal(one, other)
        drop_all(columns)
        assert not columns.names


def test_tables_have_the_expected_number_of_pieces(tmp_path, monkeypatch):
    """Each pair occurs once, in order, however many columns contain it."""
    pieces, votes = dice_votes(1)
    monkeypatch.setattr(ballots, "PIECES", 20)
    columns = Columns(tmp_path)
    cuts = [keep(columns, name_of(k), some, pieces) for k, some in enumerate(votes)]
    tables = list(OnDiskVotes(columns, [name_of(k) for k in range(3)], cuts))
    assert len(tables) == -(-pieces // 20)
    for k, table in enumerate(tables):
        assert ((table.pairs >> 32) // 20 == k).all()
    for one, other in zip(zip(*tables, strict=True), sum_votes(votes), strict=True):
        np.testing.assert_array_equal(np.concatenate(one), other)


@pytest.mark.long
def test_joins_take_little_memory(tmp_path, monkeypatch):
    """At most 40 bytes a piece, in addition to a few tables."""
    monkeypatch.setattr(ballots, "PIECES", 1 << 12)
    side = 512
    number, dice = np.arange(side * side).reshape(side, side), np.random.default_rng(6)
    steps = [(number[:, :-1], number[:, 1:]), (number[:-1], number[1:]), (number[:-1, :-1], number[1:, 1:])]
    pairs = np.sort(np.concatenate([(one << 32 | other).ravel() for one, other in steps]))
    sums = dice.integers(-STEPS, STEPS, len(pairs))
    votes, columns = Votes(pairs, sums, np.abs(sums)), Columns(tmp_path)
    expected = join(side * side, InMemoryVotes([votes]))
    cuts = [keep(columns, name_of(0), votes, side * side)]
    del votes, pairs, sums, steps
    tracemalloc.start()
    found = join(side * side, OnDiskVotes(columns, [name_of(0)], cuts))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 40 * side * side
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(one, other)
