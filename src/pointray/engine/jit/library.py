"""Kernels that were compiled before: the library for this processor, if there is one that fits the sources.

`POINTRAY_KERNELS` says what is wanted: `compiled` kernels and no others, `jit` for kernels that Numba compiles, `auto`
(the default) for Numba where there is no compiled kernel.
"""

from __future__ import annotations

import ctypes
import hashlib
import json
import os
import struct
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import cache, cached_property
from pathlib import Path
from typing import Any

from ...base.dependencies import ROOT, digest_of, key_of
from .boundary import Results, error_at, packer, size_of

FOLDER = ROOT / "engine" / "native"
MANIFEST, FORMAT = "manifest.json", 2
# Check every array access and every SIMD load (slow). The test suite runs once with it; it is part of the cache key.
CHECK = os.environ.get("POINTRAY_CHECK", "") not in ("", "0")
CHOICES = "auto", "compiled", "jit"


def wanted() -> str:
    """What `POINTRAY_KERNELS` says."""
    text = os.environ.get("POINTRAY_KERNELS", "") or "auto"
    if text not in CHOICES:
        raise ValueError(f"POINTRAY_KERNELS must be one of {', '.join(CHOICES)}, not {text!r}")
    return text


def symbol(kernel: str) -> str:
    """The name of a kernel's C function."""
    return "pr_" + kernel.removeprefix("pointray.").replace(".", "__")


class Library:
    """The compiled kernels for a level of processors.

    level : such as x86-64-v3
    """

    def __init__(self, level: str, code: ctypes.CDLL, manifest: Mapping[str, Any]) -> None:
        self.level, self._code = level, code
        self._kernels, self._records, self._sources = manifest["kernels"], manifest["records"], manifest["sources"]

    def find(self, kernel: str, file: Path) -> Callable[..., Any] | None:
        """A kernel that is compiled from the sources of today; None if there is none.

        file : in which the kernel is written
        """
        about = self._kernels.get(kernel)
        if about is None or not (self._is_of_today or about["key"] == key_of([file])):
            return None
        return self._callable(kernel, about)

    @cached_property
    def _is_of_today(self) -> bool:
        """Whether all sources are those that the library was built from: quicker than to ask kernel by kernel."""
        try:
            return all(digest_of(ROOT / name) == digest for name, digest in self._sources.items())
        except OSError:
            return False

    def _callable(self, kernel: str, about: Mapping[str, Any]) -> Callable[..., Any]:
        """The Python function that calls a kernel."""
        call = self._code[symbol(kernel)]
        call.argtypes, call.restype = [ctypes.c_void_p, ctypes.c_void_p], ctypes.c_int32
        release = self._code["pr_release"]
        release.argtypes, release.restype = [ctypes.c_void_p], None
        pack = packer(about["arguments"], self._records)
        results = Results(about["returns"], self._records, release)
        words = ctypes.c_int64 * max(size_of(about["returns"], self._records), 1)

        def kernel_in_library(*arguments: Any) -> Any:
            out = words()
            try:
                slots = pack(*arguments)
            except (TypeError, ValueError, OverflowError, struct.error) as error:
                raise TypeError(f"{kernel}: {error}") from None
            if call(slots, out):
                raise error_at(out[0])
            return results.read(out)

        return kernel_in_library


@cache
def choice() -> tuple[Library | None, str]:
    """The library that is used, if any, and why, as a sentence without its full stop."""
    if CHECK:
        return None, "POINTRAY_CHECK is set, so Numba compiles kernels with checks"
    if wanted() == "jit":
        return None, "POINTRAY_KERNELS=jit"
    try:
        manifest = json.loads((FOLDER / MANIFEST).read_text())
        libraries = dict(manifest["libraries"])
        _check(manifest)
    except FileNotFoundError:
        return None, "this installation has no compiled kernels"
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        return None, f"the compiled kernels cannot be used: {FOLDER / MANIFEST}: {error}"
    reasons = []
    for level, about in libraries.items():  # the best first
        try:
            code = _load(FOLDER / about["file"], about["sha256"])
            if not _runs(level, code):
                reasons.append(f"this processor is not one of {level}")
                continue
            return Library(level, code, manifest), f"compiled for {level}"
        except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
            reasons.append(str(error))
    return None, f"the compiled kernels cannot be used: {'; '.join(reasons)}"


def _check(manifest: Any) -> None:
    """Raise ValueError where a manifest is of another kind."""
    if manifest["format"] != FORMAT:
        raise ValueError(f"its format is {manifest['format']}, not {FORMAT}")
    if not all(isinstance(manifest[part], dict) for part in ("kernels", "records", "sources")):
        raise ValueError("it is damaged")


def _load(path: Path, sha256: str) -> ctypes.CDLL:
    """Load a library with known content.

    Where the system allows it, what is loaded is a copy in memory: whatever happens to the file, kernels stay.
    """
    content = path.read_bytes()
    if hashlib.sha256(content).hexdigest() != sha256:
        raise ValueError(f"{path} is damaged or of another build")
    if hasattr(os, "memfd_create"):
        with suppress(OSError):
            # It stays open: the loader takes another library of the same path for this one.
            descriptor = os.memfd_create(path.name)
            with open(descriptor, "wb", closefd=False) as file:
                file.write(content)
            return ctypes.CDLL(f"/proc/self/fd/{descriptor}")
    return ctypes.CDLL(str(path))


def _runs(level: str, code: ctypes.CDLL) -> bool:
    """Whether this processor is one of a level."""
    if not level.startswith("x86-64-v"):
        return True
    return int(code.pr_level()) >= int(level.removeprefix("x86-64-v"))
