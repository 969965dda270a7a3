"""Rows of a text file."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

from ....cloud.georeference import Georeference
from .._counts import count_mismatch
from .._source import Chunk, Faults, Listing, Request, Source
from ._columns import Layout, merged, scanning
from ._first_look import EXAMINED, examine_text
from ._lines import shortened
from ._numbers import Block, Reader, line_at

MOST_BLOCKS = 10_000  # maximum number of blocks of rows, each after a line with their number (PTS)


class TextSource(Source):
    """Reader of text files with rows of numbers."""

    def __init__(self, path: Path, request: Request) -> None:
        self._path, self.faults = path, Faults(request.strict)
        with path.open("rb") as file:
            head = file.read(EXAMINED)
        self._properties = properties = examine_text(head, path, request.columns, self.faults)
        self._layout, self.note = Layout.of(properties.names), properties.note
        self._size = path.stat().st_size
        facts: dict[str, Any] = {
            "columns": properties.names,
            "separator": (properties.dialect.delimiters or b" ").decode(),
        }
        if properties.dialect.decimal == b",":
            facts["decimal"] = ","
        if properties.announced is not None:
            facts["announced"] = properties.announced
        expected = max(int((self._size - properties.start) / max(properties.row, 1)), 1)
        georeference = Georeference(
            "EPSG:4326" if properties.has_degrees else None, format="PTS" if path.suffix.lower() == ".pts" else None
        )
        self.listing = Listing(None, self._layout.row(), expected, georeference, facts)

    def chunks(self) -> Iterator[Chunk]:
        properties, layout = self._properties, self._layout
        k = len(properties.names)
        with self._path.open("rb") as file:
            doubtful = layout.doubtful(properties.whole)
            if doubtful:  # all chunks must have the same types, so all rows are scanned first: a third of the time
                stats = merged(self._blocks(file, scanning(k, doubtful)), None)
                assert stats is not None
                layout = layout.typed(stats, doubtful)
            for block in self._blocks(file, layout.modes(k)):
                if len(block):
                    yield layout.chunk(block, block.end / max(self._size, 1))

    def _blocks(self, file: BinaryIO, modes: list[int]) -> Iterator[Block]:
        """Yield all blocks of rows; a number of rows other than announced (PTS) is recorded in `faults`.

        modes : how each column is read
        """
        reader = Reader(file, self._properties.dialect, modes, self._properties.start, None, self.faults)
        announced, line, total, there = self._properties.announced, "the line before the first row", 0, 0
        for _ in range(MOST_BLOCKS):
            count = 0
            for block in reader.blocks():
                count += len(block)
                yield block
            if self.faults.strict:
                _check_count(announced, count, line)
            total, there = total + (announced or 0), there + count
            following = None if reader.at >= self._size else _announced(file, reader, announced, self.faults)
            if following is None:
                break
            announced, line = following
        else:
            raise ValueError(f"has more than {MOST_BLOCKS:,} blocks of rows")
        if announced is not None and total != there:
            self.faults.add(count_mismatch(total, there, "rows"))


def _check_count(announced: int | None, count: int, line: str) -> None:
    if announced is not None and announced != count:
        what = "is cut off" if count < announced else "is damaged"
        raise ValueError(f"{what}: {line} announces {announced:,} rows, {count:,} found")


def _announced(file: BinaryIO, reader: Reader, before: int | None, faults: Faults) -> tuple[int, str] | None:
    """Read the number of rows from a line between rows; return it and its place, such as "line 12".

    PTS files have such a line before the rows of each scan. The reader is moved past it. Return None if it is an
    incomplete last line; raise ValueError if it is not a number.

    before : number announced for the previous rows, None if none was
    """
    number, text, within = line_at(file, reader.at)
    is_last = file.seek(0, 2) <= reader.at + len(text) - within
    if is_last and not faults.strict:
        faults.add("its last line is cut off")
        return None
    if before is None or not re.fullmatch(r"\s*\d{1,18}\s*", text):
        raise ValueError(f"line {number:,} has 1 column, the previous rows have more: {shortened(text)}")
    reader.at += len(text) - within
    return int(text), f"line {number:,}"
