"""How much memory is available, so that work that does not fit is refused before the system kills the process.

What is free in the heap of the C library is given back between steps that take much of it, if that library is glibc.
Disks that are full are told by the numbers of errors.
"""

from __future__ import annotations

import ctypes
import errno
import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path, PurePosixPath

FULL_DISK = {getattr(errno, name, None) for name in ("ENOSPC", "EDQUOT", "EFBIG")} - {None}  # numbers of errors
MEMINFO, CGROUPS, OWN_CGROUPS = Path("/proc/meminfo"), Path("/sys/fs/cgroup"), Path("/proc/self/cgroup")
# Where a control group states its limit, its usage, and the part of the usage that the system reclaims by itself.
VERSION_2 = "memory.max", "memory.current", "inactive_file"
VERSION_1 = "memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file"


def available_memory() -> int | None:
    """Bytes that the machine and this process's control groups still leave to it; None if unknown."""
    known = [free for free in (_of_the_machine(), *_of_groups()) if free is not None]
    return max(min(known), 0) if known else None


def check_memory(need: int, what: str) -> None:
    """ValueError if `need` bytes are not available. what : "to write a.png", say"""
    free = available_memory()
    if free is not None and need > free:
        raise ValueError(f"{_in_units(need)} of memory are needed {what}, {_in_units(free)} are available")


def give_back() -> None:
    """Give what is free in the heap back to the system."""
    with suppress(AttributeError, OSError, TypeError):
        ctypes.CDLL(None).malloc_trim(0)


def _in_units(size: int) -> str:
    return f"{size / 2**30:.1f} GiB" if size >= 2**30 else f"{size / 2**20:.0f} MiB"


def _of_the_machine() -> int | None:
    with suppress(OSError, ValueError):
        for line in MEMINFO.read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return int(line.split()[1]) * 1024
    with suppress(OSError, ValueError, AttributeError):  # the total, as no free memory is stated
        pages, size = os.sysconf("SC_PHYS_PAGES"), os.sysconf("SC_PAGE_SIZE")
        return pages * size if pages > 0 and size > 0 else None
    return None


def _of_groups() -> Iterator[int | None]:
    """Bytes left below the limit of each control group that this process is in: its own, and those around it."""
    with suppress(OSError, ValueError):
        for line in OWN_CGROUPS.read_text().splitlines():
            _, controllers, name = line.split(":", 2)
            if controllers and "memory" not in controllers.split(","):
                continue
            root, files = (CGROUPS / "memory", VERSION_1) if controllers else (CGROUPS, VERSION_2)
            own = PurePosixPath(name.lstrip("/"))
            # In a container the group's name may be the one outside; its files then lie at the root.
            for group in (own, *own.parents):
                yield _left_in(root / group, files)


def _left_in(folder: Path, files: tuple[str, str, str]) -> int | None:
    """Bytes left below a group's limit; None where there is no limit."""
    limit, used, reclaimable = files
    try:
        left = int((folder / limit).read_text()) - int((folder / used).read_text())  # ValueError for "max", no limit
        for line in (folder / "memory.stat").read_text().splitlines():
            if line.split()[:1] == [reclaimable]:
                left += int(line.split()[1])
    except (OSError, ValueError):
        return None
    return left
