"""A Python function -> a compiled kernel, cached on disk and run on all cores.

This folder and `simd` are the only ones that import Numba. A *kernel* is called from Python and is cached on disk;
an *inline* and a *routine* are pieces of a kernel and are compiled into it.

compile : the decorators; disk : the cache
threads : `run`, `next_tile` and `Cancel`; a tile is here any part of the work
arrays, numbers : what kernels compute with
beside, backlog : kernels compiled in a second process; how long it will take

Begin with compile, then threads.
"""

from __future__ import annotations

from .arrays import array_at, borrow, intrinsic, keep_alive
from .backlog import Compiling
from .beside import compile_beside, wait_for
from .compile import (
    BACKLOG,
    KERNELS,
    compilations,
    compile_seconds,
    compile_times,
    inline,
    is_compiled,
    kernel,
    name_of,
    routine,
    uncompiled,
)
from .disk import CHECK, cache_folder, cpu_features, cpu_name
from .numbers import Array, f32, f64, i32, i64, u64
from .threads import Cancel, cancelled, next_tile, run, thread_count

__all__ = [
    "Array",
    "f32",
    "f64",
    "i32",
    "i64",
    "u64",
    "BACKLOG",
    "CHECK",
    "Cancel",
    "Compiling",
    "KERNELS",
    "array_at",
    "borrow",
    "cache_folder",
    "cancelled",
    "compilations",
    "compile_beside",
    "compile_seconds",
    "compile_times",
    "cpu_features",
    "cpu_name",
    "inline",
    "intrinsic",
    "keep_alive",
    "is_compiled",
    "kernel",
    "name_of",
    "routine",
    "run",
    "next_tile",
    "thread_count",
    "uncompiled",
    "wait_for",
]
