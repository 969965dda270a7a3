"""Facts about this installation, for bug reports."""

from __future__ import annotations

import os
import platform
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import platformdirs

PACKAGES = ("numpy", "scipy", "numba", "laspy", "OpenEXR", "OpenImageIO", "pye57", "trimesh", "dask", "matplotlib")


def describe_system() -> dict[str, Any]:
    """Return facts for bug reports by name: versions of packages, computer, threads, cache, kernels in use."""
    from .. import __version__
    from ..engine.jit import thread_count
    from ..engine.jit.library import choice

    _, why = choice()
    return {
        "pointray": __version__,
        "python": platform.python_version(),
        "system": platform.platform(),
        "processor": platform.machine(),
        "threads": thread_count(),
        "kernels": why,
        "cache": os.environ.get("POINTRAY_CACHE") or platformdirs.user_cache_dir("pointray", appauthor=False),
        **{name.lower(): _version(name) for name in PACKAGES},
    }


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"
