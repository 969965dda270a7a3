"""Arguments at the boundary of compiled kernels: packed to the bit, or refused before anything is called."""

from __future__ import annotations

import ctypes
import struct
from collections import namedtuple

import numpy as np
import pytest

from pointray.engine.jit.boundary import Results, error_at, packer, size_of

RECORDS = {"home:Pair": ["f4[1C]", "i8"], "home:Outer": ["home:Pair", ["b1", "f8"]]}
Pair = namedtuple("Pair", "values count")  # noqa: PYI024


def packed_slots(*kinds):
    """Return a function that packs arguments of these types into 64-bit slots."""
    pack = packer(kinds, RECORDS)
    return lambda *arguments: struct.unpack(f"<{len(pack(*arguments)) // 8}q", pack(*arguments))


def test_numbers_keep_their_bits():
    kinds = "i8", "u8", "i4", "u4", "i2", "u2", "i1", "u1", "b1"
    values = -(2**63), 2**64 - 1, -(2**31), 2**32 - 1, -(2**15), 2**16 - 1, -128, 255, True
    raw = packer(kinds, {})(*values)
    for k, (kind, value) in enumerate(zip(kinds, values, strict=True)):
        assert np.frombuffer(raw, kind, 1, 8 * k)[0] == value
    raw = packer(["f8", "f4"], {})(-1e300, 0.1)
    assert np.frombuffer(raw, "f8", 1)[0] == -1e300
    assert np.frombuffer(raw, "f4", 1, 8)[0] == np.float32(0.1)
    assert packer(["i8"], {})(np.int32(7)) == packer(["i8"], {})(7)


@pytest.mark.parametrize(
    ("kind", "value"),
    [("i8", 2**63), ("u8", -1), ("i4", 2**31), ("u1", 256), ("i8", 1.5), ("i8", "1"), ("f8", "1"), ("f4", 1e39)],
)
def test_numbers_that_do_not_fit_are_refused(kind, value):
    with pytest.raises((struct.error, OverflowError)):
        packer([kind], {})(value)


def test_arrays_are_an_address_and_a_shape():
    flat, table = np.arange(5, dtype="f4"), np.zeros((3, 4), "i8")
    assert packed_slots("f4[1C]", "i8[2C]")(flat, table) == (flat.ctypes.data, 5, table.ctypes.data, 3, 4)
    across = table[:, ::2]
    assert packed_slots("i8[2A]")(across) == (across.ctypes.data, 3, 2, 32, 16)
    assert packed_slots("i8[2F]")(table.T) == (table.ctypes.data, 4, 3)
    table.flags.writeable = False
    assert packed_slots("const i8[2C]")(table) == (table.ctypes.data, 3, 4)
    empty = np.zeros(0, "f4")
    assert packed_slots("f4[1C]")(empty) == (empty.ctypes.data, 0)


def test_tuples_are_flattened():
    values = np.ones(3, "f4")
    slots = packed_slots("home:Outer", ["i8", "i8"], [])((Pair(values, 4), (True, 0.5)), (1, 2), ())
    assert slots == (values.ctypes.data, 3, 4, 1, struct.unpack("<q", struct.pack("<d", 0.5))[0], 1, 2)
    with pytest.raises(ValueError, match="unpack"):
        packed_slots("home:Pair")((values,))
    with pytest.raises(TypeError, match="unpack"):
        packed_slots("home:Pair")(values[0])


def unaligned() -> np.ndarray:
    return np.frombuffer(bytearray(4 * 4 + 1), np.uint8)[1:].view("f4")


def read_only() -> np.ndarray:
    array = np.zeros(4, "f4")
    array.flags.writeable = False
    return array


class Disguise:
    """Not an array, though it looks like one."""

    dtype, ndim, shape, flags = np.dtype("f4"), 1, (4,), np.zeros(4, "f4").flags


@pytest.mark.parametrize(
    "array",
    [
        np.zeros(4, "f8"),
        np.zeros(4, ">f4"),
        np.zeros(4, "i4"),
        np.zeros((2, 2), "f4"),
        np.float32(1.0),
        np.zeros(8, "f4")[::2],
        unaligned(),
        read_only(),
        [0.0, 0.0],
        None,
        Disguise(),
    ],
    ids=[
        "double",
        "byte order",
        "int",
        "axes",
        "number",
        "steps",
        "unaligned",
        "read-only",
        "list",
        "none",
        "disguise",
    ],
)
def test_other_arrays_are_refused(array):
    with pytest.raises(TypeError, match=r"f4\[1C\]"):
        packed_slots("f4[1C]")(array)


def test_arrays_of_derived_classes_and_other_dtype_objects_are_arrays(tmp_path):
    array = np.memmap(tmp_path / "a", "f4", "w+", shape=4)
    assert packed_slots("f4[1C]")(array) == (array.ctypes.data, 4)
    dtype = np.dtype("f4").newbyteorder("=")
    array = np.zeros(4, dtype)
    assert packed_slots("f4[1C]")(array) == (array.ctypes.data, 4)


def test_results_are_read():
    freed = []
    array = np.arange(6.0).reshape(2, 3)
    kind = ["home:Pair", "i8", "b1", "f8", "f8[2C]", "none"]
    records = {"home:Pair": ["i8", "i8"]}
    count = size_of(kind, records)
    assert count == 2 + 3 + 4
    out = (ctypes.c_int64 * count)(1, 2, -3, 1, 0, array.ctypes.data, 77, 2, 3)
    ctypes.c_double.from_buffer(out, 8 * 4).value = 0.25
    *numbers, found, nothing = Results(kind, records, freed.append).read(out)
    assert (numbers, nothing, freed) == ([(1, 2), -3, True, 0.25], None, [77])
    np.testing.assert_array_equal(found, array)
    assert Results("none", {}, freed.append).read(out) is None


def test_error_texts_become_exceptions():
    for text, kind in (
        (b"ValueError: a: b", ValueError),
        (b"MemoryError: full", MemoryError),
        (b"Odd: x", RuntimeError),
    ):
        buffer = ctypes.create_string_buffer(text)
        error = error_at(ctypes.addressof(buffer))
        assert type(error) is kind and str(error) == text.decode().partition(": ")[2]
