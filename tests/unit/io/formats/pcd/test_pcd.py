import struct
import warnings

import numpy as np
import pytest

from helpers.pcd_files import COLUMNS, ENCODINGS, NORMALS, PACKED, RGB, XYZ, N, header, packed_by_lzf, save
from helpers.places import shared_model
from pointray.io.files import read
from pointray.io.formats.pcd import pcd
from pointray.io.formats.pcd._lzf import unpack


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("rows", [1 << 20, 7])
def test_every_encoding_gives_all_fields_with_their_types(tmp_path, monkeypatch, encoding, rows):
    monkeypatch.setattr(pcd, "CHUNK", rows)
    points = read(save(tmp_path / "a.pcd", encoding=encoding))
    np.testing.assert_array_equal(points.positions, XYZ)
    np.testing.assert_array_equal(points.normals, NORMALS)
    np.testing.assert_array_equal(points.colors, RGB)
    assert list(points.attributes) == ["ring", "label", "timestamp", "stamp", "fpfh"]
    for name, values in points.attributes.items():
        assert values.dtype == COLUMNS[name].dtype
        np.testing.assert_array_equal(values, COLUMNS[name])
    assert points.georeference.stations == ()


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_padding_is_left_out(tmp_path, encoding):
    columns = {"_1": np.zeros((N, 3), np.uint8), "z": XYZ[:, 2], "x": XYZ[:, 0], "_2": RGB[:, 0], "y": XYZ[:, 1]}
    points = read(save(tmp_path / "a.pcd", columns, encoding))
    np.testing.assert_array_equal(points.positions, XYZ)
    assert points.attributes == {}


def test_packed_data_may_contain_the_padding(tmp_path):
    columns = {"x": XYZ[:, 0], "_1": RGB, "y": XYZ[:, 1], "z": XYZ[:, 2]}
    data = packed_by_lzf(raw := b"".join(np.ascontiguousarray(c).tobytes() for c in columns.values()))
    text = header(columns, "binary_compressed").encode()
    (tmp_path / "a.pcd").write_bytes(text + struct.pack("<II", len(data), len(raw)) + data)
    np.testing.assert_array_equal(read(tmp_path / "a.pcd").positions, XYZ)


@pytest.mark.parametrize("encoding", ["ascii", "binary"])
@pytest.mark.parametrize(
    ("name", "column"),
    [
        ("rgb", (PACKED & 0x7FFFFF).view(np.float32)),  # the bits of a float, without alpha
        ("rgb", (PACKED & 0x7FFFFF).astype(np.float32)),  # the number as a float
        ("rgba", PACKED | 0xFF000000),
        ("rgba", (PACKED | 0xFF000000).view(np.int32)),
    ],
)
def test_packed_colours_are_unpacked(tmp_path, encoding, name, column):
    columns = {**dict(zip("xyz", XYZ.T, strict=True)), name: column}
    points = read(save(tmp_path / "a.pcd", columns, encoding))
    expected = RGB & [127, 255, 255] if column.dtype == np.float32 else RGB
    np.testing.assert_array_equal(points.colors, expected)
    assert points.attributes == {}


@pytest.mark.parametrize("encoding", ["ascii", "binary"])
def test_points_without_a_packed_colour_are_grey(tmp_path, encoding):
    """One NaN means no colour; others are colours of alpha 255, whose bits a text does not preserve."""
    bits = np.full(len(XYZ), 0x00102030, np.uint32)
    bits[3], bits[5:] = 0x7FC00000, 0xFFC01122 if encoding == "binary" else 0x00C01122
    path = save(tmp_path / "a.pcd", {**dict(zip("xyz", XYZ.T, strict=True)), "rgba": bits.view(np.float32)}, encoding)
    with pytest.warns(UserWarning, match=r"a.pcd: 1 points without a colour \(NaN\) are set to grey"):
        colors = read(path).colors
    assert colors[2:6].tolist() == [[16, 32, 48], [128] * 3, [16, 32, 48], [192, 17, 34]]


@pytest.mark.parametrize("encoding", ["ascii", "binary"])
def test_types_may_be_in_lower_case(tmp_path, encoding):
    columns = {**dict(zip("xyz", XYZ.T, strict=True)), "ring": np.arange(len(XYZ), dtype=np.uint16)}
    points = read(save(tmp_path / "a.pcd", columns, encoding, TYPE="f f F u"))
    np.testing.assert_array_equal(points.positions, XYZ)
    np.testing.assert_array_equal(points.attributes["ring"], columns["ring"])


def test_a_packed_colour_written_as_a_whole_number_in_a_field_of_floats_is_exact(tmp_path):
    columns = {**dict(zip("xyz", XYZ.T, strict=True)), "rgb": PACKED | 0xFF000000}
    path = save(tmp_path / "a.pcd", columns, "ascii", TYPE="F F F F")
    np.testing.assert_array_equal(read(path).colors, RGB)


def test_separate_colours_and_short_names_of_normals(tmp_path):
    columns = dict(zip(("x", "y", "z", "nx", "ny", "nz"), [*XYZ.T, *NORMALS.T], strict=True))
    columns |= dict(zip("rgb", RGB.T, strict=True))
    points = read(save(tmp_path / "a.pcd", columns))
    np.testing.assert_array_equal(points.normals, NORMALS)
    np.testing.assert_array_equal(points.colors, RGB)


@pytest.mark.parametrize(
    ("viewpoint", "stations"),
    [
        ("0 0 0 1 0 0 0", ()),
        ("0 0 0 0 0 0 0", ()),
        ("1 2.5 -3 1 0 0 0", ((1.0, 2.5, -3.0),)),
        ("0 0 0 0.7 0.7 0 0", ((0.0, 0.0, 0.0),)),
        ("nan 0 0 1 0 0 0", ()),
        (None, ()),
    ],
)
def test_the_viewpoint_becomes_a_station_and_does_not_move_points(tmp_path, viewpoint, stations):
    points = read(save(tmp_path / "a.pcd", VIEWPOINT=viewpoint))
    assert points.georeference.stations == stations
    np.testing.assert_array_equal(points.positions, XYZ)


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_organised_clouds_keep_rows_without_a_return(tmp_path, encoding):
    xyz = XYZ.copy()
    xyz[::3] = np.nan
    columns = dict(zip("xyz", xyz.T, strict=True))
    points = read(save(tmp_path / "a.pcd", columns, encoding, WIDTH=12, HEIGHT=5))
    np.testing.assert_array_equal(points.positions, xyz)


def test_old_headers_with_missing_lines_are_read(tmp_path):
    columns = dict(zip("xyz", XYZ.T, strict=True))
    lacking = {"FIELDS": None, "SIZE": None, "TYPE": None, "COUNT": None, "HEIGHT": None, "VERSION": "0.5"}
    path = save(tmp_path / "a.pcd", columns, "ascii", **lacking)
    path.write_bytes(path.read_bytes().replace(b"VERSION 0.5", b"VERSION 0.5\nCOLUMNS x y z\n# a comment\n"))
    np.testing.assert_array_equal(read(path).positions, XYZ)
    save(path, columns, WIDTH=0, HEIGHT=0)
    assert len(read(path)) == N
    save(path, columns, POINTS=None)
    assert len(read(path)) == N


def test_contents_decide_and_line_ends_do_not_matter(tmp_path):
    path = save(tmp_path / "a.xyz", encoding="ascii")
    path.write_bytes(path.read_bytes().replace(b"\n", b"\r\n").replace(b" ", b"\t", 4))
    np.testing.assert_array_equal(read(path).positions, XYZ)


def test_zeros_behind_the_data_are_ignored(tmp_path):
    path = save(tmp_path / "a.pcd")
    path.write_bytes(path.read_bytes() + bytes(4000))
    assert len(read(path)) == N


SIMPLE = dict(zip("xyz", XYZ.T, strict=True))


@pytest.mark.parametrize(
    ("encoding", "lines", "message"),
    [
        ("binary", {"POINTS": N + 1}, "line 10: 61 points announced, but WIDTH x HEIGHT is 60 x 1"),
        ("binary", {"POINTS": N + 1, "WIDTH": N + 1}, "cut off: 61 points of 12 bytes or more expected, 720 bytes"),
        ("binary", {"POINTS": N - 1, "WIDTH": N - 1}, "has 12 more bytes"),
        ("binary", {"POINTS": 10**14, "WIDTH": 10**14}, "cut off"),
        ("ascii", {"POINTS": N + 1, "WIDTH": N + 1}, "cut off: 61 points expected, 60 found"),
        ("ascii", {"POINTS": N - 1, "WIDTH": N - 1}, "line 71: more points follow than the 59"),
        ("ascii", {"POINTS": 10**14, "WIDTH": 10**14}, "cut off"),
        ("binary_compressed", {"POINTS": N - 1, "WIDTH": N - 1}, "720 decompressed bytes announced, but 59 points"),
        ("binary", {"POINTS": 0, "WIDTH": 0}, "contains no points"),
        ("binary", {"POINTS": None, "WIDTH": None, "HEIGHT": None}, "neither POINTS nor WIDTH found"),
        ("binary", {"POINTS": "-5"}, "line 10: '-5' is not an integer"),
        ("binary", {"SIZE": "4 4"}, "line 4: SIZE has 2 values for 3 fields"),
        ("binary", {"SIZE": "4 4 3"}, "line 5: the field 'z' has an unknown type: 'F 3'"),
        ("binary", {"TYPE": "F F Q"}, "line 5: the field 'z' has an unknown type: 'Q 4'"),
        ("binary", {"COUNT": "1 1 0"}, "columns x, y, z not found; available: x, y"),
        ("binary", {"COUNT": "0 0 0"}, "columns x, y, z not found; available: none"),
        ("binary", {"COUNT": "1 1 999999999999999"}, "cut off"),
        ("binary", {"FIELDS": "x y y"}, "line 3: duplicate field 'y'"),
        ("binary", {"FIELDS": "x y w"}, "columns x, y, z not found; available: x, y, w"),
        ("binary", {"FIELDS": None}, "line FIELDS not found"),
        ("binary", {"DATA": "binary_zip"}, "line 11: got data 'binary_zip'"),
        ("binary", {"DATA": None}, "cut off: line 'DATA' not found"),
        ("binary", {"VIEWPOINT": "0 0 0 1"}, "line 9: VIEWPOINT must be 7 numbers"),
        ("binary", {"HEIGHT": "1\nFOO 3"}, "line 9: 'FOO 3' is not valid in a PCD header"),
    ],
)
def test_invalid_headers_are_refused(tmp_path, encoding, lines, message):
    path = save(tmp_path / "a.pcd", SIMPLE, encoding, **lines)
    with pytest.raises(ValueError, match=message) as caught:
        read(path, strict=True)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("rows", [1 << 20, 5])
@pytest.mark.parametrize(
    ("line", "message"),
    [("1 2 x", "line 20: could not convert string 'x' to float32"), ("1 2", "line 20: .* 3 columns but 2")],
)
def test_errors_in_text_name_the_line(tmp_path, monkeypatch, rows, line, message):
    monkeypatch.setattr(pcd, "CHUNK", rows)
    path = save(tmp_path / "a.pcd", SIMPLE, "ascii")
    lines = path.read_text().split("\n")
    path.write_text("\n".join([*lines[:19], line, *lines[20:]]))
    with pytest.raises(ValueError, match=message):
        read(path)


@pytest.mark.parametrize("size", [0, 1, 2, 31, 32, 33, 300, 9000])
@pytest.mark.parametrize("letters", [1, 3, 256])
def test_lzf_gives_back_what_was_packed(rng, size, letters):
    data = rng.integers(0, letters, size).astype(np.uint8)
    packed = np.frombuffer(packed_by_lzf(data.tobytes()), np.uint8).copy()
    np.testing.assert_array_equal(unpack(packed, size, 0), data)


@pytest.mark.parametrize(
    ("packed", "size", "message"),
    [
        ([2, 1, 2], 3, "byte 1,001: the compressed data end within a run"),
        ([0x20], 3, "end within a run"),
        ([0xE0, 4], 9, "end within a run"),
        ([0, 1, 0x20, 1], 4, "byte 1,004: the compressed data refer to bytes before their beginning"),
        ([0, 1, 0x20, 0], 3, "contain more than announced"),
        ([3, 1, 2, 3, 4], 3, "contain more than announced"),
        ([3, 1, 2, 3, 4], 5, "5 decompressed bytes expected, 4 found"),
        ([0, 1], 2**31, "2 compressed bytes cannot contain 2,147,483,648"),
    ],
)
def test_damaged_lzf_is_refused(packed, size, message):
    with pytest.raises(ValueError, match=message):
        unpack(np.array(packed, np.uint8), size, 1000)


def test_mutated_files_are_read_whole_or_refused(rng, tmp_path):
    path = tmp_path / "a.pcd"
    texts = [save(path, encoding=encoding).read_bytes() for encoding in ENCODINGS]
    refused = 0
    for k in range(150):
        data = bytearray(texts[k % 3])
        at = int(rng.integers(0, 500 if k % 2 else len(data)))
        change = rng.integers(0, 4)
        if change == 0:
            del data[at:]
        elif change == 1:
            data[at] ^= 1 << int(rng.integers(0, 8))
        elif change == 2:
            del data[at : at + int(rng.integers(1, 9))]
        else:
            data[at:at] = bytes(rng.integers(0, 256, int(rng.integers(1, 9))).astype(np.uint8))
        path.write_bytes(data)
        try:
            assert len(read(path, strict=True)) == N
        except ValueError as error:
            refused += 1
            assert "\n" not in str(error)
    assert refused > 50


def fields_of(path):
    """Return columns by name: a minimal independent parser of binary and ascii files."""
    data = path.read_bytes()
    end = data.index(b"\n", data.index(b"\nDATA ") + 1) + 1
    lines = dict(line.split(None, 1) for line in data[:end].decode().splitlines() if line[0] != "#")
    names = lines["FIELDS"].split()
    types = [t.lower() + s for t, s in zip(lines["TYPE"].split(), lines["SIZE"].split(), strict=True)]
    if lines["DATA"] == "ascii":
        return dict(zip(names, np.array([row.split() for row in data[end:].splitlines()], float).T, strict=True))
    rows = np.frombuffer(data[end:], list(zip(names, types, strict=True)), int(lines["POINTS"]))
    return {name: rows[name] for name in names}


@pytest.mark.scans
@pytest.mark.parametrize("name", ["Zaghetto_binary", "bun0_ascii", "colored_cloud"])
def test_files_of_other_programs_are_read(name):
    path = shared_model(f"raw/{name}.pcd")
    columns, points = fields_of(path), read(path)
    for k, axis in enumerate("xyz"):
        np.testing.assert_array_equal(points.positions[:, k], columns.pop(axis).astype(np.float32))
        normal = columns.pop(f"normal_{axis}", None)
        assert (normal is None) == (points.normals is None)
        if normal is not None:
            np.testing.assert_array_equal(points.normals[:, k], normal.astype(np.float32))
    if "rgb" in columns:
        packed = np.ascontiguousarray(columns.pop("rgb"))
        np.testing.assert_array_equal(points.colors, packed.view(np.uint8).reshape(-1, 4)[:, 2::-1])
    assert points.attributes.keys() == columns.keys()
    for attribute, values in points.attributes.items():
        np.testing.assert_array_equal(values, columns[attribute].astype(np.float32))


def test_valid_files_cause_no_warning(tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for encoding in ENCODINGS:
            read(save(tmp_path / "a.pcd", encoding=encoding))
