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
    """Key of a file of a model in parts.

    part : number of the part; level : 0 for the part itself, 1 for its finest level of detail
    """

    part: int
    level: int


class Opened(NamedTuple):
    """An open file of a model in parts. data : its mapped arrays and its settings; nbytes : size of the file"""

    data: ModelData
    nbytes: int


class ResidencyCache:
    """Cache of the open parts and levels of detail of a model in a folder. Thread-safe.

    Beyond the budget the least recently used files are closed.

    Parameters
    ----------
    folder : Path
        The folder of the model.
    index : Index
        Contents of its index file.
    whole : Level
        All points of the model, and a tree without splats.
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
        """Return the entry of a file in the folder's index file: its name, size, number of points and spacing."""
        part = self._index.parts[key.part]
        return part.levels[key.level - 1] if key.level else part

    def find(self, key: Key) -> ModelData | None:
        """Return the arrays and settings of a part or level if its file is open, which counts as a use; else None."""
        with self._lock:
            found = self._open.get(key)
            if found is None:
                return None
            self._open.move_to_end(key)
            return found.data

    def open(self, key: Key) -> ModelData:
        """Return the arrays and settings of a part or level; open and validate its file if it is not open.

        Raises
        ------
        OSError
            If the file cannot be opened; the error names it.
        ValueError
            If it is damaged or does not match the folder's index file; the message names it.
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
        """Bytes of the budget for files that can be closed: without the coarsest levels of detail, which stay open."""
        with self._lock:
            return self.budget - sum(opened.nbytes for key, opened in self._open.items() if self.is_kept(key))

    def is_kept(self, key: Key) -> bool:
        """Return whether a file stays open once opened: the coarsest level of a part.

        It can stand in for the others.
        """
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
        """Remove the least recently used files beyond the budget from the cache; return their trees.

        The caller releases the memory that the trees' mapped files occupy.

        newest : key of the file just opened, which is kept
        """
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
    """The file of a part or level of detail, and the cache through which it is opened.

    key : number of the part, and of the level (0: the part itself)
    """

    cache: ResidencyCache
    key: Key

    def open(self) -> ModelData:
        """Return the arrays and settings in the file; open and validate it if it is not open."""
        return self.cache.open(self.key)

    def find(self) -> ModelData | None:
        """Return the arrays and settings in the file if it is open, which counts as a use; else None."""
        return self.cache.find(self.key)

    @property
    def is_open(self) -> bool:
        """Whether the file is open; asking does not count as a use."""
        return self.cache.is_open(self.key)

    @property
    def is_kept(self) -> bool:
        """Whether the file stays open once opened: the coarsest level of a part. It can stand in for the others."""
        return self.cache.is_kept(self.key)

    @property
    def file(self) -> PartFile | LevelFile:
        """Entry of the file in the folder's index file: its name, size, number of points and spacing."""
        return self.cache.file(self.key)
