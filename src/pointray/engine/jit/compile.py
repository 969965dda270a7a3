"""How Numba compiles kernels and their pieces."""

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
from .decorators import KERNELS, Later, Table
from .disk_cache import KernelCache, cache_folder
from .library import CHECK

njit: Any = numba.njit

# No `nnan` and `ninf`: a miss is inf. No `reassoc`: positions are summed as (near part) + small part on purpose.
FASTMATH = {"nsz", "arcp", "contract", "afn"}

_COMPILING = threading.RLock()
_OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "fastmath": FASTMATH, "boundscheck": CHECK}


def dispatcher_of_kernel(function: Callable[..., Any]) -> Any:
    """Numba's function of a kernel, which is cached on disk."""
    _with_tables(function)
    dispatcher = njit(**_OPTIONS)(function)
    if cache_folder() is not None:
        dispatcher._cache = KernelCache(function)
        dispatcher.compile = partial(_compile_alone, dispatcher)
    return dispatcher


def _with_tables(function: Callable[..., Any]) -> None:
    """Replace `Table` objects among a function's global names by their arrays, which Numba needs there."""
    names = function.__globals__
    names.update({name: value.real for name, value in names.items() if isinstance(value, Table)})


def type_of(value: Any) -> Any:
    """Numba's type of a function that kernels call."""
    return cpu_target.typing_context.resolve_value_type(value)


def _compile_alone(dispatcher: Any, signature: Any) -> Any:
    """Load or compile a kernel; of several threads and processes that need it one compiles, and the others wait."""
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
            BACKLOG.drop([name])  # where another process has compiled it


class _PieceLibrary(JITCodeLibrary):
    """The code of a piece, linked into kernels as it is: it is optimized there and nowhere else."""

    def finalize(self) -> None:
        for library in dict.fromkeys(self._linking_libraries):
            self._reload_init.update(library._reload_init)
            self._final_module.link_in(library._get_module_for_linking(), preserve=True)
        self._finalized = True


def dispatcher_of_piece(function: Callable[..., Any], is_inline: bool) -> Any:
    """Compile for other compiled code only: no wrappers for Python and C, no machine code of its own.

    A kernel takes three times as long to compile if each piece is optimized and becomes machine code by itself, and
    twice where an argument is a constant in one call and not in another (docs/decisions/jit-and-cache.md).
    """
    # The options are all given explicitly: a piece inherits an omitted one from its caller.
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
        # Callers look a piece up by its address. It has none, so its Python function serves as the key.
        result = result._replace(entry_point=function)
        result.target_context.insert_user_function(function, result.fndesc, [library])
        dispatcher.overloads[tuple(result.signature.args)] = result

    def without_constants(args: Any, kws: Any) -> Any:
        return template([types.unliteral(a) for a in args], {k: types.unliteral(a) for k, a in kws.items()})

    dispatcher._compiler._customize_flags = customize
    dispatcher.add_overload = add
    dispatcher.get_call_template = without_constants
    return dispatcher


def is_compiled(dispatcher: Any) -> bool:
    """Whether a kernel is compiled, in this process or on disk."""
    return bool(dispatcher.overloads) or (cache_folder() is not None and dispatcher._cache.is_fresh)


class _Listener(event.Listener):
    """Counts and times compilations."""

    def __init__(self) -> None:
        self._since: dict[Any, tuple[float, float]] = {}

    def on_start(self, event: Any) -> None:
        kernel = event.data["dispatcher"]
        name = name_of(kernel)
        if not name:
            return
        for module in Later.known:  # Numba learns of intrinsics before it compiles, not within
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
    """A kernel's name in `KERNELS`; empty for a piece of a kernel."""
    name = f"{dispatcher.py_func.__module__}.{dispatcher.py_func.__qualname__}"
    return name if name in KERNELS and KERNELS[name].made is dispatcher else ""


event.register("numba:compile", _Listener())
