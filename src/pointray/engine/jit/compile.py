"""Compilation of kernels and device functions with Numba."""

from __future__ import annotations

import importlib
import threading
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numba
from numba.core import event, types
from numba.core.codegen import JITCodeLibrary
from numba.core.registry import cpu_target

from .backlog import BACKLOG, COUNTS
from .decorators import KERNELS, Later, Piece, Table
from .disk_cache import KernelCache, cache_folder
from .library import CHECK

njit: Any = numba.njit

# `nnan` and `ninf` are left out as a miss is inf; `reassoc`, as positions are summed as (near part) + small part.
FASTMATH = {"nsz", "arcp", "contract", "afn"}

_COMPILING = threading.RLock()
_OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "fastmath": FASTMATH, "boundscheck": CHECK}


def dispatcher_of_kernel(function: Callable[..., Any]) -> Any:
    """Return the Numba dispatcher of a kernel's Python function; what it compiles is cached on disk, if possible."""
    _with_tables(function)
    dispatcher = njit(**_OPTIONS)(function)
    if cache_folder() is not None:
        dispatcher._cache = KernelCache(function)
        dispatcher.compile = partial(_compile_alone, dispatcher)
    return dispatcher


def _with_tables(function: Callable[..., Any]) -> None:
    """Replace `Table` objects (constants computed on demand) among a function's globals by arrays, as Numba needs."""
    names = function.__globals__
    names.update({name: value.real for name, value in names.items() if isinstance(value, Table)})


def type_of(value: Any) -> Any:
    """Return the Numba type of an object that kernels refer to as a global, such as a device function."""
    return cpu_target.typing_context.resolve_value_type(value)


def _compile_alone(dispatcher: Any, signature: Any) -> Any:
    """Load a kernel from disk, or compile it; return what Numba's `Dispatcher.compile` returns, the function to call.

    If several threads or processes need the kernel, one compiles it and the others wait.

    signature : Numba types of the arguments
    """
    compile_or_load = type(dispatcher).compile
    with _COMPILING:
        if is_compiled(dispatcher):
            return compile_or_load(dispatcher, signature)
        name = name_of(dispatcher)
        BACKLOG.begin(name)
        try:
            with dispatcher._cache.exclusive():
                return compile_or_load(dispatcher, signature)
        finally:
            BACKLOG.drop([name])  # for a kernel that another process has compiled


class _PieceLibrary(JITCodeLibrary):
    """LLVM code of a device function, linked into kernels as it is: only the kernel as a whole is optimized."""

    def finalize(self) -> None:
        for library in dict.fromkeys(self._linking_libraries):
            self._reload_init.update(library._reload_init)
            self._final_module.link_in(library._get_module_for_linking(), preserve=True)
        self._finalized = True


def dispatcher_of_piece(piece: Piece) -> Any:
    """Return the Numba dispatcher of a device function, without wrappers for Python and C and without machine code.

    A kernel takes three times as long to compile if each device function is optimized and compiled to machine code by
    itself, and twice as long if calls with a constant argument are specialized (docs/decisions/jit-and-cache.md).
    """
    function, is_inline = piece.py_func, piece.is_inline
    # All options are given explicitly: a device function inherits omitted ones from its caller.
    options = {"forceinline": is_inline, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
    _with_tables(function)
    dispatcher = njit(**_OPTIONS, **options)(function)
    template = dispatcher.get_call_template

    def customize(flags: Any) -> Any:
        flags.no_compile = True
        return flags

    def add(result: Any) -> None:
        library = result.library
        library.__class__ = _PieceLibrary
        if not is_inline:
            library._final_module.get_function(result.fndesc.llvm_func_name).add_function_attribute("noinline")
        # Callers look up device functions by address. There is none, so the Python function serves as the key.
        result = result._replace(entry_point=function)
        result.target_context.insert_user_function(function, result.fndesc, [library])
        dispatcher.overloads[tuple(result.signature.args)] = result

    def without_constants(args: Any, kws: Any) -> Any:
        records = [getattr(a, "instance_class", None) for a in args]
        special = next((piece.versions[record] for record in records if record in piece.versions), None)
        if special is not None:
            found = special.dispatcher.get_call_template(args, kws)
            dispatcher.overloads.update(special.dispatcher.overloads)
            return found
        return template([types.unliteral(a) for a in args], {k: types.unliteral(a) for k, a in kws.items()})

    dispatcher._compiler._customize_flags = customize
    dispatcher.add_overload = add
    dispatcher.get_call_template = without_constants
    return dispatcher


def is_compiled(dispatcher: Any) -> bool:
    """Return whether a kernel is compiled, in this process or on disk."""
    return bool(dispatcher.overloads) or (cache_folder() is not None and dispatcher._cache.is_fresh)


class _Listener(event.Listener):
    """Listener to Numba's events that counts and times the compilations of kernels."""

    def __init__(self) -> None:
        self._since: dict[Any, tuple[float, float]] = {}

    def on_start(self, event: Any) -> None:
        kernel = event.data["dispatcher"]
        name = name_of(kernel)
        if not name:
            return
        for module in Later.known:  # intrinsics must be registered before compilation starts
            importlib.import_module(module)
        COUNTS.kernels += 1
        self._since[kernel] = time.perf_counter(), time.thread_time()
        BACKLOG.begin(name)

    def on_end(self, event: Any) -> None:
        kernel = event.data["dispatcher"]
        start, name = self._since.pop(kernel, None), name_of(kernel)
        if start is not None and name:
            COUNTS.seconds += time.perf_counter() - start[0]
            COUNTS.times[name] = time.thread_time() - start[1]
            BACKLOG.end(name)


def name_of(dispatcher: Any) -> str:
    """Return the full name of a dispatcher's kernel, its key in `KERNELS`, or an empty string for a device function."""
    name = f"{dispatcher.py_func.__module__}.{dispatcher.py_func.__qualname__}"
    return name if name in KERNELS and KERNELS[name].made is dispatcher else ""


event.register("numba:compile", _Listener())
