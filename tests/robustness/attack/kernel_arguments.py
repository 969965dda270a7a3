"""Arguments of compiled kernels: trees of numbers, arrays and tuples, right ones and ones with something wrong in them.

Valid arguments are packed like a plain reference does, to the bit; invalid ones are refused before a kernel runs.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from attack import Attack, WrongError
from attack.mutate import Rng, pick
from pointray.engine.jit.boundary import packer

NUMBERS = "i8", "i4", "i2", "i1", "u8", "u4", "u2", "u1", "f8", "f4", "b1"
REFUSALS = TypeError, ValueError, OverflowError, struct.error
OTHER = None, "3", b"3", [1.0], (1.0, 2.0, 3.0), 1j, {}, np.zeros(3, "c8"), np.array("x"), np.zeros(2, object), object()


def kind_of(rng: Rng, depth: int) -> Any:
    """A type: a number, an array, or a tuple of types."""
    what = rng.random()
    if depth and what < 0.3:
        return [kind_of(rng, depth - 1) for _ in range(int(rng.integers(5)))]
    if what < 0.6:
        return pick(rng, NUMBERS)
    const = "const " if rng.random() < 0.2 else ""
    return f"{const}{pick(rng, NUMBERS)}[{int(rng.integers(1, 4))}{pick(rng, 'CFA')}]"


def value_of(rng: Rng, kind: Any) -> Any:
    """A value of a type."""
    if isinstance(kind, list):
        return tuple(value_of(rng, item) for item in kind)
    dtype, bracket, shape = kind.removeprefix("const ").partition("[")
    if not bracket:
        value = np.frombuffer(rng.bytes(8), dtype)[0] if dtype != "b1" else rng.random() < 0.5
        if dtype in ("f4", "f8"):
            value = dtype == "f8" and float(rng.normal() * 10.0 ** rng.integers(-30, 30)) or float(rng.normal())
        return (
            value
            if rng.random() < 0.3
            else (bool(value) if dtype == "b1" else value + 0.0 if "f" in dtype else int(value))
        )
    size = tuple(int(n) for n in rng.integers(0, 5, int(shape[:-2])))
    array = np.zeros(size, dtype, order="F" if shape[-2] == "F" else "C")
    if shape[-2] == "A":
        array = np.zeros([2 * n + 1 for n in size], dtype)[tuple(slice(1, None, 2) for _ in size)]
    array.flags.writeable = not kind.startswith("const") or rng.random() < 0.5
    return array


def reference_slots(kind: Any, value: Any) -> list[bytes]:
    """The slots of a value."""
    if isinstance(kind, list):
        return [slot for item, part in zip(kind, value, strict=True) for slot in reference_slots(item, part)]
    dtype, bracket, shape = kind.removeprefix("const ").partition("[")
    if not bracket:
        return [np.array(value, dtype).tobytes().ljust(8, b"\0")]
    words = [value.__array_interface__["data"][0], *value.shape, *(value.strides if shape[-2] == "A" else ())]
    return [struct.pack("<q", word) for word in words]


def spoiled(rng: Rng, kind: Any, value: Any) -> Any:
    """The value with something wrong; WrongError if there is nothing in it that could be."""
    if isinstance(kind, list):
        if not kind or rng.random() < 0.2:
            return pick(rng, ((*value, 1), value[:-1] if value else 5, 7, None))
        k = int(rng.integers(len(kind)))
        return (*value[:k], spoiled(rng, kind[k], value[k]), *value[k + 1 :])
    dtype, bracket, _ = kind.removeprefix("const ").partition("[")
    if not bracket:
        return _other_number(rng, dtype)
    if rng.random() < 0.3:
        return pick(rng, OTHER)
    return pick(rng, _ARRAYS)(value, kind)


def _other_number(rng: Rng, dtype: str) -> Any:
    """Return a value that is not a number of this type; a bool may be anything."""
    if dtype == "b1":
        return (True, False)  # the argument is not a tuple: the reference treats it as True
    if dtype[0] == "f":
        return pick(rng, ("3", None, [], 1j, 10**400, object()))
    info = np.iinfo(dtype)
    return pick(rng, ("3", None, [], 1.5, int(info.max) + 1, int(info.min) - 1, object()))


def _read_only(array: Any, kind: str) -> Any:
    if kind.startswith("const"):
        return array.tolist()
    array = array.copy(order="K")
    array.flags.writeable = False
    return array


def _unaligned(array: Any, kind: str) -> Any:
    if array.dtype.itemsize == 1 or not array.size:
        return array.shape
    raw = np.zeros(array.nbytes + 1, np.uint8)[1:]
    return raw.view(array.dtype).reshape(array.shape)


def _stepped(array: Any, kind: str) -> Any:
    """Every second item, where items must follow each other."""
    if kind[-2] == "A" or array.size < 2:
        return array.astype("c16")
    return np.zeros([2 * n for n in array.shape], array.dtype)[tuple(slice(None, None, 2) for _ in array.shape)]


_ARRAYS: tuple[Callable[[Any, str], Any], ...] = (
    lambda array, kind: array[np.newaxis],
    lambda array, kind: array.astype(">f8" if array.dtype.kind != "f" else ">i4"),
    lambda array, kind: array.astype("u2" if array.dtype.itemsize != 2 else "f4"),
    lambda array, kind: array.tolist(),
    _read_only,
    _unaligned,
    _stepped,
)


def begin(folder: Path) -> Attack:
    """Calls with random arguments, half of them spoiled."""

    def attack(rng: Rng, index: int) -> bool:
        kinds = [kind_of(rng, 3) for _ in range(int(rng.integers(1, 6)))]
        values = [value_of(rng, kind) for kind in kinds]
        pack, expected = packer(kinds, {}), b"".join(reference_slots(kinds, values))
        if pack(*values) != expected:
            raise WrongError(f"{kinds}: {values}")
        if index % 2:
            return True
        k = int(rng.integers(len(kinds)))
        if kinds[k] == "b1":
            kinds[k], values[k] = "i8", 0
        bad = [*values[:k], spoiled(rng, kinds[k], values[k]), *values[k + 1 :]]
        try:
            packed = packer(kinds, {})(*bad)
        except REFUSALS:
            return False
        if "b1" in str(kinds[k]):
            return True
        raise WrongError(f"accepted: {kinds[k]}: {bad[k]!r} as {packed!r}")

    return attack
