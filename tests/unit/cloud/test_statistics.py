"""Statistics of a cloud, and the precision with which they are stored."""

import math

import numpy as np
import pytest

from pointray.cloud.statistics import BITS, CloudStatistics, quantize


@pytest.mark.parametrize("value", [1e-30, 0.0071279, 0.6, 1.0, 3.0, 12345.6])
def test_numbers_that_hardly_differ_are_quantized_to_one(value: float) -> None:
    told = quantize(value)
    assert told == pytest.approx(value, rel=2.0**-BITS) and quantize(told) == told
    assert {quantize(value * (1 + share)) for share in np.linspace(-1e-6, 1e-6, 9)} == {told}
    assert value * (1 - 2.0 ** (1 - BITS)) < quantize(value, is_limit=True) <= value


@pytest.mark.parametrize("value", [0.0, math.inf])
def test_zero_and_non_finite_numbers_are_not_quantized(value: float) -> None:
    assert quantize(value) == value
    assert math.isnan(quantize(math.nan))


def test_statistics_of_a_cloud_are_quantized() -> None:
    values = np.random.default_rng(0).lognormal(size=5000).astype(np.float32)
    statistics = CloudStatistics()
    found = statistics.quantile("a", values, 0.5)
    assert found == quantize(float(np.quantile(values, 0.5))) == statistics.known["a"]
    assert statistics.share("b", values > 1) == quantize(float((values > 1).mean()))
    assert statistics.least("c", values) == values.min()  # it is compared with each value
