"""Text with a point in each line: recognition of columns, spellings, and errors."""

import random
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest

from helpers.places import shared_model
from helpers.text_files import INTENSITY, NORMALS, RGB, XYZ, mutated, save
from pointray.io.files import headers, read
from pointray.io.formats._source import MAYBE, NO, SURE
from pointray.io.formats.text import _numbers, text


def warns_of(columns):
    """Expect a warning about columns that are not recognised."""
    return pytest.warns(UserWarning, match="not recognised: read as column_4") if columns else nullcontext()


def columns_of(path):
    return next(headers(path))[2].facts["columns"]


ORDERS = {
    "x y z": (XYZ,),
    "x y z intensity": (XYZ, INTENSITY),
    "x y z r g b": (XYZ, RGB),
    "x y z nx ny nz": (XYZ, NORMALS),
    "x y z intensity r g b": (XYZ, INTENSITY, RGB),
    "x y z r g b intensity": (XYZ, RGB, INTENSITY),
    "x y z nx ny nz intensity": (XYZ, NORMALS, INTENSITY),
    "x y z r g b nx ny nz": (XYZ, RGB, NORMALS),
    "x y z nx ny nz r g b": (XYZ, NORMALS, RGB / 255),
    "x y z intensity r g b nx ny nz": (XYZ, INTENSITY, RGB, NORMALS),
    "x y z nx ny nz r g b intensity": (XYZ, NORMALS, RGB, INTENSITY),
    "x y z column_4 column_5": (XYZ, XYZ[:, :2]),
    "x y z column_4 column_5 column_6": (XYZ, XYZ),
}


def test_colors_of_8_bits_are_likelier_than_of_16(tmp_path):
    strong = 300 + np.arange(len(XYZ))[:, None]
    assert columns_of(save(tmp_path / "a.xyz", XYZ, RGB, strong)) == ["x", "y", "z", "r", "g", "b", "intensity"]
    assert columns_of(save(tmp_path / "b.xyz", XYZ, strong, RGB)) == ["x", "y", "z", "intensity", "r", "g", "b"]


@pytest.mark.parametrize("names", ORDERS)
@pytest.mark.parametrize("separator", [" ", ",", ";", "\t", ", "])
def test_columns_without_names_are_recognised_by_their_values(tmp_path, names, separator):
    path = save(tmp_path / "a.xyz", *ORDERS[names], separator=separator)
    assert columns_of(path) == names.split()
    with warns_of("column_" in names):
        points = read(path)
    np.testing.assert_allclose(points.world, XYZ, atol=1e-5)
    if "nx" in names:
        np.testing.assert_array_equal(points.normals, NORMALS.astype(np.float32))
    if " r" in names:
        np.testing.assert_array_equal(points.colors, RGB)
    if "intensity" in names:
        assert points.attributes["intensity"].dtype == np.int16
        np.testing.assert_array_equal(points.attributes["intensity"], INTENSITY[:, 0])
    if "column_4" in names:
        np.testing.assert_array_equal(points.attributes["column_4"], XYZ[:, 0])


def test_ambiguous_columns_are_refused(tmp_path):
    path = save(tmp_path / "a.txt", XYZ, RGB[::-1, :1], RGB)
    with pytest.raises(ValueError, match=r"cannot be told apart: .*--columns x,y,z.*; the first row is '"):
        read(path)
    assert columns_of(path.rename(tmp_path / "a.pts")) == ["x", "y", "z", "intensity", "r", "g", "b"]
    points = read(tmp_path / "a.pts", columns="X,y,Z,Red,green,blue,Class")
    np.testing.assert_array_equal(points.attributes["classification"], RGB[:, 2])


@pytest.mark.parametrize(
    ("header", "separator"),
    [
        ("//X Y Z R G B Scan_Angle\n", " "),
        ("# made by someone\n# x y z red green blue scan_angle\n", " "),
        ("X;Y;Z;R;G;B;Scan Angle\n", ";"),
        ("x,y,z,r,g,b,scan_angle\n", " "),
        ('"Easting [m]","Northing [m]","Height [m]","R","G","B","Scan Angle"\n', ","),
        ("\ufeffE N H R G B scan_angle\n", "\t"),
        ("//X Y Z R G B Scan_Angle\n50\n", " "),
        ("50\nX Y Z R G B Scan_Angle\n", " "),
    ],
)
def test_headers_name_columns(tmp_path, header, separator):
    path = save(tmp_path / "a.foo", XYZ, RGB, INTENSITY, header=header, separator=separator)
    points = read(path)
    np.testing.assert_array_equal(points.colors, RGB)
    np.testing.assert_array_equal(points.attributes["scan_angle"], INTENSITY[:, 0])


def test_two_columns_with_one_name_are_both_kept(tmp_path):
    (tmp_path / "a.txt").write_text("//X Y Z Scalar_field Scalar_field\n1 2 3 4 5\n")
    assert {k: v.tolist() for k, v in read(tmp_path / "a.txt").attributes.items()} == {
        **{"scalar_field": [4], "scalar_field_5": [5]}
    }


@pytest.mark.parametrize("separator", [";", " ", "\t", "; "])
def test_decimal_commas_are_read(tmp_path, separator):
    path = save(tmp_path / "a.csv", XYZ, RGB, separator=separator, decimal=",")
    np.testing.assert_allclose(read(path).world, XYZ, atol=1e-5)
    assert columns_of(path) == ["x", "y", "z", "r", "g", "b"]


def test_columns_keep_all_their_numbers(tmp_path, monkeypatch, rng):
    """Later rows decide the type of a column too, and whole numbers beyond 2^53 stay exact."""
    monkeypatch.setattr(_numbers, "BLOCK", 1000)
    time = 3e8 + rng.random((50, 1)) * 1e5
    big = np.full((50, 1), 2**53 + 1)
    late = np.append(np.full(49, 7), 70_000)[:, None]
    half = np.append(np.full(49, 7.0), 0.5)[:, None].astype(object)
    half[:49] = 7
    path = save(tmp_path / "a.csv", XYZ, time, big, late, half, header="x,y,z,gpstime,big,late,half\n", separator=",")
    found = read(path).attributes
    np.testing.assert_array_equal(found["gps_time"], time[:, 0])
    assert {name: str(values.dtype) for name, values in found.items()} == {
        **{"gps_time": "float64", "big": "int64", "late": "int32", "half": "float64"}
    }
    assert found["big"][0] == 2**53 + 1
    assert found["late"][-1] == 70_000
    assert found["half"].tolist() == [7.0] * 49 + [0.5]


def test_colours_of_16_bits_are_recognised(tmp_path):
    np.testing.assert_array_equal(read(save(tmp_path / "a.xyz", XYZ, RGB * 257)).colors, RGB)


BAD = {
    "a.txt": [
        ("1 2 3\n4 5 6\n7 8\n", "line 3 has 2 columns, expected 3: '7 8'"),
        ("1 2 3\n4 5 6 7\n", "line 2 has 4 columns, expected 3: '4 5 6 7'"),
        ("# a\n\n1 2 3\n4 5 x\n", "line 4: 'x' is not a number: '4 5 x'"),
        ("1 2 3\n4 5 1_0\n", "line 2: '1_0' is not a number"),
        ("1,5 2,5 3,5\n" * 300 + "1.5 2 3\n", "line 301: '1.5' is not a number"),
        ("1 2 3\n" * 300 + "4,5 5 6\n", "line 301: '4,5' is not a number"),
        ("1,5 2.5 3,5\n", "commas as well as semicolons or blanks: '1,5 2.5 3,5'"),
        ("1,5;2.5;3\n", "ambiguous separators: .*: '1,5;2.5;3'"),
        ('"1,5","2,5","3,5"\n', "decimal commas and commas as separators"),
        ("1 2\n3 4\n", "contains no rows of at least three numbers; it begins with '1 2'"),
        ("hello\nworld\n", "contains no rows of at least three numbers; it begins with 'hello'"),
        ("a b c\n1 2 3\n", "invalid header 'a b c': expected names with x, y, z .*: '1 2 3': name its columns with --"),
        ("x y z l\n1 2 3 tree\n", "column 4 contains 'tree', which is not a number: ignore the column"),
        ("x y x z\n1 2 3 4\n", "duplicate column name 'x'"),
        (" ".join(["1"] * 1001), "1,001 columns, more than 1,000"),
        ("1 2 3\n\0", "begins with"),
    ],
    "a.pts": [
        ("3\n1 2 3\n4 5 6\n", "is cut off: .* announces 3 rows, 2 found"),
        ("1\n1 2 3\n4 5 6\n", "is damaged: .* announces 1 rows, 2 found"),
        ("1\n1 2 3\n2\n4 5 6\n", "is cut off: line 3 announces 2 rows, 1 found"),
        ("1\n1 2 3\nx\n4 5 6\n", "line 3 has 1 column, the previous rows have more: 'x'"),
    ],
    "a.xyz": [("2\nmethane\nC 0 0 0\nH 0 0 1\n", "is a molecule"), ("C 0 0 0\nH 0 0 1\n", "column 1 contains 'C'")],
    "a.asc": [("ncols 2\nnrows 2\n", "is a height grid")],
}


@pytest.mark.parametrize(("name", "content", "word"), [(n, *row) for n, rows in BAD.items() for row in rows])
def test_errors_are_reported_in_one_line(tmp_path, name, content, word):
    (tmp_path / name).write_text(content)
    with pytest.raises(ValueError, match=word) as error:
        read(tmp_path / name, strict=True)
    assert "\n" not in str(error.value)


def test_utf16_is_refused(tmp_path):
    (tmp_path / "a.csv").write_text("1 2 3\n" * 100, "utf-16")
    with pytest.raises(ValueError, match="is encoded in UTF-16: save it as UTF-8"):
        read(tmp_path / "a.csv")


def test_the_number_of_column_names_is_checked(tmp_path):
    path = save(tmp_path / "a.xyz", XYZ, RGB)
    with pytest.raises(ValueError, match="3 columns are named, but the first row has 6: '"):
        read(path, columns="x,y,z")
    points = read(path, columns="-,-,-,z,y,x")
    np.testing.assert_array_equal(points.world, RGB[:, ::-1])
    assert points.attributes == {}


def test_ignored_columns_may_contain_words(tmp_path):
    (tmp_path / "a.txt").write_text("tree 1 2 3\nhouse 4 5 6\n")
    np.testing.assert_array_equal(read(tmp_path / "a.txt", columns="-,x,y,z").world, [[1, 2, 3], [4, 5, 6]])


def test_consecutive_scans_of_pts_are_joined(tmp_path):
    rows = [f"{i} 2 3 -5 0 1 2\n" for i in range(6)]
    (tmp_path / "a.pts").write_text("1\n" + rows[0] + "2\n" + "".join(rows[1:3]) + "3\n" + "".join(rows[3:]))
    np.testing.assert_array_equal(read(tmp_path / "a.pts").positions[:, 0], range(6))


def recognised(content, name="a.foo"):
    return text.recognise(content.encode("latin-1") if isinstance(content, str) else content, Path(name))


def test_other_formats_are_not_recognised_as_text():
    for content in (
        "ply\nformat ascii 1.0\n", "# .PCD v0.7\nFIELDS x y z\nSIZE 4 4 4\n1 2 3\n", "v 1 2 3\nv 4 5 6\n",
        "# cube\nv 1 2 3\n", "OFF\n8 6 12\n1 2 3\n", "COFF\n8 6 12\n1 2 3\n", "solid a\nfacet normal 0 0 1\n",
        "2\n3\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n", "ASTM-E57\0", "<?xml version='1.0'?>\n1 2 3\n", '{"a": [1, 2, 3]}',
        "[1, 2, 3]\n", "1 2 3\n\x00", "LASF\1", "hello\n",
    ):  # fmt: skip
        assert recognised(content) == NO, content
    assert recognised("hello\n", "a.txt") == MAYBE
    for content in ("1 2 3\n", "x,y,z\n1,2,3", "10\n1 2 3 4", "//X Y Z\n1 2 3\n", "# a\n\n1;2;3", "nan nan nan\n"):
        assert recognised(content) == SURE, content


@pytest.mark.scans
def test_real_files_agree_with_numpy():
    path = shared_model("raw/kitten_xyz_normals.xyz")
    wanted, points = np.loadtxt(path), read(path)
    np.testing.assert_array_equal(points.positions, wanted[:, :3].astype(np.float32))
    np.testing.assert_array_equal(points.normals, wanted[:, 3:].astype(np.float32))
    path = shared_model("raw/autzen_tiny.pts")
    wanted, points = np.loadtxt(path, skiprows=1), read(path)
    np.testing.assert_allclose(points.world, wanted[:, :3], atol=2e-5, rtol=0)
    np.testing.assert_array_equal(points.attributes["intensity"], wanted[:, 3])
    np.testing.assert_array_equal(points.colors, wanted[:, 4:])


SEEDS = [
    b"1 2 3\n4 5 6\n-7 8.5 9e3\n" * 9,
    b"27\n" + b"1.5 2 3 -4 255 0 7\n" * 27,
    b"x,y,z,class\n1,2,3,4\n5,6,,8\n" * 1 + b"1,2,3,4\n" * 20,
    b"1,5;2,5;3,5;0;0;255\r\n" * 20,
    b"//X Y Z Nx Ny Nz\n" + b"1 2 3 0 0.6 0.8\n" * 20,
]


@pytest.mark.filterwarnings("ignore:.*(not recognised|column 1|colour)")
def test_damaged_files_are_read_or_refused(tmp_path):
    r = random.Random(5)
    for k in range(200):
        path = tmp_path / f"a{r.choice(['.xyz', '.pts', '.foo'])}"
        path.write_bytes(mutated(SEEDS[k % len(SEEDS)], r))
        try:
            points = read(path, strict=True)
        except ValueError as error:
            assert "\n" not in str(error)
        else:
            assert 0 < len(points) <= path.stat().st_size
