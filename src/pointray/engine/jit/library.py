"""Kernels compiled ahead of time: the library for this CPU, if there is one built from the current sources.

`POINTRAY_KERNELS` selects the kernels: `compiled` for the library only, `jit` for Numba only, `auto` (the default) for
the library where it has a kernel, else Numba.
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
# Check every array access and SIMD load (slow). The test suite runs once with it. It is part of the cache key.
CHECK = os.environ.get("POINTRAY_CHECK", "") not in ("", "0")
CHOICES = "auto", "compiled", "jit"


def kernel_choice() -> str:
    """Return POINTRAY_KERNELS: "compiled" (ahead of time), "jit" (by Numba) or "auto"; ValueError for other values."""
    text = os.environ.get("POINTRAY_KERNELS", "") or "auto"
    if text not in CHOICES:
        raise ValueError(f"POINTRAY_KERNELS must be one of {', '.join(CHOICES)}, got {text!r}")
    return text


def symbol(kernel: str) -> str:
    """Return the name of a kernel's C function in the library. kernel : its module and name, separated by dots"""
    return "pr_" + kernel.removeprefix("pointray.").replace(".", "__")


class Library:
    """Library of kernels compiled ahead of time for one CPU level.

    level : such as x86-64-v3; manifest : types of each kernel's arguments, and hashes of the sources it was built from
    """

    def __init__(self, level: str, code: ctypes.CDLL, manifest: Mapping[str, Any]) -> None:
        self.level, self._code = level, code
        self._kernels, self._records, self._sources = manifest["kernels"], manifest["records"], manifest["sources"]

    def find(self, kernel: str, file: Path) -> Callable[..., Any] | None:
        """Return a kernel of the library as a Python function, or None if it is missing or built from other sources.

        kernel : its full name; file : its source file
        """
        about = self._kernels.get(kernel)
        if about is None or not (self._is_current or about["key"] == key_of([file])):
            return None
        return self._callable(kernel, about)

    @cached_property
    def _is_current(self) -> bool:
        """Whether all source files are unchanged since the library was built; then no kernel is checked by itself."""
        try:
            return all(digest_of(ROOT / name) == digest for name, digest in self._sources.items())
        except OSError:
            return False

    def _callable(self, kernel: str, about: Mapping[str, Any]) -> Callable[..., Any]:
        """Return the Python function that checks and packs arguments, and calls a kernel's C function.

        kernel : its full name; about : its entry in the manifest, with the types of its arguments and result
        """
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
    """Return the library of kernels compiled ahead of time that is in use, and the reason for the choice.

    The library is None if Numba compiles kernels. The reason is a sentence without its full stop, for messages.
    """
    if CHECK:
        return None, "POINTRAY_CHECK is set: kernels are compiled with bounds checks"
    if kernel_choice() == "jit":
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
    for level, about in libraries.items():  # best level first
        try:
            code = _load(FOLDER / about["file"], about["sha256"])
            if not _runs(level, code):
                reasons.append(f"this CPU does not support {level}")
                continue
            return Library(level, code, manifest), f"compiled for {level}"
        except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
            reasons.append(str(error))
    return None, f"the compiled kernels cannot be used: {'; '.join(reasons)}"


def _check(manifest: Any) -> None:
    """Raise ValueError if a library's manifest (`manifest.json`, parsed) is damaged or has an unsupported format."""
    if manifest["format"] != FORMAT:
        raise ValueError(f"unsupported format {manifest['format']}, expected {FORMAT}")
    if not all(isinstance(manifest[part], dict) for part in ("kernels", "records", "sources")):
        raise ValueError("the manifest is damaged")


def _load(path: Path, sha256: str) -> ctypes.CDLL:
    """Load a library after a check of its hash.

    Where the system allows it, a copy in memory is loaded, so that later changes of the file have no effect.
    """
    content = path.read_bytes()
    if hashlib.sha256(content).hexdigest() != sha256:
        raise ValueError(f"{path} is damaged or from another build")
    if hasattr(os, "memfd_create"):
        with suppress(OSError):
            # The descriptor stays open: the loader would take another library at the same path for this one.
            descriptor = os.memfd_create(path.name)
            with open(descriptor, "wb", closefd=False) as file:
                file.write(content)
            return ctypes.CDLL(f"/proc/self/fd/{descriptor}")
    return ctypes.CDLL(str(path))


def _runs(level: str, code: ctypes.CDLL) -> bool:
    """Return whether this CPU supports a library's level, such as x86-64-v3; always True for other names.

    code : the library, which has a function that tests the CPU
    """
    if not level.startswith("x86-64-v"):
        return True
    return int(code.pr_level()) >= int(level.removeprefix("x86-64-v"))
