"""The engine room: how kernels are compiled, cached on disk and run on all cores.

This module and `simd` are the only ones that import Numba. A *kernel* is called from Python and is cached on disk;
an *inline* is a piece of a kernel and is compiled into it.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import llvmlite.binding
import llvmlite.ir
import numba
import numpy as np
import platformdirs
from numba.core import cgutils, event, types
from numba.core.caching import CompileResultCacheImpl, FunctionCache
from numba.core.codegen import JITCodeLibrary
from numba.extending import intrinsic as _intrinsic

intrinsic: Any = _intrinsic  # its type describes the definition, not the call in a kernel
njit: Any = numba.njit

# Check every array access and every SIMD load (slow): the suite runs once with it. Part of the cache key.
CHECK = os.environ.get("POINTRAY_CHECK", "") not in ("", "0")

# No `nnan` and `ninf`: a miss is inf. No `reassoc`: positions are summed as (near part) + small part on purpose.
FASTMATH = {"nsz", "arcp", "contract", "afn"}

NO_KERNELS = ("cli", "report.py", "demonstration.py", "benchmark")  # an edit there compiles nothing anew
KEEP_CACHES = 4  # folders of other versions that are kept; older ones go

_OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "fastmath": FASTMATH, "boundscheck": CHECK}


# --------------------------------------------------------------------------------------------------- the disk cache


def cpu_name() -> str:
    """The processor that kernels are compiled for: this one, or Numba's NUMBA_CPU_NAME."""
    return os.environ.get("NUMBA_CPU_NAME") or str(llvmlite.binding.get_host_cpu_name())


def cpu_features() -> str:
    """What that processor can do beyond its name, as Numba takes it: NUMBA_CPU_FEATURES may be empty."""
    features = os.environ.get("NUMBA_CPU_FEATURES")
    if features is None and cpu_name() == "generic":
        return ""
    return str(llvmlite.binding.get_host_cpu_features().flatten()) if features is None else features


@cache
def source_key() -> str:
    """Name of the cache folder: a hash of everything that compiled code depends on.

    Numba looks at the file of the function only, so that an edit of `vec.py` would leave stale kernels behind.
    """
    digest = hashlib.sha256()
    root = Path(__file__).parent
    for path in sorted(root.rglob("*.py")):
        if path.relative_to(root).parts[0] in NO_KERNELS:
            continue
        digest.update(str(path.relative_to(root)).encode())
        digest.update(path.read_bytes())
    facts = (numba.__version__, llvmlite.__version__, np.__version__, sys.version_info[:2], CHECK)
    digest.update(repr((facts, cpu_name(), cpu_features())).encode())
    return digest.hexdigest()[:16]


@cache
def cache_folder() -> Path | None:
    """Folder of the compiled kernels (`POINTRAY_CACHE`, else the user's cache); None where nothing can be written."""
    base = Path(os.environ.get("POINTRAY_CACHE") or platformdirs.user_cache_dir("pointray", appauthor=False))
    folder = base / f"kernels-{source_key()}"
    try:
        fresh = not folder.exists()
        folder.mkdir(parents=True, exist_ok=True)
        probe = folder / f".probe-{os.getpid()}-{threading.get_ident()}"
        probe.touch()
        probe.unlink()
        if fresh:
            others = sorted(base.glob("kernels-*"), key=lambda p: p.stat().st_mtime)
            for old in others[: -KEEP_CACHES - 1]:
                shutil.rmtree(old, ignore_errors=True)
    except OSError:
        return None
    return folder


class _Locator:
    """Tells Numba where one kernel's compiled code lies: all of them in `cache_folder()`."""

    def __init__(self, py_func: Callable[..., Any], py_file: str) -> None:
        self._line = py_func.__code__.co_firstlineno
        # A kernel of a benchmark or a test lies outside of the package: its own file counts too.
        own = Path(py_file)
        self._stamp = source_key() + (hashlib.sha256(own.read_bytes()).hexdigest()[:16] if own.exists() else "")

    @classmethod
    def from_function(cls, py_func: Callable[..., Any], py_file: str) -> _Locator:
        return cls(py_func, py_file)

    def get_cache_path(self) -> str:
        return str(cache_folder())

    def ensure_cache_path(self) -> None:
        pass

    def get_source_stamp(self) -> str:
        return self._stamp

    def get_disambiguator(self) -> str:
        return str(self._line)


class _CacheImpl(CompileResultCacheImpl):
    _locator_classes = [_Locator]


class _Cache(FunctionCache):
    """Numba's cache in our folder; a cache that cannot be read or written is no error."""

    _impl_class = _CacheImpl

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        try:
            return super().load_overload(sig, target_context)  # type: ignore[no-untyped-call]
        except Exception:  # a damaged or half-written file: compile again
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        with suppress(OSError):
            try:
                super().save_overload(sig, data)  # type: ignore[no-untyped-call]
            except OSError:
                raise
            except Exception:  # a damaged index: begin a new one
                self.flush()  # type: ignore[no-untyped-call]
                super().save_overload(sig, data)  # type: ignore[no-untyped-call]


KERNELS: dict[str, Any] = {}


def kernel(function: Callable[..., Any]) -> Any:
    """Compile a function that Python calls: without the interpreter lock, cached on disk, one signature."""
    dispatcher = njit(**_OPTIONS)(function)
    if cache_folder() is not None:
        dispatcher._cache = _Cache(function)
    KERNELS[f"{function.__module__}.{function.__qualname__}"] = dispatcher
    return dispatcher


def inline(function: Callable[..., Any]) -> Any:
    """Compile a piece of a kernel; LLVM inlines it where it is called."""
    return _piece(function, inlined=True)


def routine(function: Callable[..., Any]) -> Any:
    """Compile a piece of a kernel that is too large, or called from too many places, to be inlined."""
    return _piece(function, inlined=False)


class _PieceLibrary(JITCodeLibrary):
    """The code of a piece, which kernels take over as it is: optimized there, and nowhere else."""

    def finalize(self) -> None:
        for library in dict.fromkeys(self._linking_libraries):
            self._reload_init.update(library._reload_init)
            self._final_module.link_in(library._get_module_for_linking(), preserve=True)
        self._finalized = True


def _piece(function: Callable[..., Any], inlined: bool) -> Any:
    """Compile for other compiled code only: no wrappers for Python and C, no machine code of its own.

    The render kernel has 80 pieces: it takes 12 s to compile, and 48 s if each piece is optimized and becomes machine
    code by itself, twice over where an argument is once a constant and once not.
    """
    # Said in so many words: a piece inherits what is not said from the one that calls it.
    options = {"forceinline": inlined, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
    dispatcher = njit(**_OPTIONS, **options)(function)
    template = dispatcher.get_call_template

    def customize(flags: Any) -> Any:
        flags.no_compile = True
        return flags

    def add(result: Any) -> None:
        library = result.library
        library.__class__ = _PieceLibrary
        if not inlined:
            library._final_module.get_function(result.fndesc.llvm_func_name).add_function_attribute("noinline")
        # Callers look a piece up by its address: it has none, its Python function stands in.
        result = result._replace(entry_point=function)
        result.target_context.insert_user_function(function, result.fndesc, [library])
        dispatcher.overloads[tuple(result.signature.args)] = result

    def without_constants(args: Any, kws: Any) -> Any:
        return template([types.unliteral(a) for a in args], {k: types.unliteral(a) for k, a in kws.items()})

    dispatcher._compiler._customize_flags = customize
    dispatcher.add_overload = add
    dispatcher.get_call_template = without_constants
    return dispatcher


def compilations() -> int:
    """Number of kernels that this process has compiled, not loaded from the cache."""
    return sum(sum(k.stats.cache_misses.values()) for k in KERNELS.values()) if cache_folder() else _Listener.count


def compile_seconds() -> float:
    """How long this process has compiled kernels."""
    return _Listener.seconds


class _Listener(event.Listener):  # type: ignore[misc]
    """Counts and times compilations, and says once that the first one takes a moment."""

    count = 0
    seconds = 0.0
    notice: Callable[[], None] | None = None
    since: dict[Any, float] = {}  # noqa: RUF012

    def on_start(self, event: Any) -> None:
        kernel = event.data["dispatcher"]
        if kernel not in KERNELS.values():
            return
        _Listener.count += 1
        _Listener.since[kernel] = time.perf_counter()
        if _Listener.notice is not None:
            notice, _Listener.notice = _Listener.notice, None
            notice()

    def on_end(self, event: Any) -> None:
        start = _Listener.since.pop(event.data["dispatcher"], None)
        if start is not None:
            _Listener.seconds += time.perf_counter() - start


event.register("numba:compile", _Listener())


def on_first_compilation(notice: Callable[[], None] | None) -> None:
    """Call `notice` when the next kernel has to be compiled."""
    _Listener.notice = notice


# --------------------------------------------------------------------------------------------------- all cores

# What a kernel and its caller share: int64 slots, a cache line apart.
NEXT, TOTAL, CANCEL, SLOTS = 0, 8, 16, 24


@intrinsic
def _fetch_add(typingctx, array, index, value):  # type: ignore[no-untyped-def]
    """array[index] += value as one atomic step; returns the value before."""
    if not (isinstance(array, types.Array) and array.dtype == types.int64):
        return None

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        data = context.make_array(signature.args[0])(context, builder, args[0]).data
        pointer = builder.gep(data, [args[1]])
        return builder.atomic_rmw("add", pointer, args[2], "monotonic")

    return types.int64(array, types.int64, types.int64), codegen


@intrinsic
def _peek(typingctx, array, index):  # type: ignore[no-untyped-def]
    """array[index], read afresh from memory."""

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        data = context.make_array(signature.args[0])(context, builder, args[0]).data
        pointer = builder.gep(data, [args[1]])
        return builder.load_atomic(pointer, "monotonic", 8, typ=llvmlite.ir.IntType(64))

    return types.int64(array, types.int64), codegen


@intrinsic
def array_at(typingctx, address, length, like):  # type: ignore[no-untyped-def]
    """The one-dimensional array of `length` items of the type of `like` that lies at an address; owns nothing."""
    array = types.Array(like, 1, "C")

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        item = context.get_abi_sizeof(context.get_data_type(array.dtype))
        size = context.get_constant(types.intp, item)
        out = context.make_array(array)(context, builder)
        pointer = builder.inttoptr(args[0], out.data.type)
        context.populate_array(
            out,
            data=pointer,
            shape=cgutils.pack_array(builder, [args[1]]),
            strides=cgutils.pack_array(builder, [size]),
            itemsize=size,
            meminfo=None,
        )
        return out._getvalue()

    return array(types.int64, types.int64, like), codegen


@intrinsic
def borrow(typingctx, array):  # type: ignore[no-untyped-def]
    """The same array without a reference to its memory, which its owner must keep alive.

    Numba counts references with atomic additions at every use of an array that owns its memory; two threads that share
    one then wait for each other. Rays that meet nothing took 160 ns before and 35 ns without.
    """

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        out = context.make_array(signature.return_type)(context, builder, args[0])
        out.meminfo = cgutils.get_null_value(out.meminfo.type)
        out.parent = cgutils.get_null_value(out.parent.type)
        return out._getvalue()

    return array(array), codegen


@intrinsic
def keep(typingctx, value):  # type: ignore[no-untyped-def]
    """Keeps arrays alive up to here: the last line of a kernel that lends out arrays it made."""

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        return context.get_dummy_value()

    return types.none(value), codegen


@inline
def take(work):  # type: ignore[no-untyped-def]
    """The number of the next tile, or -1: none left, or cancelled."""
    if _peek(work, CANCEL) != 0:
        return -1
    tile = _fetch_add(work, NEXT, 1)
    return tile if tile < work[TOTAL] else -1


@inline
def cancelled(work):  # type: ignore[no-untyped-def]
    """Whether the caller wants the kernel to stop."""
    return _peek(work, CANCEL) != 0


def thread_count(threads: int | None = None) -> int:
    """Threads to use: the argument, else `POINTRAY_THREADS`, else all processors this process may use."""
    if threads is None:
        text = os.environ.get("POINTRAY_THREADS", "")
        if not text:
            return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
        try:
            threads = int(text)
        except ValueError:
            raise ValueError(f"POINTRAY_THREADS must be a whole number, not {text!r}") from None
    if threads < 1:
        raise ValueError(f"threads must be at least 1, not {threads}")
    return threads


def run(
    kernel: Callable[..., Any],
    tiles: int,
    *args: Any,
    threads: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> list[Any]:
    """Run `kernel(work, *args)` in worker threads that `take(work)` tiles until none is left.

    The caller only waits, so that Ctrl-C gets through: it cancels the kernels between two tiles.
    `progress` is called with the share done, some ten times a second. Returns what each worker returned.
    """
    work = np.zeros(SLOTS, np.int64)
    work[TOTAL] = tiles
    results: list[Any] = []
    errors: list[BaseException] = []
    done = threading.Semaphore(0)

    def worker() -> None:
        try:
            results.append(kernel(work, *args))
        except BaseException as error:
            errors.append(error)
            work[CANCEL] = 1
        finally:
            done.release()

    workers = [threading.Thread(target=worker, daemon=True) for _ in range(min(thread_count(threads), max(tiles, 1)))]
    for thread in workers:
        thread.start()
    try:
        for _ in workers:
            # Not Thread.join: an interrupt in it marks the thread as ended, and nobody waits for it any more.
            while not done.acquire(timeout=0.1):
                if progress is not None:
                    progress(min(work[NEXT] / max(tiles, 1), 1.0))
    except BaseException:
        # A worker may be inside the compiler, which nothing interrupts: wait a little and leave it behind.
        work[CANCEL] = 1
        end = time.monotonic() + 0.3
        for _ in workers:
            done.acquire(timeout=max(0.0, end - time.monotonic()))
        raise
    if errors:
        raise errors[0]
    return results
