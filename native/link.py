"""Linking of objects to one shared library, by the system's C compiler, or by Zig for any system."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from .targets import SYSTEMS

HERE = Path(__file__).parent
OF_RUNTIME = "pr_level", "pr_release"


def compiler() -> list[str] | None:
    """Return the C compiler of this system; None if there is none."""
    found = next((path for name in ("cc", "gcc", "clang") if (path := shutil.which(name))), None)
    return [found] if found else None


def zig(system: str) -> list[str]:
    """Return Zig's C compiler for a system."""
    return [sys.executable, "-m", "ziglang", "cc", "-target", SYSTEMS[system].zig]


def linking_key() -> str:
    """Return a hash of the inputs of each library other than the kernels."""
    digest = hashlib.sha256()
    for name in ("link.py", "runtime.c", "exports.map"):
        digest.update((HERE / name).read_bytes())
    return digest.hexdigest()


def link(command: list[str], system: str, objects: dict[str, Path], library: Path) -> None:
    """Link objects, given by their functions, and the runtime; the library is replaced atomically."""
    options = ["-O2", "-std=gnu11", "-fPIC", f"-ffile-prefix-map={HERE}=native"]
    with tempfile.TemporaryDirectory(dir=library.parent) as folder:
        runtime, made = Path(folder, "runtime.o"), Path(folder, library.name)
        _run([*command, *options, "-c", str(HERE / "runtime.c"), "-o", str(runtime)])
        listing = Path(folder, "objects")  # all names together exceed the length of a command on Windows
        listing.write_text("\n".join(f'"{path.as_posix()}"' for path in [*objects.values(), runtime]))
        exported = _exports(system, [*objects, *OF_RUNTIME], Path(folder))
        _run([*command, "-shared", "-s", *exported, "-o", str(made), f"@{listing}", "-lm"])
        os.replace(made, library)


def _exports(system: str, functions: list[str], folder: Path) -> list[str]:
    """Return linker options that export only these functions. folder : for files that the linker reads"""
    if system.startswith("linux"):
        return [
            f"-Wl,--version-script={HERE / 'exports.map'}",
            "-Wl,-z,now",
            "-Wl,--no-undefined",
            "-Wl,--build-id=none",
        ]
    if system.startswith("windows"):
        listing = folder / "exports.def"
        listing.write_text("\n ".join(["EXPORTS", *functions]))
        return [str(listing)]
    return []  # Zig's linker for macOS exports all symbols that are not hidden; the objects hide the others


def _run(command: list[str]) -> None:
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f"{' '.join(command[:6])} ...: {done.stderr[-2000:]}")
