"""The rows of a text file."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

from .._source import Chunk, Listing, Request, Source
from ._columns import Layout, merged, scanning
from ._first_look import LOOK, look_at
from ._lines import shortened
from ._numbers import Block, Reader, line_at

MOST_BLOCKS = 10_000  # blocks of rows, each after a line with their number (PTS)


class TextSource(Source):
    """The rows of a text file."""

    def __init__(self, path: Path, request: Request) -> None:
        self._path = path
        with path.open("rb") as file:
            head = file.read(LOOK)
        self._look = look = look_at(head, path, request.columns)
        self._layout = Layout.of(look.names)
        self._size = path.stat().st_size
        facts: dict[str, Any] = {"columns": look.names, "separator": (look.dialect.delimiters or b" ").decode()}
        if look.dialect.decimal == b",":
            facts["decimal"] = ","
        if look.announced is not None:
            facts["announced"] = look.announced
        expected = max(int((self._size - look.start) / max(look.row, 1)), 1)
        self.listing = Listing(None, self._layout.row(), expected, facts=facts)

    def chunks(self) -> Iterator[Chunk]:
        look, layout = self._look, self._layout
        k = len(look.names)
        with self._path.open("rb") as file:
            doubtful = layout.doubtful(look.whole)
            if doubtful:  # all chunks have the same types, so all rows are looked at first: a third of the time
                stats = merged(self._blocks(file, scanning(k, doubtful)), None)
                assert stats is not None
                layout = layout.typed(stats, doubtful)
            for block in self._blocks(file, layout.modes(k)):
                if len(block):
                    yield layout.chunk(block, block.end / max(self._size, 1))

    def _blocks(self, file: BinaryIO, modes: list[int]) -> Iterator[Block]:
        """All blocks of rows, checked against the numbers that are announced before them (PTS)."""
        reader = Reader(file, self._look.dialect, modes, self._look.start)
        announced, line = self._look.announced, ""
        for _ in range(MOST_BLOCKS):
            count = 0
            for block in reader.blocks():
                count += len(block)
                yield block
            _check_count(announced, count, line)
            if reader.at >= self._size:
                return
            announced, line = _announced(file, reader, announced)
        raise ValueError(f"has more than {MOST_BLOCKS:,} blocks of rows")


def _check_count(announced: int | None, count: int, line: str) -> None:
    if announced is not None and announced != count:
        where = line or "the line before the first row"
        what = "is cut off" if count < announced else "is damaged"
        raise ValueError(f"{what}: {where} announces {announced:,} rows, {count:,} are there")


def _announced(file: BinaryIO, reader: Reader, before: int | None) -> tuple[int, str]:
    """The number of rows in a line between rows, and where it is; the reader goes on behind it."""
    number, text, within = line_at(file, reader.at)
    if before is None or not re.fullmatch(r"\s*\d{1,18}\s*", text):
        raise ValueError(f"line {number:,} has 1 column, the rows before it have more: {shortened(text)}")
    reader.at += len(text) - within
    return int(text), f"line {number:,}"
