"""Run Mitsuba in a child process, because its LLVM aborts on unknown CPUs (AMD Zen 5)."""

from __future__ import annotations

import multiprocessing
import signal
import sys
from collections.abc import Callable
from typing import Any

from pointray.engine.jit.disk_cache import cpu_name


def in_child(work: Callable[..., Any], *arguments: Any) -> str | None:
    """Run it in a process of its own; None if it ended well, else how it ended."""
    child = multiprocessing.get_context("spawn").Process(target=work, args=arguments)
    child.start()
    child.join()
    code = child.exitcode or 0
    return None if code == 0 else signal.Signals(-code).name if code < 0 else f"status {code}"


def llvm_works() -> bool:
    """Whether Mitsuba can compile with the installed LLVM, if any. Prints a message if that ends a process."""
    ended = in_child(try_llvm)
    if ended not in (None, "status 3"):
        print(describe_exit(ended), "Mitsuba's scalar variant instead", flush=True)
    return ended is None


def try_llvm() -> None:
    """Compile a little; the exit status is 3 without LLVM."""
    import drjit as dr

    if not dr.has_backend(dr.JitBackend.LLVM):
        sys.exit(3)
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    dr.eval(dr.sqrt(dr.arange(mi.Float, 64)) + 1.0)
    dr.sync_thread()


def describe_exit(ended: str | None) -> str:
    """A line about how a child ended: by a signal, or by an error that it printed."""
    why = f"its LLVM may not know this processor, {cpu_name()}" if "SIG" in str(ended) else "there may be no LLVM"
    return f"Mitsuba has ended its process ({ended}): {why};"
