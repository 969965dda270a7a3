"""PTX: the matrix and position of each scan, and rows without a return."""

import random
import warnings

import numpy as np
import pytest

from helpers.places import shared_model
from helpers.ptx_files import FIRST, SECOND, TURNED, UNMOVED, save, scan
from helpers.text_files import mutated
from pointray.cloud.georeference import SCAN
from pointray.io.files import headers, read
from pointray.io.formats._source import Request


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("last", [True, False])
def test_scans_are_placed_by_their_matrices(tmp_path, end, last):
    text = (FIRST + SECOND).replace("\n", end)
    path = save(tmp_path, text if last else text.rstrip())
    points = read(path)
    np.testing.assert_array_equal(points.world, [[10, 21, 30], [9, 20, 30], [10, 20, 31], [5, 6, 7], [8, 9, 10]])
    assert points.attributes[SCAN].tolist() == [0, 0, 0, 1, 1]
    assert points.attributes["intensity"].dtype == np.float32
    assert points.georeference.stations == ((10, 20, 30), (0, 0, 0))
    assert points.colors is None
    assert next(headers(path))[2].facts["scans"] == [{"columns": 2, "rows": 2}, {"columns": 1, "rows": 2}]


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_files_that_are_cut_off_anywhere_are_read_or_refused(tmp_path, end):
    text = (FIRST + SECOND).replace("\n", end)
    for size in range(len(text)):
        path = save(tmp_path, text[:size])
        try:
            with warnings.catch_warnings(record=True):
                warnings.simplefilter("always")
                count = len(read(path))
        except ValueError as error:
            assert str(error).startswith(str(path)) and "\n" not in str(error)
        else:
            assert 0 < count <= 5


def test_a_single_scan_has_no_scan_numbers(tmp_path):
    path = save(tmp_path, FIRST)
    points = read(path)
    assert set(points.attributes) == {"intensity"}
    assert points.georeference.stations == ((10, 20, 30),)
    with next(headers(path))[1].open(path, Request()) as source:
        list(source.chunks())
        assert source.listing.facts["without_return"] == 1


def test_large_numbers_keep_precision_and_transposed_matrices_are_recognised(tmp_path):
    """Coordinates of millions of metres keep float64 precision; a transposed matrix has the last row 0 0 0 1."""
    matrix = "1 0 0 500000.125\n0 1 0 5400000.5\n0 0 1 7\n0 0 0 1\n"
    points = read(save(tmp_path, scan(2, 1, matrix, "0.0625 0 1 1", "-0.0625 2 1 1")))
    np.testing.assert_array_equal(points.world, [[500000.1875, 5400000.5, 8], [500000.0625, 5400002.5, 8]])


def test_scans_with_and_without_colours_are_joined(tmp_path):
    colored = scan(1, 2, UNMOVED, "1 2 3 1 255 0 7", "4 5 6 1 0 8 9")
    assert read(save(tmp_path, colored)).colors.tolist() == [[255, 0, 7], [0, 8, 9]]
    with pytest.warns(UserWarning, match="1 of 2 scans have no colours"):
        points = read(save(tmp_path, colored + SECOND))
    assert points.colors.tolist() == [[255, 0, 7], [0, 8, 9], [128] * 3, [128] * 3]


@pytest.mark.parametrize(
    ("text", "word"),
    [
        (FIRST[:-8], "is cut off at line 14: scan 1 of 2 x 2 has 3 of 4 rows"),
        (FIRST + SECOND[:-9], "is cut off at line 26: scan 2 of 1 x 2 has 1 of 2 rows"),
        (FIRST + SECOND[:-4], "line 26 has 3 columns, expected 4: '8 9 1'"),
        (FIRST + SECOND[:-8], "scan 2 ends at line 26, '8': 2 rows expected, 1 found"),
        (FIRST + SECOND[:20], "line 19 in the header of scan 2, expected 3 numbers: '0 1'"),
        (FIRST[:30], "in the header of scan 1"),
        (FIRST.replace("0.25", "0,25"), "line 13: '0,25' is not a number: '0 1 0 0,25'"),
        (FIRST.replace("0 1 0 0.25", "0 1 0"), "line 13 has 3 columns, expected 4"),
        (scan(1, 1, UNMOVED, "1 2 3 1 0 0 256"), "invalid colours of scan 1: got 0 to 256, expected 0 to 255"),
        (scan(1, 1, UNMOVED, "1 2 3 1 0 0 0.5"), "line 11: '0.5' is not a whole number"),
        (scan(1, 1, UNMOVED, "1 2 3 1", "4 5 6 1"), "line 12 in the header of scan 2, expected one number"),
        (scan(1, 1, UNMOVED, "1 2 3 1 5"), "line 11 has 5 columns, expected 4 or 7: '1 2 3 1 5'"),
        (scan(10**9, 10**9, UNMOVED, "1 2 3 1"), "is cut off at line 12: .* has 1 of 1,000,000,000,000,000,000 rows"),
        (scan(1, 1, TURNED.replace("0 0 1 0", "0 0 1 7"), "1 2 3 1"), "last column .*, expected 0, 0, 0, 1"),
        (scan(1, 1, UNMOVED.replace("0 0 1 0", "0 0 nan 0"), "1 2 3 1"), "line 9 in the header of scan 1"),
        (scan(0, 5, UNMOVED), "contains no points"),
        (scan(1, 1, UNMOVED, "0 0 0 1"), "contains no points"),
        ("hello\n", "line 1 in the header of scan 1, expected one number: 'hello'"),
    ],
)
def test_errors_are_reported_with_their_line(tmp_path, text, word):
    with pytest.raises(ValueError, match=word) as error:
        read(save(tmp_path, text), strict=True)
    assert "\n" not in str(error.value)


@pytest.mark.scans
def test_a_real_file_agrees_with_numpy():
    """PDAL wrote world coordinates and a default header: there was no scanner at (0, 0, 0)."""
    path = shared_model("raw/1.2-with-color.ptx")
    wanted, points = np.loadtxt(path, skiprows=10), read(path)
    np.testing.assert_allclose(points.world, wanted[:, :3], atol=3e-4, rtol=0)
    np.testing.assert_array_equal(points.attributes["intensity"], wanted[:, 3].astype(np.float32))
    np.testing.assert_array_equal(points.colors, wanted[:, 4:])
    assert points.georeference.stations == ()


def test_damaged_files_are_read_or_refused(tmp_path):
    r = random.Random(7)
    colored = scan(1, 2, UNMOVED, "1 2 3 1 255 0 7", "4 5 6 1 0 8 9")
    for _ in range(100):
        path = save(tmp_path, "")
        path.write_bytes(mutated((FIRST + SECOND + colored).encode(), r))
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                points = read(path)
        except ValueError as error:
            assert "\n" not in str(error)
        else:
            assert 0 < len(points) <= path.stat().st_size
