"""Available memory, so that work that does not fit is refused before the system kills the process.

Also returns freed memory to the system (glibc only), and lists the error numbers of full disks.
"""

from __future__ import annotations

import ctypes
import errno
import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path, PurePosixPath

from .manual import with_note

FULL_DISK = {getattr(errno, name, None) for name in ("ENOSPC", "EDQUOT", "EFBIG")} - {None}  # error numbers
MEMINFO, CGROUPS, OWN_CGROUPS = Path("/proc/meminfo"), Path("/sys/fs/cgroup"), Path("/proc/self/cgroup")
# Files and keys of a control group: its limit, its usage, and the part of the usage that the system can reclaim.
VERSION_2 = "memory.max", "memory.current", "inactive_file"
VERSION_1 = "memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file"


def available_memory() -> int | None:
    """Return the bytes of memory that this process can still use; None if unknown.

    They are limited by the machine and by the limits of control groups, as in a container.
    """
    known = [free for free in (_of_the_machine(), *_of_groups()) if free is not None]
    return max(min(known), 0) if known else None


def check_memory(need: int, what: str) -> None:
    """Raise ValueError if `need` bytes are not available. what : such as "to write a.png", for the message"""
    free = available_memory()
    if free is not None and need > free:
        message = f"{in_units(need)} of memory are needed {what}, {in_units(free)} are available"
        raise with_note(ValueError(message))


def trim_heap() -> None:
    """Return freed memory of the heap to the system, which glibc would keep."""
    with suppress(AttributeError, OSError, TypeError):
        ctypes.CDLL(None).malloc_trim(0)


def in_units(size: int) -> str:
    """Return a number of bytes as text, in GiB or MiB."""
    return f"{size / 2**30:.1f} GiB" if size >= 2**30 else f"{size / 2**20:.0f} MiB"


def _of_the_machine() -> int | None:
    with suppress(OSError, ValueError):
        for line in MEMINFO.read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return int(line.split()[1]) * 1024
    with suppress(OSError, ValueError, AttributeError):  # total memory, if the available memory is not stated
        pages, size = os.sysconf("SC_PHYS_PAGES"), os.sysconf("SC_PAGE_SIZE")
        return pages * size if pages > 0 and size > 0 else None
    return None


def _of_groups() -> Iterator[int | None]:
    """Yield the bytes left below the memory limit of each control group (cgroup) of this process, its own first.

    None stands for a group without a limit, or whose files cannot be read.
    """
    with suppress(OSError, ValueError):
        for line in OWN_CGROUPS.read_text().splitlines():
            _, controllers, name = line.split(":", 2)
            if controllers and "memory" not in controllers.split(","):
                continue
            root, files = (CGROUPS / "memory", VERSION_1) if controllers else (CGROUPS, VERSION_2)
            own = PurePosixPath(name.lstrip("/"))
            # In a container the name may be that on the host; the files of the group are then at the root.
            for group in (own, *own.parents):
                yield _left_in(root / group, files)


def _left_in(folder: Path, files: tuple[str, str, str]) -> int | None:
    """Return the bytes left below the memory limit of a control group (cgroup); None if it has no limit.

    folder : folder of the group; files : name of the limit's file, name of the usage's file, and key in memory.stat of
    the part of the usage that the system can reclaim
    """
    limit, used, reclaimable = files
    try:
        left = int((folder / limit).read_text()) - int((folder / used).read_text())  # ValueError for "max", no limit
        for line in (folder / "memory.stat").read_text().splitlines():
            if line.split()[:1] == [reclaimable]:
                left += int(line.split()[1])
    except (OSError, ValueError):
        return None
    return left
