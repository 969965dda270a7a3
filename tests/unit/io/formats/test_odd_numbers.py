"""Unusual spellings of numbers and names, and unusual bytes around the points."""

from __future__ import annotations

import numpy as np
import pytest

from helpers.places import MODELS
from pointray.io.files import read
from pointray.io.formats._odd_numbers import odd_number, plain_lines

CASES = MODELS.parent / "cases"
HEADER = """ply
format ascii 1.0
element {element} {count}
property float {0}
property float {1}
property float {2}
property uchar {3}
property uchar {4}
property uchar {5}
end_header
"""
NAMES = ("x", "y", "z", "red", "green", "blue")
ROWS = "0 1 2 10 20 30\n3 4 5 40 50 60\n"
NAN, INF = float("nan"), float("inf")
SPELLED = {"-nan(ind)": NAN, "nan(snan)": NAN, "1.#QNAN": NAN, "-1.#IND00": NAN, "1.#INF": INF, "-1.#INF0": -INF}


@pytest.mark.parametrize(("word", "value"), SPELLED.items())
def test_nan_and_inf_as_written_by_microsoft_are_read(word, value):
    np.testing.assert_equal(odd_number(word), value)
    np.testing.assert_equal(odd_number(word.lower()), value)
    (line,) = plain_lines([f"1 {word}\t2 {word}\n"])
    np.testing.assert_equal([float(field) for field in line.split()], [1, value, 2, value])


@pytest.mark.parametrize("word", ["nan", "inf", "1.5", "1.#", "nan(", "1.#QNANx", "x1.#IND", "1.#INF(", ""])
def test_other_words_are_not_numbers(word):
    assert odd_number(word) is None
    assert list(plain_lines([word])) == [word]


@pytest.mark.parametrize(("word", "value"), SPELLED.items())
def test_files_with_microsoft_numbers_are_read(tmp_path, word, value):
    rows = [f"{word} 0 1", "2 3 4", "5 6 7"]
    (tmp_path / "a.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
        + "\n".join(rows)
    )
    (tmp_path / "a.pcd").write_text(
        "VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 3\nHEIGHT 1\nPOINTS 3\nDATA ascii\n"
        + "\n".join(rows)
    )
    (tmp_path / "a.xyz").write_text("\n".join([*rows[1:], rows[0]]))
    for name in ("a.ply", "a.pcd"):
        np.testing.assert_equal(read(tmp_path / name).positions, [[value, 0, 1], [2, 3, 4], [5, 6, 7]])
    np.testing.assert_equal(read(tmp_path / "a.xyz").positions, [[2, 3, 4], [5, 6, 7], [value, 0, 1]])


@pytest.mark.parametrize("element", ["vertex", "Vertex", "vertices", "point", "points"])
@pytest.mark.parametrize("spelled", [str.lower, str.upper, str.title])
def test_ply_names_may_have_any_case(tmp_path, element, spelled):
    text = HEADER.format(*map(spelled, NAMES), element=element, count=2) + ROWS
    (tmp_path / "a.ply").write_text(text)
    points = read(tmp_path / "a.ply")
    assert points.positions.tolist() == [[0, 1, 2], [3, 4, 5]]
    assert points.colors.tolist() == [[10, 20, 30], [40, 50, 60]]
    assert points.attributes == {}


def test_lower_case_names_and_vertex_elements_are_preferred(tmp_path):
    text = HEADER.format("X", "y", "z", "x", "Y", "blue", element="points", count=1) + ROWS.splitlines()[0] + "\n"
    (tmp_path / "a.ply").write_text(text)
    points = read(tmp_path / "a.ply")
    assert points.positions.tolist() == [[10, 1, 2]]
    assert sorted(points.attributes) == ["X", "Y", "blue"]
    both = HEADER.format(*NAMES, element="point", count=2).replace(
        "end_header", "element vertex 1\nproperty float x\nproperty float y\nproperty float z\nend_header"
    )
    (tmp_path / "b.ply").write_text(f"{both}{ROWS}7 8 9\n")
    assert read(tmp_path / "b.ply").positions.tolist() == [[7, 8, 9]]


def test_the_error_of_a_ply_file_without_positions_lists_its_names(tmp_path):
    (tmp_path / "a.ply").write_text(HEADER.format("u", "y", "z", *NAMES[3:], element="vertex", count=2) + ROWS)
    with pytest.raises(
        ValueError, match="properties x, y, z of the vertices not found; available: u, y, z, red, green, blue"
    ):
        read(tmp_path / "a.ply")
    (tmp_path / "b.ply").write_text(HEADER.format(*NAMES, element="face", count=2) + ROWS)
    with pytest.raises(ValueError, match="element 'vertex' not found; available: face"):
        read(tmp_path / "b.ply")


@pytest.mark.parametrize("encoding", ["ascii", "binary"])
def test_pcd_fields_without_values_are_ignored(tmp_path, encoding):
    fields = "FIELDS x _ y z _ label\nSIZE 4 1 4 4 1 2\nTYPE F U F F U U\nCOUNT 1 0 1 1 0 1\n"
    head = f"VERSION .7\n{fields}WIDTH 2\nHEIGHT 1\nPOINTS 2\nDATA {encoding}\n".encode()
    rows = np.array([(0, 1, 2, 7), (3, 4, 5, 8)], [(name, "<f4") for name in "xyz"] + [("label", "<u2")])
    body = b"0 1 2 7\n3 4 5 8\n" if encoding == "ascii" else rows.tobytes()
    (tmp_path / "a.pcd").write_bytes(head + body)
    points = read(tmp_path / "a.pcd")
    assert points.positions.tolist() == [[0, 1, 2], [3, 4, 5]]
    assert points.attributes["label"].tolist() == [7, 8]


@pytest.mark.parametrize("end", ["\x1a", "\n\x1a", "\r\n\x1a\r\n", "\n\x1a\x1a\x1a"])
def test_a_trailing_ctrl_z_is_ignored(tmp_path, end):
    (tmp_path / "a.xyz").write_bytes(("0 1 2\n3 4 5" + end).encode())
    assert read(tmp_path / "a.xyz").positions.tolist() == [[0, 1, 2], [3, 4, 5]]


@pytest.mark.skipif(not CASES.exists(), reason="no cases here")
@pytest.mark.parametrize(
    ("name", "count"),
    {
        "pcd_ouster_count0.pcd": 2000,
        "ply_ascii_windows_nan.ply": 1500,
        "pcd_windows_nan_ascii.pcd": 4100,
        "ply_uppercase_xyz.ply": 6500,
        "ply_element_points.ply": 6500,
        "xyz_trailing_junk.xyz": 4100,
    }.items(),
)
def test_small_copies_of_real_files_are_read(name, count):
    assert len(read(CASES / name)) == count
