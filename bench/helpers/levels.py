"""Processor levels for benches: kernels compiled for an older processor than this one."""

from __future__ import annotations

import argparse
import os
import sys

from native.targets import LEVELS

NAMES = {"v2": "x86-64-v2", "v3": "x86-64-v3", "v4": "x86-64-v4"}
EMBREE = {"v2": "isa=sse4.2", "v3": "isa=avx2", "v4": "isa=avx512"}  # the same instructions in Embree


def add_level(parser: argparse.ArgumentParser) -> None:
    """Add the option --level to the arguments of a bench."""
    parser.add_argument("--level", choices=NAMES, help="instructions used: v2 (SSE4.2), v3 (AVX2) or v4 (AVX-512)")


def restart_at(level: str | None, module: str) -> None:
    """Start the bench anew with kernels compiled for a processor level, unless this process already has them.

    Numba reads the level when it is imported, so that a running process cannot change it.

    level : of `NAMES`; None for this processor's own
    module : name of the bench, such as bench.tracing.embree
    """
    if level is None:
        return
    target = LEVELS[NAMES[level]]
    wanted = {"NUMBA_CPU_NAME": target.name, "NUMBA_CPU_FEATURES": target.features, "POINTRAY_KERNELS": "jit"}
    if all(os.environ.get(name) == value for name, value in wanted.items()):
        return
    os.execve(sys.executable, [sys.executable, "-m", module, *sys.argv[1:]], {**os.environ, **wanted})
