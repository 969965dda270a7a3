"""Disk cache of compiled kernels: its location and what its entries depend on."""

from __future__ import annotations

import hashlib
import os
import shutil
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any

import llvmlite.binding
import numba
import numpy as np
import platformdirs
from numba.core.caching import CompileResultCacheImpl, FunctionCache
from numba.core.runtime.nrt import rtsys

from ...base.dependencies import ROOT, key_of
from .library import CHECK

KEEP_CACHES = 4  # folders of other environments to keep; older ones are removed
KEEP_VERSIONS = 8  # versions of a module's kernels to keep
PATIENCE = 900.0  # timeout in seconds for a kernel that another process compiles
MARK, MARKED = ".made-by-pointray", b"compiled kernels of pointray: this folder may be removed at any time\n"


def cpu_name() -> str:
    """Return the CPU that kernels are compiled for: Numba's NUMBA_CPU_NAME, else this one."""
    return os.environ.get("NUMBA_CPU_NAME") or str(llvmlite.binding.get_host_cpu_name())


def cpu_features() -> str:
    """Return the CPU features in Numba's format: NUMBA_CPU_FEATURES, which may be empty, else those of this CPU."""
    features = os.environ.get("NUMBA_CPU_FEATURES")
    if features is None and cpu_name() == "generic":
        return ""
    return str(llvmlite.binding.get_host_cpu_features().flatten()) if features is None else features


@cache
def environment_key() -> str:
    """Return a hash of what compiled code depends on besides its sources, which names the folder of the disk cache.

    It includes the versions of Numba, llvmlite, NumPy and Python, the CPU with its features, and POINTRAY_CHECK.
    """
    versions = numba.__version__, llvmlite.__version__, np.__version__, sys.version_info[:2]
    facts = versions, CHECK, cpu_name(), cpu_features()
    return hashlib.sha256(repr(facts).encode()).hexdigest()[:16]


@cache
def cache_folder() -> Path | None:
    """Return the folder of compiled kernels, in `POINTRAY_CACHE` or the user's cache; None if it is not writable."""
    base = Path(os.environ.get("POINTRAY_CACHE") or platformdirs.user_cache_dir("pointray", appauthor=False))
    folder = base / f"kernels-{environment_key()}"
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
    """Remove the oldest kernel folders, of other versions or CPUs, from the cache; only those that pointray has marked.

    base : folder of the cache
    """
    _remove_oldest((path for path in base.glob("kernels-*") if _is_ours(path)), KEEP_CACHES + 1)


def _remove_oldest(folders: Iterable[Path], keep: int) -> None:
    """Remove all folders but the `keep` newest ones, by modification time."""
    ages = []
    for folder in folders:
        with suppress(OSError):
            ages.append((folder.stat().st_mtime, folder))
    for _, old in sorted(ages)[:-keep]:
        shutil.rmtree(old, ignore_errors=True)


def _is_ours(folder: Path) -> bool:
    """Return whether a folder carries the mark of pointray's cache, a file, and so may be removed."""
    try:
        return not folder.is_symlink() and (folder / MARK).read_bytes() == MARKED
    except OSError:
        return False


class _Locator:
    """Location of a kernel in Numba's cache: a folder named after its module and a hash of all files that it imports.

    Numba checks only the function's own file, so that an edit of `engine/kernels/vec.py` would leave stale kernels.
    """

    def __init__(self, py_func: Callable[..., Any], py_file: str) -> None:
        self._line = py_func.__code__.co_firstlineno
        file = Path(py_file)
        self._module = (
            ".".join(file.relative_to(ROOT).with_suffix("").parts) if file.is_relative_to(ROOT) else file.stem
        )
        self._key = key_of([file]) if file.exists() else ""

    @classmethod
    def from_function(cls, py_func: Callable[..., Any], py_file: str) -> _Locator:
        return cls(py_func, py_file)

    def get_cache_path(self) -> str:
        return str(self._folder)

    @property
    def _folder(self) -> Path:
        folder = cache_folder()
        assert folder is not None
        return folder / f"{self._module}-{self._key}"

    def ensure_cache_path(self) -> None:
        if not self._folder.exists():
            self._folder.mkdir(exist_ok=True)
            versions = self._folder.parent.glob(f"{self._module}-{'?' * 16}")
            _remove_oldest(versions, KEEP_VERSIONS)

    def get_source_stamp(self) -> str:
        return self._key

    def get_disambiguator(self) -> str:
        return str(self._line)


class _CacheImpl(CompileResultCacheImpl):
    _locator_classes = [_Locator]


class KernelCache(FunctionCache):
    """Numba's disk cache of one kernel, in pointray's folder. Failures to read or write it are ignored."""

    _impl_class = _CacheImpl

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)  # type: ignore[no-untyped-call]

    @property
    def is_fresh(self) -> bool:
        """Whether the kernel is on disk, compiled from the current sources, so that it need not be compiled."""
        try:
            return bool(self._cache_file._load_index())
        except MemoryError:
            raise
        except Exception:  # a damaged index
            return False

    @contextmanager
    def exclusive(self) -> Iterator[None]:
        """Lock out other processes that would compile this kernel, within a `with` block.

        Without effect on file systems that do not support locks.
        """
        from filelock import FileLock  # takes 50 ms, so only when something is compiled

        with ExitStack() as stack:
            with suppress(OSError, NotImplementedError):
                self._impl.locator.ensure_cache_path()
                stack.enter_context(FileLock(f"{self._cache_file._index_path}.lock", timeout=PATIENCE))
            yield

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Load a kernel from disk; return its Numba compile result, or None if it has to be compiled.

        Numba would first import all modules needed for compilation, which takes 0.4 s of the 2.4 s of a first picture.
        Compilation imports them itself.

        sig : Numba types of the arguments
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
            except Exception:  # a damaged index: start a new one
                self.flush()  # type: ignore[no-untyped-call]
                super().save_overload(sig, data)  # type: ignore[no-untyped-call]
