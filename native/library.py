"""The folder with a system's libraries and their manifest, as read by `pointray.engine.jit.library`."""

from __future__ import annotations

import hashlib
import json
import os
from pathlib import Path
from typing import Any

from filelock import FileLock

from pointray.base.dependencies import ROOT, digest_of, files_of
from pointray.engine.jit.library import FORMAT, MANIFEST, symbol

from . import signatures
from .link import link, linking_key
from .objects import Object, Order, Progress, build, file_of, own_key
from .targets import SYSTEMS


def make(order: Order, folder: Path, command: list[str], progress: Progress) -> None:
    """Make the libraries of a system, and the manifest; keep up-to-date ones.

    If several processes do this at once, one works and the others wait.

    command : the C compiler
    progress : called with the number of finished kernels, of all, and the last one
    """
    folder.mkdir(parents=True, exist_ok=True)
    order.folder.mkdir(parents=True, exist_ok=True)
    with FileLock(order.folder / "lock"):
        built = {level: build(order, level, progress) for level in order.levels}
        libraries = {
            level: _library(order.system, level, built[level], folder, command)
            for level in sorted(order.levels, reverse=True)  # the best first
        }
        _write(folder / MANIFEST, {"format": FORMAT, "libraries": libraries, **_described(built[order.levels[0]])})
        kept = {MANIFEST, *(library["file"] for library in libraries.values())}
        for path in folder.iterdir():
            if path.name not in kept:
                path.unlink()


def _library(system: str, level: str, objects: list[Object], folder: Path, command: list[str]) -> dict[str, str]:
    """Link a library unless it exists; return its entry in the manifest."""
    facts = "\n".join([linking_key(), *command[1:], *(one.path.name for one in objects)])
    path = folder / f"{level}-{hashlib.sha256(facts.encode()).hexdigest()[:16]}{SYSTEMS[system].ending}"
    if not path.exists():
        link(command, system, {symbol(one.kernel): one.path for one in objects}, path)
    return {"file": path.name, "sha256": hashlib.sha256(path.read_bytes()).hexdigest()}


def _described(objects: list[Object]) -> dict[str, Any]:
    """Return the manifest's entries: key, arguments and result of each kernel, and keys of sources and builder."""
    recorded = signatures.recorded()
    kernels = {
        one.kernel: {"key": one.key, "arguments": recorded["kernels"][one.kernel], "returns": one.returns}
        for one in objects
    }
    files = files_of([file_of(one.kernel) for one in objects])
    sources = {path.relative_to(ROOT).as_posix(): digest_of(path) for path in files}
    return {"records": recorded["records"], "kernels": kernels, "sources": sources, "builder": builder_key()}


def builder_key() -> str:
    """Return a hash of the files that compile and link."""
    return hashlib.sha256((own_key() + linking_key()).encode()).hexdigest()[:16]


def _write(path: Path, manifest: dict[str, Any]) -> None:
    unfinished = path.with_suffix(f".{os.getpid()}")
    unfinished.write_text(json.dumps(manifest, indent=1) + "\n")
    unfinished.replace(path)
