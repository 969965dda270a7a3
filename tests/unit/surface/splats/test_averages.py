"""Averages of attributes over groups of points, compared with a slow loop over groups."""

from collections import Counter
from fractions import Fraction

import numpy as np
import pytest

import pointray as pr
from pointray.cloud.points import categories_of, is_label
from pointray.surface.splats.averages import attribute_averages, commonest, has_categories, have_categories

N, GROUPS = 1500, 200
DTYPES = ["u1", "i1", "u2", "i2", "u4", "i4", "u8", "i8", "f4", "f8"]


def slow_average(name, values, rows, least):
    """Return the value of one group from exact sums."""
    if values.ndim == 2:
        return [slow_average(name, column, rows, least) for column in values.T]
    group = values[rows].tolist()
    whole = values.dtype.kind != "f"
    if categories_of(values, name) is not None or (whole and is_label(name)):
        counts = Counter(group)
        return min(value for value in counts if counts[value] == max(counts.values()))
    known = group if whole else [x for x in group if np.isfinite(x)]
    if not known or len(known) < least * len(group):
        return np.nan
    mean = sum(map(Fraction, known)) / len(known)
    return round(mean) if whole else float(mean)


def slow_averages(attributes, order, starts, least):
    ends = [*starts[1:], len(order)]
    groups = [order[start:end] for start, end in zip(starts, ends, strict=True)]
    return {
        name: np.array([slow_average(name, values, rows, least) for rows in groups], values.dtype)
        for name, values in attributes.items()
    }


@pytest.fixture
def groups(rng):
    """Rows in random order, some repeated and some missing, and the starts of groups of 1 to about 50 rows."""
    starts = np.sort(rng.choice(np.arange(1, N), GROUPS - 1, replace=False))
    return rng.integers(0, N, N), np.array([0, *starts])


@pytest.mark.parametrize("least", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("dtype", ["f4", "f8"])
def test_means_of_floats(rng, groups, dtype, least):
    values = rng.normal(3e8 if dtype == "f8" else 0, 10, (N, 3)).astype(dtype)
    values[rng.random((N, 3)) < 0.4] = np.nan
    values[rng.random((N, 3)) < 0.05] = np.inf
    attributes = {"one": values[:, 0].copy(), "three": values}
    found, want = attribute_averages(attributes, *groups, least), slow_averages(attributes, *groups, least)
    for name, array in found.items():
        assert array.dtype == dtype and array.shape == (GROUPS, *attributes[name].shape[1:])
        np.testing.assert_allclose(array, want[name], rtol=1e-15 if dtype == "f8" else 1e-6, equal_nan=True)


@pytest.mark.parametrize("dtype", [name for name in DTYPES if name[0] != "f"])
def test_means_of_whole_numbers(rng, groups, dtype):
    limits = np.iinfo(dtype)
    attributes = {"all": rng.integers(limits.min, limits.max, (N, 2), dtype, endpoint=True)}
    attributes["near"] = attributes["all"][:, 0] // 4
    found, want = attribute_averages(attributes, *groups), slow_averages(attributes, *groups, 0.5)
    for name, array in found.items():
        assert array.dtype == dtype
        away = np.abs(array.astype(float) - want[name].astype(float))
        assert (away <= (1 if limits.bits < 64 else 2.0**13)).all()
        if limits.bits < 64:  # sums of at most a few rows are exact: only halves may round either way
            np.testing.assert_array_equal(array, want[name])


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("value", [3, 0.1, 2**53 + 1])
def test_equal_values_stay_exact(dtype, value):
    value = np.array([value]).astype(np.float64 if isinstance(value, float) else np.int64).astype(dtype)
    values = np.concatenate([np.tile(value, 60), np.arange(60).astype(dtype)])
    starts = np.array([0, 1, 4, 10, 33])
    found = attribute_averages({"a": np.stack([values, values], axis=1)}, np.arange(60), starts)["a"]
    assert found.dtype == dtype and (found == value).all()


@pytest.mark.parametrize("dtype", ["?", "u1", "i8", "f4"])
def test_categories_take_the_commonest(rng, groups, dtype):
    values = rng.choice([0, 1] if dtype == "?" else [2, 6, 9], N).astype(dtype)
    attributes = {"kind": values}
    found = attribute_averages(attributes, *groups)["kind"]
    assert found.dtype == dtype
    np.testing.assert_array_equal(found, slow_averages(attributes, *groups, 0.5)["kind"])


@pytest.mark.parametrize("name", ["classification", "point_source_id", "scan", "scalar_Classification"])
def test_labels_are_never_averaged_however_many(rng, groups, name):
    attributes = {name: rng.integers(0, 5000, N).astype(np.uint16)}
    found = attribute_averages(attributes, *groups)[name]
    np.testing.assert_array_equal(found, slow_averages(attributes, *groups, 0.5)[name])
    assert np.isin(found, attributes[name]).all()


def test_bools_of_several_columns_become_the_majority():
    values = np.array([[1, 0], [1, 0], [0, 1], [1, 1]], np.bool_)
    found = attribute_averages({"flags": values}, np.arange(4), np.array([0, 3]))["flags"]
    assert found.dtype == np.bool_ and found.tolist() == [[True, False], [True, True]]


def test_among_equally_common_categories_the_least_wins():
    rows, starts = np.array([5, 2, 2, 5, 9, 7]), np.array([0, 4, 5])
    assert commonest(rows, starts).tolist() == [2, 9, 7]


@pytest.mark.long
def test_a_subsample_and_levels_keep_classes_and_dtypes(rng):
    points = pr.procedural("torus", 6000)
    kinds = {
        "classification": np.where(points.positions[:, 2] > 0, 6, 2).astype(np.uint8),
        "intensity": rng.integers(0, 60_000, 6000).astype(np.uint16),
        "gps_time": 3e8 + 1e-7 * np.arange(6000),
        "withheld": points.positions[:, 0] > 0.3,
        "scan": (np.arange(6000) % 300).astype(np.int32),
    }
    points = points.changed(attributes=kinds)
    model = pr.Model(points)
    model.make_levels()
    for fewer in (pr.subsample(points, count=500)[0], *(level.points for level in model.levels)):
        assert {name: values.dtype for name, values in fewer.attributes.items()} == {
            name: values.dtype for name, values in kinds.items()
        }
        assert set(np.unique(fewer.attributes["classification"])) == {2, 6}
        low, high = kinds["gps_time"].min(), kinds["gps_time"].max()
        assert (fewer.attributes["gps_time"] >= low).all() and (fewer.attributes["gps_time"] <= high).all()


def column(rng, name):
    return {
        "classes": rng.integers(0, 9, 5000),
        "many": rng.integers(0, 900, 5000),
        "33": np.arange(5000) % 33,
        "32": np.arange(5000) % 32,
        "halves": rng.integers(0, 9, 5000) / 2,
        "whole floats": rng.integers(0, 9, 5000) * 1.0,
        "not finite": np.where(np.arange(5000) == 4000, np.nan, 3.0),
        "few rows": np.arange(200) % 30,
        "bools": rng.random(5000) < 0.5,
        "classification": rng.integers(0, 5000, 5000),
        "scalar_Classification": rng.integers(0, 99, 5000) * 1.0,
        "pairs": rng.integers(0, 3, (5000, 2)),
    }[name]


@pytest.mark.parametrize(
    "name",
    [
        *("classes", "many", "33", "32", "halves", "whole floats", "not finite", "few rows", "bools"),
        *("classification", "scalar_Classification", "pairs"),
    ],
)
def test_categories_are_found_chunk_by_chunk(rng, name):
    values = column(rng, name)
    chunks = [values[start : start + 700] for start in range(0, len(values), 700)]
    assert have_categories(name, iter(chunks)) == has_categories(name, values)
    assert not have_categories(name, iter([]))
    assert have_categories("classes", [column(rng, "classes")])
