"""Columns on disk: written rows are read in pieces and in any order; damaged files raise errors."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from pointray.base import disk_columns as own
from pointray.base.disk_columns import Column, Columns
from pointray.io.spooling.raw import Raw

ROWS = np.random.default_rng(8).random((5000, 3), np.float32)
ROWS.setflags(write=False)


@pytest.fixture
def columns(tmp_path):
    return Columns(tmp_path / "a" / "b")


@pytest.mark.parametrize("rows", [ROWS, ROWS[:, 0], ROWS[:, 0] < 0.5, (ROWS[:, :2] * 18 - 9).astype(np.int64)])
@pytest.mark.parametrize("span", [64, 1 << 20])
def test_rows_come_back(rng, columns, monkeypatch, rows, span):
    monkeypatch.setattr(own, "SPAN", span)
    monkeypatch.setattr(own, "GAP", span // 4)
    width = rows.shape[1] if rows.ndim > 1 else 0
    made = columns.make("attribute.0", rows.dtype, width)
    for start in (0, 3000):
        made.append(rows[start : start + 3000])
    column = columns["attribute.0"]
    assert (column.name, column.dtype, column.width, len(column)) == ("attribute.0", rows.dtype, width, 5000)
    assert column.nbytes == rows.nbytes
    some = rng.integers(0, 5000, 700)
    for wanted in (
        *(slice(None), slice(7, 9), slice(-5, None), slice(9, 7), slice(3, 4000, 7), slice(4000, 3, -7)),
        *(some, np.sort(some), some[:0], np.arange(40, 90), np.array([4999, 0, 0]), some.astype(np.uint16)),
    ):
        found = column[wanted]
        assert found.dtype == rows.dtype
        np.testing.assert_array_equal(found, rows[wanted])
        found[:] = 0  # the array belongs to the caller


def test_only_requested_rows_are_read(columns, monkeypatch):
    """Nearby rows are read in one piece of bounded size; distant rows separately."""
    column = columns.make("a", np.float64, rows=10**6)
    read = []
    monkeypatch.setattr(Column, "_read", lambda self, start, out: read.append((start, len(out))))
    column[np.array([5000, 7, 5003, 5001, 1000, 999_999])]
    assert read == [(7, 1), (1000, 1), (5000, 4), (999_999, 1)]
    read.clear()
    column[np.arange(0, 10**6, 100)]
    assert len(read) == -(-8 * 10**6 // own.SPAN) and max(rows for _, rows in read) <= own.SPAN / 8


def test_short_reads_and_writes_are_continued(columns, monkeypatch):
    get, put = Column._get, Column._put
    monkeypatch.setattr(Column, "_get", lambda self, out, place: get(self, out[:100], place))
    monkeypatch.setattr(Column, "_put", lambda self, data, place: put(self, data[:100], place))
    column = columns.make("a", np.float32, 3)
    column.append(ROWS)
    np.testing.assert_array_equal(column[:], ROWS)


def test_rows_are_written_anywhere(columns):
    column = columns.make("a", "i8", rows=100)
    assert not column[:].any()
    column.write(90, np.arange(20))
    column.write(5, [7, 8])
    assert len(column) == 110
    assert column[:].tolist() == [0] * 5 + [7, 8] + [0] * 83 + list(range(20))
    for start, rows in ((0, np.zeros((2, 2))), (-1, [1])):
        with pytest.raises(ValueError, match=r"a\.i8x0"):
            column.write(start, rows)
    for wanted in (np.array([110]), np.array([-1, 5])):
        with pytest.raises(IndexError, match="are outside a.i8x0, which has 110"):
            column[wanted]
    with pytest.raises(TypeError, match="must be integers"):
        column[np.array([0.5])]


def test_threads_write_concurrently(columns):
    column = columns.make("a", "i4", 2)
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(lambda k: column.write(1000 * k, np.full((1000, 2), k)), range(50)))
    np.testing.assert_array_equal(column[:], np.repeat(np.arange(50), 2000).reshape(-1, 2))


def test_columns_have_names_and_files(columns):
    columns.make("a", "f4", 3)
    columns.make("attribute.1", "u1")
    columns.put("a", {"rows": 5})
    assert columns.names == ["a", "attribute.1"]
    assert "a" in columns and "attribute" not in columns
    assert sorted(os.listdir(columns.folder)) == ["a.f4x3", "a.json", "attribute.1.u1x0"]
    columns.make("a", "i8").append([1])
    assert columns["a"][:].tolist() == [1]
    columns.rename("a", "attribute.1")
    assert columns.names == ["attribute.1"] and columns["attribute.1"][:].tolist() == [1]
    columns.drop("a")
    columns.drop("attribute.1")
    assert os.listdir(columns.folder) == []
    with pytest.raises(KeyError):
        columns["a"]
    for name in ("", ".a", "a/b", "ä", "a b"):
        with pytest.raises(ValueError, match="letters, digits"):
            columns.make(name, "f4")
    with pytest.raises(ValueError, match="not the file name of a column"):
        columns.make("a", "c8")


def test_damage_is_reported(columns):
    columns.make("a", "f4", 3, rows=2)
    (columns.folder / "a.f4x3").write_bytes(bytes(30))
    with pytest.raises(ValueError, match=r"a\.f4x3: is cut off: its 30 bytes are not a multiple of 12"):
        columns["a"]
    columns.make("a", "f4", 3, rows=2)
    column = columns["a"]
    os.truncate(columns.folder / "a.f4x3", 12)
    with pytest.raises(ValueError, match=r"a\.f4x3: is cut off after 12 bytes"):
        column._read(0, np.empty((2, 3), np.float32))
    (columns.folder / "a.i8x0").touch()
    with pytest.raises(ValueError, match=r"duplicate column a: a\.f4x3, a\.i8x0"):
        columns["a"]
    for text in ("{", "[1]", "\xff"):
        (columns.folder / "b.json").write_bytes(text.encode("latin-1"))
        with pytest.raises(ValueError, match=r"b\.json: is damaged"):
            columns.get("b")


def test_metadata_is_stored_exactly(columns):
    assert columns.get("spooled") is None
    columns.put("spooled", {"rows": 1})
    columns.put("spooled", {"rows": 2, "origin": [0.1, 1e300]})
    assert columns.get("spooled") == {"rows": 2, "origin": [0.1, 1e300]}


# -------------------------------------------------------------------------------------------------- raw columns


def test_raw_columns_store_rows_of_several_types_and_gaps(columns):
    """Rows 0 to 9 and 15 to 24 of whole numbers, 10 to 14 missing, 25 to 29 of floats."""
    raw = Raw(columns, 0)
    rows = np.arange(30).astype(np.float64)
    rows[25:] += 0.5
    for begin, end, dtype in ((0, 5, "u1"), (5, 10, ">u1"), (15, 25, "u1"), (25, 30, ">f4")):
        raw.add(begin, rows[begin:end].astype(dtype))
    raw.add(30, np.empty(0, np.float64))
    assert columns.names == ["raw.0.0", "raw.0.1"]
    expected = np.where((rows >= 10) & (rows < 15), -1, rows)
    for begin, end in ((0, 30), (3, 8), (8, 17), (11, 13), (20, 30), (24, 26), (26, 28)):
        found = raw.read(begin, end, np.dtype(np.float64), -1)
        assert found.dtype == np.float64
        np.testing.assert_array_equal(found, expected[begin:end])
    assert raw.read(0, 30).dtype == np.float32 and raw.read(3, 8).dtype == np.uint8
    for step in (1, 3, 4, 7):
        there = [row for row in rows[::step] if not 10 <= row < 15]
        np.testing.assert_array_equal(np.concatenate(raw.sample(step)), there)
    assert raw.whole(30) is None
    raw.drop()
    assert columns.names == []


def test_a_raw_column_of_all_rows(columns):
    raw = Raw(columns, 7)
    raw.add(0, ROWS[:3])
    raw.add(3, ROWS[3:9])
    assert raw.whole(9).name == "raw.7.0" and raw.whole(10) is None
    np.testing.assert_array_equal(raw.read(2, 5), ROWS[2:5])
