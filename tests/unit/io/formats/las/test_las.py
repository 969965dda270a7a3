"""LAS, LAZ and COPC: all point formats, exact integers and dtypes, coordinate systems, octree nodes, damaged files."""

from __future__ import annotations

import struct
import sys
import warnings
from itertools import product
from pathlib import Path

import laspy
import numpy as np
import pytest
from laspy.vlrs.known import WktCoordinateSystemVlr

import pointray as pr
from helpers.las_files import write_random
from helpers.marks import long
from helpers.places import shared_model
from pointray.cloud.georeference import RESIDUAL, Georeference, numbers_of
from pointray.io.files import headers, write_points
from pointray.io.formats._source import Request
from pointray.io.formats.las._crs import keys_of, records_for, unit_of
from pointray.io.formats.las.las import LasSource

FILES = ("1.2-with-color.las", "Megaplot.laz", "autzen_trim_rgb.laz", long("lion_takanawa.copc.laz"))
VERSIONS = [("1.1", f) for f in (0, 1)] + [("1.2", f) for f in (2, 3)] + [("1.3", f) for f in (4, 5)]
VERSIONS += [("1.4", f) for f in range(11)]
NOT_ATTRIBUTES = {"X", "Y", "Z", "red", "green", "blue"}
PROJECTED = (
    'PROJCS["a",GEOGCS["b",UNIT["degree",0.0174]],PROJECTION["c"],PARAMETER["d",1],UNIT["US survey foot",0.3048]]'
)


def check_same(points: pr.Points, las: laspy.LasData) -> None:
    """Check that all that laspy reads is there, with its dtypes."""
    names = [name for name in las.point_format.dimension_names if name not in NOT_ATTRIBUTES]
    assert set(points.attributes) - {RESIDUAL} == set(names)
    for name in names:
        wanted, found = np.asarray(las[name]), points.attributes[name]
        assert found.dtype == wanted.dtype and found.shape == wanted.shape and found.flags.c_contiguous, name
        np.testing.assert_array_equal(found, wanted, err_msg=name)
    numbers = numbers_of(points.georeference, points.world) + points.attributes.get(RESIDUAL, 0)
    np.testing.assert_array_equal(numbers, np.stack([las.X, las.Y, las.Z], axis=1))
    np.testing.assert_array_equal(points.georeference.scale, las.header.scales)
    assert (points.colors is not None) == ("red" in las.point_format.dimension_names)


@pytest.mark.scans
@pytest.mark.parametrize("name", FILES)
def test_real_files_agree_with_laspy(name: str, tmp_path: Path) -> None:
    path = shared_model(f"raw/{name}")
    points, las = pr.read(path), laspy.read(path)
    check_same(points, las)
    world = np.stack([np.asarray(las[axis]) for axis in "xyz"], axis=1)
    np.testing.assert_allclose(points.bounds, [world.min(axis=0), world.max(axis=0)], atol=1e-3)
    for suffix in (".las", ".laz") if len(points) < 200_000 else (".laz",):
        pr.write(tmp_path / f"b{suffix}", points)
        again = laspy.read(tmp_path / f"b{suffix}")
        assert again.point_format.id == las.point_format.id
        assert all(np.array_equal(again[axis], las[axis]) for axis in "XYZ")
        check_same(pr.read(tmp_path / f"b{suffix}"), las)


@pytest.mark.parametrize(("version", "format", "suffix"), [(*v, s) for v, s in product(VERSIONS, (".las", ".laz"))])
def test_all_versions_and_formats_are_read(version: str, format: int, suffix: str, tmp_path: Path) -> None:
    las = write_random(tmp_path / f"a{suffix}", version, format)
    points = pr.read(tmp_path / f"a{suffix}")
    check_same(points, las)
    pr.write(tmp_path / f"b{suffix}", points)
    again = laspy.read(tmp_path / f"b{suffix}")
    assert str(again.header.version) == "1.4" and not any(
        name == RESIDUAL for name in again.point_format.dimension_names
    )
    assert all(np.array_equal(again[axis], las[axis]) for axis in "XYZ")
    own = pr.read(tmp_path / f"b{suffix}").attributes
    for name, values in points.attributes.items():
        if name != RESIDUAL:
            np.testing.assert_array_equal(np.asarray(again[name]), values, err_msg=name)
            np.testing.assert_array_equal(own[name], values, err_msg=name)


def test_version_1_0_and_unnamed_extra_bytes_are_read(tmp_path: Path) -> None:
    path = tmp_path / "a.las"
    las = write_random(path, "1.1", 1)
    raw = bytearray(path.read_bytes())
    raw[25] = 0
    at = raw.index(b"LASF_Spec\0")
    raw[at : at + 9] = b"SOME_Spec"
    path.write_bytes(raw)
    points = pr.read(path)
    assert [facts for _, _, x in headers(path) if (facts := x.facts["version"])] == ["1.0"]
    extra = points.attributes["ExtraBytes"]
    assert extra.shape == (500, las.header.point_format.num_extra_bytes)
    assert (extra[:, 0] == las["e u1"]).all()
    with pytest.warns(UserWarning, match="separately"):
        pr.write(tmp_path / "b.laz", points)
    assert (pr.read(tmp_path / "b.laz").attributes["ExtraBytes_0"] == extra[:, 0]).all()


def test_extra_bytes_of_the_same_name_are_kept_apart(tmp_path: Path) -> None:
    path = tmp_path / "a.las"
    las = write_random(path, "1.4", 6)
    raw = path.read_bytes().replace(b"e i2\0\0\0\0\0", b"intensity", 1).replace(b"e u4\0", b"\0\0\0\0\0", 1)
    path.write_bytes(raw)
    attributes = pr.read(path).attributes
    assert (attributes["intensity_"] == las["e i2"]).all() and (attributes["extra"] == las["e u4"]).all()
    assert (attributes["intensity"] == las["intensity"]).all()


def test_extra_bytes_of_several_records(tmp_path: Path) -> None:
    """The descriptions continue in the next record; a repeated one is ignored."""
    path = tmp_path / "a.las"
    las = write_random(path, "1.1", 1)
    raw = path.read_bytes()
    at, size = raw.index(b"LASF_Spec") - 2, 192 * 9
    record, described = raw[at : at + 54], raw[at + 54 : at + 54 + size]
    parts = [described[:384], described[384:], described[:384]]
    records = b"".join(record[:20] + struct.pack("<H", len(part)) + record[22:] + part for part in parts)
    raw = changed(raw, 96, "<II", struct.unpack_from("<I", raw, 96)[0] + len(records) - 54 - size, 3)
    path.write_bytes(raw[:at] + records + raw[at + 54 + size :])
    check_same(pr.read(path, strict=True), las)


def test_an_offset_of_minus_zero_is_reported_as_zero(tmp_path: Path) -> None:
    path = tmp_path / "a.las"
    header = laspy.LasHeader(version="1.2", point_format=3)
    header.offsets = np.array([-0.0, 1.0, -0.0])
    las = laspy.LasData(header)
    las.x = las.y = las.z = np.arange(5.0)
    las.write(path)
    offset = next(headers(path))[2].facts["offset"]
    assert str(offset) == "[0.0, 1.0, 0.0]"


@pytest.mark.parametrize("scale", (0.01, 1e-7, 0.25, 7.3e-5))
@pytest.mark.parametrize("offset", (0.0, 123456.789, -5.4e6))
@pytest.mark.parametrize("width", (1000, 2**31 - 1))  # so wide that float32 loses digits
def test_integer_coordinates_are_kept_exactly(scale: float, offset: float, width: int, tmp_path: Path) -> None:
    header = laspy.LasHeader(version="1.4", point_format=0)
    header.scales, header.offsets = np.full(3, scale), np.full(3, offset)
    las = laspy.LasData(header)
    numbers = np.random.default_rng(5).integers(-width, width, (3, 2000), endpoint=True).astype(np.int32)
    las.X, las.Y, las.Z = numbers
    las.write(tmp_path / "a.las")
    points = pr.read(tmp_path / "a.las")
    assert (RESIDUAL in points.attributes) == (width > 1000)
    pr.write(tmp_path / "b.laz", points)
    again = laspy.read(tmp_path / "b.laz")
    np.testing.assert_array_equal([again.X, again.Y, again.Z], numbers)
    assert (again.header.scales == scale).all() and (again.header.offsets == offset).all()
    some = points.select(np.arange(0, 2000, 7))
    pr.write(tmp_path / "c.las", some)
    np.testing.assert_array_equal(laspy.read(tmp_path / "c.las").X, numbers[0, ::7])


def test_colors_normals_and_other_attributes_are_written(tmp_path: Path) -> None:
    random = np.random.default_rng(0)
    n = 300
    attributes = {
        "intensity": random.random(n),  # no whole numbers: extra bytes
        "classification": random.integers(0, 31, n),
        "gps_time": random.random(n) * 1e9,
        "flag": random.random(n) < 0.5,
        "wide": random.random((n, 5)).astype(np.float32),
        "three": random.integers(0, 9, (n, 3)).astype(np.int16),
        "a name of more than thirty-two bytes in all": np.arange(n, dtype=np.uint64),
        "X": np.arange(n, dtype=np.int8),
    }
    points = pr.Points(
        random.random((n, 3)), random.random((n, 3)), random.integers(0, 256, (n, 3), np.uint8), attributes
    )
    with pytest.warns(UserWarning) as told:
        pr.write(tmp_path / "a.laz", points)
    assert len(told) == 4
    las = laspy.read(tmp_path / "a.laz")
    assert las.point_format.id == 3 and las.header.global_encoding.gps_time_type == 1
    assert (las.red == points.colors[:, 0].astype(int) * 257).all()
    again = pr.read(tmp_path / "a.laz")
    np.testing.assert_array_equal(again.normals, points.normals)
    np.testing.assert_array_equal(again.colors, points.colors)
    np.testing.assert_allclose(again.world, points.world, atol=2.0**-24)
    for name, found in {
        "classification": "classification",
        "gps_time": "gps_time",
        "intensity": "intensity_2",
        "three": "three",
        "X": "X_2",
    }.items():
        np.testing.assert_array_equal(again.attributes[found], attributes[name])
    np.testing.assert_array_equal(again.attributes["wide_4"], attributes["wide"][:, 4])
    assert again.attributes["flag"].dtype == np.uint8


def test_names_are_reported_as_they_are_read(rng, tmp_path: Path) -> None:
    names = [" ", " a ", "\0", "\ud800", "a", "b" * 31 + " c", "\u65e5" * 11, "b" * 31]
    points = pr.Points(rng.random((20, 3)), attributes={name: np.arange(20) + k for k, name in enumerate(names)})
    losses = write_points(tmp_path / "a.las", points)
    again = pr.read(tmp_path / "a.las").attributes
    new = ["extra", "a", "extra_2", "?", "a_2", "b" * 31, "\u65e5" * 10, "b" * 30 + "_2"]
    assert losses == [f"stores {old} as the extra bytes {name}" for old, name in zip(names, new, strict=True)]
    for k, name in enumerate(new):
        np.testing.assert_array_equal(again[name], np.arange(20) + k, err_msg=name)


@pytest.mark.parametrize(
    "names", [("nx", "ny", "nz"), ("Normal_X", "normal_y", "normal_z"), ("NormalX", "NormalY", "NormalZ")]
)
def test_attributes_named_like_normals_stay_attributes(rng, tmp_path: Path, names: tuple[str, ...]) -> None:
    attributes = {name: rng.random(20).astype(np.float32) for name in names}
    for normals in (None, rng.normal(size=(20, 3)).astype(np.float32)):
        points = pr.Points(rng.random((20, 3)), normals, attributes=attributes)
        losses = write_points(tmp_path / "a.las", points)
        again = pr.read(tmp_path / "a.las")
        assert (again.normals is None) == (normals is None)
        if normals is not None:
            np.testing.assert_array_equal(again.normals, normals)
        assert len(again.attributes) - ("grid_residual" in again.attributes) >= 3
        for name in names:
            new = name if name in again.attributes else f"{name}_2"
            np.testing.assert_array_equal(again.attributes[new], attributes[name])
            assert (f"stores {name} as the extra bytes {new}" in losses) == (new != name)


def test_the_smallest_sufficient_point_format_is_chosen(tmp_path: Path) -> None:
    n = 10
    for names, wanted in ((), 0), (("gps_time",), 1), (("nir",), 8), (("overlap", "classification"), 6):
        points = pr.Points(np.random.default_rng(0).random((n, 3)), attributes={name: np.ones(n) for name in names})
        pr.write(tmp_path / "a.las", points)
        assert laspy.read(tmp_path / "a.las").point_format.id == wanted
    points = pr.Points(np.ones((n, 3)) * np.arange(n)[:, None], attributes={"classification": np.full(n, 200)})
    pr.write(tmp_path / "a.las", points)
    assert laspy.read(tmp_path / "a.las").point_format.id == 6


def test_rows_that_are_not_finite_are_left_out(tmp_path: Path) -> None:
    positions = np.arange(30.0).reshape(10, 3)
    positions[3, 1] = np.nan
    with pytest.warns(UserWarning, match="leaves out 1 row"):
        pr.write(tmp_path / "a.las", pr.Points(positions, attributes={"user_data": np.arange(10)}))
    assert pr.read(tmp_path / "a.las").attributes["user_data"].tolist() == [0, 1, 2, 4, 5, 6, 7, 8, 9]


def test_grids_that_do_not_fit_are_moved_or_coarsened(tmp_path: Path) -> None:
    far = pr.Points(
        np.arange(30.0).reshape(10, 3) + 1e7, georeference=Georeference(scale=(0.001,) * 3, offset=(0.0,) * 3)
    )
    pr.write(tmp_path / "a.las", far)
    np.testing.assert_allclose(pr.read(tmp_path / "a.las").world, far.world, atol=1e-6)
    wide = pr.Points(
        np.arange(30.0).reshape(10, 3) * 1e6, georeference=Georeference(scale=(0.001,) * 3, offset=(0.0,) * 3)
    )
    with pytest.warns(UserWarning, match="too large for 32 bits"):
        pr.write(tmp_path / "a.las", wide)
    np.testing.assert_allclose(pr.read(tmp_path / "a.las").world, wide.world, atol=3)


# ------------------------------------------------------------------------------------------- coordinate systems


def test_well_known_text_is_kept_unchanged(tmp_path: Path) -> None:
    path = tmp_path / "a.las"
    for text in (PROJECTED, PROJECTED.replace("c", "c" * 70_000)):
        points = pr.Points(np.arange(30.0).reshape(10, 3), georeference=Georeference(text))
        pr.write(path, points)
        assert pr.read(path).crs == text and pr.read(path).georeference.unit == "US survey foot"
        assert laspy.read(path).header.global_encoding.wkt
    header = laspy.LasHeader(version="1.4", point_format=6)
    header.vlrs.append(WktCoordinateSystemVlr(PROJECTED))
    las = laspy.LasData(header)
    las.X = las.Y = las.Z = np.arange(9)
    las.write(path)
    assert pr.read(path).crs == PROJECTED


@pytest.mark.parametrize(("code", "unit"), [(25832, "metre"), (2285, "US survey foot"), (4326, "degree"), (2285, None)])
def test_epsg_codes_are_written_and_read(code: int, unit: str | None, tmp_path: Path) -> None:
    points = pr.Points(np.arange(30.0).reshape(10, 3), georeference=Georeference(f"EPSG:{code}", unit))
    pr.write(tmp_path / "a.las", points)
    georeference = pr.read(tmp_path / "a.las").georeference
    assert (georeference.crs, georeference.unit) == (f"EPSG:{code}", unit)
    keys = laspy.read(tmp_path / "a.las").header.vlrs.get("GeoKeyDirectoryVlr")[0].geo_keys
    assert code in [key.value_offset for key in keys]


def test_coordinate_systems_that_geokeys_cannot_store_are_reported() -> None:
    words: list[str] = []
    assert (
        records_for("EPSG:102100", None, words) == [] and records_for("ESRI:1", None, words) == [] and len(words) == 2
    )
    ((number, data),) = records_for(None, "foot", words)
    assert (number, keys_of(data)) == (34735, {3076: 9002})
    assert keys_of(b"\1\0") == {}


def test_units_are_found_in_well_known_text() -> None:
    assert unit_of(PROJECTED) == "US survey foot"
    assert unit_of('GEOGCS["b",PRIMEM["c",0],UNIT["degree",0.0174]]') == "degree"
    two = 'COMPOUNDCRS["x",PROJCRS["a",BASEGEOGCRS["b",DATUM["d",ELLIPSOID["e",1,2,LENGTHUNIT["foot",1]]]],'
    two += 'CONVERSION["f",PARAMETER["g",1,ANGLEUNIT["degree",1]]],CS[Cartesian,2],AXIS["E",east],'
    two += 'LENGTHUNIT["metre",1]],VERTCRS["v",CS[vertical,1],AXIS["u",up],LENGTHUNIT["foot",1]]]'
    assert unit_of(two) == "metre" and unit_of("]]][[[") is None and unit_of("") is None
    for part in ("a", '"', '""a', "a[", "]", " ", "a  ", 'UNIT["",'):  # no hang
        assert unit_of('"' + part * 200_000) is None


# --------------------------------------------------------------------------------------------------------- COPC


@pytest.mark.scans
def test_octree_nodes_agree_with_laspy() -> None:
    path = shared_model("raw/lion_takanawa.copc.laz")
    whole = laspy.read(path)
    low, high = np.quantile(np.stack([whole.x, whole.y, whole.z], axis=1), [0.3, 0.6], axis=0)
    box = np.round([low, high], 2) + np.array([[-0.004], [0.004]])  # laspy rounds to steps of 0.01
    with laspy.CopcReader.open(path) as reader:
        few, inside = reader.query(resolution=0.04), reader.query(laspy.Bounds(*box))
    points = pr.read(path, resolution=0.04)
    assert len(points) == len(few) < len(whole.points)
    np.testing.assert_array_equal(points.attributes["OriginId"], few["OriginId"])
    points = pr.read(path, bounds=box)
    rows = np.ones(len(whole.points), np.bool_)
    for k, axis in enumerate("xyz"):
        rows &= (np.asarray(whole[axis]) >= box[0, k]) & (np.asarray(whole[axis]) <= box[1, k])
    assert len(points) == rows.sum() == len(inside)
    with LasSource(path, Request(bounds=box)) as source:
        assert source.listing.count is None and len(points) <= source.listing.expected < len(whole.points)
        assert sum(len(chunk.positions) for chunk in source.chunks()) == source.listing.expected
    with pytest.raises(ValueError, match="no selected points"):
        pr.read(path, bounds=box + 1000)


@pytest.mark.scans
def test_hierarchy_pages_that_refer_to_each_other_are_refused(tmp_path: Path) -> None:
    data = bytearray(shared_model("raw/lion_takanawa.copc.laz").read_bytes())
    start, size = struct.unpack_from("<2Q", data, 375 + 54 + 40)
    struct.pack_into("<4iQ2i", data, start, 0, 0, 0, 0, start, size, -1)
    path = tmp_path / "a.copc.laz"
    path.write_bytes(data)
    with pytest.raises(ValueError, match="a page of its octree"):
        pr.read(path, resolution=1.0)
    struct.pack_into("<4iQ2i", data, start, 0, 0, 0, 0, start, 2**30, 100)
    path.write_bytes(data)
    with pytest.raises(ValueError, match="a node of its octree"):
        pr.read(path, resolution=1.0)


# -------------------------------------------------------------------------------------------------------- damage


def error_of(path: Path, data: bytes | bytearray) -> str:
    path.write_bytes(data)
    with pytest.raises(ValueError) as error:
        pr.read(path, strict=True)
    text = str(error.value)
    assert text.startswith(str(path)) and "\n" not in text
    return text[len(str(path)) :]


def changed(data: bytes, at: int, form: str, *values: object) -> bytearray:
    out = bytearray(data)
    struct.pack_into(form, out, at, *values)
    return out


def test_errors_are_reported(tmp_path: Path) -> None:
    path = tmp_path / "a.las"
    write_random(path, "1.4", 7)
    good = path.read_bytes()
    nan = float("nan")
    assert "is cut off in its header" in error_of(path, good[:200])
    for end in (300, 1000, len(good) - 1):
        assert "is cut off" in error_of(path, good[:end])
    assert "contains no points" in error_of(path, changed(changed(good, 247, "<Q", 0), 107, "<I", 0))
    assert "501 rows" in error_of(path, changed(good, 247, "<Q", 501))
    assert "invalid coordinate scale" in error_of(path, changed(good, 139, "<d", nan))
    assert "invalid coordinate offset" in error_of(path, changed(good, 155, "<d", nan))
    assert "its points begin at byte" in error_of(path, changed(good, 96, "<I", 2**31))
    assert "its points begin at byte" in error_of(path, changed(good, 96, "<I", 100))
    assert "1 of 4,294,967,295 variable length records" in error_of(path, changed(good, 100, "<I", 2**32 - 1))
    assert "unsupported point format 11" in error_of(path, changed(good, 104, "<B", 11))
    assert "point format 7 need 36 or more" in error_of(path, changed(good, 105, "<H", 35))
    assert "version 1.9" in error_of(path, changed(good, 25, "<B", 9))
    assert "begin at invalid byte 3" in error_of(path, changed(good, 235, "<QI", 3, 1))
    assert "0 of 1 extended variable" in error_of(path, changed(good, 235, "<QI", len(good), 1))
    path.write_bytes(changed(good, 247, "<Q", 400))
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        assert len(pr.read(path)) == 500
    caught = "; ".join(str(one.message) for one in told)
    assert "as many as 100 rows" in caught and "400 rows, but" in caught


def read_with_warning(path: Path, data: bytes) -> tuple[pr.Points, str]:
    """Return the points of a damaged file, and its only warning."""
    path.write_bytes(data)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        points = pr.read(path)
    assert len(caught) == 1
    return points, str(caught[0].message)


def test_wrong_records_do_not_hide_the_points(tmp_path: Path) -> None:
    path = tmp_path / "a.las"
    write_random(path, "1.4", 7)
    good, expected = path.read_bytes(), pr.read(path)
    described = good.index(b"e u1")  # of the first extra bytes
    records = [(100, "<I", 2), (100, "<I", 2**31 - 1), (235, "<QI", len(good), 1), (235, "<QI", 3, 1)]
    types = [(described - 2, "<B", 29), (described - 2, "<B", 99)]  # of 3 x 4 bytes; unknown
    for change in (*records, *types, (described + 4 * 192 - 2, "<B", 30)):
        at = change[0]
        points, caught = read_with_warning(path, changed(good, *change))
        assert ("variable length records" in caught) == (at < described - 2), change
        np.testing.assert_array_equal(points.world, expected.world)
        np.testing.assert_array_equal(points.attributes["gps_time"], expected.attributes["gps_time"])
        assert error_of(path, path.read_bytes())


@pytest.mark.parametrize(("version", "format"), [("1.2", 3), ("1.4", 7)])
@pytest.mark.parametrize("chunk", (50_000, 100))
def test_wrong_counts_of_compressed_points_are_handled(version: str, format: int, chunk: int, tmp_path: Path) -> None:
    """A layered chunk states its row count; of other chunks the last is decompressed as far as possible."""
    import lazrs

    path = tmp_path / "a.laz"
    write_random(path, version, format)
    good = path.read_bytes()
    las = laspy.read(path)
    if chunk == 100:
        vlr = lazrs.LazVlr.new_for_compression(format, las.header.point_format.num_extra_bytes)
        data = bytearray(vlr.record_data())
        struct.pack_into("<I", data, 12, chunk)
        (start,) = struct.unpack_from("<I", good, 96)
        with (tmp_path / "rows").open("w+b") as stream:
            compressor = lazrs.LasZipCompressor(stream, lazrs.LazVlr(bytes(data)))
            compressor.compress_many(las.points.array.tobytes())
            compressor.done()
            stream.seek(0)
            rows = bytearray(stream.read())
        struct.pack_into("<q", rows, 0, struct.unpack_from("<q", rows)[0] + start)
        at = good.index(b"laszip encoded") - 2 + 54
        good = good[:at] + bytes(data) + good[at + len(data) : start] + bytes(rows)
    path.write_bytes(good)
    expected = pr.read(path).world
    place = (107, "<I") if version == "1.2" else (247, "<Q")
    returns = changed(good, place[0] + struct.calcsize(place[1]), place[1], 500)  # fewer rows are noticed by them
    for count in (501, 530, 600, 2**32 - 1, 499, 350, 100):
        points, caught = read_with_warning(path, changed(returns, *place, count))
        assert f"{count:,} rows expected, 500 found" in caught
        np.testing.assert_array_equal(points.world, expected)
        assert f"{count:,} rows" in error_of(path, path.read_bytes())


@pytest.mark.scans
def test_an_octree_with_a_wrong_count_is_read_with_a_warning(tmp_path: Path) -> None:
    """Nodes selected by a box are read as well."""
    good, path = shared_model("raw/lion_takanawa.copc.laz").read_bytes(), tmp_path / "a.laz"
    (low, high), (count,) = (
        pr.read(shared_model("raw/lion_takanawa.copc.laz")).bounds,
        struct.unpack_from("<Q", good, 247),
    )
    path.write_bytes(changed(good, 247, "<Q15Q", 1000, *(0,) * 15))
    with pytest.warns(UserWarning, match="1,000 rows expected"):
        assert len(pr.read(path, bounds=[low, low + (high - low) * [1, 1, 0.99]])) > 0.9 * count
    with pytest.raises(ValueError, match="1,000 rows expected"):
        pr.read(path, bounds=[low, high], strict=True)


def test_errors_in_compressed_points_are_reported(tmp_path: Path) -> None:
    path = tmp_path / "a.laz"
    write_random(path, "1.4", 7)
    good = path.read_bytes()
    (start,) = struct.unpack_from("<I", good, 96)
    (table,) = struct.unpack_from("<q", good, start)
    vlr = good.index(b"laszip encoded") - 2 + 54
    for end in (start + 4, start + 2000, table, table + 4, len(good) - 8):
        assert "cut off" in error_of(path, good[:end])
    assert "not yet written" in error_of(path, changed(good, start, "<q", 0))
    assert "table of its chunks" in error_of(path, changed(good, table + 4, "<I", 2**32 - 1))
    assert "its chunks" in error_of(path, changed(good, table + 8, "<I", 2**32 - 1))
    assert "499 rows expected, 500 found" in error_of(path, changed(good, 247, "<Q", 499))
    assert "501 rows expected, 500 found" in error_of(path, changed(good, 247, "<Q", 501))
    (row,) = struct.unpack_from("<H", good, 105)
    assert "layers of other sizes" in error_of(path, changed(good, start + 8 + row + 4, "<I", 2**32 - 1))
    assert "compressed rows have" in error_of(path, changed(good, vlr + 34 + 2, "<H", 29))
    assert "compressed rows have" in error_of(path, changed(good, vlr + 34 + 6, "<H", 13))  # 6 bytes of a wave packet
    streams = start + 8 + row + 4 + 4 * 12  # behind the sizes of the layers: nine, colours, two extra bytes
    for skipped in (0, sum(struct.unpack_from("<8I", good, start + 8 + row + 4))):  # lazrs crashed on the times
        assert "an invalid stream" in error_of(path, changed(good, streams + skipped, "<I", 2**32 - 1))
    many = changed(good, vlr + 12, "<I", 2**31)  # rows in a chunk, and in this one: lazrs would fill 80 GB
    assert "which its 1 chunks contradict" in error_of(path, changed(bytes(many), start + 8 + row, "<I", 2**31))
    assert "an unsupported compression (1, 0)" in error_of(path, changed(good, vlr, "<H", 1))
    assert "record that describes the compression" in error_of(path, good.replace(b"laszip encoded", b"laszip_encoded"))
    path.write_bytes(good)
    assert len(pr.read(path)) == 500


def test_a_chunk_table_at_the_end_is_found(tmp_path: Path) -> None:
    path = tmp_path / "a.laz"
    las = write_random(path, "1.2", 3)
    good = path.read_bytes()
    (start,) = struct.unpack_from("<I", good, 96)
    (table,) = struct.unpack_from("<q", good, start)
    path.write_bytes(changed(good, start, "<q", -1) + struct.pack("<q", table))
    check_same(pr.read(path), las)


@pytest.mark.parametrize("raised", (KeyboardInterrupt, OSError))
def test_errors_of_the_stream_are_raised_unchanged(
    raised: type[BaseException], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """lazrs replaces them by an error of its own."""
    from pointray.base.atomic_write import Replacement

    written = Replacement.write

    def failing(self: Replacement, data: object) -> int:
        if len(bytes(data)) > 3000:  # type: ignore[call-overload]
            raise raised("the disk is full")
        return written(self, data)  # type: ignore[arg-type]

    monkeypatch.setattr(Replacement, "write", failing)
    points = pr.Points(np.random.default_rng(0).random((5000, 3)))
    with pytest.raises(raised):
        pr.write(tmp_path / "a.laz", points)
    assert list(tmp_path.iterdir()) == []


def test_the_same_points_give_the_same_file(tmp_path: Path) -> None:
    points = pr.Points(np.random.default_rng(0).random((120_000, 3)), attributes={"gps_time": np.arange(120_000.0)})
    shares: list[float] = []
    for name in ("a.laz", "b.laz"):
        pr.write(tmp_path / name, points, progress=lambda _, share: shares.append(share))
    assert (tmp_path / "a.laz").read_bytes() == (tmp_path / "b.laz").read_bytes()
    assert shares[-1] == 1.0 and len(pr.read(tmp_path / "a.laz", max_points=1000)) == 1000


def test_laz_without_lazrs_names_the_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_random(tmp_path / "a.laz", "1.2", 3)
    monkeypatch.setitem(sys.modules, "lazrs", None)
    with pytest.raises(ValueError, match=r"pip install 'laspy\[lazrs\]'"):
        pr.read(tmp_path / "a.laz")
