"""A cache of compiled kernels for a process that needs its own."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

from pointray.engine.jit import disk_cache as disk


def linked_cache(folder: Path) -> Path:
    """Make a cache folder that has the kernels compiled so far, as hard links; what is added to it stays there.

    For a process that needs a cache of its own, as POINTRAY_CACHE.
    """
    shared = disk.cache_folder()
    if shared is not None:
        try:
            shutil.copytree(shared, folder / shared.name, copy_function=os.link)
        except OSError:  # another file system
            shutil.copytree(shared, folder / shared.name, dirs_exist_ok=True)
    return folder
