"""Calls of kernels in a compiled library: arguments are checked and packed, results are unpacked.

A type is a string, or a list of types for a tuple. `i8`, `f4`, `b1` are numbers. `f4[2C]` is an array with the number
of axes and the layout (C, F, or A for any). `const f4[2C]` is an array that may be read-only. `package.module:Class` is
a named tuple defined in the manifest's records. `none` stands for no result.
"""

from __future__ import annotations

import ctypes
import struct
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

# Offset of the data pointer in an array object: the size of the header that all Python objects have.
_BEFORE_DATA = object.__basicsize__
_FORMATS = {"f8": "d", "f4": "f4x", "u8": "Q", "b1": "?7x", "i8": "q", "i4": "i4x", "i2": "h6x", "i1": "b7x"}
_FORMATS |= {"u4": "I4x", "u2": "H6x", "u1": "B7x"}
_ERRORS = {error.__name__: error for error in (IndexError, MemoryError, OverflowError, ValueError, ZeroDivisionError)}


def packer(arguments: Sequence[Any], records: Mapping[str, Any]) -> Callable[..., bytes]:
    """Return a function that checks a kernel's arguments and packs them into slots of eight bytes for its C function.

    The function is generated from the types: a call of the largest kernel passes 88 slots and checks 60 arrays.

    arguments : type of each argument, such as "f4[2C]" (float32, two axes, C order), or a list of types for a tuple
    records : types of named tuples, by the name of the class
    """
    writer = _Writer(records)
    names = [f"a{k}" for k in range(len(arguments))]
    for argument, kind in zip(names, arguments, strict=True):
        writer.add(argument, kind)
    lines = [*writer.lines, f"return pack({', '.join(writer.values)})"]
    source = f"def pack_arguments({', '.join(names)}):\n    " + "\n    ".join(lines)
    names_in_it: dict[str, Any] = {
        "pack": struct.Struct("<" + " ".join(writer.formats)).pack,
        "refuse": _refuse,
        "ndarray": np.ndarray,
        "word": ctypes.c_int64.from_address,
        **{dtype: np.dtype(dtype) for dtype in writer.dtypes},
    }
    exec(source, names_in_it)
    pack: Callable[..., bytes] = names_in_it["pack_arguments"]
    return pack


class _Writer:
    """Generator of the Python source of a function that packs a kernel's arguments into slots of eight bytes.

    lines : statements that unpack tuples and check arrays; values, formats : source and `struct` format of each slot
    """

    def __init__(self, records: Mapping[str, Any]) -> None:
        self._records, self._count = records, 0
        self.lines: list[str] = []
        self.values: list[str] = []
        self.formats: list[str] = []
        self.dtypes: set[str] = set()

    def add(self, argument: str, kind: Any) -> None:
        """Add the source that checks and packs an argument, or an item of a tuple.

        argument : name of the local variable that holds it; kind : its type, such as "f4[2C]", or a list for a tuple
        """
        kind = self._records.get(kind, kind) if isinstance(kind, str) else kind
        if isinstance(kind, list):
            items = [f"t{self._count + k}" for k in range(len(kind))]
            self._count += len(kind)
            self.lines.append(f"({''.join(f'{item}, ' for item in items)}) = {argument}")
            for item, part in zip(items, kind, strict=True):
                self.add(item, part)
        elif "[" in kind:
            self._add_array(argument, kind)
        else:
            self.formats.append(_FORMATS[kind])
            self.values.append(argument)

    def _add_array(self, argument: str, kind: str) -> None:
        dtype, axes, layout = _array(kind)
        self.dtypes.add(dtype)
        wrong = f"type({argument}) is not ndarray or {argument}.dtype is not {dtype} or {argument}.ndim != {axes}"
        wrong += f" or not {_flags(argument, layout, kind.startswith('const'))}"
        self.lines.append(f"if {wrong}: refuse({argument}, {kind!r})")
        self.values += [f"word(id({argument}) + {_BEFORE_DATA}).value", f"*{argument}.shape"]
        self.formats += ["q"] * (1 + axes)
        if layout == "A":
            self.values.append(f"*{argument}.strides")
            self.formats += ["q"] * axes


def _flags(array: str, layout: str, is_const: bool) -> str:
    """Return the Python expression that checks layout, alignment and writability of an array by its flags.

    array : name of its variable; layout : "C", "F", or "A" for any; is_const : whether it may be read-only
    """
    if layout == "C" and not is_const:
        return f"{array}.flags.carray"  # one attribute lookup instead of three
    wanted = (
        {"C": ["c_contiguous"], "F": ["f_contiguous"], "A": []}[layout] + ["aligned"] + ["writeable"] * (not is_const)
    )
    first, *others = [f"flags.{name}" for name in wanted]
    return f"({' and '.join([first.replace('flags', f'(flags := {array}.flags)'), *others])})"


def _array(kind: str) -> tuple[str, int, str]:
    """Split an array type such as "const f4[2C]" into dtype, number of axes and layout: ("f4", 2, "C")."""
    dtype, _, shape = kind.removeprefix("const ").partition("[")
    return dtype, int(shape[:-2]), shape[-2]


def _refuse(array: Any, kind: str) -> None:
    """Raise TypeError unless an array fits the type of a kernel's argument after all, such as "f4[2C]".

    It is called when the generated check fails, which also happens for subclasses of ndarray and for equal but distinct
    dtypes. These are accepted here.
    """
    dtype, axes, layout = _array(kind)
    if not isinstance(array, np.ndarray):
        raise TypeError(f"{type(array).__name__} found, expected an array of type {kind}")
    flags = array.flags
    fits = array.dtype == np.dtype(dtype) and array.ndim == axes and flags.aligned
    fits = fits and (flags.writeable or kind.startswith("const"))
    if not fits or not {"C": flags.c_contiguous, "F": flags.f_contiguous, "A": True}[layout]:
        traits = [name for name in ("c_contiguous", "f_contiguous", "aligned", "writeable") if getattr(flags, name)]
        found = f"{array.dtype.str}, {array.ndim} axes, {', '.join(traits) or 'no flags'}"
        raise TypeError(f"got an array of {found} (expected {kind})")


def size_of(kind: Any, records: Mapping[str, Any]) -> int:
    """Return the number of 8-byte words in which a kernel returns a result.

    kind : its type, such as "f8" or "f4[2C]", or a list for a tuple; records : types of named tuples, by class
    """
    kind = records.get(kind, kind) if isinstance(kind, str) else kind
    if isinstance(kind, list):
        return sum(size_of(item, records) for item in kind)
    if "[" in kind:
        return 2 + _array(kind)[1]
    return 0 if kind == "none" else 1


class Results:
    """Reader of a kernel's result, a number, an array or a tuple of these, from the words that its C function writes.

    kind : type of the result, such as "f8" or "f4[2C]"; records : types of named tuples, by class
    release : frees the memory of an array, given its handle
    """

    def __init__(self, kind: Any, records: Mapping[str, Any], release: Callable[[int], Any]) -> None:
        self._kind, self._records, self._release = kind, records, release

    def read(self, words: Any) -> Any:
        """Return the result as Python objects. words : array of int64, filled by the kernel's C function"""
        return self._read(self._kind, words, 0)[0]

    def _read(self, kind: Any, words: Any, k: int) -> tuple[Any, int]:
        """Read one value of a kernel's result; return the value and the position in `words` behind it.

        kind : type of the value; words : the words that the C function has written; k : where the value starts
        """
        kind = self._records.get(kind, kind) if isinstance(kind, str) else kind
        if isinstance(kind, list):
            items = []
            for part in kind:
                item, k = self._read(part, words, k)
                items.append(item)
            return tuple(items), k
        if kind == "none":
            return None, k
        if "[" in kind:
            return self._array(kind, words, k)
        if kind == "f8":
            return ctypes.c_double.from_buffer(words, 8 * k).value, k + 1
        return (bool(words[k]) if kind == "b1" else words[k]), k + 1

    def _array(self, kind: str, words: Any, k: int) -> tuple[Any, int]:
        """Read one array of a kernel's result and free its memory; return a copy and the position in `words` behind it.

        kind : type of the array, such as "f4[2C]"; k : where its description in `words` starts
        """
        dtype, axes, _ = _array(kind)
        array = np.empty(tuple(words[k + 2 : k + 2 + axes]), dtype)
        ctypes.memmove(array.ctypes.data, words[k], array.nbytes)
        self._release(words[k + 1])
        return array, k + 2 + axes


def error_at(address: int) -> Exception:
    """Return the exception that a kernel has raised, from its text `Name: message` at an address in memory."""
    name, _, message = ctypes.string_at(address).decode(errors="replace").partition(": ")
    return _ERRORS.get(name, RuntimeError)(message)
