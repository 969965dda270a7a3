"""Compilation of Python functions to kernels, which are cached on disk and run on all cores.

Only this folder and `simd` import Numba, and only when something is compiled. A *kernel* is called from Python and
cached on disk. An *inline* or a *routine* is a device function: it is called from kernels and compiled into them.

decorators : kernels and device functions; compile : compilation by Numba; disk_cache : Numba's cache
library, boundary : kernels compiled ahead of time, and calls of them
threads : `run`, `next_tile` and `Cancel`; a tile is here any unit of work; c_threads : start of threads in C
arrays, numbers : types and array functions for kernels; intrinsics : those array functions, which need Numba
second_process, backlog : compilation in a second process; remaining compile time

Begin with decorators, then threads.
"""

from __future__ import annotations

from .arrays import array_at, borrow, keep_alive
from .backlog import BACKLOG, Compiling, compilations, compile_seconds, compile_times
from .decorators import KERNELS, Kernel, Table, inline, kernel, later, routine, uncompiled, version_for
from .library import CHECK
from .numbers import Array, f32, f64, i32, i64, u64
from .second_process import compile_in_background, wait_for
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
    "Kernel",
    "Table",
    "array_at",
    "borrow",
    "cancelled",
    "compilations",
    "compile_in_background",
    "compile_seconds",
    "compile_times",
    "inline",
    "keep_alive",
    "kernel",
    "later",
    "routine",
    "run",
    "next_tile",
    "thread_count",
    "uncompiled",
    "version_for",
    "wait_for",
]
