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
    """Import the module that compiles kernels with Numba, and return it; ValueError if Numba is not installed."""
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
    versions : device functions that replace it in calls with a record (named tuple) of the type that is their key
    """

    def __init__(self, function: Callable[..., Any], is_inline: bool) -> None:
        functools.update_wrapper(cast(Any, self), function)
        self.py_func, self.is_inline = function, is_inline
        self.versions: dict[type, Piece] = {}  # by a record among the arguments

    def __reduce__(self) -> str:
        return self.py_func.__qualname__  # pickled by name, as functions are

    @cached_property
    def dispatcher(self) -> Any:
        """Numba dispatcher of the device function, created on first use, which imports Numba."""
        return _compiler().dispatcher_of_piece(self)

    @property
    def _numba_type_(self) -> Any:
        """Numba type of a kernel's reference to this device function; Numba looks for an attribute of this name."""
        return _compiler().type_of(self.dispatcher)


class Kernel(Piece):
    """Compiled function called from Python, without the interpreter lock and with one signature.

    It is found in the library of kernels compiled ahead of time, or else compiled by Numba when it is first called.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function, is_inline=False)
        self.name = f"{function.__module__}.{function.__qualname__}"
        self.made: Any = None  # Numba dispatcher, created on demand

    def __call__(self, *args: Any) -> Any:
        return self._function(*args)

    @cached_property
    def in_library(self) -> Callable[..., Any] | None:
        """The kernel in the library compiled ahead of time for this CPU; None if there is none.

        ValueError if there is none, but POINTRAY_KERNELS=compiled requires it.
        """
        found, why = choice()
        function = None if found is None else found.find(self.name, Path(self.py_func.__code__.co_filename))
        if function is None and kernel_choice() == "compiled":
            if found is not None:
                why = f"it is missing in the library for {found.level}, or the library was built from other sources"
            raise ValueError(f"POINTRAY_KERNELS=compiled, but {self.name} is not available: {why}")
        return function

    @cached_property
    def _function(self) -> Callable[..., Any]:
        """The function to call: from the library of kernels compiled ahead of time, else by Numba."""
        return self.in_library or cast(Callable[..., Any], self.dispatcher)

    @property
    def dispatcher(self) -> Any:
        """Numba dispatcher of the kernel, created on first use; threads that need it at the same time share one."""
        with _LOCK:
            if self.made is None:
                self.made = _compiler().dispatcher_of_kernel(self.py_func)
            return self.made

    @property
    def was_called(self) -> bool:
        """Whether this process has called the kernel, in the library or compiled by Numba."""
        return "_function" in vars(self)

    @property
    def signatures(self) -> list[Any]:
        """Signatures that Numba has compiled or loaded in this process."""
        return [] if self.made is None else list(self.made.signatures)

    @property
    def is_compiled(self) -> bool:
        """Whether the kernel is compiled: ahead of time, in this process or on disk."""
        if self.in_library is not None:
            return True
        return _compiler().is_compiled(self.dispatcher)


class Later:
    """Placeholder of an object whose module imports Numba, so that importing pointray does not import it.

    The modules are imported when a kernel is compiled.

    modules : full names of modules, one of which defines the object; name : of the object
    known : the modules of all placeholders
    """

    known: set[str] = set()  # the modules of all placeholders

    def __init__(self, modules: Sequence[str], name: str) -> None:
        self._modules, self._name = modules, name

    @cached_property
    def real(self) -> Any:
        """The object that the placeholder stands for; its module is imported."""
        homes = map(importlib.import_module, self._modules)
        return next(vars(home)[self._name] for home in homes if self._name in vars(home))

    @property
    def _numba_type_(self) -> Any:
        """Numba type of a kernel's reference to this placeholder: the object's. Numba looks for this attribute."""
        return _compiler().type_of(self.real)


def later(package: str | None, modules: Sequence[str], *names: str) -> list[Any]:
    """Return placeholders of objects in modules that import Numba, so that importing pointray does not import it.

    The caller assigns the modules to a global `LATER`, where `base/dependencies.py` finds them.

    package : their package; modules : their names, without it; names : of the objects
    """
    full = [f"{package}.{name}" for name in modules]
    Later.known.update(full)
    return [Later(full, name) for name in names]


class Table:
    """Constant array of kernels, computed when it is first used: indexed by Python code, or compiled into a kernel.

    make : function that computes it
    """

    def __init__(self, make: Callable[[], np.ndarray[Any, Any]]) -> None:
        self._make = make

    @cached_property
    def real(self) -> np.ndarray[Any, Any]:
        """The array, computed on first use."""
        return self._make()

    def __getitem__(self, key: Any) -> Any:
        """Return an item of the array, for Python code that indexes it as kernels do."""
        return self.real[key]


KERNELS: dict[str, Kernel] = {}


def kernel(function: Function) -> Function:
    """Decorate a function that Python calls, to be compiled ahead of time or when it is first called.

    It runs without the interpreter lock, is cached on disk and must always be called with the same argument types.
    """
    made = Kernel(function)
    KERNELS[made.name] = made
    return cast(Function, made)


def inline(function: Function) -> Function:
    """Decorate a device function (called only by compiled code) that LLVM inlines at each call."""
    return cast(Function, Piece(function, is_inline=True))


def routine(function: Function) -> Function:
    """Decorate a device function that is not inlined, because it is too large or called from too many places."""
    return cast(Function, Piece(function, is_inline=False))


def version_for(record: type, general: Callable[..., Any]) -> Callable[[Function], Function]:
    """Decorate a device function to replace `general` in all calls that have an argument of the type `record`.

    Callers of the general function need not know of it, like those of a function overloaded in C++.

    record : class of a named tuple; general : a device function with the same parameters
    """

    def declare(special: Function) -> Function:
        cast(Piece, general).versions[record] = cast(Piece, special)
        return special

    return declare


def uncompiled(function: Function) -> Function:
    """Return the Python function behind a kernel or device function, to call it from Python or to decorate it anew."""
    return cast(Function, cast(Any, function).py_func)
