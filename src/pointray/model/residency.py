"""Cache of open model parts and levels of detail, within a memory budget; the least recently used are closed first.

Arrays that an image still reads stay mapped. Only their pages are returned to the system, which reads them again from
the file when they are touched.
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

SHARE = 0.5  # default budget as a share of the available memory when a model is loaded
UNKNOWN = 1 << 32  # default budget in bytes where the available memory is unknown
MOST_OPEN = 400  # open files: each mapped file takes one of the descriptors of the process, often 1,024


class Key(NamedTuple):
    """Key of a file. level : 0 for the part itself, 1 for its finest level of detail"""

    part: int
    level: int


class Opened(NamedTuple):
    """An open file. data : its mapped arrays; nbytes : its size"""

    data: ModelData
    nbytes: int


class ResidencyCache:
    """Cache of the open parts and levels of detail of a model in a folder. Thread-safe.

    Parameters
    ----------
    folder : Path
    index : Index
    whole : Level
        The whole: all points, and a tree without splats.
    budget : int, optional
        Bytes of files that are open at once. Default: half of the available memory.

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
        self._open: OrderedDict[Key, Opened] = OrderedDict()  # least recently used first
        self._validated: dict[Key, tuple[int, ...]] = {}  # validated files: inode, size and time of change then
        self._lock = threading.Lock()  # guards the dictionaries
        self._reading: dict[Key, threading.Lock] = {}

    @property
    def step(self) -> float:
        """Longest step of a ray's samples in any part, in the points' unit."""
        return self._index.longest

    def file(self, key: Key) -> PartFile | LevelFile:
        """Return the entry of a file in the index."""
        part = self._index.parts[key.part]
        return part.levels[key.level - 1] if key.level else part

    def find(self, key: Key) -> ModelData | None:
        """Return the data of a file if it is open, which counts as a use; else None."""
        with self._lock:
            found = self._open.get(key)
            if found is None:
                return None
            self._open.move_to_end(key)
            return found.data

    def open(self, key: Key) -> ModelData:
        """Return the data of a file; open and validate it if necessary.

        Raises
        ------
        OSError
            If the file cannot be opened; the error names it.
        ValueError
            If it is damaged or does not match the index; the message names it.
        """
        found = self.find(key)
        if found is not None:
            return found
        with self._lock:
            reading = self._reading.setdefault(key, threading.Lock())
        with reading:  # one of the threads that need a file reads it
            found = self.find(key)
            if found is not None:
                return found
            opened = self._read(key)
            with self._lock:
                self._open[key] = opened
                closed = self._close_surplus(key)
        for tree in closed:
            drop_pages(tree)
        return opened.data

    @property
    def room(self) -> int:
        """Bytes of the budget for files that can be closed: all but the coarsest levels, which stay open."""
        with self._lock:
            return self.budget - sum(opened.nbytes for key, opened in self._open.items() if self.is_kept(key))

    def is_kept(self, key: Key) -> bool:
        """Return whether a file stays open: the coarsest level of a part, which can stand in for all others."""
        return key.level > 0 and key.level == len(self._index.parts[key.part].levels)

    def is_open(self, key: Key) -> bool:
        """Return whether a file is open; does not count as a use."""
        return key in self._open

    @property
    def nbytes(self) -> int:
        """Total size of the open files in bytes."""
        with self._lock:
            return sum(opened.nbytes for opened in self._open.values())

    def _read(self, key: Key) -> Opened:
        file, path = self.file(key), self._folder / self.file(key).name
        facts = os.stat(path)
        now = facts.st_ino, facts.st_size, facts.st_mtime_ns
        is_valid = self._validated.get(key) == now
        read = read_level if key.level else read_part
        level = read(self._folder, self._index, key, self._whole, is_valid)
        try:
            data = ModelData.from_stored(level)
        except (ValueError, TypeError) as error:
            raise ValueError(f"{path}: the model is damaged: {error}") from error
        self._validated[key] = now
        return Opened(data, file.nbytes)

    def _close_surplus(self, newest: Key) -> list[Tree]:
        """Remove files beyond the budget from the cache; return their trees."""
        closed: list[Tree] = []
        total = sum(opened.nbytes for opened in self._open.values())
        closable = [key for key in self._open if key != newest and not self.is_kept(key)]
        for key in closable:
            if total <= self.budget and len(closable) - len(closed) < MOST_OPEN:
                break
            opened = self._open.pop(key)
            total -= opened.nbytes
            closed.append(opened.data.tree)
        return closed


class Source(NamedTuple):
    """The file of a part or level of detail, and the cache through which it is opened."""

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
        """Entry of the file in the index."""
        return self.cache.file(self.key)
