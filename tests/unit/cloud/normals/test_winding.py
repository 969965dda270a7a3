"""Winding numbers of a cloud loaded in tiles equal those of the whole, and are close to direct sums."""

import numpy as np
import pytest

import pointray as pr
from pointray.cloud.neighbors import NeighborTree, kd_order
from pointray.cloud.normals.winding import SOFT, TILE, Frame, Splats, Winding, roots_of, spacings, top_of


@pytest.fixture(scope="module")
def splats():
    """A closed surface of many tiles, the last of which is short."""
    points = pr.procedural("torus", 10 * TILE + 100)
    order = kd_order(points.positions)
    positions = points.positions[order]
    placed = Frame(positions[0], float(np.ptp(positions, axis=0).max())).of(positions)
    return Splats(placed, points.normals[order], spacings(placed, NeighborTree(placed, in_order=True).rows(11)))


def some(splats, tiles):
    rows = (tiles[:, None] * TILE + np.arange(TILE)).ravel()
    rows = rows[rows < len(splats.positions)]
    return Splats(*(array[rows] for array in splats))


def winding(splats, read):
    tiles = -(-len(splats.positions) // TILE)
    roots = [roots_of(some(splats, part)) for part in np.array_split(np.arange(tiles), 3)]
    return Winding(top_of(np.concatenate(roots)), tiles, read)


def test_only_tiles_that_are_needed_are_read(splats):
    rows, read = np.arange(3 * TILE, 4 * TILE, 7), []

    def note(tiles):
        read.append(tiles)
        return some(splats, tiles)

    whole = Winding.of(splats).around(rows, 1.5)
    parts = winding(splats, note)
    np.testing.assert_array_equal(parts.around(rows, 1.5), whole)
    assert [len(tiles) for tiles in read[:1]] == [1] and 2 <= len(read) <= 3 and len(read[-1]) < 11
    count = len(read)
    np.testing.assert_array_equal(parts.around(rows[:100], 1.5), whole[:100])
    assert len(read) == count
    assert parts.around(rows[:0], 1.5).shape == (0, 2)


def test_winding_numbers_equal_direct_sums(splats):
    rows = np.arange(0, len(splats.positions), 997)
    found = winding(splats, lambda tiles: some(splats, tiles)).around(rows, 1.0)
    x, n, a = (array.astype(np.float64) for array in splats)
    for side, column in ((1, 0), (-1, 1)):
        away = x - (x[rows] + side * a[rows, None] * n[rows])[:, None]
        square = (away**2).sum(axis=2) + (SOFT * a[rows, None]) ** 2
        sums = ((away * n).sum(axis=2) * a**2 / square**1.5).sum(axis=1) / (4 * np.pi)
        np.testing.assert_allclose(found[:, column], sums, atol=0.1)
    assert np.median(found[:, 0]) < 0.2 and np.median(found[:, 1]) > 0.8


@pytest.mark.parametrize("n", [1, 17, TILE, TILE + 1])
def test_small_clouds_have_winding_numbers(n):
    dice = np.random.default_rng(n)
    normals = dice.normal(size=(n, 3)).astype(np.float32)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    splats = Splats(normals / 2, normals, np.full(n, np.sqrt(np.pi / n), np.float32))
    found = winding(splats, lambda tiles: some(splats, tiles)).around(np.arange(n), 1.0)
    assert found.shape == (n, 2) and np.isfinite(found).all()
    if n > 1000:
        assert abs(np.median(found[:, 1]) - 1) < 0.1
