"""Decorators of kernels and device functions. Numba is imported only when something is compiled."""

from __future__ import annotations

import functools
import importlib
import threading
from collections.abc import Callable, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np

from .library import choice, kernel_choice

LATER = ("compile",)
_LOCK = threading.RLock()
Function = TypeVar("Function", bound=Callable[..., Any])


def _compiler() -> Any:
    """Return the module that compiles, which imports Numba."""
    try:
        return importlib.import_module(f"{__package__}.compile")
    except ModuleNotFoundError as error:
        if error.name not in ("numba", "llvmlite"):
            raise
        why = choice()[1]
        raise ValueError(f"{why}, and Numba is not installed to compile them: pip install 'pointray[jit]'") from None


class Piece:
    """Device function: a function called only by compiled code.

    is_inline : whether LLVM inlines it at each call
    """

    def __init__(self, function: Callable[..., Any], is_inline: bool) -> None:
        functools.update_wrapper(cast(Any, self), function)
        self.py_func, self.is_inline = function, is_inline
        self.versions: dict[type, Piece] = {}  # by a record among the arguments

    def __reduce__(self) -> str:
        return self.py_func.__qualname__  # pickled by name, as functions are

    @cached_property
    def dispatcher(self) -> Any:
        """Numba dispatcher."""
        return _compiler().dispatcher_of_piece(self)

    @property
    def _numba_type_(self) -> Any:
        """Numba's type of a global that holds this device function."""
        return _compiler().type_of(self.dispatcher)


class Kernel(Piece):
    """Function called from Python, without the interpreter lock and with one signature."""

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function, is_inline=False)
        self.name = f"{function.__module__}.{function.__qualname__}"
        self.made: Any = None  # Numba dispatcher, created on demand

    def __call__(self, *args: Any) -> Any:
        return self._function(*args)

    @cached_property
    def in_library(self) -> Callable[..., Any] | None:
        """The kernel in the library for this CPU, else None, or ValueError if POINTRAY_KERNELS=compiled."""
        found, why = choice()
        function = None if found is None else found.find(self.name, Path(self.py_func.__code__.co_filename))
        if function is None and kernel_choice() == "compiled":
            if found is not None:
                why = f"it is missing in the library for {found.level}, or the library was built from other sources"
            raise ValueError(f"POINTRAY_KERNELS=compiled, but {self.name} is not available: {why}")
        return function

    @cached_property
    def _function(self) -> Callable[..., Any]:
        """The function to call: from the library, else by Numba."""
        return self.in_library or cast(Callable[..., Any], self.dispatcher)

    @property
    def dispatcher(self) -> Any:
        """Numba dispatcher, shared by threads that call the kernel for the first time at once."""
        with _LOCK:
            if self.made is None:
                self.made = _compiler().dispatcher_of_kernel(self.py_func)
            return self.made

    @property
    def was_called(self) -> bool:
        """Whether this process has called the kernel."""
        return "_function" in vars(self)

    @property
    def signatures(self) -> list[Any]:
        """Signatures that Numba has compiled or loaded in this process."""
        return [] if self.made is None else list(self.made.signatures)

    @property
    def is_compiled(self) -> bool:
        """Whether the kernel is compiled: in the library, in this process or on disk."""
        if self.in_library is not None:
            return True
        return _compiler().is_compiled(self.dispatcher)


class Later:
    """Placeholder of an object that needs Numba. Its module, one of several, is imported when a kernel is compiled."""

    known: set[str] = set()  # the modules of all placeholders

    def __init__(self, modules: Sequence[str], name: str) -> None:
        self._modules, self._name = modules, name

    @cached_property
    def real(self) -> Any:
        """The object itself."""
        homes = map(importlib.import_module, self._modules)
        return next(vars(home)[self._name] for home in homes if self._name in vars(home))

    @property
    def _numba_type_(self) -> Any:
        """Numba's type of a global that holds this placeholder."""
        return _compiler().type_of(self.real)


def later(package: str | None, modules: Sequence[str], *names: str) -> list[Any]:
    """Return placeholders of the named objects in modules of a package that need Numba.

    The caller assigns the modules to `LATER`, where `dependencies` finds them.
    """
    full = [f"{package}.{name}" for name in modules]
    Later.known.update(full)
    return [Later(full, name) for name in names]


class Table:
    """Constant array of kernels, computed when a kernel is compiled. make : function that computes it"""

    def __init__(self, make: Callable[[], np.ndarray[Any, Any]]) -> None:
        self._make = make

    @cached_property
    def real(self) -> np.ndarray[Any, Any]:
        """The array."""
        return self._make()

    def __getitem__(self, key: Any) -> Any:
        """Return an item, for Python code that indexes like kernels do."""
        return self.real[key]


KERNELS: dict[str, Kernel] = {}


def kernel(function: Function) -> Function:
    """Compile a function called from Python: without the interpreter lock, cached on disk, with one signature."""
    made = Kernel(function)
    KERNELS[made.name] = made
    return cast(Function, made)


def inline(function: Function) -> Function:
    """Compile a device function that LLVM inlines at each call."""
    return cast(Function, Piece(function, is_inline=True))


def routine(function: Function) -> Function:
    """Compile a device function that is not inlined, as it is too large or called from too many places."""
    return cast(Function, Piece(function, is_inline=False))


def version_for(record: type, general: Callable[..., Any]) -> Callable[[Function], Function]:
    """Declare a device function to be the version of a general one for calls with a record of this type.

    Callers of the general function need not know of it, like those of a function overloaded in C++.
    """

    def declare(special: Function) -> Function:
        cast(Piece, general).versions[record] = cast(Piece, special)
        return special

    return declare


def uncompiled(function: Function) -> Function:
    """Return the Python function of a kernel or device function, for Python code that calls a short one."""
    return cast(Function, cast(Any, function).py_func)
