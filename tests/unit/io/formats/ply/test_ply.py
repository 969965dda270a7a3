import os
import stat
import struct
import sys

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st
from plyfile import PlyData, PlyElement

from helpers.places import shared_model
from pointray.base.atomic_write import check_writable, replacing
from pointray.cli import BAD_INPUT, execute
from pointray.cloud.points import Points
from pointray.io.files import read, write
from pointray.io.formats._source import CHUNK
from pointray.io.formats.ply import _ascii

XYZ = np.random.default_rng(2).random((50, 3)).astype(np.float32)
RGB = np.random.default_rng(3).integers(0, 256, (50, 3)).astype(np.uint8)


def save(path, columns, text=False, order="<", before=()):
    """Write vertices of the given columns with plyfile."""
    rows = np.empty(50, [(name, column.dtype) for name, column in columns.items()])
    for name, column in columns.items():
        rows[name] = column
    PlyData([*before, PlyElement.describe(rows, "vertex"), faces()], text, order).write(str(path))
    return path


def faces(name="face"):
    rows = np.empty(3, [("vertex_indices", object), ("flag", "u1")])
    rows["vertex_indices"] = [np.array(row, np.int32) for row in ([0, 1, 2], [3, 4, 5, 6], [7])]
    rows["flag"] = 0
    return PlyElement.describe(rows, name, val_types={"vertex_indices": "i4"})


FORMATS = [(True, "="), (False, "<"), (False, ">")]


@pytest.mark.parametrize(("text", "order"), FORMATS)
@pytest.mark.parametrize("dtype", ["f4", "f8", "i2"])
def test_every_format_and_property_order_is_read(tmp_path, text, order, dtype):
    xyz = (XYZ * 100).astype(dtype)
    columns = {
        "blue": RGB[:, 2],
        "z": xyz[:, 2],
        "nz": XYZ[:, 2],
        "intensity": np.arange(50, dtype=np.uint16),
        "nx": XYZ[:, 0],
        "x": xyz[:, 0],
        "green": RGB[:, 1],
        "ny": XYZ[:, 1],
        "y": xyz[:, 1],
        "red": RGB[:, 0],
    }
    points = read(save(tmp_path / "a.PLY", columns, text, order))
    np.testing.assert_array_equal(points.positions, xyz.astype(np.float32))
    np.testing.assert_array_equal(points.normals, XYZ)
    np.testing.assert_array_equal(points.colors, RGB)
    assert list(points.attributes) == ["intensity"]
    np.testing.assert_array_equal(points.attributes["intensity"], np.arange(50))


@pytest.mark.parametrize(("text", "order"), FORMATS)
def test_elements_before_the_vertices_are_skipped(tmp_path, text, order):
    before = [PlyElement.describe(np.zeros(4, [("a", "i2")]), "grid"), faces("strips")]
    points = read(save(tmp_path / "a.ply", dict(zip("xyz", XYZ.T, strict=True)), text, order, before))
    np.testing.assert_array_equal(points.positions, XYZ)
    assert points.normals is None
    assert points.colors is None


@pytest.mark.parametrize(("text", "order"), FORMATS)
def test_lists_among_the_vertices_are_dropped(tmp_path, text, order):
    (tmp_path / "a.ply").write_bytes(with_lists(text, order))
    points = read(tmp_path / "a.ply")
    np.testing.assert_array_equal(points.positions, XYZ)
    assert points.attributes == {}


def with_lists(text, order):
    """Return a file with a list in each vertex; plyfile would write such rows in the wrong byte order."""
    name = "ascii" if text else {"<": "binary_little_endian", ">": "binary_big_endian"}[order]
    header = f"ply\nformat {name} 1.0\nelement first 2\nproperty uchar a\nelement vertex 50\nproperty float x\n"
    header += "property list uchar int near\nproperty float y\nproperty float z\nend_header\n"
    body = b"1\n2\n" if text else b"12"
    for i, (x, y, z) in enumerate(XYZ):
        near = range(i % 4)
        if text:
            body += " ".join(str(value) for value in (x, len(near), *near, y, z)).encode() + b"\n"
        else:
            body += struct.pack(f"{order}fB{len(near)}iff", x, len(near), *near, y, z)
    return header.encode() + body


@pytest.mark.parametrize(
    "names", ["red green blue", "r g b", "diffuse_red diffuse_green diffuse_blue", "scalar_R scalar_G scalar_B"]
)
@pytest.mark.parametrize(
    "colors", [RGB, RGB.astype("u2") * 257, RGB.astype("i4"), (RGB / 255).astype("f4"), RGB.astype("f4")]
)
def test_colors_of_all_types_become_8_bits(tmp_path, names, colors):
    columns = dict(zip(["x", "y", "z", *names.split()], [*XYZ.T, *colors.T], strict=True))
    for text in (False, True):
        np.testing.assert_array_equal(read(save(tmp_path / "a.ply", columns, text)).colors, RGB)


@pytest.mark.parametrize(("text", "order"), FORMATS)
@pytest.mark.parametrize("name", ["rgb", "RGBA"])
@pytest.mark.parametrize("dtype", ["u4", "i4", "f4", "whole f4"])
def test_packed_colors_are_unpacked(tmp_path, text, order, name, dtype):
    """PCL writes the bits 0xAARRGGBB, as an integer, a float of the same bits, or a float of the same value."""
    packed = RGB.astype(np.uint32) @ np.array([1 << 16, 1 << 8, 1], np.uint32) | 1 << 16
    expected = RGB | np.array([1, 0, 0], np.uint8)
    if dtype == "f4" and text:  # text does not preserve the bits of a NaN
        packed, expected = packed & 0x7FFFFF, expected & [127, 255, 255]
    elif dtype != "whole f4":
        packed = packed | 0xFF000000
    column = packed.astype("f4") if dtype == "whole f4" else packed.view(dtype)
    columns = dict(zip(["x", "y", "z", name, "label"], [*XYZ.T, column, RGB[:, 0]], strict=True))
    points = read(save(tmp_path / "a.ply", columns, text, order))
    np.testing.assert_array_equal(points.colors, expected)
    assert list(points.attributes) == ["label"]


def test_points_without_a_packed_color_are_grey(tmp_path):
    column = np.full(50, 0x00102030, np.uint32).view("f4")
    column[7] = np.nan
    path = save(tmp_path / "a.ply", dict(zip(["x", "y", "z", "rgb"], [*XYZ.T, column], strict=True)))
    with pytest.warns(UserWarning, match="1 points without a colour"):
        colors = read(path).colors
    assert colors[7].tolist() == [128] * 3 and colors[8].tolist() == [16, 32, 48]


def test_named_colors_are_preferred_to_packed_ones_and_scalars(tmp_path):
    names = ["x", "y", "z", "red", "green", "blue", "rgb", "scalar_R", "scalar_G", "scalar_B", "scalar_Label"]
    columns = dict(zip(names, [*XYZ.T, *RGB.T, *XYZ.T, *XYZ.T[:2]], strict=True))
    points = read(save(tmp_path / "a.ply", columns))
    np.testing.assert_array_equal(points.colors, RGB)
    assert list(points.attributes) == names[6:]


@pytest.mark.parametrize("line_end", ["\n", "\r\n", "\r"])
def test_headers_of_other_programs_are_read(tmp_path, line_end):
    """Headers have any line end, a comment in Latin-1, and a first byte of data that looks like a line end."""
    lines = [
        "ply",
        "format binary_little_endian 1.0",
        "comment M\xfcnchen",
        "obj_info num_cols 512",
        "element vertex 1",
    ]
    lines += [f"property float {name}" for name in "xyz"] + ["end_header"]
    header = "".join(line + line_end for line in lines).encode("latin-1")
    row = np.array([[1, 2, 3]], "<f4")
    row.view(np.uint8)[0, 0] = 10
    (tmp_path / "a.ply").write_bytes(header + row.tobytes())
    np.testing.assert_array_equal(read(tmp_path / "a.ply").positions, row)


STRIPS = "ply\nformat ascii 1.0\nelement strip 3\nproperty list uchar int near\n{vertices}end_header\n{body}"
PLAIN = "element vertex 2\nproperty float x\nproperty float y\nproperty float z\n"
LISTED = "element vertex 2\nproperty float x\nproperty list uchar int near\nproperty float y\nproperty float z\n"


@pytest.mark.parametrize("line_end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("blank", ["", "\n", " \t\n\n"])
@pytest.mark.parametrize("vertices", [(PLAIN, "1 2 3", "4 5 6"), (LISTED, "1 0 2 3", "4 2 8 9 5 6")])
def test_ascii_rows_before_the_vertices_may_have_any_line_end_and_blank_lines(tmp_path, line_end, blank, vertices):
    """Rows of strips have three numbers: if one row too few were skipped, it would be read as a vertex."""
    header, *rows = vertices
    body = blank + blank.join(f"{line}\n" for line in ("2 7 8", "2 7 8", "2 7 8", *rows))
    (tmp_path / "a.ply").write_bytes(STRIPS.format(vertices=header, body=body).replace("\n", line_end).encode())
    np.testing.assert_array_equal(read(tmp_path / "a.ply").positions, [[1, 2, 3], [4, 5, 6]])


@pytest.mark.parametrize("block", [1, 2, 3, 7])
def test_ascii_may_be_split_into_blocks_anywhere(tmp_path, monkeypatch, block):
    monkeypatch.setattr(_ascii, "TEXT_BYTES", block)
    monkeypatch.setattr(_ascii, "CHUNK", 1)
    for line_end in ("\n", "\r\n", "\r"):
        text = STRIPS.format(vertices=PLAIN, body="\n2 7 8\n \n2 7 8\n2 7 8 \n\n 1 2 3\n4 5 6")
        (tmp_path / "a.ply").write_bytes(text.replace("\n", line_end).encode())
        np.testing.assert_array_equal(read(tmp_path / "a.ply").positions, [[1, 2, 3], [4, 5, 6]])


def test_all_rows_decide_the_range_of_colors(tmp_path, monkeypatch):
    monkeypatch.setattr(_ascii, "CHUNK", 2)
    names = [*(f"float {x}" for x in "xyz"), *(f"uchar {x}" for x in ("red", "green", "blue"))]
    header = ["ply", "format ascii 1.0", "element vertex 4", *(f"property {name}" for name in names), "end_header"]
    rows = ["0 0 0 1 1 1", "1 0 0 0 0 0", "0 1 0 0.5 0.5 0.5", "0 0 1 1 1 1", ""]
    (tmp_path / "a.ply").write_text("\n".join([*header, *rows]))
    assert read(tmp_path / "a.ply").colors[:, 0].tolist() == [255, 0, 128, 255]


def with_strips(count, order="<", kind="uchar", before=1, last=b""):
    """A binary file with lists before its one vertex, and the bytes of the lists."""
    name = {"<": "binary_little_endian", ">": "binary_big_endian"}[order]
    header = f"ply\nformat {name} 1.0\nelement strip {before}\nproperty list {kind} short near\nelement vertex 1\n"
    header += "property float x\nproperty float y\nproperty float z\nend_header\n"
    return header.encode() + count + struct.pack(f"{order}fff", 1, 2, 3) + last


KINDS = {"char": "b", "uchar": "B", "short": "h", "ushort": "H", "int": "i", "uint": "I", "float": "f", "double": "d"}


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("kind", KINDS)
def test_list_lengths_may_have_any_type(tmp_path, order, kind):
    for length in (0, 1, 2, 3, 100):
        rows = struct.pack(f"{order}{KINDS[kind]}", length) + bytes(2 * length)
        (tmp_path / "a.ply").write_bytes(with_strips(rows, order, kind))
        np.testing.assert_array_equal(read(tmp_path / "a.ply").positions, [[1, 2, 3]])


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize(
    ("kind", "length"),
    [(k, x) for k in ("float", "double") for x in (np.inf, -np.inf, np.nan, 1e30, -1, 0.5, 2.5, 2.0**53)]
    + [("char", -1), ("short", -3), ("int", -(2**31)), ("uchar", 255), ("uint", 2**32 - 1)],
)
def test_invalid_list_lengths_are_reported(tmp_path, capsys, order, kind, length):
    path = tmp_path / "a.ply"
    path.write_bytes(with_strips(struct.pack(f"{order}{KINDS[kind]}", length), order, kind))
    with pytest.raises(ValueError, match="invalid list length|is cut off"):
        read(path)
    assert execute(["info", str(path)]) == BAD_INPUT
    assert len(capsys.readouterr().err.splitlines()) == 1


@pytest.mark.parametrize("length", ["inf", "nan", "1e30", "-1", "1.5", "x", "3"])
def test_invalid_list_lengths_in_ascii_are_reported(tmp_path, length):
    (tmp_path / "a.ply").write_text(STRIPS.format(vertices=LISTED, body=f"0\n0\n0\n1 {length} 2 3\n1 0 2 3\n"))
    with pytest.raises(ValueError, match="invalid list length|vertex 0 does not match|'x'"):
        read(tmp_path / "a.ply")


def calls_in(work):
    """Return the number of function calls, Python or compiled, made to read the file."""
    count = 0

    def see(frame, event, argument):
        nonlocal count
        count += event in ("call", "c_call")

    before = sys.getprofile()
    sys.setprofile(see)
    try:
        work()
    finally:
        sys.setprofile(before)
    return count


@pytest.mark.parametrize("text", [False, True])
@pytest.mark.parametrize("row", [b"\0", b"\2abcd"])
def test_rows_before_the_vertices_are_skipped_in_compiled_code(tmp_path, text, row):
    """A hundred thousand rows need as many calls as ten."""
    counts = []
    for n in (10, 10, 100_000):  # the first call compiles
        content = with_strips(row * n, before=n)
        if text:
            body = "0\n" * n if row == b"\0" else "2 25185 25699\n" * n
            content = STRIPS.replace(" 3\n", f" {n}\n").format(vertices=PLAIN, body=body + "1 2 3\n1 2 3\n").encode()
        (tmp_path / "a.ply").write_bytes(content)
        counts.append(calls_in(lambda: read(tmp_path / "a.ply")))
        np.testing.assert_array_equal(read(tmp_path / "a.ply").positions[0], [1, 2, 3])
    assert counts[2] < counts[1] + 100


def test_map_coordinates_keep_their_precision(tmp_path):
    world = XYZ.astype(np.float64) + [637369.0, 5851979.0, 406.0]
    points = read(save(tmp_path / "a.ply", dict(zip("xyz", world.T, strict=True))))
    assert np.abs(points.world - world).max() < 1e-7


def test_writing_and_reading_gives_the_same(tmp_path):
    attributes = {"intensity": XYZ[:, 0], "uv": XYZ[:, :2]}
    near, far = (Points(XYZ + shift, XYZ, RGB, attributes) for shift in ([0, 0, 0], [5e6, 0, 0]))
    for points in (near, far):
        write(tmp_path / "a.ply", points)
        again = read(tmp_path / "a.ply")
        np.testing.assert_array_equal(again.world, points.world)
        np.testing.assert_array_equal(again.normals, XYZ)
        np.testing.assert_array_equal(again.colors, RGB)
        np.testing.assert_array_equal(again.attributes["intensity"], XYZ[:, 0])
        np.testing.assert_array_equal(again.attributes["uv_1"], XYZ[:, 1])
    assert [path.name for path in tmp_path.iterdir()] == ["a.ply"]


def test_plyfile_reads_written_files(tmp_path):
    write(tmp_path / "a.ply", Points(XYZ, colors=RGB))
    vertex = PlyData.read(str(tmp_path / "a.ply"))["vertex"]
    assert [str(p) for p in vertex.properties] == [
        *(f"property float {name}" for name in "xyz"),
        *(f"property uchar {name}" for name in ("red", "green", "blue")),
    ]
    np.testing.assert_array_equal(vertex["y"], XYZ[:, 1])


# ------------------------------------------------------------------------------------------------- what goes wrong


HEADER = "ply\nformat {format} 1.0\nelement vertex {count}\n"
HEADER += "property float x\nproperty float y\nproperty float z\nend_header\n"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "is empty"),
        (b"\x89PNG\r\n\x1a\n" + bytes(range(256)), "invalid PLY file"),
        (b"ply\n" + bytes(range(256)) * 4, "line 'end_header' not found"),
        (b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\n", "line 'end_header' not found"),
        (b"ply\nformat ascii 1.0\nelement face 0\nend_header\n", "element 'vertex' not found.*face"),
        (b"ply\nformat ascii 1.0\nelement vertex -3\nproperty float x\nend_header\n", "element vertex -3"),
        (b"ply\nformat weird 1.0\nelement vertex 3\nproperty float x\nend_header\n", "invalid header"),
        (b"ply\nformat ascii 1.0\nelement vertex 3\nproperty half x\nend_header\n", "invalid header.*half"),
        (
            b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float a\nend_header\n1\n2\n3\n",
            "properties x, y, z of the vertices not found; available: a",
        ),
        (HEADER.format(format="ascii", count=0), "0 vertices"),
        (HEADER.format(format="binary_little_endian", count=10**14) + "abc", "is cut off"),
        (HEADER.format(format="ascii", count=10**14) + "1 2 3\n", "is cut off"),
        (HEADER.format(format="binary_little_endian", count=2) + "0" * 23, "cut off: 2 vertices of 12 bytes"),
        (HEADER.format(format="ascii", count=2) + "1 2 3\n\n\n\n\n\n\n\n\n\n", "2 lines of 3 numbers.*1 of 3"),
        (HEADER.format(format="ascii", count=2) + " " * 99, "2 lines of 3 numbers"),
        (HEADER.format(format="ascii", count=2) + "1 2 3\n4 5 six\n", "six"),
        (HEADER.format(format="ascii", count=2) + "1 2 3 4\n4 5 6 7\n", "2 of 4"),
        (HEADER.format(format="ascii", count=2) + "nan nan nan\nnan 0 0\n", "none of the 2 rows is finite"),
    ],
)
def test_damaged_files_are_named_with_the_reason_in_one_line(tmp_path, content, message):
    path = tmp_path / "damaged.ply"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(ValueError, match=message) as caught:
        read(path, strict=True)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


@pytest.fixture(scope="module")
def valid(tmp_path_factory):
    """A small file of each kind as bytes (the last has a list in each vertex), and a path for damaged ones."""
    path = tmp_path_factory.mktemp("fuzz") / "a.ply"
    columns = dict(zip(["x", "y", "z", "red", "green", "blue", "a"], [*XYZ.T, *RGB.T, XYZ[:, 0]], strict=True))
    contents = [save(path, columns, text, order, [faces("strips")]).read_bytes() for text, order in FORMATS]
    return path, [*contents, *(with_lists(text, order) for text, order in FORMATS)]


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    kind=st.integers(0, 5),
    cut=st.floats(0, 1),
    flips=st.lists(st.tuples(st.floats(0, 1, exclude_max=True), st.integers(1, 255)), max_size=4),
)
def test_a_damaged_file_is_read_or_refused(valid, kind, cut, flips):
    path, contents = valid
    content = bytearray(contents[kind])
    for offset, bits in flips:
        content[int(offset**2 * len(content))] ^= bits  # most of them in the header
    path.write_bytes(content[: int(np.sqrt(cut) * len(content)) + 1])
    try:
        points = read(path, strict=True)
    except ValueError as error:
        assert str(error).startswith(str(path))
    else:
        assert len(points) > 0


def test_what_cannot_be_opened_is_an_oserror(tmp_path):
    with pytest.raises(FileNotFoundError):
        read(tmp_path / "none.ply")
    with pytest.raises(FileNotFoundError):
        read(tmp_path / "none.xyz")
    (tmp_path / "folder.ply").mkdir()
    with pytest.raises(OSError, match="not a regular file"):
        read(tmp_path / "folder.ply")
    if hasattr(os, "mkfifo"):
        os.mkfifo(tmp_path / "pipe.ply")
        with pytest.raises(OSError, match="not a regular file"):
            read(tmp_path / "pipe.ply")


def test_an_unknown_file_lists_what_can_be_read(tmp_path):
    (tmp_path / "a.nothing").touch()
    with pytest.raises(ValueError, match=r"a\.nothing: is empty"):
        read(tmp_path / "a.nothing")
    (tmp_path / "a.nothing").write_bytes(bytes(range(250, 256)) * 9)
    with pytest.raises(
        ValueError, match=r"unsupported file type \.nothing: begins with .*; supported formats: .*\.ply"
    ):
        read(tmp_path / "a.nothing")
    with pytest.raises(ValueError, match=r"cannot write \.nothing; supported: .*\.ply"):
        write(tmp_path / "a.nothing", Points(XYZ))


@pytest.mark.parametrize("name", ["x", "two words", "größe"])
def test_attribute_names_that_ply_cannot_store_are_refused(tmp_path, name):
    with pytest.raises(ValueError, match="cannot store an attribute"):
        write(tmp_path / "a.ply", Points(XYZ, attributes={name: XYZ[:, 0]}))
    assert list(tmp_path.iterdir()) == []


def test_a_missing_folder_is_reported_before_any_work(tmp_path):
    with pytest.raises(FileNotFoundError, match="folder not found"):
        check_writable(tmp_path / "none" / "a.ply")
    with pytest.raises(FileNotFoundError, match="folder not found"):
        write(tmp_path / "none" / "a.ply", Points(XYZ))
    with pytest.raises(IsADirectoryError):
        check_writable(tmp_path)


@pytest.mark.parametrize("failure", [ValueError, KeyboardInterrupt])
def test_a_failed_write_leaves_the_old_file(tmp_path, failure):
    path = tmp_path / "a.txt"
    path.write_text("old")
    with pytest.raises(failure), replacing(path) as beside:
        beside.write(b"half")
        raise failure
    assert [(p.name, p.read_text()) for p in tmp_path.iterdir()] == [("a.txt", "old")]


@pytest.mark.skipif(os.name != "posix", reason="modes and links of POSIX")
def test_a_replaced_file_has_default_permissions_and_links_are_kept(tmp_path):
    target, link, plain = tmp_path / "target.txt", tmp_path / "link.txt", tmp_path / "plain.txt"
    target.write_text("old")
    link.symlink_to(target)
    plain.touch()
    with replacing(link) as beside:
        beside.write(b"new")
    assert link.is_symlink()
    assert target.read_text() == "new"
    assert stat.S_IMODE(target.stat().st_mode) == stat.S_IMODE(plain.stat().st_mode)


# ------------------------------------------------------------------------------------------------------ real files


@pytest.mark.scans
def test_points_and_colors_of_real_files_are_read():
    points = read(shared_model("points/tls_pumpA_rgb.ply"))
    assert len(points) == 155_201
    assert points.normals is not None
    assert points.colors is not None
    mesh = read(shared_model("meshes/stanford_bunny_mesh.ply"))
    np.testing.assert_array_equal(mesh.positions, read(shared_model("points/stanford_bunny.ply")).positions)
    grid = read(shared_model("raw/bun000_rangegrid_ascii.ply"))
    assert len(grid) == 40_256
    assert np.ptp(grid.bounds, axis=0).max() < 0.2


@pytest.mark.scans
def test_real_map_coordinates_and_labels_are_read():
    path = shared_model("raw/b9_als_rgb_label.ply")
    points, truth = read(path), PlyData.read(str(path))["vertex"]
    for axis, name in enumerate("xyz"):
        assert np.abs(points.world[:, axis] - truth[name]).max() < 1e-5
    np.testing.assert_array_equal(points.attributes["label"], truth["label"])


def test_more_vertices_than_fit_into_memory_are_refused(tmp_path):
    """The file is sparse, but contains all of them."""
    path = tmp_path / "huge.ply"
    path.write_text(HEADER.format(format="binary_little_endian", count=2**31))
    os.truncate(path, 2**31 * 12 + 1000)
    with pytest.raises(ValueError, match="2,147,483,648 points are too many"):
        read(path)


@pytest.mark.parametrize("mixed", [False, True])
def test_rows_of_several_chunks_are_those_of_the_file(rng, tmp_path, mixed):
    """mixed : whether coordinates and colours are interleaved in a row, or contiguous"""
    count, names = CHUNK + 5000, ["x", "y", "z", "nx", "ny", "nz", "red", "green", "blue", "label"]
    if mixed:
        names = ["blue", "x", "nx", "red", "z", "label", "ny", "y", "nz", "green"]
    types = {"red": "u1", "green": "u1", "blue": "u1", "label": "<i4"}
    rows = np.zeros(count, [(name, types.get(name, "<f4")) for name in names])
    for name in names:
        rows[name] = rng.integers(0, 200, count)
    kinds = {"u1": "uchar", "<i4": "int", "<f4": "float"}
    lines = [f"property {kinds[types.get(name, '<f4')]} {name}" for name in names]
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {count}", *lines, "end_header", ""]
    (tmp_path / "a.ply").write_bytes("\n".join(head).encode() + rows.tobytes())
    points = read(tmp_path / "a.ply")
    for k in range(3):
        assert np.array_equal(points.positions[:, k], rows["xyz"[k]])
        assert np.array_equal(points.normals[:, k], rows["n" + "xyz"[k]])
        assert np.array_equal(points.colors[:, k], rows[("red", "green", "blue")[k]])
    assert np.array_equal(points.attributes["label"], rows["label"])
