"""Resource usage of a command: memory of all its processes, disk under a folder, and end times of its stages."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import psutil

EVERY = 0.05  # seconds between two samples of memory
RARE = 10  # samples between two looks at processes, marks and the disk
UNFINISHED = "unfinished"
# Folders in it that have marks, and what their stages are called besides: of all points, of the surface where scattered
# points were put apart, of these.
PLACES = {".": "", "surface": "surface-", "loose": "loose-"}
MARK = re.compile(r"([^.].*?)(?:-\d{4,})?\.json")  # a file that is being written begins with a dot
BESIDE = ("task", "id", "margin", "made-")  # how marks begin that stages leave while they are at work
ENDED = ("files",)  # what comes after the last stage that leaves a mark


class Sample(NamedTuple):
    """Memory of all processes at a time, bytes.

    at : seconds, as `time.time` counts
    resident : with the pages of mapped files, as `ps` shows it; pages that processes share count for each
    anonymous : without these
    """

    at: float
    resident: int
    anonymous: int


class Stage(NamedTuple):
    """A stage of `pointray prepare`.

    parts : how many parts it was done for, one by one; 0: for all at once
    """

    name: str
    seconds: float
    parts: int
    resident: int
    anonymous: int


@dataclass
class Watched:
    """Resource usage of a command.

    seconds : from its start to its end
    resident, anonymous : most bytes of memory, see `Sample`
    disk : most bytes under the folder; left : when all was done
    """

    seconds: float = 0.0
    resident: int = 0
    anonymous: int = 0
    processes: int = 0
    disk: int = 0
    left: int = 0
    stages: list[Stage] = field(default_factory=list)
    output: str = ""


class Watch:
    """Monitors a process and its children until `end`.

    Parameters
    ----------
    pid : int
    folder : path, optional
        In which a model in parts is made.
    """

    def __init__(self, pid: int, folder: Path | None = None) -> None:
        self._process, self._folder = psutil.Process(pid), folder
        self._begun, self._samples = time.time(), list[Sample]()
        self._marks: dict[str, float] = {}
        self._most, self._disk, self._processes = 0, 0, 0
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._look, daemon=True)
        self._thread.start()

    def _look(self) -> None:
        pids, turn = [self._process.pid], 0
        while not self._ended.is_set():
            if turn % RARE == 0:
                with suppress(psutil.Error):
                    pids = [self._process.pid, *(child.pid for child in self._process.children(recursive=True))]
                self._look_at_disk()
            found = [one for one in map(memory_of, pids) if one is not None]
            self._processes = max(self._processes, len(found))
            if found:
                self._most = max(self._most, *(most for _, _, most in found))
                resident, anonymous = (sum(one[k] for one in found) for k in (0, 1))
                self._samples.append(Sample(time.time(), resident, anonymous))
            turn += 1
            self._ended.wait(EVERY)

    def _look_at_disk(self) -> None:
        if self._folder is None:
            return
        self._disk = max(self._disk, disk_of(self._folder))
        for place, prefix in PLACES.items():
            with suppress(OSError):
                for entry in os.scandir(self._folder / UNFINISHED / place):
                    if entry.name.endswith(".json") and prefix + entry.name not in self._marks:
                        self._marks[prefix + entry.name] = entry.stat().st_mtime

    def end(self) -> Watched:
        """The result of monitoring."""
        self._ended.set()
        self._thread.join()
        resident = max([self._most, *(sample.resident for sample in self._samples)])
        anonymous = max((sample.anonymous for sample in self._samples), default=0)
        left = 0 if self._folder is None else disk_of(self._folder)
        seconds = time.time() - self._begun
        return Watched(seconds, resident, anonymous, self._processes, max(self._disk, left), left, self._stages())

    def _stages(self) -> list[Stage]:
        """A stage lasts from the last mark of the previous one to its own; very short ones count to the next."""
        ends: dict[str, list[float]] = {}
        for name, at in self._marks.items():
            match = MARK.fullmatch(name)
            if match is not None and not name.startswith(BESIDE):
                ends.setdefault(match[1], []).append(at)
        order = sorted(
            (max(times), name, len(times) if f"{name}-0000.json" in self._marks else 0) for name, times in ends.items()
        )
        if not order:
            return []
        order.append((time.time(), ENDED[0], 0))
        stages, begin = [], self._begun
        for at, name, parts in order:
            if at - begin < EVERY:  # a mark that is left beside another one
                continue
            some = [sample for sample in self._samples if begin < sample.at <= at]
            most = [max((sample[k] for sample in some), default=0) for k in (1, 2)]
            stages.append(Stage(name, at - begin, parts, *most))
            begin = at
        return stages


def memory_of(pid: int) -> tuple[int, int, int] | None:
    """Return resident bytes of a process, the anonymous ones among them, and the peak; None if it has ended."""
    try:
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    except OSError:
        return None if sys.platform == "linux" else _memory_elsewhere(pid)
    found = {
        name: 1024 * int(rest.split()[0]) for name, _, rest in (line.partition(":") for line in lines) if name in FIELDS
    }
    if "VmRSS" not in found:
        return None
    return found["VmRSS"], found.get("RssAnon", 0) + found.get("RssShmem", 0), found.get("VmHWM", 0)


FIELDS = "VmRSS", "VmHWM", "RssAnon", "RssShmem"


def _memory_elsewhere(pid: int) -> tuple[int, int, int] | None:
    try:
        resident = psutil.Process(pid).memory_info().rss
    except psutil.Error:
        return None
    return resident, resident, resident


def disk_of(path: Path) -> int:
    """Bytes that a file, or all files under a folder, take on the disk: holes take none."""
    total = 0
    for folder, _, names in os.walk(path):
        for name in names:
            with suppress(OSError):
                total += blocks_of(os.stat(os.path.join(folder, name)))
    if path.is_file():
        total = blocks_of(path.stat())
    return total


def blocks_of(found: os.stat_result) -> int:
    """Bytes on the disk."""
    return getattr(found, "st_blocks", found.st_size // 512) * 512


def watched(command: Sequence[object], folder: Path | None = None) -> Watched:
    """Run a command of Python and watch it; a RuntimeError has the last line of its complaint."""
    words = [sys.executable, *map(str, command)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        watch = Watch(process.pid, folder)
        output, complaint = process.communicate()
        found = watch.end()
    if process.returncode:
        raise RuntimeError((complaint.strip().splitlines() or [f"it ended with status {process.returncode}"])[-1])
    found.output = output
    return found
