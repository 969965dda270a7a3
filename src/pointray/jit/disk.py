"""The disk cache: where compiled kernels are stored, and what they depend on."""

from __future__ import annotations

import hashlib
import os
import shutil
import sys
import threading
from collections.abc import Callable, Iterable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import llvmlite.binding
import numba
import numpy as np
import platformdirs
from numba.core.caching import CompileResultCacheImpl, FunctionCache
from numba.core.runtime.nrt import rtsys

# Check every array access and every SIMD load (slow). The test suite runs once with it; it is part of the cache key.
CHECK = os.environ.get("POINTRAY_CHECK", "") not in ("", "0")

ROOT = Path(__file__).parent.parent  # of the package

# Files that files with kernels import: an edit to one of them recompiles all kernels. An edit to any other file
# recompiles the kernels in it.
SHARED = (
    *("arguments.py", "choices.py", "data.py", "neighbors/", "progress.py", "survey.py"),
    *("jit/", "simd/", "kernels/", "intersect/", "trace/", "points/procedural/"),
    *("points/normals/agreement.py", "points/normals/axes.py", "points/normals/jet.py", "points/normals/jets.py"),
    *("points/normals/moments.py", "points/normals/pieces.py", "points/normals/planes.py"),
    *("points/normals/quadrics.py", "points/normals/votes.py"),
    *("points/normals/sixteen.py", "points/normals/winding.py"),
    *("points/smoothing/candidates.py", "points/smoothing/creases.py"),
    *("points/smoothing/solids.py", "points/usual.py"),
    *("points/strays/fits.py", "points/strays/survey.py"),
    *("tree/blocks.py", "tree/cells.py", "tree/columns.py", "tree/near.py"),
    *("splats/borders.py", "splats/cells.py", "splats/closed.py", "splats/grow.py", "splats/heap.py"),
    *("splats/sheets.py", "splats/voronoi.py"),
    *("shade/ambient.py", "shade/attributes.py", "shade/bsdf.py", "shade/catcher.py", "shade/choice.py"),
    *("shade/colormaps.py", "shade/direct.py", "shade/emitters.py", "shade/materials/", "shade/path.py"),
    *("shade/shading_points.py", "shade/sky.py", "shade/specular_rays.py"),
    *("shade/baked.py", "shade/baked_code.py", "shade/baked_light.py", "shade/grid.py", "shade/harmonics.py"),
    *("shade/baked_sums.py", "shade/lobe_tables.py", "shade/lobes.py", "shade/rgbe.py"),
    *("baking/directions.py", "baking/gather.py", "baking/patches.py", "rendering/integrate.py"),
    *("image/tone.py", "rendering/film.py", "rendering/lens.py", "rendering/settings.py"),
)
KEEP_CACHES = 4  # folders of other versions that are kept; older ones are removed
MARK, MARKED = ".made-by-pointray", b"compiled kernels of pointray: this folder may be removed at any time\n"


def cpu_name() -> str:
    """The processor that kernels are compiled for: this one, or Numba's NUMBA_CPU_NAME."""
    return os.environ.get("NUMBA_CPU_NAME") or str(llvmlite.binding.get_host_cpu_name())


def cpu_features() -> str:
    """The processor's features in Numba's format: NUMBA_CPU_FEATURES, which may be empty, or this processor's."""
    features = os.environ.get("NUMBA_CPU_FEATURES")
    if features is None and cpu_name() == "generic":
        return ""
    return str(llvmlite.binding.get_host_cpu_features().flatten()) if features is None else features


@cache
def source_key() -> str:
    """Name of the cache folder: a hash of everything that compiled code depends on.

    Numba checks only the function's own file, so an edit to `kernels/vec.py` would leave stale kernels behind.
    """
    shared = [path for path in sorted(ROOT.rglob("*.py")) if path.relative_to(ROOT).as_posix().startswith(SHARED)]
    digest = hashlib.sha256(_hash_of(shared).encode())
    facts = (numba.__version__, llvmlite.__version__, np.__version__, sys.version_info[:2], CHECK)
    digest.update(repr((facts, cpu_name(), cpu_features())).encode())
    return digest.hexdigest()[:16]


def _hash_of(files: Iterable[Path]) -> str:
    """A hash of the names and contents of files."""
    digest = hashlib.sha256()
    for path in files:
        digest.update(path.name.encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


@cache
def cache_folder() -> Path | None:
    """Folder of the compiled kernels (in `POINTRAY_CACHE`, else the user's cache); None if it cannot be written."""
    base = Path(os.environ.get("POINTRAY_CACHE") or platformdirs.user_cache_dir("pointray", appauthor=False))
    folder = base / f"kernels-{source_key()}"
    try:
        fresh = not folder.exists()
        folder.mkdir(parents=True, exist_ok=True)
        probe = folder / f".probe-{os.getpid()}-{threading.get_ident()}"
        probe.touch()
        probe.unlink()
        if fresh:
            (folder / MARK).write_bytes(MARKED)
            _prune(base)
    except OSError:
        return None
    return folder


def _prune(base: Path) -> None:
    """Remove the oldest folders of kernels that carry our mark; other folders with such names stay."""
    ours = [path for path in base.glob("kernels-*") if _is_ours(path)]
    for old in sorted(ours, key=lambda path: path.stat().st_mtime)[: -KEEP_CACHES - 1]:
        shutil.rmtree(old, ignore_errors=True)


def _is_ours(folder: Path) -> bool:
    """Whether pointray has made and marked a folder."""
    try:
        return not folder.is_symlink() and (folder / MARK).read_bytes() == MARKED
    except OSError:
        return False


class _Locator:
    """Tells Numba where a kernel's compiled code is stored: `cache_folder()` for all kernels."""

    def __init__(self, py_func: Callable[..., Any], py_file: str) -> None:
        self._line = py_func.__code__.co_firstlineno
        own = Path(py_file)
        # A kernel from elsewhere may call anything in the package.
        inner = own.is_relative_to(ROOT)
        key = source_key() if inner else _hash_of(sorted(ROOT.rglob("*.py")))
        self._stamp = key + (_hash_of([own]) if own.exists() else "")

    @classmethod
    def from_function(cls, py_func: Callable[..., Any], py_file: str) -> _Locator:
        return cls(py_func, py_file)

    def get_cache_path(self) -> str:
        return str(cache_folder())

    def ensure_cache_path(self) -> None:
        pass

    def get_source_stamp(self) -> str:
        return self._stamp

    def get_disambiguator(self) -> str:
        return str(self._line)


class _CacheImpl(CompileResultCacheImpl):
    _locator_classes = [_Locator]


class KernelCache(FunctionCache):
    """Numba's cache in our folder; a cache that cannot be read or written is no error."""

    _impl_class = _CacheImpl

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)  # type: ignore[no-untyped-call]

    @property
    def is_fresh(self) -> bool:
        """Whether the kernel is on disk, compiled from the source of today."""
        try:
            return bool(self._cache_file._load_index())
        except MemoryError:
            raise
        except Exception:  # a damaged index
            return False

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """A kernel from the disk; None if it has to be compiled.

        Numba would first import all that compiling needs, which takes 0.4 s of a first picture's 2.4. Compiling imports
        it itself.
        """
        rtsys.initialize(target_context)
        try:
            with self._guard_against_spurious_io_errors():
                return self._load_overload(sig, target_context)  # type: ignore[no-untyped-call]
        except Exception:  # a damaged or half-written file: compile again
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        with suppress(OSError):
            try:
                super().save_overload(sig, data)  # type: ignore[no-untyped-call]
            except OSError:
                raise
            except Exception:  # a damaged index: begin a new one
                self.flush()  # type: ignore[no-untyped-call]
                super().save_overload(sig, data)  # type: ignore[no-untyped-call]
