"""A Python function -> a compiled kernel, cached on disk and run on all cores.

This folder and `simd` are the only ones that import Numba, when something is compiled. A *kernel* is called from Python
and is cached on disk; an *inline* and a *routine* are pieces of a kernel and are compiled into it.

decorators : what kernels and their pieces are; compile : Numba compiles them; disk_cache : Numba's cache
threads : `run`, `next_tile` and `Cancel`; a tile is here any part of the work
arrays, numbers : what kernels compute with; intrinsics : the arrays' part that needs Numba
second_process, backlog : kernels compiled in a second process; how long it will take

Begin with decorators, then threads.
"""

from __future__ import annotations

from .arrays import array_at, borrow, keep_alive
from .backlog import BACKLOG, Compiling, compilations, compile_seconds, compile_times
from .decorators import KERNELS, Kernel, Table, inline, kernel, later, routine, uncompiled
from .library import CHECK
from .numbers import Array, f32, f64, i32, i64, u64
from .second_process import compile_beside, wait_for
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
    "compile_beside",
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
    "wait_for",
]
