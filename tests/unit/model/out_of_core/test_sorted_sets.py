"""Sets of numbers of cells."""

import numpy as np
import pytest

from pointray.model.out_of_core.sorted_sets import distinct_numbers, isin_sorted


@pytest.mark.parametrize("size", [1, 2, 1000])
@pytest.mark.parametrize("spread", [1, 50, 1 << 62])
def test_sets_equal_those_of_numpy(size: int, spread: int) -> None:
    dice = np.random.default_rng(size)
    some, others = (dice.integers(-spread, spread, size) for _ in range(2))
    known = distinct_numbers(some)
    np.testing.assert_array_equal(known, np.unique(some))
    for numbers in (some, others, others[:0]):
        np.testing.assert_array_equal(isin_sorted(known, numbers), np.isin(numbers, some))


def test_an_empty_set_is_empty() -> None:
    assert distinct_numbers(np.zeros(0, np.int64)).size == 0
