"""Calls of kernels, recorded where they run and repeated by `replay.c` on another system.

A file of calls, in words of 64 bits: the number of calls; for each the length of its function's name and the name, the
numbers of slots, of words of the result, of blocks of memory, of addresses in slots and of those in blocks, the slots,
each block (its address modulo 64, its size, its bytes); for each slot that is an address its number, its block and
where in the block it points; for each address in a block that block and where in it, and the same of what it points to.
The results of a call: its code, the words of the result, and all blocks.
"""

from __future__ import annotations

import ctypes
import json
import struct
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pointray.engine.jit import boundary, library


class Part(NamedTuple):
    """An array among the arguments. slot : of its address; where : in its block, in bytes"""

    slot: int
    dtype: str
    block: int
    where: int
    size: int


@dataclass
class Call:
    """A call before it is made.

    blocks : where they begin, and what is in them; links : where in memory addresses of memory are
    """

    name: str
    slots: tuple[int, ...]
    parts: list[Part]
    blocks: list[tuple[int, bytes]]
    links: list[tuple[int, int]]

    def place(self, address: int) -> tuple[int, int]:
        """The block that holds an address, and where in it."""
        k = bisect_right(self.blocks, address, key=lambda block: block[0]) - 1
        assert 0 <= address - self.blocks[k][0] < len(self.blocks[k][1])
        return k, address - self.blocks[k][0]


class Recorder:
    """Stands for the code of a library: calls its functions, and keeps the first call of each that is small enough.

    only : kernels, by default all; most : bytes of memory of a call that is kept
    """

    def __init__(self, found: library.Library, folder: Path, only: Sequence[str] = (), most: int = 30_000_000) -> None:
        self._records, self._code, self._most, self._folder = found._records, found._code, most, folder
        self._wanted = {library.symbol(name) for name in only or found._kernels}
        self._kernels = {library.symbol(name): about for name, about in found._kernels.items()}
        self._facts: dict[str, Any] = {}
        found._code = self  # type: ignore[assignment]

    def __getitem__(self, name: str) -> Any:
        function = self._code[name]
        if name not in self._kernels:
            return function
        function.argtypes, function.restype = [ctypes.c_void_p, ctypes.c_void_p], ctypes.c_int32
        return _Recorded(lambda slots, out: self._call(name, function, slots, out))

    def _call(self, name: str, function: Any, slots: bytes, out: Any) -> int:
        call = self._seen(name, slots) if name in self._wanted.difference(self._facts) else None
        code = int(function(slots, out))
        if call is not None and code == 0:
            facts = {"out": len(out), "sizes": [len(data) for _, data in call.blocks], "parts": call.parts}
            facts["links"] = [call.place(at) for at, _ in call.links]
            self._facts[name] = {**facts, "returns": self._kernels[name]["returns"]}
            after = [ctypes.string_at(start, len(data)) for start, data in call.blocks]
            with open(self._folder / "calls", "ab") as calls, open(self._folder / "wanted", "ab") as wanted:
                calls.write(_as_file(call, len(out)))
                wanted.write(_words(code, *out) + b"".join(after))
        return code

    def _seen(self, name: str, slots: bytes) -> Call | None:
        """A call with the memory that it is given; None if that is too much."""
        words = struct.unpack(f"<{len(slots) // 8}q", slots)
        kinds = self._kernels[name]["arguments"]
        arrays = [one for one in self._arrays(kinds, iter(range(len(words))), words) if one[2]]
        held = [(words[slot], words[slot] + size) for slot, _, size in arrays]
        links = [link for slot, dtype, size in arrays if dtype == "i8" for link in _links(words[slot], size)]
        spans = _merged([*held, *(span for _, span in links)])
        if sum(stop - start for start, stop in spans) > self._most:
            return None
        blocks = [(start, ctypes.string_at(start, stop - start)) for start, stop in spans]
        call = Call(name, words, [], blocks, [(at, span[0]) for at, span in links])
        call.parts += [Part(slot, dtype, *call.place(words[slot]), size) for slot, dtype, size in arrays]
        return call

    def _arrays(self, kind: Any, slots: Iterator[int], words: Sequence[int]) -> Iterator[tuple[int, str, int]]:
        """The slot of each array's address, its dtype and how many bytes it spans."""
        kind = self._records.get(kind, kind) if isinstance(kind, str) else kind
        slot = None if isinstance(kind, list) else next(slots)
        if slot is None:
            for part in kind:
                yield from self._arrays(part, slots, words)
        elif "[" in kind:
            dtype, axes, layout = boundary._array(kind)
            item, shape = np.dtype(dtype).itemsize, [words[next(slots)] for _ in range(axes)]
            strides = [words[next(slots)] for _ in range(axes)] if layout == "A" else None
            size = item * int(np.prod(shape, dtype=np.int64))
            if strides and size:
                assert min(strides) >= 0, "an array with a negative stride"
                size = item + sum((n - 1) * step for n, step in zip(shape, strides, strict=True))
            yield slot, dtype, size

    def finish(self) -> None:
        """Write what is known of the calls."""
        calls = self._folder / "calls"
        calls.write_bytes(_words(len(self._facts)) + calls.read_bytes())
        (self._folder / "facts.json").write_text(json.dumps(self._facts))


class _Recorded:
    """A function in place of one of ctypes, which has attributes too."""

    def __init__(self, call: Any) -> None:
        self._call = call

    def __call__(self, *arguments: Any) -> Any:
        return self._call(*arguments)


def _links(start: int, size: int) -> list[tuple[int, tuple[int, int]]]:
    """Where a table of numbers holds an address and a length, as in `engine/kernels/tree.py`, and what lies there."""
    table = np.frombuffer(ctypes.string_at(start, size), np.int64)
    able = (table[:-1] > 1 << 32) & (table[:-1] < 1 << 47) & (table[1:] > 0) & (table[1:] < 1 << 24)
    found = []
    for k in np.flatnonzero(able):
        address, count = int(table[k]), int(table[k + 1])
        end = next((stop for begin, stop in _mapped() if begin <= address < stop), 0)
        if end:
            found.append((start + 8 * int(k), (address, min(address + 4 * count, end))))
    return found


def _mapped() -> list[tuple[int, int]]:
    """The memory that this process may read."""
    lines = [line.split() for line in Path("/proc/self/maps").read_text().splitlines()]
    spans = [tuple(int(text, 16) for text in line[0].split("-")) for line in lines if line[1].startswith("r")]
    return [(start, stop - 1) for start, stop in _merged([(start, stop + 1) for start, stop in spans])]


def _merged(spans: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """Spans of memory, those that overlap as one."""
    merged: list[tuple[int, int]] = []
    for start, stop in sorted(spans):
        if merged and start < merged[-1][1]:
            merged[-1] = merged[-1][0], max(merged[-1][1], stop)
        else:
            merged.append((start, stop))
    return merged


def _as_file(call: Call, outs: int) -> bytes:
    """A call as it stands in a file."""
    name = call.name.encode()
    counts = len(call.slots), outs, len(call.blocks), len(call.parts), len(call.links)
    pieces = [_words(len(name)), name, _words(*counts, *call.slots)]
    for start, data in call.blocks:
        pieces += [_words(start % 64, len(data)), data]
    pieces += [_words(part.slot, part.block, part.where) for part in call.parts]
    pieces += [_words(*call.place(at), *call.place(address)) for at, address in call.links]
    return b"".join(pieces)


def _words(*values: int) -> bytes:
    return struct.pack(f"<{len(values)}q", *values)


class Result(NamedTuple):
    """What a call has left. arrays : its arguments; out : the words of its result"""

    code: int
    out: list[int]
    arrays: list[np.ndarray[Any, Any]]


def read(folder: Path, name: str) -> dict[str, Result]:
    """The results of all calls, from a file in the folder of the recording; without arrays that kernels return."""
    found = {}
    with open(folder / name, "rb") as file:
        for kernel, facts in json.loads((folder / "facts.json").read_text()).items():
            code, *out = struct.unpack(f"<{1 + facts['out']}q", file.read(8 * (1 + facts["out"])))
            blocks = [bytearray(file.read(size)) for size in facts["sizes"]]
            for block, where in facts["links"]:  # an address differs, and is not what it means
                blocks[block][where : where + 8] = bytes(8)
            parts = [Part(*part) for part in facts["parts"]]
            arrays = [np.frombuffer(blocks[p.block][p.where : p.where + p.size], p.dtype) for p in parts]
            known = out if "[" not in json.dumps(facts["returns"]) else []
            found[kernel] = Result(code, known, arrays)
        assert not file.read(1)
    return found
