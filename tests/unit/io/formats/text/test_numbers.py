"""Numbers in text are parsed exactly as by Python's float, to the last bit."""

import io
import random
import struct

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from pointray.io.formats.text import _numbers
from pointray.io.formats.text._numbers import FLOAT, INT, SCAN, SKIP, Dialect, Reader, line_at, number_of, smallest

PLAIN = Dialect()
WORDS = ["nan", "inf", "-inf", "+NaN", "-nan", "Infinity", "1.", "+.5", ".5", "-0", "-0.0", "0e5", "1E+05", "5.e-3"]
HARD = [
    *("9007199254740993", "9007199254740992.5", "9007199254740993.00000000000000000000001", "18446744073709551616"),
    *("2.2250738585072012e-308", "4.9e-324", "2e-324", "1.7976931348623159e308", "1e400", "-1e-400", "1e23", "8.5e22"),
    *("0.000000000000000000000000000000000000001", "00000000000000000000000000000012", "1e99999999999", "0e99999"),
]


def read(text, k, dialect=PLAIN):
    """All rows, (n, k) float64."""
    blocks = Reader(io.BytesIO(text), dialect, [FLOAT] * k).blocks()
    return np.concatenate([np.empty((0, k)), *(block.take(range(k), np.float64) for block in blocks)])


def any_double(r):
    return struct.unpack("d", struct.pack("Q", r.getrandbits(64)))[0]


KINDS = [
    lambda r: repr(any_double(r)),
    lambda r: f"{any_double(r):.{r.randrange(25)}g}",
    lambda r: f"{r.uniform(-1e7, 1e7):.{r.randrange(12)}f}",
    lambda r: f"{r.gauss(0, 1):.18e}",
    lambda r: str(r.randrange(-(10 ** r.randrange(1, 25)), 10 ** r.randrange(1, 25))),
    lambda r: f"{r.gauss(0, 1) * 10.0 ** r.randrange(-30, 30):.{r.randrange(1, 40)}f}",
    lambda r: f"{r.randrange(10**19)}e{r.randrange(-400, 400)}",
    lambda r: r.choice(WORDS + HARD),
    lambda r: f"{r.randrange(2**53, 2**54) * 2 + 1}.{'0' * r.randrange(30)}{r.choice(['', '1'])}",  # between doubles
    lambda r: f"{'0' * r.randrange(30)}{r.randrange(1000)}.{'0' * r.randrange(30)}{r.randrange(100)}",
    lambda r: f"{r.randrange(10 ** r.randrange(1, 20))}.{r.randrange(10 ** r.randrange(1, 20))}",
]


def test_a_hundred_thousand_tokens_are_parsed_as_by_python():
    r = random.Random(1)
    tokens = [KINDS[i % len(KINDS)](r) for i in range(100_000)]
    text = "\n".join(" ".join(tokens[i : i + 4]) for i in range(0, len(tokens), 4)).encode()
    found, wanted = read(text, 4).reshape(-1), np.array([float(token) for token in tokens])
    wrong = np.flatnonzero(found.view(np.int64) != wanted.view(np.int64))
    assert [(tokens[i], found[i]) for i in wrong] == []


@settings(max_examples=60, deadline=None)
@given(st.from_regex(r"[+-]?([0-9]{1,25}(\.[0-9]{0,25})?|\.[0-9]{1,25})([eE][+-]?[0-9]{1,4})?", fullmatch=True))
def test_any_token_is_parsed_as_by_python(token):
    assert read(token.encode(), 1).view(np.int64)[0, 0] == np.float64(float(token)).view(np.int64)


@settings(max_examples=200, deadline=None)
@given(st.text("0123456789.eE+-naifx_ ,", max_size=8))
def test_tokens_that_python_refuses_are_refused(text):
    token = text.replace(" ", "").replace("_", "")
    try:
        wanted = float(token)
    except ValueError:
        wanted = None
    assert (number_of(token, Dialect()) is None) == (wanted is None)
    if wanted is None and token:
        with pytest.raises(ValueError, match=r"line 2: .* is not a number"):
            read(f"1\n{token}".encode(), 1)


@pytest.mark.parametrize("token", ["1_0", "0x10", "1,5", "--1", "1e", ".", "e5", "1.2.3", "\u0661", "1d5", "nano"])
def test_invalid_tokens_are_refused_with_their_line(token):
    with pytest.raises(ValueError, match="line 4: .* is not a number"):
        read(f"1 2\r\n\r\n# {token}\r\n3 {token}\r\n".encode(), 2)


def test_nan_as_written_by_microsoft_is_read():
    found = read(b"1.#QNAN -1.#IND 1.#INF00 -1.#INF", 4)
    np.testing.assert_array_equal(found, [[np.nan, np.nan, np.inf, -np.inf]])


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize(
    ("line", "dialect"),
    [
        (" 1.5\t\t2  -3 ", Dialect()),
        ("1.5,2,-3", Dialect(b",")),
        ("1.5 , 2\t, -3 ,", Dialect(b",")),
        ('"1.5";"2";"-3"', Dialect(b";")),
        ("1,5;2;-3", Dialect(b";", b",")),
        ("1,5 2 -3", Dialect(b"", b",")),
    ],
)
def test_all_separators_and_line_ends_are_read(line, dialect, end):
    dialect = dialect._replace(newline=end[-1:].encode())
    text = f"# a\n\n  // b\n{line}\n\n{line}\n{line}".replace("\n", end)
    np.testing.assert_array_equal(read(text.encode(), 3, dialect=dialect), [[1.5, 2, -3]] * 3)


def test_empty_fields_are_nan():
    found = read(b",2,3\n1,,3\n1,2,\n,,\n", 3, dialect=Dialect(b","))
    nan = np.nan
    np.testing.assert_array_equal(found, [[nan, 2, 3], [1, nan, 3], [1, 2, nan], [nan] * 3])


@pytest.mark.parametrize("size", [1, 7, 50])
def test_text_may_be_split_into_blocks_anywhere(monkeypatch, size):
    monkeypatch.setattr(_numbers, "BLOCK", size)
    monkeypatch.setattr(_numbers, "PIECE", 10)
    monkeypatch.setattr(_numbers, "FIRST", 4)
    rows = np.arange(300).reshape(100, 3)
    text = "\r\n".join(" ".join(map(str, row)) for row in rows)
    np.testing.assert_array_equal(read(text.encode(), 3), rows)
    with pytest.raises(ValueError, match="line 101 has 4 columns, expected 3: '5 6 7 8'"):
        read((text + "\r\n5 6 7 8\n9 9 9").encode(), 3)


def test_integer_columns_are_detected_with_their_limits():
    text = b"5 x 9007199254740993 1\n-7 y 0 2.5\n"
    block = next(Reader(io.BytesIO(text), Dialect(), [INT, SKIP, INT, FLOAT]).blocks())
    assert block.take([2], np.int64).tolist() == [[9007199254740993], [0]]
    assert block.take([0, 3], np.float64).tolist() == [[5, 1], [-7, 2.5]]
    stats = next(Reader(io.BytesIO(text), Dialect(), [SCAN] * 4).blocks()).stats
    assert stats[:, 0].tolist() == [1, 0, 1, 0]
    assert stats[0, 1:].tolist() == [-7, 5]
    for token in ("1.0", "1e1", "99999999999999999999", "nan", "x"):
        assert next(Reader(io.BytesIO(token.encode()), Dialect(), [SCAN]).blocks()).stats[0, 0] == 0
        with pytest.raises(ValueError, match="line 1: .* is not a (whole )?number"):
            next(Reader(io.BytesIO(token.encode()), Dialect(), [INT]).blocks())


def test_a_line_with_one_field_ends_the_rows():
    reader = Reader(io.BytesIO(b"1 2\n3 4\n\n 7 \n5 6\n"), Dialect(), [FLOAT] * 2)
    assert sum(map(len, reader.blocks())) == 2
    assert line_at(io.BytesIO(b"1 2\n3 4\n\n 7 \n5 6\n"), reader.at) == (4, " 7 ", 1)


def test_lines_that_never_end_are_refused():
    with pytest.raises(ValueError, match="line 2 is longer than"):
        read(b"1\n" + b"1" * (5 << 20), 1)


@pytest.mark.parametrize(
    ("low", "high", "dtype"),
    [(0, 255, "u1"), (-1, 255, "i2"), (0, 65535, "u2"), (-1, 65535, "i4"), (0, 2**31 - 1, "i4"), (0, 2**31, "i8")],
)
def test_the_smallest_sufficient_integer_type_is_chosen(low, high, dtype):
    assert smallest(low, high) == np.dtype(dtype)
