"""SPZ files and .splat files."""

import gzip
import re
import struct
import warnings

import numpy as np
import pytest

from helpers.splat_files import check, cloud, damaged
from helpers.spz_files import header, packed, plain, rows
from pointray.io.files import headers, read
from pointray.io.formats.splats import splat, spz


@pytest.mark.parametrize("degree", [0, 1, 4])
@pytest.mark.parametrize("version", [1, 2, 3, 4])
def test_every_version_of_spz_is_read(tmp_path, version, degree):
    made = cloud(400)
    data = packed(made, degree, b"skip this") if version == 4 else gzip.compress(plain(made, version, degree))
    (tmp_path / "a.spz").write_bytes(data)
    points = read(tmp_path / "a.spz", opacity=0)
    turned = 0.98 if version < 3 else 0.9999  # a small w has the rounding error of three bytes
    exact = {"position": 2e-3 if version == 1 else 1.3e-4, "scale": 0.032, "opacity": 0.002}
    check(points, made, turned=turned, shades=1.5, **exact)
    rows = points.attributes["opacity"] >= 0.5
    np.testing.assert_array_equal(read(tmp_path / "a.spz", opacity=0.5).positions, points.positions[rows])
    [(_, form, listing)] = headers(tmp_path / "a.spz")
    assert form.name == "SPZ"
    assert listing.facts == {"version": version, "splats": 400, "harmonics": degree, "antialiased": False}


def test_known_bytes_of_spz_are_read(tmp_path):
    """A file of one splat, byte by byte."""
    rows = [b"\x00\x10\x00", b"\x00\xf0\xff", b"\xff\xff\x7f", b"\x80", b"\x00\x80\xff", b"\xa0\xa0\x00"]
    # The largest is w, at place 3; x is -0.5: the z axis turns about x by -60 degrees.
    rows += [struct.pack("<I", 3 << 30 | 1 << 29 | round(511 * 0.5 * 2**0.5) << 20)]
    (tmp_path / "a.spz").write_bytes(gzip.compress(header(1, flags=1) + b"".join(rows)))
    points = read(tmp_path / "a.spz")
    np.testing.assert_array_equal(points.world, [[1, -1, 2047.999755859375]])
    np.testing.assert_allclose(points.attributes["opacity"], [128 / 255])
    np.testing.assert_array_equal(points.colors, [[0, 128, 255]])
    np.testing.assert_allclose(points.attributes["scale"], [[1, 1, np.exp(-10)]], rtol=1e-6)
    np.testing.assert_allclose(points.normals, [[0, np.sqrt(0.75), 0.5]], atol=2e-3)
    [(_, _, listing)] = headers(tmp_path / "a.spz")
    assert listing.facts["antialiased"]


def test_any_number_of_fractional_bits_is_read(tmp_path):
    made = cloud(50)
    for bits in (0, 8, 20):
        (tmp_path / "a.spz").write_bytes(gzip.compress(plain(made, bits=bits)))
        np.testing.assert_allclose(read(tmp_path / "a.spz", opacity=0).positions, made.xyz, atol=0.51 * 2.0**-bits)


def test_more_splats_than_are_unpacked_together(tmp_path, monkeypatch):
    made = cloud(1000)
    for data in (gzip.compress(plain(made)), packed(made)):
        (tmp_path / "a.spz").write_bytes(data)
        whole = read(tmp_path / "a.spz")
        with monkeypatch.context() as patch:
            patch.setattr(spz, "ROWS", 300)
            parts = read(tmp_path / "a.spz")
        np.testing.assert_array_equal(parts.positions, whole.positions)
        np.testing.assert_array_equal(parts.normals, whole.normals)


MADE = cloud(20)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (plain(MADE, 5), "unsupported SPZ version 5; expected 1 to 4"),
        (plain(MADE, 0), "unsupported SPZ version 0"),
        (plain(MADE)[:-1], "is cut off: 20 splats reach to byte 416, 415 bytes found"),
        (plain(MADE)[:11], "is cut off: expected a header of 16 bytes, got 11"),
        (plain(MADE, n=4_000_000_000), "is cut off: 4,000,000,000 splats"),
        (plain(MADE, n=0), "contains no points: the header announces 0 splats"),
        (plain(MADE).replace(b"\x00\x0c", b"\x05\x0c", 1), "invalid degree 5 of harmonics"),
        (plain(MADE, 3).replace(b"\x00\x0c", b"\x00\x19", 1), "25 fractional bits"),
        (packed(MADE, n=21), "is damaged: column 0 has 180 bytes, expected 189"),
        (packed(MADE, change=1), "is damaged: column 0 has 181 bytes, expected 180"),
        (packed(MADE)[:-1], "is cut off: its columns reach to byte"),
        (packed(MADE)[:70], "is cut off: its table of columns is at byte 32 of 70"),
        (packed(MADE, 1).replace(b"\x06\x20\0\0\0", b"\x05\x20\0\0\0", 1), "got 5 columns, expected 6"),
    ],
)
def test_damaged_files_are_refused(tmp_path, data, message):
    (tmp_path / "a.spz").write_bytes(data)
    with pytest.raises(ValueError, match=re.escape(message)):
        read(tmp_path / "a.spz")


def test_columns_shorter_than_announced_are_reported(tmp_path):
    zstd = pytest.importorskip("backports.zstd")
    small = [zstd.compress(bytes(size)) for size in (9_000_000, 100, 100, 100, 100)]
    table = b"".join(
        struct.pack("<QQ", len(s), 1_000_000 * width) for s, width in zip(small, (9, 1, 3, 3, 4), strict=True)
    )
    data = header(1_000_000, 4)[:-1] + struct.pack("<BI12x", 5, 32) + table + b"".join(small)
    (tmp_path / "a.spz").write_bytes(data.ljust(9000, b"\0"))
    with pytest.raises(ValueError, match="is cut off near splat 100"):
        read(tmp_path / "a.spz")
    (tmp_path / "a.spz").write_bytes(data)
    with pytest.raises(ValueError, match="1,000,000 splats do not fit into"):
        read(tmp_path / "a.spz")


@pytest.mark.parametrize("kind", ["plain", "packed", "splat"])
def test_damage_is_reported_in_one_line(tmp_path, kind):
    rng = np.random.default_rng(5)
    data = {"plain": plain(MADE), "packed": packed(MADE), "splat": rows(MADE)}[kind]
    path = tmp_path / ("a.splat" if kind == "splat" else "a.spz")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for _ in range(100):
            path.write_bytes(damaged(rng, data))
            try:
                assert len(read(path, opacity=0, strict=True)) <= 50
            except ValueError as error:
                assert "\n" not in str(error)


# ------------------------------------------------------------------------------------------------------------ .splat


def test_splat_files_are_read(tmp_path):
    made = cloud(400)
    (tmp_path / "a.splat").write_bytes(rows(made))
    check(read(tmp_path / "a.splat", opacity=0), made, turned=0.9995, opacity=0.002)
    assert len(read(tmp_path / "a.splat", opacity=0.5)) == (np.rint(made.alpha * 255) >= 127.5).sum()
    (tmp_path / "b.splat.gz").write_bytes(gzip.compress(rows(made)))
    check(read(tmp_path / "b.splat.gz", opacity=0), made, turned=0.9995, opacity=0.002)


def test_other_files_named_splat_are_refused(tmp_path):
    made = cloud(20)
    (tmp_path / "a.splat").write_bytes(rows(made)[:-1])
    with pytest.raises(ValueError, match="its 639 bytes are not a multiple of 32"):
        read(tmp_path / "a.splat", strict=True)
    for data in (b"x" * 640, b"short", np.random.default_rng(1).bytes(640), bytes(640)):
        (tmp_path / "a.splat").write_bytes(data)
        with pytest.raises(ValueError, match=r"invalid splat file: begins with"):
            read(tmp_path / "a.splat")
    assert splat.recognise(rows(made), tmp_path / "a.bin") == 0
    (tmp_path / "a.ksplat").write_bytes(bytes(4096))
    with pytest.raises(ValueError, match=r"a.ksplat: .ksplat files are unsupported: convert it to"):
        read(tmp_path / "a.ksplat")
