"""Files with fewer or more rows than announced are read with one warning, or refused in strict mode."""

from __future__ import annotations

import gzip
import io
import json
import struct
import warnings
from pathlib import Path

import laspy
import numpy as np
import pytest

import pointray as pr
from helpers.splat_files import cloud
from pointray.base.disk_columns import Columns
from pointray.cli import execute
from pointray.io.files import open_files, request_of
from pointray.io.selection import Selection
from pointray.io.spooling.spool import spool

N = 40
XYZ = np.round(np.random.default_rng(21).random((N, 3)) * 9 + 1, 3).astype(np.float32)
TEXT = "".join("{:g} {:g} {:g}\n".format(*row) for row in XYZ.tolist())
CUT = TEXT.rsplit(" ", 1)[0]  # the last line has two fields
LINES = TEXT.splitlines(keepends=True)
UNMOVED = "1 0 0\n" * 4 + "1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n"
HUGE = 10**14


def ply(count: int, body: str | bytes, kind: str = "binary_little_endian", after: str = "") -> bytes:
    """A PLY file with this count of vertices."""
    axes = "".join(f"property float {axis}\n" for axis in "xyz")
    head = f"ply\nformat {kind} 1.0\nelement vertex {count}\n{axes}{after}end_header\n"
    return head.encode() + (body if isinstance(body, bytes) else body.encode())


def lists(count: int, rows: int) -> bytes:
    """A binary PLY file whose vertices have lists."""
    body = b"".join(xyz.tobytes() + bytes([2, 5, 6]) for xyz in XYZ[:rows])
    return ply(count, body).replace(b"end_header", b"property list uchar uchar near\nend_header")


def pcd(count: int, body: str | bytes, kind: str, width: int | None = None) -> bytes:
    """A PCD file with this count of points."""
    head = f"VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH {width or count}\nHEIGHT 1\n"
    head += f"POINTS {count}\nDATA {kind}\n"
    return head.encode() + (body if isinstance(body, bytes) else body.encode())


def lzf(count: int) -> bytes:
    """Return a compressed PCD file of all points, with this count."""
    plain = XYZ.T.tobytes()
    stored = b"".join(bytes([len(plain[k : k + 32]) - 1]) + plain[k : k + 32] for k in range(0, len(plain), 32))
    return pcd(count, struct.pack("<II", len(stored), len(plain)) + stored, "binary_compressed")


def ptx(columns: int, rows: int, start: int, end: int) -> str:
    """Return a PTX scan with some of the points."""
    points = "".join(f"{line.strip()} 0.5\n" for line in LINES[start:end])
    return f"{columns}\n{rows}\n{UNMOVED.replace('1 0 0' + chr(10), '0 0 0' + chr(10), 4)}{points}"


def las(count: int, rows: int = N) -> bytes:
    """A LAS file 1.2 with this count of points."""
    scale, origin = (0.001,) * 3, (0.0,) * 3
    head = struct.pack("<4sHH16sBB32s32sHHHII", b"LASF", 0, 0, bytes(16), 1, 2, b"", b"", 1, 2020, 227, 227, 0)
    head += struct.pack("<BHI5I", 0, 20, count, min(count, 2**31), 0, 0, 0, 0)
    head += struct.pack("<12d", *scale, *origin, *(9.0, 0.0) * 3)
    points = np.zeros(rows, [("xyz", "<i4", 3), ("more", "V8")])
    points["xyz"] = np.rint(XYZ[:rows] * 1000.0)
    return head + points.tobytes()


def laz(count: int, version: str) -> bytes:
    """Return a LAZ file with this count of points; chunks state their row count in 1.4, not in 1.2."""
    header = laspy.LasHeader(version=version, point_format=0 if version == "1.2" else 6)
    header.scales = (0.001,) * 3
    file = laspy.LasData(header)
    file.xyz = XYZ
    out = io.BytesIO()
    file.write(out, do_compress=True)
    data = bytearray(out.getvalue())
    if version == "1.4":
        struct.pack_into("<Q15Q", data, 247, count, *(0,) * 15)
    else:
        struct.pack_into("<I5I", data, 107, count, *(0,) * 5)
    return bytes(data)


def npy(count: int, rows: int = N) -> bytes:
    """Return an .npy file that announces this count of rows."""
    facts = f"{{'descr': '<f4', 'fortran_order': False, 'shape': ({count}, 3), }}".ljust(117) + "\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", 118) + facts.encode() + XYZ[:rows].tobytes()


def colmap(count: int) -> bytes:
    """A points3D.bin of all points with this count."""
    rows = [struct.pack("<Q3d3BdQ", k, *map(float, xyz), 1, 2, 3, 0.5, 0) for k, xyz in enumerate(XYZ)]
    return struct.pack("<Q", count) + b"".join(rows)


def sweep() -> bytes:
    """Return a KITTI sweep around its scanner."""
    return np.column_stack([XYZ - 5, np.full(N, 0.5)]).astype("<f4").tobytes()


OFF = f"OFF\n{N} 1 0\n{TEXT}3 0 1 2\n".encode()
CLOUD_OBJ = "".join("v " + line for line in LINES).encode()
COLMAP = "# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[]\n" + "".join(
    f"{k} {line.strip()} 1 2 3 0.5 1 2\n" for k, line in enumerate(LINES)
)
# name, contents, points in the file, the warning, the error of a strict reader
CASES = {
    "pts, fewer": ("a.pts", f"50\n{TEXT}", N, "50 rows expected, 40 found: 10 of 50 are missing", "is cut off"),
    "pts, more": ("a.pts", f"30\n{TEXT}", N, "30 rows expected, 40 found", "is damaged"),
    "pts, blocks": ("a.pts", f"20\n{TEXT}9\n{TEXT}", 2 * N, "29 rows expected, 80 found", "is damaged"),
    "pts, cut": ("a.pts", f"40\n{CUT}", N - 1, "last line is cut off; 40 rows .* 1 of 40", "has 2 columns, expected 3"),
    "xyz, cut": ("a.xyz", TEXT + "4 5", N, "its last line is cut off", "has 2 columns, expected 3"),
    "xyz, one field": ("a.xyz", TEXT + "4", N, "its last line is cut off", "has 1 column"),
    "xyz, half a number": ("a.xyz", TEXT + "4 5 -", N, "its last line is cut off", "'-' is not a number"),
    "ptx, fewer": ("a.ptx", ptx(8, 5, 0, 33), 33, "40 rows expected, 33 found: 7 of 40", "is cut off at line 44"),
    "ptx, first": ("a.ptx", ptx(5, 4, 0, 17) + ptx(5, 4, 20, N), 37, "40 rows .*, 37 found: 3", "the header of scan 2"),
    "ptx, more": ("a.ptx", ptx(5, 4, 0, 23) + ptx(5, 4, 20, N), 43, "40 rows .*, 43 found", "the header of scan 2"),
    "ptx, header": ("a.ptx", ptx(8, 5, 0, N) + "4\n5\n0 0", N, "the header of scan 2", "the header of scan 2"),
    "ptx, huge": ("a.ptx", ptx(10**9, 10**9, 0, N), N, "1,000,000,000,000,000,000 rows expected", "is cut off"),
    "las, fewer": ("a.las", las(50), N, "50 rows of 20 bytes .* 40 rows: 10 of 50 are missing", "is cut off: 50 rows"),
    "las, huge": ("a.las", las(2**32 - 1), N, "4,294,967,255 of 4,294,967,295 are missing", "is cut off"),
    "las, more": ("a.las", las(30), N, "30 rows; 200 more bytes follow, as many as 10 rows$", "as many as 10 rows"),
    "laz, fewer": ("a.laz", laz(50, "1.2"), N, "50 rows expected, 40 found: 10 of 50", "50 rows"),
    "laz, huge": ("a.laz", laz(2**32 - 1, "1.2"), N, "4,294,967,295 rows expected, 40 found", "rows"),
    "laz, layers, fewer": ("a.laz", laz(50, "1.4"), N, "50 rows expected, 40 found: 10 of 50", "50 rows"),
    "laz, layers, more": ("a.laz", laz(30, "1.4"), N, "30 rows expected, 40 found", "30 rows"),
    "laz, layers, huge": ("a.laz", laz(1 << 60, "1.4"), N, "rows expected, 40 found", "rows"),
    "las, none": ("a.las", las(0), N, "announces 0 rows; 800 more bytes", "contains no points: the header announces 0"),
    "las, padding": ("a.las", las(N) + bytes(200), N, "10 rows, which are not read", "as many as 10 rows"),
    "ply, fewer": (
        "a.ply",
        ply(50, XYZ.tobytes()),
        N,
        "50 vertices of 12 bytes .*: 10 of 50 are missing",
        "is cut off: 50",
    ),
    "ply, cut": ("a.ply", ply(N, XYZ.tobytes()[:-3]), N - 1, "1 of 40 are missing", "is cut off: 40 vertices"),
    "ply, huge": ("a.ply", ply(HUGE, XYZ.tobytes()), N, "are missing", "is cut off"),
    "ply, more": (
        "a.ply",
        ply(30, XYZ.tobytes()),
        N,
        "30 vertices expected, 120 bytes follow them, 10 more",
        "30 vert",
    ),
    "ply, padding": (
        "a.ply",
        ply(N, XYZ.tobytes() + bytes(24)),
        N,
        "24 bytes follow them, which are not read",
        "24 bytes",
    ),
    "ply, text, fewer": ("a.ply", ply(50, TEXT, "ascii"), N, "40 of 3 found: 10 of 50 are missing", "40 of 3 found"),
    "ply, text, more": ("a.ply", ply(30, TEXT, "ascii"), N, "30 lines of 3 numbers expected, 40 of 3", "30 lines"),
    "ply, text, cut": ("a.ply", ply(N, CUT, "ascii"), N - 1, "last line is cut off; .* 1 of 40", "3 to 2"),
    "ply, text, cut, end of line": (
        "a.ply",
        ply(N, CUT + "\n\n", "ascii"),
        N - 1,
        "last line is cut off; .* 1 of 40",
        "3 to 2",
    ),
    "ply, text, huge": ("a.ply", ply(HUGE, TEXT, "ascii"), N, "are missing", "is cut off"),
    "ply, lists": (
        "a.ply",
        lists(50, N),
        N,
        "in the element 'vertex', row 40 of 50: 10 of 50 are missing",
        "50 vertices of 13 bytes",
    ),
    "ply, text, lists": (
        "a.ply",
        ply(50, TEXT.replace("\n", " 2 5 6\n"), "ascii", "property list uchar uchar near\n"),
        N,
        "50 vertices expected, 40 found: 10 of 50 are missing",
        "50 vertices expected, 40 found",
    ),
    "ply, text, lists, cut": (
        "a.ply",
        ply(N, TEXT.replace("\n", " 2 5 6\n")[:-3] + "\n\n", "ascii", "property list uchar uchar near\n"),
        N - 1,
        "is cut off: 40 vertices expected, 39 found: 1 of 40 are missing",
        "vertex 39 does not match",
    ),
    "pcd, fewer": (
        "a.pcd",
        pcd(50, XYZ.tobytes(), "binary"),
        N,
        "50 points of 12 bytes .* 10 of 50",
        "is cut off: 50 points",
    ),
    "pcd, more": ("a.pcd", pcd(30, XYZ.tobytes(), "binary"), N, "has 120 more bytes", "has 120 more bytes"),
    "pcd, width": (
        "a.pcd",
        pcd(N, XYZ.tobytes(), "binary", 7),
        N,
        "40 points .* WIDTH x HEIGHT is 7 x 1",
        "WIDTH x HEIGHT",
    ),
    "pcd, packed": (
        "a.pcd",
        lzf(30),
        N,
        "480 decompressed bytes .*: 40 points found",
        "480 decompressed bytes announced",
    ),
    "pcd, text, fewer": ("a.pcd", pcd(50, TEXT, "ascii"), N, "50 points expected, 40 found: 10 of 50", "is cut off"),
    "pcd, text, more": ("a.pcd", pcd(30, TEXT, "ascii"), N, "30 points expected, 40 found", "more points follow"),
    "pcd, text, cut": ("a.pcd", pcd(N, CUT, "ascii"), N - 1, "last line is cut off; .* 1 of 40", "line 49"),
    "pcd, text, cut, end of line": (
        "a.pcd",
        pcd(N, CUT + "\n\n", "ascii"),
        N - 1,
        "last line is cut off; .* 1 of 40",
        "line 49",
    ),
    "pcd, text, huge": ("a.pcd", pcd(HUGE, TEXT, "ascii"), N, "are missing", "is cut off"),
    "npy, fewer": ("a.npy", npy(50), N, r"600 bytes of \(50, 3\) expected, 480 found: 10 of 50", "is cut off: 600"),
    "npy, more": ("a.npy", npy(30), 30, "has more bytes after its array", "has more bytes after its array: 360 bytes"),
    "kitti, cut": (
        "a.bin",
        sweep()[:-5],
        N - 1,
        "its 635 bytes are not a multiple of 16",
        "cut off, or not a lidar sweep",
    ),
    "kitti, other rows": ("a.bin", sweep()[:620], N - 2, "its 620 bytes are not a multiple", "cut off|known lidar"),
    "colmap, fewer": ("points3D.bin", colmap(50), N, "at point 40 of 50: 10 of 50 are missing", "is cut off"),
    "colmap, huge": ("points3D.bin", colmap(1 << 60), N, "are missing", "is cut off: 1,152,921,504,606,846,976"),
    "colmap, more": ("points3D.bin", colmap(30), 30, "has 510 more bytes after 30 points", "has 510 more bytes"),
    "colmap, text": ("points3D.txt", COLMAP[:-3], N - 1, "its last line is cut off", "is invalid, expected id"),
    "off, faces": ("a.off", OFF[:-3], N, "40 vertices and 1 faces expected", "is cut off: 40 vertices"),
    "off, fewer": ("a.off", OFF.replace(b"40 1", b"50 9"), N + 1, "50 vertices and 9 faces", "more than its 42 lines"),
    "obj, cut": ("a.obj", CLOUD_OBJ + b"v 1 2", N, "line 41 is 'v 1 2': it is cut off", "line 41 is 'v 1 2'"),
    "gzip": ("a.xyz.gz", gzip.compress(TEXT.encode())[:-8], N, "bytes could be decompressed", "is damaged or cut off"),
}


def warned(path: Path, **options: object) -> tuple[pr.Points, list[str]]:
    """Return the points of a file, and the texts of all warnings."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        points = pr.read(path, **options)
    return points, [str(one.message) for one in caught]


@pytest.mark.parametrize("case", CASES)
def test_rows_present_are_read_with_a_warning_or_refused(tmp_path, case):
    name, content, count, words, refusal = CASES[case]
    if name.endswith((".off", ".obj")):
        pytest.importorskip("trimesh")
    path = tmp_path / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    points, caught = warned(path)
    assert len(points) == count and len(caught) == 1
    assert caught[0].startswith(str(path))
    with pytest.warns(UserWarning, match=words):
        pr.read(path)
    with pytest.raises(ValueError, match=refusal) as error:
        pr.read(path, strict=True)
    assert str(error.value).startswith(str(path)) and "\n" not in str(error.value)
    if name != "a.bin" and "blocks" not in case and not case.startswith("ptx, "):
        np.testing.assert_allclose(points.world[: min(count, N)], XYZ[: min(count, N)], atol=1e-6)


@pytest.mark.parametrize("case", [case for case in CASES if case != "off, fewer"])
def test_spooled_scans_give_the_same_warnings(tmp_path, case):
    name, content, count, _, refusal = CASES[case]
    path = tmp_path / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    expected = warned(path)
    columns = Columns(tmp_path / "columns")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        with open_files([path], request_of()) as files:
            assert spool(files, Selection(), columns).rows == count
    assert [str(one.message) for one in caught] == expected[1]
    np.testing.assert_array_equal(columns["positions"][:], expected[0].positions)
    with pytest.raises(ValueError, match=refusal), open_files([path], request_of(strict=True)) as files:
        spool(files, Selection(), columns)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.pts", "50\n"),
        ("a.las", las(50, 0)),
        ("a.ply", ply(50, b"12345678")),
        ("a.ply", ply(50, "1 2", "ascii")),
        ("a.pcd", pcd(50, b"12345678", "binary")),
        ("a.pcd", pcd(50, "1 2", "ascii")),
        ("a.npy", npy(50, 0)),
        ("points3D.bin", colmap(50)[:30]),
        ("a.ptx", ptx(8, 5, 0, 0)),
        ("a.bin", sweep()[:11]),
    ],
)
def test_files_without_a_point_are_refused(tmp_path, name, content):
    path = tmp_path / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    with pytest.raises(ValueError, match=r"\w") as error:
        pr.read(path)
    assert str(error.value).startswith(str(path)) and "\n" not in str(error.value)


@pytest.mark.parametrize("kind", ["trained", "compressed", "splat"])
def test_cut_off_splat_files_are_read_or_refused(tmp_path, kind):
    from helpers import gaussian_files, spz_files

    path = tmp_path / ("a.splat" if kind == "splat" else "a.ply")
    if kind == "trained":
        gaussian_files.save(path, gaussian_files.trained(cloud(300)))
    else:
        path.write_bytes(
            spz_files.rows(cloud(300)) if kind == "splat" else gaussian_files.packed(cloud(300), harmonics=False)
        )
    whole = pr.read(path, opacity=0)
    path.write_bytes(path.read_bytes()[:-100])
    points, caught = warned(path, opacity=0)
    assert 200 < len(points) < 300 and len(caught) == 1 and "is cut off" in caught[0]
    np.testing.assert_array_equal(points.positions, whole.positions[: len(points)])
    with pytest.raises(ValueError, match="is cut off"):
        pr.read(path, opacity=0, strict=True)


@pytest.mark.parametrize("kind", ["stl", "ascii.stl"])
def test_cut_off_triangle_files_are_read_or_refused(tmp_path, kind):
    trimesh = pytest.importorskip("trimesh")
    data = trimesh.creation.icosphere(3).export(file_type="stl_ascii" if kind == "ascii.stl" else "stl")
    data = data.encode() if isinstance(data, str) else data
    path = tmp_path / "a.stl"
    path.write_bytes(data[: len(data) * 9 // 10])
    points, caught = warned(path)
    assert 500 < len(points) < 642 and len(caught) == 1 and "is cut off" in caught[0]
    with pytest.raises(ValueError, match="is cut off"):
        pr.read(path, strict=True)
    path.write_bytes(b"not a mesh" * 100)
    with pytest.raises(ValueError, match="is cut off"):
        pr.read(path)


def test_missing_rows_of_an_e57_scan_are_reported(tmp_path):
    own = pytest.importorskip("test_e57")
    path = own.save(tmp_path / "a.e57", (own.xyz_columns(), {}))
    own.with_xml(path, 'recordCount="500"', 'recordCount="987"')
    points, caught = warned(path)
    assert len(points) == 500 and caught == [
        f"{path}: is cut off in scan 0: 987 points expected, 500 found: 487 of 987 are missing"
    ]


def test_commands_report_missing_rows(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("a.pts").write_text(f"50\n{TEXT}")
    assert execute(["info", "a.pts", "--json"]) == 0
    out, err = capsys.readouterr()
    assert json.loads(out)["points"] == N and err.count("10 of 50 are missing") == 1
    for command in (["info"], ["render", "-o", "a.png"], ["convert", "a.ply"], ["prepare", "-o", "a.pointray"]):
        assert execute([command[0], "a.pts", *command[1:], "--strict"]) == 2
        err = capsys.readouterr().err
        assert err.count("\n") == 1 and "announces 50 rows, 40 found" in err
    assert execute(["convert", "a.pts", "a.ply"]) == 0
    assert len(pr.read("a.ply", strict=True)) == N


def test_max_points_selects_from_the_rows_present(tmp_path):
    """Points are chosen evenly from those that the file contains."""
    (tmp_path / "a.ply").write_bytes(ply(80, XYZ.tobytes()))
    points, _ = warned(tmp_path / "a.ply", max_points=20)
    np.testing.assert_allclose(points.world, XYZ[1::2])
