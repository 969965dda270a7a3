"""Sample positions: each pair of dimensions is a (0, m, 2)-net; pairs and keys are independent."""

import numpy as np
import pytest

from pointray.engine.jit import kernel
from pointray.engine.kernels.sampling import _second, on_disc, pixel_key, sample_pair


@kernel
def _pairs(keys, count, pair, out):
    for k in range(keys.size):
        for i in range(count):
            out[k, i, 0], out[k, i, 1] = sample_pair(keys[k], i, pair)


@kernel
def _seconds(out):
    for i in range(out.size):
        out[i] = _second(i)


@kernel
def _keys(width, seed, out):
    for i in range(out.size):
        out[i] = pixel_key(i % width, i // width, seed)


@kernel
def _on_disc(square, out):
    for i in range(square.shape[0]):
        out[i, 0], out[i, 1] = on_disc(square[i, 0], square[i, 1])


def keys(count, seed=0):
    out = np.empty(count, np.int64)
    _keys(64, seed, out)
    return out


def sample_pairs(count, pair, many=64, seed=0):
    out = np.empty((many, count, 2))
    _pairs(keys(many, seed), count, pair, out)
    return out


def test_the_second_dimension_is_that_of_sobol():
    """The direction numbers of x + 1, added one by one, are compared with the product of masked shifts."""

    def sobol(i):
        out, direction = 0, 1 << 31
        while i:
            out ^= direction if i & 1 else 0
            i, direction = i >> 1, direction ^ direction >> 1
        return int(f"{out:032b}"[::-1], 2)

    out = np.empty(3000, np.int64)
    _seconds(out)
    assert out.tolist() == [sobol(i) for i in range(3000)]


@pytest.mark.parametrize("power", [2, 4, 6, 8])
@pytest.mark.parametrize("pair", [0, 1, 17])
def test_every_pair_is_a_net(power, pair):
    """Each of the 2^power boxes of any shape holds one of 2^power samples."""
    count = 2**power
    for xy in sample_pairs(count, pair):
        for across in range(power + 1):
            boxes = np.floor(xy * [2**across, 2 ** (power - across)]) @ [2 ** (power - across), 1]
            assert len(np.unique(boxes)) == count


def test_pairs_keys_and_seeds_are_independent():
    a, b, other = sample_pairs(64, 0), sample_pairs(64, 1), sample_pairs(64, 0, seed=1)
    for x, y in ((a[..., 0], a[..., 1]), (a[..., 0], b[..., 0]), (a[:-1, :, 0], a[1:, :, 0]), (a, other)):
        assert abs(np.corrcoef(x.ravel(), y.ravel())[0, 1]) < 0.05
    assert 0 <= a.min() and a.max() < 1
    assert len(np.unique(keys(4096))) == 4096 and (keys(64) != keys(64, 1)).all()


def test_sums_converge_faster_than_at_random():
    """The root mean square error of a smooth function's mean: 256 random samples would give 0.0149."""
    x, y = np.moveaxis(sample_pairs(256, 3), 2, 0)
    error = (x * y).mean(axis=1) - 0.25
    assert np.sqrt((error**2).mean()) < 0.0015


def test_equal_areas_of_the_square_are_equal_areas_of_the_disc():
    """A grid of points keeps its shares within each circle and sector, and neighbours stay neighbours."""
    side = (np.arange(400) + 0.5) / 400
    square = np.stack(np.meshgrid(side, side, indexing="ij"), axis=-1)
    out = np.empty((400 * 400, 2))
    _on_disc(np.ascontiguousarray(square.reshape(-1, 2)), out)
    radius, angle = np.hypot(*out.T), np.arctan2(out[:, 1], out[:, 0])
    assert radius.max() <= 1 + 1e-15
    for share in np.linspace(0, 1, 21):
        assert (radius**2 <= share + 1e-12).mean() == pytest.approx(share, abs=0.005)  # a ring is 0.004
        assert (angle <= (2 * share - 1) * np.pi).mean() == pytest.approx(share, abs=0.003)
    disc = out.reshape(400, 400, 2)
    for axis in (0, 1):
        assert np.linalg.norm(np.diff(disc, axis=axis), axis=-1).max() < 2.55 / 400  # 2 sqrt(1 + (pi / 4)^2)
