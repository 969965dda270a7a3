"""Vectors compared with NumPy."""

import os
import subprocess
import sys

import numpy as np
import pytest

from native.__main__ import best_level, this_system
from native.targets import LEVELS, SYSTEMS
from pointray.engine import jit
from pointray.engine.jit import kernel
from pointray.engine.simd import (
    bit_fields,
    bits,
    broadcast8,
    broadcast16,
    broadcast_from,
    broadcast_like,
    columns,
    count_bits,
    count_trailing_zeros,
    extend_lane,
    extend_quarter,
    first_quarter,
    gather16,
    gather_rows8,
    high_half,
    join4,
    join_halves,
    lane,
    last_quarter,
    load8,
    load16,
    load16_int,
    load_apart16,
    load_register,
    look_up,
    low_half,
    mask16,
    mask_register,
    middle_half,
    number_like,
    one_bit,
    outer_half,
    pack,
    power_of_two,
    put_around,
    quarters,
    register_lanes,
    repeat4,
    select,
    shift_quarter,
    store,
    store_packed,
    sum_over_lanes,
    sum_over_quarters,
    sums_of_fours,
    swap_halves,
    third_quarter,
    trunc,
    vabs,
    vmax,
    vmin,
    vsqrt,
)


@kernel
def _packed(words, a, out):
    store(out, 0, bit_fields(load16_int(words, 0), 0, 9, 18, 27, 511))
    for k in range(4):
        store(out, 16 + 16 * k, bit_fields(columns(load16_int(words, 0))[k], 0, 0, 0, 0, 255))
    store(out, 80, power_of_two(load16(a, 0)))
    store(out, 96, sums_of_fours(load16(a, 0), load16(a, 16), load16(a, 32), load16(a, 48)))
    store(out, 112, third_quarter(load16(a, 0)))


def test_words_are_unpacked():
    rng = np.random.default_rng(3)
    words, out = rng.integers(-(2**31), 2**31, 16, dtype=np.int64).astype(np.int32), np.zeros(128, np.float32)
    a = rng.integers(-126, 128, 64).astype(np.float32)
    _packed(words, a, out)
    unsigned = words.view(np.uint32)
    want = [(unsigned >> np.repeat([0, 9, 18, 27], 4)) & 511]
    want += [np.tile(unsigned.reshape(4, 4)[:, k] & 255, 4) for k in range(4)]
    want += [2.0 ** a[:16].astype(np.float64), a.reshape(4, 4, 4).sum(axis=2).T.ravel(), np.tile(a[8:12], 4)]
    assert out == pytest.approx(np.concatenate(want))


@kernel
def _gathered(table, places, a, out, words):
    for c in range(8):
        store(out, 16 * c, gather_rows8(table, places, 2, 3)[c])
    store(out, 128, gather16(a, places, 1, 2))
    store(out, 144, load_apart16(a, 5, 7))
    store(words, 0, one_bit(load16(a, 0)) | one_bit(load16(a, 16)))
    store(words, 16, select(load16(a, 0) != load16(a, 16), one_bit(load16(a, 0)), 0))


def test_vectors_are_gathered():
    rng = np.random.default_rng(4)
    table, places = rng.normal(size=(50, 8)).astype(np.float32), rng.integers(0, 50, 48).astype(np.int32)
    a, out, words = rng.uniform(0, 32, 128).astype(np.float32), np.zeros(160, np.float32), np.zeros(32, np.int32)
    a[3] = a[19]
    places[2], places[5] = 0, 49
    _gathered(table.reshape(-1), places, a, out, words)
    assert (out[:128].reshape(8, 16) == table[places[2::3][:16]].T).all()
    assert (out[128:144] == a[places[1::2][:16]]).all() and (out[144:] == a[5::7][:16]).all()
    bits_set = np.uint32(1) << a[:32].astype(np.uint32)
    assert (words[:16].view(np.uint32) == bits_set[:16] | bits_set[16:]).all()
    assert (words[16:].view(np.uint32) == np.where(a[:16] != a[16:32], bits_set[:16], 0)).all() and words[19] == 0


@kernel
def _vectors(a, numbers, out):
    v, w = load16(a, 0), repeat4(a, 4)
    q = quarters(np.float32(1), np.float32(2), np.float32(3), np.float32(4))
    x = v * 2.0 + w / q - 1
    mask = (x > 5.0) & (x < 20)
    store(out, 0, x)
    store(out, 16, x)
    store(out, 32, shift_quarter(q, x))
    store(out, 48, vmax(vmin(x, 5.0), q))
    store(out, 64, select(mask, vabs(x - 9), broadcast16(np.float32(0))))
    store(out, 80, sum_over_quarters(x))
    store(out, 96, first_quarter(x) + last_quarter(x))
    store(out, 112, trunc(x) + vsqrt(v) + sum_over_lanes(x))
    store(out, 128, select(mask16(0xF0A5), x, broadcast_from(a, 7)))
    store(out, 144, broadcast16(np.float32(-1)))
    store_packed(out, 144, mask, x)
    found = np.zeros(16, np.int32)
    word = bits(mask)
    return word, lane(x, 3), count_trailing_zeros(word), count_bits(word), pack(mask, numbers, 0, found, 0), found


def test_vector_operations_equal_numpy():
    a, out, numbers = np.arange(32, dtype=np.float32), np.zeros(160, np.float32), np.arange(100, 116, dtype=np.int32)
    word, third, first, set_bits, count, found = _vectors(a, numbers, out)
    q = np.repeat([1, 2, 3, 4], 4).astype(np.float32)
    x = a[:16] * 2 + np.tile(a[4:8], 4) / q - 1
    mask = (x > 5) & (x < 20)
    want = [x, x, np.concatenate([q[12:], x[:12]]), np.maximum(np.minimum(x, 5), q)]
    want += [np.where(mask, np.abs(x - 9), 0), np.tile(x.reshape(4, 4).sum(0), 4), np.tile(x[:4] + x[12:], 4)]
    want += [np.trunc(x) + np.sqrt(a[:16]) + x.sum(), np.where((0xF0A5 >> np.arange(16)) & 1, x, a[7])]
    assert out[:144] == pytest.approx(np.concatenate(want))
    assert out[144 : 144 + mask.sum()] == pytest.approx(x[mask])
    assert word == (mask << np.arange(16)).sum() and third == x[3] and first == np.flatnonzero(mask)[0]
    assert found[:count].tolist() == numbers[mask].tolist() and set_bits == count


@kernel
def _compared(a, out):
    x, y = load16(a, 0), load16(a, 16)
    store(out, 0, vmin(x, y))
    store(out, 16, vmax(x, y))
    v, w = load8(a, 1), load8(a, 21)
    store(out, 32, v * w - broadcast8(a[3]))
    store(out, 40, vmin(v, w))
    return bits(x < y), bits(x <= y), bits(x > y), bits(x >= y), bits((x < y) | (y < x)), bits((x < y) ^ (x <= y))


def test_comparisons_know_nan_and_inf():
    """A comparison with NaN is false; if one argument is NaN, min and max give the second."""
    a = np.random.default_rng(4).normal(size=32).astype(np.float32)
    a[0], a[17], a[2], a[19], a[20] = np.nan, np.nan, np.inf, -np.inf, a[4]
    out = np.zeros(48, np.float32)
    words = _compared(a, out)
    x, y = a[:16], a[16:]
    truths = [x < y, x <= y, x > y, x >= y, (x < y) | (y < x), x == y]
    assert list(words) == [(t << np.arange(16)).sum() for t in truths]
    assert np.array_equal(out[:16], np.where(x < y, x, y), equal_nan=True)
    assert np.array_equal(out[16:32], np.where(x > y, x, y), equal_nan=True)
    v, w = a[1:9], a[21:29]
    assert out[32:40] == pytest.approx(v * w - a[3])
    assert np.array_equal(out[40:], np.minimum(v, w))


@kernel
def _looked_up(a, indices, out):
    store(out, 0, look_up(a, 5, load16(indices, 0)))
    store(out, 16, join4(a, 20, 1, 1, 7))
    return 0


def test_numbers_are_looked_up_by_index():
    rng = np.random.default_rng(6)
    a, out = rng.normal(size=24).astype(np.float32), np.zeros(32, np.float32)
    indices = rng.integers(16, size=16).astype(np.float32)
    _looked_up(a, indices, out)
    assert np.array_equal(out[:16], a[5 + indices.astype(int)])
    assert np.array_equal(out[16:].reshape(4, 4), a[np.add.outer([20, 1, 1, 7], np.arange(4))])


@kernel
def _parts(a, out):
    v = load16(a, 0)
    low, high = low_half(v), high_half(v)
    store(out, 0, join_halves(high, low))
    store(out, 16, put_around(outer_half(v), middle_half(v)))
    store(out, 32, extend_quarter(low))
    store(out, 48, extend_lane(low))
    store(out, 64, join_halves(swap_halves(low), number_like(a[3], low) + broadcast_like(a, 5, low)))
    lanes = register_lanes()
    for k in range(0, 16, lanes):
        store(out, 80 + k, select(mask_register(0xB6D3 >> k), load_register(a, k), look_up(a, 8, load_register(a, k))))
    return lanes


def test_parts_of_vectors_and_registers():
    rng = np.random.default_rng(7)
    a, out = rng.integers(0, 16, 24).astype(np.float32), np.zeros(96, np.float32)
    lanes = _parts(a, out)
    v = a[:16]
    want = [v[8:], v[:8], v, v[:8], v[4:8], v[4:8], v[:8], np.repeat(v[7], 8), v[4:8], v[:4], np.repeat(v[3] + v[5], 8)]
    want.append(np.where((0xB6D3 >> np.arange(16)) & 1, v, a[8 + v.astype(int)]))
    assert lanes in (4, 8, 16) and np.array_equal(out, np.concatenate(want))


@pytest.mark.long
@pytest.mark.parametrize("level", ["x86-64", "x86-64-v2", "x86-64-v3"])
def test_registers_of_any_width_do_the_same(level, tmp_path):
    """All tests of this file with kernels compiled for other processors, the first of them without SSE4."""
    best = best_level(this_system()) if this_system() in SYSTEMS else None
    if best is None or level > best:
        pytest.skip(f"not for {best}")
    features = LEVELS[level].features if level in LEVELS else ""
    env = {**os.environ, "POINTRAY_KERNELS": "jit", "POINTRAY_CACHE": str(tmp_path)}
    env |= {"NUMBA_CPU_NAME": level, "NUMBA_CPU_FEATURES": features}
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-m", "not long", __file__]
    done = subprocess.run(command, env=env, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-2000:]


@kernel
def _append(a, numbers, found):
    n = pack(load16(a, 0) > np.float32(0), numbers, 0, found, 0)
    return n, n + pack(load16(a, 16) > np.float32(0), numbers, 16, found, n)


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_packing_appends_and_writes_16_lanes_at_most(share):
    a = np.where(np.random.default_rng(2).random(32) < share, 1, -1).astype(np.float32)
    numbers, found = np.arange(100, 132, dtype=np.int32), np.full(64, -1, np.int32)
    half, count = _append(a, numbers, found)
    assert (half, count) == ((a[:16] > 0).sum(), (a > 0).sum())
    assert found[:count].tolist() == numbers[a > 0].tolist() and (found[half + 16 :] == -1).all()


@pytest.mark.skipif(not jit.CHECK, reason="needs POINTRAY_CHECK=1")
def test_a_load_beyond_the_end_is_detected():
    with pytest.raises(IndexError):
        _vectors(np.zeros(15, np.float32), np.zeros(16, np.int32), np.zeros(160, np.float32))
