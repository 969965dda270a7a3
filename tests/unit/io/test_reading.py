"""Reading files into one cloud: selection of rows, joining, compressed files, colours, memory."""

from __future__ import annotations

import gzip
import warnings

import numpy as np
import pytest

import pointray as pr
from helpers.row_source import Rows
from pointray.base import memory
from pointray.cloud.georeference import RESIDUAL, SCAN, Georeference, numbers_of
from pointray.io import files, gather
from pointray.io.colors import ColorRange, to_shades
from pointray.io.filling import Filling
from pointray.io.formats._source import Chunk
from pointray.io.formats.ply import _binary
from pointray.io.opening import Opener
from pointray.io.selection import Selection

XYZ = np.random.default_rng(4).random((1000, 3))
CLASSES = np.random.default_rng(5).integers(0, 9, 1000).astype(np.uint8)


def gathered(*chunks, selection=None, progress=None, **about):
    openers = [Opener(f"{k}.abc", lambda chunk=chunk: Rows(chunk, **about)) for k, chunk in enumerate(chunks)]
    return gather.gather(openers, selection or Selection(), progress)


def test_dropped_rows_take_no_memory():
    """The chosen rows are copied, as a view would keep all rows of the file."""
    chunk = Chunk(XYZ, normals=XYZ.astype(np.float32), attributes={"a": CLASSES})
    for selection in (Selection(every=10), Selection(bounds=np.array([[0, 0, 0], [0.1, 1, 1]]))):
        assert all(column.base is None for column in selection.apply(chunk, 3).columns)


def test_chunks_are_copied_into_preallocated_arrays():
    filling = Filling(1000)
    for start in range(0, 1000, 300):
        filling.add(Chunk(XYZ[start : start + 300], attributes={"a": CLASSES[start : start + 300].astype(">i2")}))
    (whole,) = filling.chunks
    np.testing.assert_array_equal(whole.positions, XYZ)
    np.testing.assert_array_equal(whole.attributes["a"], CLASSES)
    assert whole.attributes["a"].dtype == np.int16


def test_a_later_chunk_may_need_a_wider_type_and_rows_may_be_missing():
    filling = Filling(1000)
    filling.add(Chunk(XYZ[:300], attributes={"a": CLASSES[:300]}))
    filling.add(Chunk(XYZ[300:400], attributes={"a": CLASSES[300:400] + 0.5}))
    (whole,) = filling.chunks
    assert len(whole.positions) == 400
    assert whole.attributes["a"].tolist() == [*CLASSES[:300], *(CLASSES[300:400] + 0.5)]
    assert Filling(1000).chunks == []


@pytest.fixture
def scan(tmp_path, monkeypatch):
    """A file of 1,000 rows that is read in chunks of 64."""
    monkeypatch.setattr(_binary, "CHUNK", 64)
    path = tmp_path / "scan.ply"
    pr.write(path, pr.Points(XYZ, attributes={"row": np.arange(1000), "classification": CLASSES}))
    return path


@pytest.mark.parametrize(
    ("options", "rows"),
    [
        ({"every": 7}, np.arange(0, 1000, 7)),
        (
            {"bounds": (0.2, 0, 0, 0.7, 1, 0.5)},
            np.flatnonzero((XYZ[:, 0] >= 0.2) & (XYZ[:, 0] <= 0.7) & (XYZ[:, 2] <= 0.5)),
        ),
        ({"keep": {"classification": [2, 6]}}, np.flatnonzero(np.isin(CLASSES, (2, 6)))),
        ({"drop": {"classification": 7}}, np.flatnonzero(CLASSES != 7)),
        (
            {"keep": {"classification": (1, 2, 3)}, "drop": {"classification": 3}},
            np.flatnonzero(np.isin(CLASSES, (1, 2))),
        ),
        ({"keep": {"classification": 4}, "every": 3}, np.flatnonzero((CLASSES == 4) & (np.arange(1000) % 3 == 0))),
    ],
)
def test_rows_are_chosen(scan, options, rows):
    assert pr.read(scan, **options).attributes["row"].tolist() == rows.tolist()


@pytest.mark.parametrize("count", [1, 3, 64, 333, 999, 1000, 5000])
def test_max_points_selects_evenly(scan, count):
    rows = pr.read(scan, max_points=count).attributes["row"]
    assert len(rows) == min(count, 1000)
    assert np.diff(rows).max(initial=1) <= -(-1000 // count)
    assert len(pr.read(scan, every=5, max_points=count)) == min(count, 200)


@pytest.mark.parametrize("count", [1, 7, 100, 400, 999])
def test_max_points_works_if_the_number_of_rows_is_unknown(count):
    chunk = Chunk(XYZ, attributes={"row": np.arange(1000)})
    points = gathered(chunk, chunk, selection=Selection(max_points=count), known=False)
    rows = np.concatenate([points.attributes["row"][:1], np.diff(points.attributes["row"]) % 1000])
    assert count / 2 <= len(points) <= count
    assert len(set(rows[1:].tolist())) <= 1  # evenly, across files as well
    kept = gathered(chunk, selection=Selection(max_points=count, drop={"row": range(500)}))
    assert min(count, 500) / 2 <= len(kept) <= count
    assert kept.attributes["row"].min() >= 500


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"every": 0}, "every must be"),
        ({"max_points": 0}, "max_points must be"),
        ({"bounds": (1, 2, 3)}, "bounds must be x0,y0,z0,x1,y1,z1"),
        ({"bounds": (1, 0, 0, 0, 1, 1)}, "minimum first"),
        ({"keep": {"class": 2}}, "no attribute 'class' for keep or drop; available: classification, row"),
        ({"keep": {"classification": []}}, "at least one number"),
        ({"keep": [2]}, "keep must be a dict"),
        ({"drop": {"row": "ground"}}, "must be numbers"),
        ({"keep": {"classification": 77}}, "contains no selected points"),
        ({"columns": "x,y"}, "must name z once"),
        ({"resolution": -1}, "resolution must be"),
        ({"sample": -1}, "sample must be"),
        ({"opacity": 2}, "opacity must be"),
        ({"intrinsics": (1, 2)}, "intrinsics must be"),
    ],
)
def test_wrong_options_are_named(scan, options, words):
    with pytest.raises(ValueError, match=words):
        pr.read(scan, **options)


def test_several_files_are_one_cloud(scan, tmp_path):
    second = tmp_path / "second.ply"
    pr.write(second, pr.Points(XYZ + [2, 0, 0], XYZ, (XYZ * 255).astype(np.uint8), {"row": np.arange(1000) + 0.5}))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        points = pr.read([scan, second])
    assert [str(warning.message) for warning in caught] == [
        f"columns that only some files have: normals, colors (set to grey); missing in: {scan}",
        f"columns that only some files have: classification; missing in: {second}",
    ]
    np.testing.assert_allclose(points.world, np.vstack([XYZ, XYZ + [2, 0, 0]]), atol=1e-6)
    assert points.attributes["row"].tolist() == [*range(1000), *(np.arange(1000) + 0.5)]
    assert points.attributes["classification"].tolist() == [*CLASSES, *[0] * 1000]
    assert (points.normals[:1000] == 0).all()
    np.testing.assert_array_equal(points.colors[[0, 1000]], [[128] * 3, (XYZ[0] * 255).astype(np.uint8)])


def test_missing_columns_are_reported_in_one_warning():
    full = Chunk(XYZ, attributes={"class": CLASSES, "row": np.arange(1000)})
    with pytest.warns(UserWarning, match="class, row; missing in") as caught:
        gathered(full, *[Chunk(XYZ)] * 7)
    expected = "columns that only some files have: class, row; missing in: 1.abc, 2.abc, 3.abc, 4.abc, 5.abc and 2 more"
    assert [str(warning.message) for warning in caught] == [expected]


def test_files_in_different_coordinate_systems_are_refused(tmp_path):
    paths = [tmp_path / f"{k}.ply" for k in range(3)]
    for path, crs in zip(paths, ("EPSG:25832", "EPSG:25832", "EPSG:25833"), strict=True):
        pr.write(path, pr.Points(XYZ, georeference=Georeference(crs)))
    assert pr.read(paths[:2]).crs == "EPSG:25832"
    with pytest.raises(ValueError, match=r"0\.ply and .*2\.ply have different coordinate systems, 'EPSG:25832'"):
        pr.read(paths)
    with pytest.raises(ValueError, match="at least one file"):
        pr.read([])


def test_stations_of_several_files_are_distinguished():
    first, second = Georeference(stations=((1, 2, 3),)), Georeference(stations=((4, 5, 6), (7, 8, 9)))
    chunk, both = Chunk(XYZ), Chunk(XYZ, attributes={SCAN: np.repeat([0, 1], 500)})
    openers = [
        Opener("a", lambda: Rows(chunk, georeference=first)),
        Opener("b", lambda: Rows(both, georeference=second)),
    ]
    openers.append(Opener("c", lambda: Rows(chunk)))
    with pytest.warns(UserWarning, match=f"only some files have: {SCAN}"):
        points = gather.gather(openers, Selection(), None)
    assert points.georeference.stations == ((1, 2, 3), (4, 5, 6), (7, 8, 9))
    assert points.attributes[SCAN].tolist() == [0] * 1000 + [1] * 500 + [2] * 500 + [-1] * 1000


@pytest.mark.parametrize("width", [10.0, 1e6])
def test_whole_numbers_of_a_file_come_back_to_the_last(width, rng):
    georeference = Georeference(scale=(1e-3, 1e-3, 1e-4), offset=(500_000.0, 5_400_000.0, 0.0))
    numbers = rng.integers(0, int(width * 1e3), (1000, 3))
    world = numbers * georeference.scale + np.array(georeference.offset)
    points = gathered(Chunk(world), georeference=georeference)
    kept = numbers_of(points.georeference, points.world) + points.attributes.get(RESIDUAL, 0)
    np.testing.assert_array_equal(kept, numbers)
    assert (RESIDUAL in points.attributes) == (width > 1e5)


def test_packed_files_are_unpacked(scan, tmp_path):
    plain = pr.read(scan)
    packed = {"scan.ply.gz": gzip.compress(scan.read_bytes()), "unsaid.ply": gzip.compress(scan.read_bytes())}
    zstd = pytest.importorskip("backports.zstd")
    packed["scan.ply.zst"] = zstd.compress(scan.read_bytes())
    for name, data in packed.items():
        (tmp_path / name).write_bytes(data)
        np.testing.assert_array_equal(pr.read(tmp_path / name).positions, plain.positions)
        (tmp_path / name).write_bytes(data[: len(data) // 2])
        with pytest.raises(ValueError, match=rf"{name}: is damaged or cut off"):
            pr.read(tmp_path / name, strict=True)
        (tmp_path / name).write_bytes(data[:9] + bytes(200) + data[209:])
        with pytest.raises(ValueError, match=rf"{name}: "):
            pr.read(tmp_path / name)


def test_a_file_that_is_being_written_is_reported(scan, monkeypatch):
    whole = scan.read_bytes()

    def written(*arguments):
        scan.write_bytes(whole + bytes(10))
        return gather.gather(*arguments)

    monkeypatch.setattr(files, "gather", written)
    with pytest.raises(ValueError, match="was modified while it was read"):
        pr.read(scan)


@pytest.mark.parametrize(
    ("given", "shown"),
    [
        (np.array([[0, 128, 255]], np.uint8), [0, 128, 255]),
        (np.array([[0, 128, 255]], np.uint16), [0, 128, 255]),  # 8 bits in 16
        (np.array([[0, 128 * 256, 255 * 256]], np.uint16), [0, 128, 255]),  # shifted
        (np.array([[0, 128 * 257, 65535]], np.uint16), [0, 128, 255]),
        (np.array([[1, 128 * 257, 40000]], np.uint16), [0, 128, 156]),
        (np.array([[0, 0.5, 1]]), [0, 128, 255]),
        (np.array([[0, 127.6, 255]], np.float32), [0, 128, 255]),
        (np.array([[0, -128, -1]], np.int8), [0, 128, 255]),
        (np.array([[0, 128, 255]], np.int64), [0, 128, 255]),
    ],
)
def test_colors_of_all_kinds_become_8_bits(given, shown):
    known = ColorRange.of([given, given[:0]])
    assert to_shades(given, known.scale(given.dtype)).tolist() == [shown]
    assert to_shades(given[:0], known.scale(given.dtype)).shape == (0, 3)
    assert not known.note(given.dtype)


@pytest.mark.parametrize("wrong", [[[0, 1, 70000]], [[0, -1, 300]], [[-0.5, 0.0, 1.0]], [[np.inf, 1, 0]]])
def test_colors_out_of_range_are_refused(wrong):
    with pytest.raises(ValueError, match="invalid colours: got"):
        ColorRange.of([np.array(wrong)]).scale(np.array(wrong).dtype)


def test_all_chunks_decide_whether_colors_have_16_bits():
    dark, bright = np.full((1, 3), 200, np.uint16), np.full((1, 3), 51400, np.uint16)
    scale = ColorRange.of([dark, bright]).scale(dark.dtype)
    assert [to_shades(one, scale).tolist() for one in (dark, bright)] == [[[1, 1, 1]], [[200, 200, 200]]]


def test_too_little_memory_is_reported_before_rows_are_read(scan, monkeypatch):
    monkeypatch.setattr(memory, "available_memory", lambda: 10_000)
    with pytest.raises(ValueError, match=r"scan\.ply.*memory are needed to read 1,000 points.*--max-points"):
        pr.read(scan)
    assert len(pr.read(scan, max_points=100)) == 100


def test_progress_grows_to_one():
    shares = []
    gathered(Chunk(XYZ), Chunk(XYZ), progress=shares.append)
    assert shares == sorted(shares)
    assert 0.8 < shares[-1] <= 1


@pytest.mark.parametrize(
    ("name", "hint"),
    [("a.sog", "SuperSplat"), ("a.fls", "as E57"), ("a.fbx", "as .glb or .obj"), ("a.zip", "unpack it")],
)
def test_files_of_other_programs_get_a_hint(tmp_path, name, hint):
    (tmp_path / name).write_bytes(b"PK\x03\x04" + bytes(100))
    with pytest.raises(ValueError, match=f"unsupported file type .{name[2:]}: .*{hint}"):
        pr.read(tmp_path / name)
