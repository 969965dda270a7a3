"""How much memory there is for what is about to be made, so that what does not fit is refused and nothing is killed."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path, PurePosixPath

MEMINFO, CGROUPS, OWN_CGROUPS = Path("/proc/meminfo"), Path("/sys/fs/cgroup"), Path("/proc/self/cgroup")
# Where a control group says its limit, what it has taken, and what of that the system takes back by itself.
VERSION_2 = "memory.max", "memory.current", "inactive_file"
VERSION_1 = "memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file"


def available_memory() -> int | None:
    """Bytes that this process may still take: of the machine and of the control groups it is in; None if unknown."""
    known = [free for free in (_of_the_machine(), *_of_groups()) if free is not None]
    return max(min(known), 0) if known else None


def check_memory(need: int, what: str) -> None:
    """ValueError if so many bytes are not there. what : "to write a.png", say"""
    free = available_memory()
    if free is not None and need > free:
        raise ValueError(f"{_in_units(need)} of memory are needed {what}, {_in_units(free)} are available")


def _in_units(size: int) -> str:
    return f"{size / 2**30:.1f} GiB" if size >= 2**30 else f"{size / 2**20:.0f} MiB"


def _of_the_machine() -> int | None:
    with suppress(OSError, ValueError):
        for line in MEMINFO.read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return int(line.split()[1]) * 1024
    with suppress(OSError, ValueError, AttributeError):  # all that there is: what is free is not said
        pages, size = os.sysconf("SC_PHYS_PAGES"), os.sysconf("SC_PAGE_SIZE")
        return pages * size if pages > 0 and size > 0 else None
    return None


def _of_groups() -> Iterator[int | None]:
    """What is left below the limit of each control group that this process is in: its own, and those around it."""
    with suppress(OSError, ValueError):
        for line in OWN_CGROUPS.read_text().splitlines():
            _, controllers, name = line.split(":", 2)
            if controllers and "memory" not in controllers.split(","):
                continue
            root, files = (CGROUPS / "memory", VERSION_1) if controllers else (CGROUPS, VERSION_2)
            own = PurePosixPath(name.lstrip("/"))
            # In a container the group's name may be that outside of it, where its files lie at the root.
            for group in (own, *own.parents):
                yield _left_in(root / group, files)


def _left_in(folder: Path, files: tuple[str, str, str]) -> int | None:
    """Bytes below a group's limit; None where there is none."""
    limit, used, reclaimable = files
    try:
        left = int((folder / limit).read_text()) - int((folder / used).read_text())  # "max" is no number
        for line in (folder / "memory.stat").read_text().splitlines():
            if line.split()[:1] == [reclaimable]:
                left += int(line.split()[1])
    except (OSError, ValueError):
        return None
    return left
