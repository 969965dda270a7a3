"""Numbers as text: values are restored to the last bit, with as few decimals as possible."""

import numpy as np
import pytest

from pointray.io.formats.text._decimals import floats, integers, joined, texts_of


def words(texts):
    return joined([texts], " ").decode("ascii").split("\n")[:-1]


@pytest.mark.parametrize(
    "values",
    [
        [0.5, -0.25, 0.1, 3, -7, 12345678.9, 0],
        [1e300, -1e300, 1e-300, 5e-324, 2.0**53, 2.0**53 + 2, -(2.0**63), 0.1],
        [1 / 3, 2 / 3, -1 / 7],
        [0.0],
        [],
    ],
)
def test_floats_are_restored(values):
    numbers = np.array(values, np.float64)
    assert [float(word) for word in words(texts_of(numbers))] == values


def test_short_decimals_stay_short():
    numbers = np.array([0.5, -0.25, 0.1, 3, -7, 12345678.9, 0])
    assert words(texts_of(numbers)) == ["0.5", "-0.25", "0.1", "3", "-7", "12345678.9", "0"]


@pytest.mark.parametrize("scale", [1e-30, 1e-6, 1, 1e5, 1e30])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_random_floats_are_restored(rng, dtype, scale):
    numbers = (rng.normal(size=2000) * scale).astype(dtype)
    texts = words(texts_of(numbers))
    np.testing.assert_array_equal(np.array([float(word) for word in texts]).astype(dtype), numbers)
    assert max(map(len, texts)) <= (25 if dtype == np.float64 else 20)


def test_measures_have_as_many_decimals_as_were_measured(rng):
    numbers = np.round(rng.random(2000) * 1e5, 3)
    texts = words(texts_of(numbers))
    assert texts == [repr(x).removesuffix(".0") for x in numbers.tolist()]


def test_values_that_are_not_finite(rng):
    numbers = np.array([np.nan, 1.5, np.inf, -np.inf, np.nan])
    assert words(texts_of(numbers)) == ["nan", "1.5", "inf", "-inf", "nan"]
    assert words(texts_of(np.full(3, np.nan, np.float32))) == ["nan"] * 3


@pytest.mark.parametrize("kind", ["i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8"])
def test_integers_of_all_types(rng, kind):
    limits = np.iinfo(kind)
    numbers = rng.integers(limits.min, limits.max, 500, kind, endpoint=True)
    numbers[:4] = limits.min, limits.max, 0, 1
    assert words(integers(numbers)) == [str(x) for x in numbers.tolist()]


def test_bools_are_numbers():
    assert words(texts_of(np.array([True, False]))) == ["1", "0"]


def test_a_tolerance_saves_decimals(rng):
    numbers = rng.random(1000) * 100
    texts = words(floats(numbers, lambda found, rows: np.abs(found - numbers[rows]) < 0.006))
    assert all(len(word.partition(".")[2]) <= 2 for word in texts)
    np.testing.assert_allclose(np.array(texts, np.float64), numbers, rtol=0, atol=0.006)


def test_large_numbers_beside_many_decimals(rng):
    """Those that an integer in steps of the last decimal cannot hold are written by themselves."""
    numbers = np.concatenate([np.round(rng.random(600), 15), [123456.5, -98765432.25]])
    np.testing.assert_array_equal([float(word) for word in words(texts_of(numbers))], numbers)
