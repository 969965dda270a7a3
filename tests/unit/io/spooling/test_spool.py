"""Spooled clouds equal clouds in memory to the last bit, and need little memory."""

from __future__ import annotations

import os
import subprocess
import sys
import tracemalloc
import warnings
from collections import namedtuple
from contextlib import contextmanager

import numpy as np
import pytest

import pointray as pr
from helpers.las_files import write_random
from helpers.marks import long
from helpers.row_source import Rows
from helpers.small_files import full_points, small_scans
from pointray.base.disk_columns import Columns
from pointray.cloud.georeference import RESIDUAL, SCAN, Georeference
from pointray.cloud.points import choose_origin
from pointray.io.files import open_files, request_of
from pointray.io.formats._source import CHUNK, Chunk, Listing
from pointray.io.formats.ply import _binary
from pointray.io.gather import gather
from pointray.io.opening import Opener
from pointray.io.selection import Selection
from pointray.io.spooling import convert, spool as own
from pointray.io.spooling.spool import Spooled, spool, spooled_in

XYZ = np.random.default_rng(12).random((1000, 3))
RGB = np.random.default_rng(13).integers(0, 256, (1000, 3))
OPTIONS = {"opacity": 0.0, "intrinsics": (50.0, 55.0, 40.0, 30.0)}
LEFT_OUT = "left out"
Usage = namedtuple("Usage", "free")
READERS = "ply._binary", "ply._ascii", "las.las", "pcd.pcd", "arrays._array", "kitti", "depth", "_named_columns"


@pytest.fixture(autouse=True)
def small_chunks(request, monkeypatch):
    """Files are read, and columns converted, in chunks of 64 rows."""
    if "large_chunks" in request.fixturenames:
        return
    for name in READERS:
        module = __import__(f"pointray.io.formats.{name}", fromlist=["CHUNK"])
        if hasattr(module, "CHUNK"):
            monkeypatch.setattr(module, "CHUNK", 64)
    monkeypatch.setattr(convert, "CHUNK", 64)


@pytest.fixture
def large_chunks():
    """Chunks have their normal size."""


@pytest.fixture
def columns(tmp_path):
    return Columns(tmp_path / "columns")


@contextmanager
def noted():
    """Collect the texts of all warnings."""
    texts = []
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        yield texts
    texts += [str(warning.message) for warning in caught]


def points_of(columns: Columns) -> pr.Points:
    """Return a spooled cloud as points, checked against its metadata."""
    known = spooled_in(columns)
    names = ["positions", *["normals"] * known.normals, *["colors"] * known.colors]
    numbered = [f"attribute.{k}" for k in range(len(known.attributes))]
    assert columns.names == sorted(names + numbered)
    found = {name: columns[name][:] for name in columns.names}
    assert {len(rows) for rows in found.values()} == {known.rows}
    attributes = {name: found[number] for name, number in zip(known.attributes, numbered, strict=True)}
    points = pr.Points.about(known.origin, found["positions"], georeference=known.georeference)
    return points.changed(normals=found.get("normals"), colors=found.get("colors"), attributes=attributes)


def check_same(found: pr.Points, points: pr.Points) -> None:
    """Check that two clouds are equal to the last bit."""
    assert found.georeference == points.georeference and list(found.attributes) == list(points.attributes)
    one, other = ({**vars_of(cloud), **cloud.attributes} for cloud in (found, points))
    for name, values in other.items():
        if values is None:
            assert one[name] is None
            continue
        assert (one[name].dtype, one[name].shape) == (values.dtype, values.shape), name
        assert one[name].tobytes() == values.tobytes(), name


def vars_of(points: pr.Points) -> dict[str, np.ndarray | None]:
    """Return the columns of points other than attributes, by names that no attribute has."""
    return {name.upper(): getattr(points, name) for name in ("origin", "positions", "normals", "colors")}


def check(files, columns: Columns, **options) -> Spooled:
    """Check that spooling gives the same points (except rows that are not finite) and errors as reading."""
    choices = {name: options.pop(name) for name in list(options) if name in ("every", "bounds", "keep", "drop")}
    for name in columns.names:
        columns.drop(name)
    error = None
    with noted() as expected:
        try:
            points = pr.read(files, **choices, **options)
        except ValueError as raised:
            error = str(raised)
    with noted() as caught:
        try:
            request = request_of(**options, bounds=choices.get("bounds"))
            with open_files(files, request) as opened:
                spooled = spool(opened, Selection(**choices), columns)
        except ValueError as raised:
            assert str(raised) == error
            return None
    assert error is None
    return _checked(points, spooled, expected, caught, columns)


def check_chunks(columns: Columns, *sources, selection=None) -> Spooled:
    """Check the same for sources in memory: (chunk, chunk size, whether the row count is known, georeference)."""
    openers = [Opener(f"{k}.abc", lambda source=source: Rows(*source)) for k, source in enumerate(sources)]
    with noted() as expected:
        points = gather(openers, selection or Selection(), None)
    with noted() as caught:
        spooled = spool(openers, selection or Selection(), columns)
    return _checked(points, spooled, expected, caught, columns)


def _checked(points, spooled, expected, caught, columns):
    lost = len(points) - int(points.finite.sum())
    assert spooled.lost == lost
    if lost:
        assert caught.pop() == f"{lost:,} of {len(points):,} points have no finite position below 1e+12: left out"
        points = points.select(points.finite)
    assert caught == expected
    check_same(points_of(columns), points)
    kept = spooled_in(columns)
    assert kept._replace(origin=0) == spooled._replace(origin=0)
    assert kept.origin.tobytes() == spooled.origin.tobytes()
    return spooled


# --------------------------------------------------------------------------------------------------- the same values


def test_files_of_every_format_are_spooled(tmp_path, columns):
    with noted():  # about what formats cannot store
        kinds = small_scans(tmp_path / "scans")
    assert len(kinds) > 9
    for kind, files in kinds.items():
        for file in files:
            known = not file.name.startswith("1.spz.")  # compressed twice
            assert (check([file], columns, **OPTIONS) is not None) == known, (kind, file)
    some = [kinds[kind][0] for kind in ("ply", "npz", "pcd", "text", "ptx", "kitti", "splat")]
    assert set(check(some, columns, **OPTIONS).attributes) >= {"intensity", "classification", SCAN}


@pytest.mark.parametrize(
    "choices",
    [
        {"every": 7},
        {"bounds": (0.2, 0, 0, 0.7, 1, 0.5)},
        {"keep": {"classification": [2, 6]}},
        {"drop": {"row": range(100, 900)}, "every": 3},
        {"keep": {"classification": 77}},
        {"keep": {"class": 77}},
    ],
)
def test_chosen_rows(tmp_path, columns, choices, rng):
    for k, path in enumerate((tmp_path / "a.ply", tmp_path / "b.ply")):
        attributes = {"row": np.arange(1000), "classification": rng.integers(0, 9, 1000).astype(np.uint8)}
        pr.write(path, pr.Points(XYZ[k:], attributes={name: values[k:] for name, values in attributes.items()}))
    done = check([tmp_path / "a.ply", tmp_path / "b.ply"], columns, **choices)
    assert (done is None) == (77 in [*choices.get("keep", {}).values()])
    check([tmp_path / "a.ply"], columns, **choices)


@pytest.mark.parametrize("every", [1, 2])
def test_late_rows_of_text_may_widen_a_column(tmp_path, columns, every):
    """Attributes and colours are integers until row 900."""
    lines = ["ply", "format ascii 1.0", "element vertex 1000", *(f"property float {axis}" for axis in "xyz")]
    lines += [
        *(f"property uchar {name}" for name in ("red", "green", "blue", "class")),
        "property int row",
        "end_header",
    ]
    for k, (xyz, rgb) in enumerate(zip(XYZ.tolist(), RGB.tolist(), strict=True)):
        late = k > 900
        colors = [c / 2 if late else c for c in rgb]
        lines.append(" ".join(map(str, [*xyz, *colors, 1000 if late else k % 5, k + 0.5 * late])))
    path = tmp_path / "a.ply"
    path.write_text("\n".join(lines) + "\n")
    check([path], columns, every=every)
    assert columns["attribute.1"].dtype == np.float64
    pr.write(tmp_path / "b.ply", pr.Points(XYZ, attributes={"row": np.arange(1000)}))
    check([tmp_path / "b.ply", path], columns, every=every)


@pytest.mark.parametrize("known", [True, False])
def test_chunks_may_have_different_types(columns, known):
    """All dtypes occur, in one file and in several; the first rows are not finite."""
    xyz = XYZ.copy()
    xyz[:100] = np.nan
    kinds = [
        np.bool_,
        np.uint8,
        np.int8,
        np.uint16,
        ">i2",
        np.float16,
        np.int32,
        ">f4",
        np.int64,
        np.uint64,
        np.float64,
    ]

    class Widening(Rows):
        def __init__(self, *args, kinds=kinds, **named):
            super().__init__(*args, **named)
            self._kinds = kinds

        def chunks(self):
            for k, chunk in enumerate(super().chunks()):
                yield chunk._replace(attributes={"a": chunk.attributes["a"].astype(self._kinds[k % len(self._kinds)])})

    chunk = Chunk(xyz, xyz.astype(np.float16), attributes={"a": np.arange(1000) % 2})
    openers = [Opener("a", lambda: Widening(chunk, known=known))]
    openers += [
        Opener(str(k), lambda k=k: Rows(chunk._replace(attributes={"a": np.arange(1000).astype(k)}))) for k in kinds
    ]
    openers.append(Opener("b", lambda: Widening(chunk, known=known, kinds=[np.int16, np.uint16, np.float32])))
    for some in (openers[:1], openers[-1:], openers[1:3], openers[3:6], openers[5:7], openers[7:], openers):
        points = gather(some, Selection(), None)
        with pytest.warns(UserWarning, match=LEFT_OUT):
            spool(some, Selection(), columns)
        check_same(points_of(columns), points.select(points.finite))


@pytest.mark.parametrize("known", [True, False])
def test_files_may_lack_columns(columns, known):
    first = Chunk(XYZ, XYZ.astype(np.float32), RGB.astype(np.uint8), {"a": np.arange(1000), "b": XYZ[:, :2]})
    second = Chunk(XYZ, attributes={"a": np.arange(1000) + 0.5, "c": np.arange(1000) % 2 == 0})
    third = Chunk(XYZ.astype(np.float32), colors=RGB * 257, attributes={"d": XYZ[:, 0].astype(np.float16)})
    for sources in ([first, second], [second, first, third], [third, second, second], [first, first]):
        check_chunks(columns, *((chunk, 100, known) for chunk in sources))


@pytest.mark.parametrize("known", [True, False])
def test_colours_of_different_ranges_are_scaled(columns, known):
    """8 bits, 16 bits, 8 bits in 16, 8 bits shifted, floats, alpha, NaN, zeros: each file has its own range."""
    alpha = np.column_stack([RGB, RGB[:, 0]])
    wide, dark = (RGB * 257).astype(np.uint16), RGB.astype(np.uint16)
    for files in (
        *([RGB.astype(np.uint8), wide], [dark], [wide], [RGB * 256], [dark, wide], [alpha, wide, XYZ]),
        *([XYZ, RGB * 1.0], [XYZ.astype(np.float32)], [RGB.astype(np.int8)], [(RGB * 257).astype(">u2"), dark]),
        *([RGB * 0, RGB], [RGB * 0], [np.where(XYZ > 0, RGB, np.nan)], [np.where(RGB == RGB[7], 300, RGB), wide]),
        ([np.where(np.arange(1000)[:, None] < 900, RGB, 257 * RGB).astype(np.uint16), wide * 0]),
    ):
        check_chunks(columns, *((Chunk(XYZ, colors=colors), 64, known) for colors in files))
    for wrong in (RGB - 3, RGB * 1000):
        openers = [Opener("a", lambda wrong=wrong: Rows(Chunk(XYZ, colors=wrong)))]
        with pytest.raises(ValueError, match="invalid colours: got") as expected:
            gather(openers, Selection(), None)
        with pytest.raises(ValueError) as found:
            spool(openers, Selection(), columns)
        assert str(found.value) == str(expected.value)


def test_rows_that_are_not_finite(columns, rng):
    xyz = XYZ.copy()
    xyz[rng.integers(0, 1000, 90)] = np.nan
    xyz[300:500, 1] = np.inf
    xyz[999] = 1e13
    chunk = Chunk(xyz, xyz, RGB, {"a": np.arange(1000), "b": XYZ[:, :2]})
    assert check_chunks(columns, (chunk,), (Chunk(XYZ),), (chunk, 7, False)).lost > 400
    assert check_chunks(columns, (chunk,)).lost > 200
    with pytest.raises(ValueError, match=r"0\.abc: positions: none of the 1,000 rows is finite and below"):
        check_chunks(columns, (Chunk(xyz * np.nan),))
    with pytest.raises(ValueError, match="none of the 1,000 rows is finite"):
        spool([Opener("a", lambda: Rows(Chunk(xyz * np.nan)))], Selection(), columns)
    assert os.listdir(columns.folder) == []


@pytest.mark.parametrize("far", [0.0, 1e13])
def test_whole_numbers_of_a_file(columns, far, rng):
    """What float32 loses is stored, also if rows are dropped; a file may contain this attribute itself."""
    georeference = Georeference(scale=(1e-3, 1e-3, 1e-4), offset=(500_000.0, 5_500_000.0, 0.0))
    numbers = rng.integers(0, 10**9, (1000, 3))
    numbers[:200] = [-500_000_000, -5_500_000_000, 0] + np.arange(200)[:, None]  # near the origin nothing is lost
    world = numbers * georeference.scale + np.array(georeference.offset)
    world[500:600] += far
    known, unknown = (Chunk(world), 100, True, georeference), (Chunk(world), 100, False, georeference)
    assert check_chunks(columns, known).attributes == [RESIDUAL]
    assert check_chunks(columns, known, unknown).attributes == [RESIDUAL]
    named = Chunk(world, attributes={RESIDUAL: numbers.astype(np.int16), "a": np.arange(1000)})
    assert check_chunks(columns, (named, 50, True, georeference)).attributes == [RESIDUAL, "a"]
    assert check_chunks(columns, (named, 50, True, Georeference())).attributes == [RESIDUAL, "a"]


def test_integer_coordinates_of_las_are_spooled(tmp_path, columns):
    pytest.importorskip("laspy")
    points = full_points()
    for k, name in enumerate("ab"):
        world = points.world + [1000 * k, 0, 0]
        pr.write(tmp_path / f"{name}.las", pr.Points(world, points.normals, points.colors, points.attributes))
    write_random(tmp_path / "c.las", "1.4", 7, 300)
    assert check([tmp_path / "a.las", tmp_path / "b.las"], columns) is not None
    check([tmp_path / "c.las"], columns)
    check([tmp_path / "a.las", tmp_path / "c.las"], columns, every=2)


def test_stations_of_all_files_are_kept(columns):
    first, second = Georeference(stations=((1, 2, 3),)), Georeference(stations=((4, 5, 6), (7, 8, 9)))
    bare, both = Chunk(XYZ), Chunk(XYZ, attributes={"a": np.arange(1000), SCAN: np.repeat([0, 1], 500)})
    one, two = (bare, 100, True, first), (both, 100, False, second)
    narrow = (both._replace(attributes={SCAN: both.attributes[SCAN].astype(np.int32)}), 100, True, second)
    several = [one], [two], [one, two, (bare,)], [(bare,), one], [two, (bare, 30, False), one, two], [narrow, narrow]
    for sources in several:
        check_chunks(columns, *sources)
    with pytest.warns(UserWarning, match=f"only some files have: a, {SCAN}"):
        spool([Opener(str(k), lambda s=s: Rows(*s)) for k, s in enumerate([one, two])], Selection(), columns)
    assert columns["attribute.1"][:].tolist() == [0] * 1000 + [1] * 500 + [2] * 500


def test_empty_files_are_spooled_or_refused(columns):
    nothing, some = (Chunk(XYZ[:0], colors=RGB[:0]), 100, False), (Chunk(XYZ),)
    for sources in ([nothing, some], [some, nothing], [nothing, some, nothing]):
        check_chunks(columns, *sources)
    with pytest.raises(ValueError, match="none of the 2 files contains points"):
        spool([Opener(str(k), lambda: Rows(*nothing)) for k in range(2)], Selection(), columns)


@pytest.mark.parametrize("shift", [0.0, long(3e6), -2e9])
def test_the_origin_is_chosen_from_all_rows(columns, monkeypatch, shift):
    """The sample includes all files: the row count of two files is not a multiple of its step."""
    samples = []

    def choose(sample, total):
        samples.append((sample.tobytes(), total))
        return choose_origin(sample, total)

    monkeypatch.setattr("pointray.io.locating.choose_origin", choose)
    first, second = np.tile(XYZ, (31, 1)) + shift, np.tile(XYZ, (20, 1))[:-13] * 100
    second[:50] = np.nan
    with np.errstate(invalid="ignore"):
        done = check_chunks(columns, (Chunk(first), 999), (Chunk(second + shift), 333, False))
    assert done.origin.any() == (shift != 0)
    check_chunks(columns, (Chunk((first * 100).astype(np.int64)),))
    check_chunks(columns, (Chunk(XYZ.astype(np.float32)),))
    assert len(samples) == 6 and samples[::2] == samples[1::2]


# ----------------------------------------------------------------------------------------------------------- errors


def test_an_error_removes_the_spooled_columns(columns):
    """Those of the failed run and of an earlier one are removed; other columns are kept."""

    class Damaged(Rows):
        def chunks(self):
            yield next(super().chunks())
            raise ValueError("is damaged")

    columns.make("parts", "i4")
    openers = [Opener("a", lambda: Rows(Chunk(XYZ, XYZ))), Opener("b", lambda: Damaged(Chunk(XYZ)))]
    spool(openers[:1], Selection(), columns)
    assert columns.names == ["normals", "parts", "positions"]
    with pytest.raises(ValueError, match="b: is damaged"):
        spool(openers, Selection(), columns)
    assert columns.names == ["parts"] and spooled_in(columns) is None
    assert os.listdir(columns.folder) == ["parts.i4x0"]


def test_some_errors_are_found_before_files_are_read(columns, monkeypatch):
    def opener(name="a", count=1000, georeference=None):
        class Unread(Rows):
            def __init__(self):
                super().__init__(Chunk(XYZ), georeference=georeference)
                self.listing = Listing(count, 64, georeference=georeference or Georeference())

            def chunks(self):
                raise AssertionError("it is read")

        return Opener(name, Unread)

    with pytest.raises(ValueError, match="max_points"):
        spool([opener()], Selection(max_points=5), columns)
    with pytest.raises(ValueError, match="a: 2,147,483,648 points are too many"):
        spool([opener(count=2**31)], Selection(), columns)
    with pytest.raises(ValueError, match="a and b have different coordinate systems"):
        spool(
            [opener("a", georeference=Georeference("EPSG:25832")), opener("b", georeference=Georeference("EPSG:1"))],
            Selection(),
            columns,
        )
    monkeypatch.setattr(own.shutil, "disk_usage", lambda folder: Usage(2**16))
    with pytest.raises(ValueError, match=r"2 files: 2,000 points need 0\.0 GiB of disk space in .*columns, only"):
        spool([opener("a"), opener("b")], Selection(), columns)
    monkeypatch.undo()
    with pytest.raises(ValueError, match="'a' must hold ints or floats, not complex64"):
        spool([Opener("a", lambda: Rows(Chunk(XYZ, attributes={"a": XYZ[:, 0].astype("c8")})))], Selection(), columns)


def test_too_many_rows_are_reported_while_reading(columns, monkeypatch):
    monkeypatch.setattr("pointray.cloud.points.MOST", 1500)
    openers = [Opener(str(k), lambda: Rows(Chunk(XYZ), known=False)) for k in range(2)]
    with pytest.raises(ValueError, match="1: 1,600 points are too many"):
        spool(openers, Selection(), columns)


def test_a_file_that_is_being_written_is_reported(tmp_path, columns):
    path = tmp_path / "a.ply"
    pr.write(path, pr.Points(XYZ))
    with pytest.raises(ValueError, match="was modified while it was read"), open_files(path, request_of()) as files:
        spool(files, Selection(), columns)
        path.write_bytes(path.read_bytes() + bytes(10))


def test_damaged_metadata_is_refused(columns):
    check_chunks(columns, (Chunk(XYZ),))
    facts = columns.get("spooled")
    for changes in ({"survey": {"a": 1}}, {"origin": "a"}, {"more": 1}):
        columns.put("spooled", {**facts, **changes})
        with pytest.raises(ValueError, match=r"spooled\.json: is damaged"):
            spooled_in(columns)
    columns.put("spooled", {name: value for name, value in facts.items() if name != "lost"})
    with pytest.raises(ValueError, match=r"spooled\.json: is damaged"):
        spooled_in(columns)


# Spools like the command line, to a disk with limited space.
COMMAND = """
import resource, signal, sys
from pathlib import Path
from pointray.cli import _reason
from pointray.base.disk_columns import Columns
from pointray.io.spooling.spool import spool
from pointray.io.files import open_files, request_of
from pointray.io.selection import Selection

signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
for limit in sys.argv[3:]:
    resource.setrlimit(resource.RLIMIT_FSIZE, (int(limit), resource.RLIM_INFINITY))
    try:
        with open_files(sys.argv[1], request_of()) as files:
            spool(files, Selection(), Columns(Path(sys.argv[2]) / limit))
        error = None
    except OSError as raised:
        error = raised
    resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    print(error and _reason(error))
"""


@pytest.mark.skipif(os.name != "posix", reason="limits of POSIX")
def test_a_full_disk_is_reported_and_files_are_removed(tmp_path):
    pr.write(tmp_path / "a.ply", pr.Points(XYZ, XYZ, attributes={"a": XYZ[:, 0]}))
    folder = tmp_path / "columns"
    limits = ["0", "1000", "11999"]
    command = [sys.executable, "-c", COMMAND, str(tmp_path / "a.ply"), str(folder), *limits]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    for limit, line in zip(limits, done.stdout.splitlines(), strict=True):
        assert line.startswith(f"{folder / limit}/raw.") and line.endswith(": File too large")
        assert list((folder / limit).iterdir()) == []


# --------------------------------------------------------------------------------------------- progress and memory


def test_progress_grows_to_one(tmp_path, columns):
    shares = []
    for k in range(2):
        pr.write(tmp_path / f"{k}.ply", pr.Points(XYZ + [k, 0, 0], XYZ, attributes={"a": np.arange(1000) + k / 2}))
    with open_files([tmp_path / "0.ply", tmp_path / "1.ply"], request_of()) as files:
        spool(files, Selection(), columns, shares.append)
    assert shares == sorted(shares)
    assert shares[0] < 0.1 and 0.95 < shares[-1] <= 1
    assert np.diff(shares).max() < 0.15  # a column that is not converted takes no time


@pytest.mark.parametrize(("n", "chunk", "most"), [(1 << 19, 1 << 14, 10e6), long(1 << 22, CHUNK, 60e6)])
def test_memory_for_a_few_chunks_is_enough(tmp_path, columns, monkeypatch, large_chunks, n, chunk, most):
    """4 million points take 170 MB, half a million 21 MB. Some are not finite."""
    for module in (_binary, convert):
        monkeypatch.setattr(module, "CHUNK", chunk)
    path = tmp_path / "large.ply"
    fields = [*((name, "<f8") for name in "xyz"), *((name, "<f4") for name in ("nx", "ny", "nz")), ("row", "<i4")]
    kinds = {"<f8": "double", "<f4": "float", "<i4": "int"}
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {n}"]
    header += [*(f"property {kinds[kind]} {name}" for name, kind in fields), "end_header\n"]
    with path.open("wb") as file:
        file.write("\n".join(header).encode())
        for start in range(0, n, 1 << 18):
            rows = np.zeros(1 << 18, fields)
            rows["row"] = np.arange(start, start + len(rows))
            rows["x"], rows["y"], rows["nz"] = 4e5 + rows["row"] % 2048, 5e6 + rows["row"] // 2048, 1
            rows["z"][::1000] = np.nan
            file.write(rows.tobytes())
    tracemalloc.start()
    try:
        with open_files(path, request_of()) as files, pytest.warns(UserWarning, match=LEFT_OUT):
            done = spool(files, Selection(), columns)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < most
    assert done.rows == n - len(range(0, n, 1 << 18)) * len(range(0, 1 << 18, 1000))
    kept = columns["attribute.0"][done.rows - 5 :]
    assert kept.tolist() == list(range(n - 5, n))
    np.testing.assert_array_equal(
        columns["positions"][done.rows - 1 :][0] + done.origin, [4e5 + 2047, 5e6 + n // 2048 - 1, 0]
    )
