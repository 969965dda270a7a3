"""How kernels are compiled: the decorators, and counts of the kernels compiled so far."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any, TypeVar, cast

import numba
from numba.core import event, types
from numba.core.codegen import JITCodeLibrary

from .backlog import Backlog
from .disk import CHECK, KernelCache, cache_folder

njit: Any = numba.njit

# No `nnan` and `ninf`: a miss is inf. No `reassoc`: positions are summed as (near part) + small part on purpose.
FASTMATH = {"nsz", "arcp", "contract", "afn"}

_OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "fastmath": FASTMATH, "boundscheck": CHECK}

Function = TypeVar("Function", bound=Callable[..., Any])

KERNELS: dict[str, Any] = {}
BACKLOG = Backlog()


def kernel(function: Function) -> Function:
    """Compile a function that Python calls: without the interpreter lock, cached on disk, one signature."""
    dispatcher = njit(**_OPTIONS)(function)
    if cache_folder() is not None:
        dispatcher._cache = KernelCache(function)
        dispatcher.compile = partial(_compile_alone, dispatcher)
    KERNELS[f"{function.__module__}.{function.__qualname__}"] = dispatcher
    return cast(Function, dispatcher)


def _compile_alone(dispatcher: Any, signature: Any) -> Any:
    """Load or compile a kernel; of several processes that need it one compiles and the others wait, then load it."""
    compile_or_load = type(dispatcher).compile
    if is_compiled(dispatcher):
        return compile_or_load(dispatcher, signature)
    name = name_of(dispatcher)
    BACKLOG.begin(name)
    try:
        with dispatcher._cache.exclusive():
            return compile_or_load(dispatcher, signature)
    finally:
        BACKLOG.drop([name])  # where another process has compiled it


def inline(function: Function) -> Function:
    """Compile a piece of a kernel; LLVM inlines it where it is called."""
    return _piece(function, inlined=True)


def routine(function: Function) -> Function:
    """Compile a piece of a kernel that is too large, or called from too many places, to be inlined."""
    return _piece(function, inlined=False)


class _PieceLibrary(JITCodeLibrary):
    """The code of a piece, linked into kernels as it is: it is optimized there and nowhere else."""

    def finalize(self) -> None:
        for library in dict.fromkeys(self._linking_libraries):
            self._reload_init.update(library._reload_init)
            self._final_module.link_in(library._get_module_for_linking(), preserve=True)
        self._finalized = True


def _piece(function: Function, inlined: bool) -> Function:
    """Compile for other compiled code only: no wrappers for Python and C, no machine code of its own.

    A kernel takes three times as long to compile if each piece is optimized and becomes machine code by itself, and
    twice where an argument is a constant in one call and not in another (docs/decisions/jit-and-cache.md).
    """
    # The options are all given explicitly: a piece inherits an omitted one from its caller.
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
        # Callers look a piece up by its address. It has none, so its Python function serves as the key.
        result = result._replace(entry_point=function)
        result.target_context.insert_user_function(function, result.fndesc, [library])
        dispatcher.overloads[tuple(result.signature.args)] = result

    def without_constants(args: Any, kws: Any) -> Any:
        return template([types.unliteral(a) for a in args], {k: types.unliteral(a) for k, a in kws.items()})

    dispatcher._compiler._customize_flags = customize
    dispatcher.add_overload = add
    dispatcher.get_call_template = without_constants
    return cast(Function, dispatcher)


def uncompiled(function: Function) -> Function:
    """The Python function that a kernel or a piece was compiled from, for Python code that calls a short one."""
    return cast(Function, cast(Any, function).py_func)


def compilations() -> int:
    """Number of kernels that this process compiled, or had compiled by a second process; loaded ones do not count."""
    here = sum(sum(k.stats.cache_misses.values()) for k in KERNELS.values()) if cache_folder() else _Listener.count
    return here + _Listener.beside


def compile_seconds() -> float:
    """How long this process has compiled kernels, or waited for kernels compiled by a second process."""
    return _Listener.seconds


def compile_times() -> dict[str, float]:
    """Return the processor time that compiling each kernel took in this process, in seconds."""
    return dict(_Listener.times)


def count_beside(kernels: int, waited: float) -> None:
    """Count kernels that a second process compiled, and seconds of waiting for them."""
    _Listener.beside += kernels
    _Listener.seconds += waited


def is_compiled(dispatcher: Any) -> bool:
    """Whether a kernel is compiled, in this process or on disk."""
    return bool(dispatcher.overloads) or (cache_folder() is not None and dispatcher._cache.is_fresh)


class _Listener(event.Listener):
    """Counts and times compilations."""

    count, beside = 0, 0
    seconds = 0.0
    since: dict[Any, tuple[float, float]] = {}  # noqa: RUF012
    times: dict[str, float] = {}  # noqa: RUF012

    def on_start(self, event: Any) -> None:
        kernel = event.data["dispatcher"]
        name = name_of(kernel)
        if not name:
            return
        _Listener.count += 1
        _Listener.since[kernel] = time.perf_counter(), time.thread_time()
        BACKLOG.begin(name)

    def on_end(self, event: Any) -> None:
        kernel = event.data["dispatcher"]
        start, name = _Listener.since.pop(kernel, None), name_of(kernel)
        if start is not None and name:
            _Listener.seconds += time.perf_counter() - start[0]
            _Listener.times[name] = time.thread_time() - start[1]
            BACKLOG.end(name)


def name_of(dispatcher: Any) -> str:
    """A kernel's name in `KERNELS`; empty for a piece of a kernel."""
    return next((name for name, known in KERNELS.items() if known is dispatcher), "")


event.register("numba:compile", _Listener())
