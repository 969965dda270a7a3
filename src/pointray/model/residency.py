"""What is open of a model in parts: opened when it is first needed, within a budget of memory, and let go again.

The least recently used parts and levels of detail go first. What a picture still reads stays as long as it is read:
only its pages are given back to the system, which fetches them from the file again where they are touched.
"""

from __future__ import annotations

import os
import threading
from collections import OrderedDict
from pathlib import Path
from typing import NamedTuple

from ..base.memory import available_memory
from ..engine.kernels.tree import Tree
from .array_file import drop_pages
from .model_data import ModelData
from .model_file import Level
from .model_folder import Index, LevelFile, PartFile, read_level, read_part

SHARE = 0.5  # of the memory that is available when a model is loaded: its budget, if none is given
UNKNOWN = 1 << 32  # bytes: the budget where that memory is unknown
MOST_OPEN = 400  # files: each that is mapped takes one of the descriptors of the process, often 1,024


class Key(NamedTuple):
    """A file. level : 0 is all points of the part, 1 its finest level of detail"""

    part: int
    level: int


class Opened(NamedTuple):
    """An open file. data : its mapped arrays; nbytes : its size"""

    data: ModelData
    nbytes: int


class ResidencyCache:
    """The parts of a model and their levels of detail, on disk and in memory. Threads may use it at once.

    Parameters
    ----------
    folder : Path
    index : Index
    whole : Level
        The whole, with all points and without splats.
    budget : int, optional
        Bytes of files that are open at once. None: half of the memory that is available now.

    Attributes
    ----------
    budget : int
    """

    def __init__(self, folder: Path, index: Index, whole: Level, budget: int | None = None) -> None:
        self._folder, self._index, self._whole = folder, index, whole
        if budget is None:
            free = available_memory()
            budget = UNKNOWN if free is None else int(SHARE * free)
        self.budget = budget
        self._open: OrderedDict[Key, Opened] = OrderedDict()  # the least recently used first
        self._sound: dict[Key, tuple[int, ...]] = {}  # files that were found sound, as they were then
        self._lock = threading.Lock()  # guards all of these
        self._reading: dict[Key, threading.Lock] = {}

    @property
    def step(self) -> float:
        """The longest step of a ray's samples in any part, in the points' unit."""
        return self._index.longest

    def file(self, key: Key) -> PartFile | LevelFile:
        """What the index says of a file."""
        part = self._index.parts[key.part]
        return part.levels[key.level - 1] if key.level else part

    def find(self, key: Key) -> ModelData | None:
        """What a file holds if it is open, which counts as use; else None."""
        with self._lock:
            found = self._open.get(key)
            if found is None:
                return None
            self._open.move_to_end(key)
            return found.data

    def open(self, key: Key) -> ModelData:
        """What a file holds; it is opened and checked if it is not open.

        Raises
        ------
        OSError
            If the file cannot be opened; the error names it.
        ValueError
            If it is damaged, or not what the index says; the message names it.
        """
        found = self.find(key)
        if found is not None:
            return found
        with self._lock:
            reading = self._reading.setdefault(key, threading.Lock())
        with reading:  # of two threads that need a file one reads it
            found = self.find(key)
            if found is not None:
                return found
            opened = self._read(key)
            with self._lock:
                self._open[key] = opened
                gone = self._surplus(key)
        for tree in gone:
            drop_pages(tree)
        return opened.data

    @property
    def room(self) -> int:
        """Bytes of the budget for what can be let go again: without the coarsest levels, which stay."""
        with self._lock:
            return self.budget - sum(opened.nbytes for key, opened in self._open.items() if self.is_kept(key))

    def is_kept(self, key: Key) -> bool:
        """Whether a file stays open: the coarsest level of a part, which is small, and stands for all others."""
        return key.level > 0 and key.level == len(self._index.parts[key.part].levels)

    def is_open(self, key: Key) -> bool:
        """Whether a file is open; that does not count as use."""
        return key in self._open

    @property
    def nbytes(self) -> int:
        """Bytes of all files that are open."""
        with self._lock:
            return sum(opened.nbytes for opened in self._open.values())

    def _read(self, key: Key) -> Opened:
        file, path = self.file(key), self._folder / self.file(key).name
        facts = os.stat(path)
        now = facts.st_ino, facts.st_size, facts.st_mtime_ns
        is_sound = self._sound.get(key) == now
        read = read_level if key.level else read_part
        level = read(self._folder, self._index, key, self._whole, is_sound)
        try:
            data = ModelData.from_stored(level)
        except (ValueError, TypeError) as error:
            raise ValueError(f"{path}: the model is damaged: {error}") from error
        self._sound[key] = now
        return Opened(data, file.nbytes)

    def _surplus(self, newest: Key) -> list[Tree]:
        """Let what is beyond the budget go; returns its trees."""
        gone: list[Tree] = []
        total = sum(opened.nbytes for opened in self._open.values())
        loose = [key for key in self._open if key != newest and not self.is_kept(key)]
        for key in loose:
            if total <= self.budget and len(loose) - len(gone) < MOST_OPEN:
                break
            opened = self._open.pop(key)
            total -= opened.nbytes
            gone.append(opened.data.tree)
        return gone


class Source(NamedTuple):
    """Where a part, or a level of detail of one, comes from."""

    cache: ResidencyCache
    key: Key

    def open(self) -> ModelData:
        """See `ResidencyCache.open`."""
        return self.cache.open(self.key)

    def find(self) -> ModelData | None:
        """See `ResidencyCache.find`."""
        return self.cache.find(self.key)

    @property
    def is_open(self) -> bool:
        """See `ResidencyCache.is_open`."""
        return self.cache.is_open(self.key)

    @property
    def is_kept(self) -> bool:
        """See `ResidencyCache.is_kept`."""
        return self.cache.is_kept(self.key)

    @property
    def file(self) -> PartFile | LevelFile:
        """What the index says of it."""
        return self.cache.file(self.key)
