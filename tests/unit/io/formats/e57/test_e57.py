"""E57 files written by pye57, with every optional element, and one by another program."""

import re
import struct
import sys

import numpy as np
import pytest

from helpers.e57_files import AT, NORMALS, RGB, TURN, XYZ, Column, N, crc32c, pose, save, with_xml, xyz_columns
from helpers.places import shared_model
from pointray.cloud.georeference import numbers_of
from pointray.io import files
from pointray.io.files import read
from pointray.io.formats._source import Request
from pointray.io.formats.e57 import _header as _e57_header, e57

pye57 = pytest.importorskip("pye57")


def turned(xyz):
    """Return positions rotated by TURN."""
    return np.stack([-xyz[:, 1], xyz[:, 0], xyz[:, 2]], axis=1)


@pytest.mark.scans
def test_a_file_of_another_program_agrees_with_pye57():
    path = shared_model("raw/bunnyFloat.e57")
    points = read(path)
    with pye57.E57(str(path)) as file:
        own = file.read_scan(0)
    np.testing.assert_array_equal(points.positions.T, [own[f"cartesian{axis}"].astype(np.float32) for axis in "XYZ"])
    assert points.attributes == {}
    assert (points.georeference.unit, points.georeference.stations) == ("metre", ())
    (_, _, listing) = next(files.headers(path))
    assert listing.facts["scans"][0]["name"] == "bunny"
    assert listing.rows == len(points) == 30_571


def test_a_pose_transforms_positions_and_normals(tmp_path):
    normals = {f"nor:normal{axis}": Column(column, "single") for axis, column in zip("XYZ", NORMALS.T, strict=True)}
    path = save(tmp_path / "a.e57", (xyz_columns() | normals, pose()))
    points = read(path)
    np.testing.assert_allclose(points.world, turned(XYZ) + AT, atol=1e-6)
    np.testing.assert_allclose(points.normals, turned(NORMALS), atol=1e-6)
    assert points.georeference.stations == (AT,)
    assert "scan" not in points.attributes
    with pye57.E57(str(path)) as file:
        np.testing.assert_allclose(file.to_global(XYZ, np.array(TURN), np.array(AT)), points.world, atol=1e-6)


def test_columns_keep_values_and_types(rng, tmp_path):
    values = {
        "intensity": Column(rng.integers(0, 4096, N), "int"),
        "rowIndex": Column(np.arange(N) * 1000, "int"),
        "columnIndex": Column(np.arange(N) - 7, "int"),
        "timeStamp": Column(np.arange(N) * 0.1 + 1e9),
        "returnIndex": Column(np.arange(N) % 3, "int"),
        "nor:huge": Column(np.arange(N) + 2**40, "int"),
    }
    points = read(save(tmp_path / "a.e57", (xyz_columns() | values, {})))
    names = ["intensity", "row_index", "column_index", "time_stamp", "return_index", "huge"]
    assert list(points.attributes) == names
    types = [np.uint16, np.uint32, np.int16, np.float64, np.uint8, np.int64]
    assert [points.attributes[name].dtype for name in names] == types
    for name, column in zip(names, values.values(), strict=True):
        np.testing.assert_array_equal(points.attributes[name], column.values)


def test_rows_that_are_invalid_are_left_out_and_counted(tmp_path):
    state = np.arange(N) % 3
    columns = xyz_columns() | {"cartesianInvalidState": Column(state, "int", 0, 2)}
    path = save(tmp_path / "a.e57", (columns, {}))
    np.testing.assert_array_equal(read(path).positions, XYZ[state == 0].astype(np.float32))
    with e57.E57Source(path, Request()) as source:
        assert source.listing.count is None
        assert sum(len(chunk.positions) for chunk in source.chunks()) == np.sum(state == 0)
        assert source.listing.facts["left_out"] == np.sum(state != 0)


def test_spherical_coordinates(rng, tmp_path):
    azimuth, elevation, distance = rng.random((3, N)) * [[6], [1.5], [9]]
    columns = {"sphericalRange": Column(distance), "sphericalAzimuth": Column(azimuth)}
    path = save(tmp_path / "a.e57", (columns | {"sphericalElevation": Column(elevation)}, pose(at=(1, 2, 3))))
    flat = distance * np.cos(elevation)
    own = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), distance * np.sin(elevation)], axis=1)
    np.testing.assert_allclose(read(path).world, turned(own) + (1, 2, 3), atol=1e-5)


def color_columns(values, kind="int", high=255):
    names = ("colorRed", "colorGreen", "colorBlue")
    return {name: Column(column, kind, 0, high) for name, column in zip(names, values.T, strict=True)}


@pytest.mark.parametrize(
    ("values", "kind", "high", "limits"),
    [
        (RGB, "int", 255, None),
        (RGB, "int", 255, (3, 201)),  # limits of the values present
        (RGB * 257, "int", 65535, None),
        (RGB * 257, "int", 65535, (0, 65535)),
        (RGB, "int", 65535, (0, 255)),  # 8 bits in 16
        (RGB // 4, "int", 65535, (0, 255)),
        (RGB / 255, "double", None, (0, 1)),
    ],
)
def test_colors_are_scaled_by_their_limits(tmp_path, values, kind, high, limits):
    facts = {}
    if limits:
        ends = dict(zip(("Minimum", "Maximum"), limits, strict=True))
        facts = {"colorLimits": {f"color{c}{end}": v for c in ("Red", "Green", "Blue") for end, v in ends.items()}}
    points = read(save(tmp_path / "a.e57", (xyz_columns() | color_columns(values, kind, high), facts)))
    np.testing.assert_array_equal(points.colors, RGB // 4 if values is not RGB and values.max() < 64 and high else RGB)


def test_scans_with_different_columns_are_one_cloud(tmp_path):
    first = xyz_columns() | color_columns(RGB) | {"intensity": Column(np.arange(N), "int")}
    second = xyz_columns() | {"intensity": Column(np.arange(N) * 0.5, "single"), "time": Column(np.arange(N) * 1.0)}
    path = save(tmp_path / "a.e57", (first, pose(at=(1, 0, 0))), (second, pose(at=(0, 2, 0)) | {"name": "second"}))
    points = read(path)
    np.testing.assert_array_equal(points.attributes["scan"], np.repeat([0, 1], N))
    assert points.georeference.stations == ((1, 0, 0), (0, 2, 0))
    np.testing.assert_array_equal(points.colors, np.concatenate([RGB, np.full((N, 3), 128)]))
    np.testing.assert_array_equal(points.attributes["intensity"][N:], np.arange(N) * 0.5)
    assert np.isnan(points.attributes["time"][:N]).all()
    np.testing.assert_allclose(
        points.world, np.concatenate([turned(XYZ) + (1, 0, 0), turned(XYZ) + (0, 2, 0)]), atol=1e-6
    )


def test_scans_without_a_pose_have_no_scanner(tmp_path):
    """If others have one, their numbers are negative; the points stay where the file has them."""
    scans = [({**xyz_columns()}, facts) for facts in ({}, pose(at=(1, 0, 0)), {}, pose(at=(0, 2, 0)))]
    points = read(save(tmp_path / "a.e57", *scans))
    np.testing.assert_array_equal(points.attributes["scan"], np.repeat([-1, 0, -2, 1], N))
    assert points.georeference.stations == ((1, 0, 0), (0, 2, 0))
    np.testing.assert_allclose(points.world[2 * N : 3 * N], XYZ, rtol=0, atol=1e-6)
    points = read(save(tmp_path / "a.e57", *scans[::2]))
    np.testing.assert_array_equal(points.attributes["scan"], np.repeat([0, 1], N))
    assert points.georeference.stations == ()


def test_whole_numbers_with_a_scale_are_kept(rng, tmp_path):
    whole = rng.integers(-(10**8), 10**8, (N, 3))
    grids = [(0.001, 500000.0), (0.001, 5400000.0), (0.01, 0.0)]
    columns = {
        f"cartesian{axis}": Column(column, "scaled", grid=grid)
        for axis, column, grid in zip("XYZ", whole.T, grids, strict=True)
    }
    points = read(save(tmp_path / "a.e57", (columns, {})))
    georeference = points.georeference
    assert list(zip(georeference.scale, georeference.offset, strict=True)) == grids
    residual = points.attributes.get("grid_residual", 0)
    np.testing.assert_array_equal(numbers_of(georeference, points.world) + residual, whole)


def test_metadata_of_the_file_and_its_scans_is_read(tmp_path):
    sensor = {"name": "yard", "sensorVendor": "Acme", "sensorModel": "X1"}
    limits = {"intensityLimits": {"intensityMinimum": 0, "intensityMaximum": 4095}}
    path = save(tmp_path / "a.e57", (xyz_columns(), sensor | limits | pose()), crs="EPSG:25832")
    (_, format, listing) = next(files.headers(path))
    assert (format.name, listing.count) == ("E57", N)
    assert listing.facts["software"] == "a test"
    (scan,) = listing.facts["scans"]
    assert (scan["name"], scan["sensor"], scan["points"]) == ("yard", "Acme X1", N)
    assert (scan["station"], scan["intensityLimits"]) == (list(AT), [0, 4095])
    np.testing.assert_allclose(scan["rotation"], TURN)
    assert read(path).crs == "EPSG:25832"


def test_many_blocks_are_one_file(tmp_path, monkeypatch):
    path = save(tmp_path / "a.e57", (xyz_columns(kind="single") | {"intensity": Column(np.arange(N), "int")}, {}))
    monkeypatch.setattr(e57, "BLOCK", 64)
    with e57.E57Source(path, Request()) as source:
        chunks = list(source.chunks())
    assert len(chunks) == -(-N // 64)
    assert {chunk.positions.dtype for chunk in chunks} == {np.dtype(np.float32)}
    np.testing.assert_array_equal(np.concatenate([chunk.positions for chunk in chunks]), XYZ.astype(np.float32))
    np.testing.assert_array_equal(np.concatenate([chunk.attributes["intensity"] for chunk in chunks]), np.arange(N))
    assert [chunk.share for chunk in chunks] == sorted(chunk.share for chunk in chunks)
    assert chunks[-1].share == 1


# ---------------------------------------------------------------------------------------------------- what is wrong


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('recordCount="500"', 'recordCount="9e9"', "recordCount of points is '9e9', not an integer"),
        ("<guid type", "<!DOCTYPE ", "its XML"),
        ("cartesianX", "cartesianW", "scan 0 has no positions; available: cartesianW, cartesianY, cartesianZ"),
        ('fileOffset="48"', 'fileOffset="7 "', "500 points from byte 7 of"),
        ('type="CompressedVector"', 'type="Structure"', "contains no points: 1 scans found, all empty"),
    ],
)
def test_invalid_headers_are_refused(tmp_path, old, new, message):
    path = save(tmp_path / "a.e57", (xyz_columns(), {}))
    with_xml(path, old, new)
    with pytest.raises(ValueError, match=re.escape(message)):
        read(path)


def test_more_points_than_bytes_are_refused_before_memory_is_taken(tmp_path):
    path = save(tmp_path / "a.e57", (xyz_columns(), {}))
    with_xml(path, 'recordCount="500"', 'recordCount="987"')
    with pytest.raises(ValueError, match=r"987 points of 23,688 bytes expected, 14,336 bytes found"):
        read(path, strict=True)


def test_a_changed_byte_is_detected(tmp_path):
    path = save(tmp_path / "a.e57", (xyz_columns(), {}))
    data = bytearray(path.read_bytes())
    data[5000] ^= 1
    path.write_bytes(data)
    with pytest.raises(ValueError, match=r"a.e57: is damaged in scan 0.*: checksum mismatch, file is corrupted(\n|$)"):
        read(path)


def test_a_file_that_is_being_written_is_refused(tmp_path):
    path = save(tmp_path / "a.e57", (xyz_columns(), {}))
    data = path.read_bytes()
    for size in (40, 1024, len(data) - 1024):
        path.write_bytes(data[:size])
        with pytest.raises(ValueError, match=r"is cut off"):
            read(path)


def test_unsafe_xml_is_refused():
    for text, message in [
        (b'<!DOCTYPE a [<!ENTITY x SYSTEM "file:///etc/passwd">]><a>&x;</a>', "declares XML types"),
        (b'<a xmlns:xsi="x" xsi:schemaLocation="http://x http://x/x.xsd"/>', "refers to an XML schema"),
        (b"<a>" * 100 + b"</a>" * 100, "nested"),
        (b"<?xml version='1.0' encoding='utf-18'?><a/>", "unknown encoding"),
    ]:
        with pytest.raises(ValueError, match=message):
            _e57_header._parse(text)


def test_mutated_files_are_read_or_refused(tmp_path, rng):
    """Checksums are valid, so that the library parses the changes; an unclosed string leaves one scan."""
    path = save(tmp_path / "a.e57", (xyz_columns() | color_columns(RGB), pose()), (xyz_columns(), {}))
    data, read_whole = path.read_bytes(), 0
    for _ in range(60):
        changed = bytearray(data)
        for at in rng.integers(0, len(data), rng.integers(1, 5)):
            changed[at] = rng.integers(256)
        rows = [bytes(changed[at : at + 1020]) for at in range(0, len(changed), 1024)]
        path.write_bytes(b"".join(row + struct.pack(">I", crc32c(row)) for row in rows))
        try:
            count = len(read(path))
            assert count in (N, 2 * N)
            read_whole += count == 2 * N
        except ValueError as error:
            assert "\n" not in str(error)
    assert 10 < read_whole < 60


def test_a_missing_package_is_named(tmp_path, monkeypatch):
    path = save(tmp_path / "a.e57", (xyz_columns(), {}))
    monkeypatch.setitem(sys.modules, "pye57", None)
    with pytest.raises(ValueError, match=r"a.e57 needs pye57: pip install 'pointray\[e57\]'"):
        read(path)
