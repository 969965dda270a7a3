"""Compilation of kernels to object files on all cores. An object is kept until its dependencies change.

Each core runs a process that takes the next kernel; those that take longest come first.
"""

from __future__ import annotations

import gc
import hashlib
import json
import os
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

from pointray.base.dependencies import files_of, key_of
from pointray.engine.jit import KERNELS

from . import signatures
from .targets import LEVELS, SYSTEMS

Progress = Callable[[int, int, str], None]


class Object(NamedTuple):
    """A compiled kernel.

    path : the object file, beside which `returns` is stored
    key : hash of the sources, from `dependencies.key_of`
    returns : the type of the result, as text
    """

    kernel: str
    path: Path
    key: str
    returns: Any


@dataclass(frozen=True)
class Order:
    """The kernels and targets to compile.

    system, levels : the target, see `targets`
    folder : folder of the objects
    jobs : processes, by default as many as cores
    only : the kernels, by default all
    """

    system: str
    levels: tuple[str, ...]
    folder: Path
    jobs: int | None = None
    only: tuple[str, ...] = ()


def build(order: Order, level: str, progress: Progress) -> list[Object]:
    """Compile kernels for a processor level, unless they are in the folder."""
    folder = order.folder / order.system / level
    folder.mkdir(parents=True, exist_ok=True)
    wanted = [_planned(kernel, order.system, level, folder) for kernel in sorted(order.only) or signatures.known()]
    missing = [one for one in wanted if not one.path.with_suffix(".json").exists()]
    missing.sort(key=lambda one: -len(files_of([file_of(one.kernel)])))
    done = len(wanted) - len(missing)
    if missing:
        with ProcessPoolExecutor(
            order.jobs or os.cpu_count(), get_context("spawn"), _begin, (order.system, level)
        ) as pool:
            tasks = {pool.submit(_compile, one.kernel, one.path): one for one in missing}
            for task in as_completed(tasks):
                done += 1
                progress(done, len(wanted), tasks[task].kernel)
            failed = {one.kernel: error for task, one in tasks.items() if (error := task.exception()) is not None}
        if failed:
            raise RuntimeError("\n".join(f"{kernel}: {error}" for kernel, error in failed.items()))
    _sweep(folder, wanted)
    return [one._replace(returns=json.loads(one.path.with_suffix(".json").read_text())["returns"]) for one in wanted]


def file_of(kernel: str) -> Path:
    """Return the source file of a kernel."""
    return Path(KERNELS[kernel].py_func.__code__.co_filename)


def _planned(kernel: str, system: str, level: str, folder: Path) -> Object:
    """Return the object of a kernel with its path, which is named by all dependencies."""
    import llvmlite
    import numba

    key, recorded = key_of([file_of(kernel)]), signatures.recorded()
    facts = key, recorded["kernels"][kernel], recorded["records"], SYSTEMS[system], LEVELS[level]
    versions = numba.__version__, llvmlite.__version__, own_key()
    digest = hashlib.sha256(repr((facts, versions)).encode()).hexdigest()[:16]
    return Object(kernel, folder / f"{kernel.removeprefix('pointray.')}-{digest}.o", key, None)


def own_key() -> str:
    """Return a hash of the files that generate machine code."""
    digest = hashlib.sha256()
    for name in ("codegen.py", "entry.py", "emit.py"):
        digest.update(Path(__file__).with_name(name).read_bytes())
    return digest.hexdigest()


def _sweep(folder: Path, wanted: list[Object]) -> None:
    """Remove objects of earlier sources."""
    kept = {one.path.stem for one in wanted}
    for path in folder.iterdir():
        if path.stem not in kept and path.suffix in (".o", ".json"):
            path.unlink()


def _begin(system: str, level: str) -> None:
    """Set up a process that compiles."""
    from . import codegen

    gc.set_threshold(200_000, 20, 100)  # types and instructions stay until the end
    codegen.use(system, level)
    signatures.import_all()


def _compile(kernel: str, path: Path) -> None:
    """Compile a kernel into an object file."""
    from numba.core.compiler_lock import global_compiler_lock

    from .emit import compiled

    begun = time.thread_time()
    with global_compiler_lock:
        code, returns = compiled(kernel)
    unfinished = path.with_suffix(f".{os.getpid()}")
    unfinished.write_bytes(code)
    unfinished.replace(path)
    facts = {"returns": returns, "seconds": round(time.thread_time() - begun, 2)}
    path.with_suffix(".json").write_text(json.dumps(facts))  # last, because it marks the object as complete
