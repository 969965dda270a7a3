"""Sparse points of COLMAP, text and binary."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from helpers.colmap_files import ERRORS, IDS, RGB, TRACKS, WRITTEN, XYZ, N, binary, text
from pointray.io.files import read
from pointray.io.formats import colmap


@pytest.mark.parametrize("name", WRITTEN)
@pytest.mark.parametrize("chunk", [1 << 18, 7])
def test_all_columns_are_read(tmp_path, monkeypatch, name, chunk):
    monkeypatch.setattr(colmap, "CHUNK", chunk)
    (tmp_path / name).write_bytes(WRITTEN[name]())
    points = read(tmp_path / name)
    np.testing.assert_allclose(points.positions + points.origin, XYZ, rtol=1e-6, atol=1e-6)
    np.testing.assert_array_equal(points.colors, RGB)
    np.testing.assert_array_equal(points.attributes["error"], ERRORS)
    np.testing.assert_array_equal(points.attributes["track_length"], TRACKS)
    np.testing.assert_array_equal(points.attributes["point_id"], IDS)


def test_text_files_are_recognised_by_their_title(tmp_path):
    (tmp_path / "cloud.xyz").write_bytes(text())
    assert len(read(tmp_path / "cloud.xyz")) == N


ONE = "# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK\n"


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("1 0 0 0 1 2 3", "line 2 is invalid, expected id"),
        ("1 0 0 0 1 2 3 0.5 7", "line 2 is invalid, expected id"),
        ("1 0 x 0 1 2 3 0.5", "line 2: could not convert string to float: 'x'"),
        ("1 0 0 0 256 2 3 0.5", "line 2: '256' is not an integer from 0 to 255"),
        ("-1 0 0 0 5 2 3 0.5", "line 2: '-1' is not an integer"),
        ("1 0 0 0 5 2 3.5 0.5", "line 2: '3.5' is not an integer"),
        ("", "contains no points"),
    ],
)
def test_invalid_text_files_are_refused(tmp_path, line, message):
    (tmp_path / "points3D.txt").write_text(ONE + line + "\n")
    with pytest.raises(ValueError, match=message):
        read(tmp_path / "points3D.txt")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (binary()[:-1], "is cut off at point 299 of 300"),
        (binary()[:20_000], "is cut off at point"),
        (binary(N + 1), "is cut off at point 300 of 301"),
        (binary(N - 1), "has .* more bytes after"),
        (binary(1 << 60), "is cut off: 1,152,921,504,606,846,976 points"),
        (bytes(8), "contains no points"),
    ],
)
def test_invalid_binary_files_are_refused(tmp_path, content, message):
    (tmp_path / "points3D.bin").write_bytes(content)
    with pytest.raises(ValueError, match=message):
        read(tmp_path / "points3D.bin", strict=True)


def test_a_track_that_is_too_long_allocates_no_memory(tmp_path):
    content = bytearray(binary())
    content[8 + 43 : 8 + 51] = struct.pack("<Q", (1 << 32) - 1)
    (tmp_path / "points3D.bin").write_bytes(content)
    with pytest.raises(ValueError, match="is cut off at point 0 of 300"):
        read(tmp_path / "points3D.bin")


def test_infinite_points_are_read(tmp_path):
    (tmp_path / "points3D.txt").write_text(ONE + "1 -nan(ind) inf 0 1 2 3 0.5\n2 1 2 3 4 5 6 -1 7 8\n")
    points = read(tmp_path / "points3D.txt")
    np.testing.assert_array_equal(points.finite, [False, True])
    assert points.attributes["track_length"].tolist() == [0, 1]
