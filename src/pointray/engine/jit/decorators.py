"""The decorators of kernels and their pieces. Numba is imported where something is compiled, and not before."""

from __future__ import annotations

import functools
import importlib
import threading
from collections.abc import Callable, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np

from .library import choice, wanted

LATER = ("compile",)
_LOCK = threading.RLock()
Function = TypeVar("Function", bound=Callable[..., Any])


def _compiler() -> Any:
    """The module that compiles, which imports Numba."""
    try:
        return importlib.import_module(f"{__package__}.compile")
    except ModuleNotFoundError as error:
        if error.name not in ("numba", "llvmlite"):
            raise
        why = choice()[1]
        raise ValueError(f"{why}, and Numba is not installed to compile them: pip install 'pointray[jit]'") from None


class Piece:
    """A piece of kernels: a function that only compiled code calls.

    is_inline : LLVM inlines it where it is called
    """

    def __init__(self, function: Callable[..., Any], is_inline: bool) -> None:
        functools.update_wrapper(cast(Any, self), function)
        self.py_func, self.is_inline = function, is_inline

    def __reduce__(self) -> str:
        return self.py_func.__qualname__  # by its name, as functions are

    @cached_property
    def dispatcher(self) -> Any:
        """Numba's function."""
        return _compiler().dispatcher_of_piece(self.py_func, self.is_inline)

    @property
    def _numba_type_(self) -> Any:
        """What Numba takes a global name for that stands for this piece."""
        return _compiler().type_of(self.dispatcher)


class Kernel(Piece):
    """A function that Python calls: without the interpreter lock, with one signature."""

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function, is_inline=False)
        self.name = f"{function.__module__}.{function.__qualname__}"
        self.made: Any = None  # Numba's function, if it was needed

    def __call__(self, *args: Any) -> Any:
        return self._function(*args)

    @cached_property
    def in_library(self) -> Callable[..., Any] | None:
        """The kernel of the library for this processor, if it is there; ValueError if it must be."""
        found, why = choice()
        function = None if found is None else found.find(self.name, Path(self.py_func.__code__.co_filename))
        if function is None and wanted() == "compiled":
            if found is not None:
                why = f"it is not in the library for {found.level}, or was built from other sources"
            raise ValueError(f"POINTRAY_KERNELS=compiled, but not {self.name}: {why}")
        return function

    @cached_property
    def _function(self) -> Callable[..., Any]:
        """What is called."""
        return self.in_library or cast(Callable[..., Any], self.dispatcher)

    @property
    def dispatcher(self) -> Any:
        """Numba's function; threads that call the kernel at the same time for the first time share it."""
        with _LOCK:
            if self.made is None:
                self.made = _compiler().dispatcher_of_kernel(self.py_func)
            return self.made

    @property
    def was_called(self) -> bool:
        """Whether this process has called it."""
        return "_function" in vars(self)

    @property
    def signatures(self) -> list[Any]:
        """Those that Numba has compiled it for in this process, or loaded."""
        return [] if self.made is None else list(self.made.signatures)

    @property
    def is_compiled(self) -> bool:
        """Whether it is compiled, in the library, in this process or on disk."""
        if self.in_library is not None:
            return True
        return _compiler().is_compiled(self.dispatcher)


class Later:
    """Something that needs Numba, by its name in one of some modules, which are imported when a kernel is compiled."""

    known: set[str] = set()  # noqa: RUF012  # all these modules

    def __init__(self, modules: Sequence[str], name: str) -> None:
        self._modules, self._name = modules, name

    @cached_property
    def real(self) -> Any:
        """What this stands for."""
        homes = map(importlib.import_module, self._modules)
        return next(vars(home)[self._name] for home in homes if self._name in vars(home))

    @property
    def _numba_type_(self) -> Any:
        """What Numba takes a global name for that stands for this."""
        return _compiler().type_of(self.real)


def later(package: str | None, modules: Sequence[str], *names: str) -> list[Any]:
    """Stand-ins for what kernels use of modules of a package that need Numba, by their names there.

    The caller assigns the modules to `LATER`, where `dependencies` finds them.
    """
    full = [f"{package}.{name}" for name in modules]
    Later.known.update(full)
    return [Later(full, name) for name in names]


class Table:
    """A constant array of kernels, which is computed when a kernel is compiled. make : computes it"""

    def __init__(self, make: Callable[[], np.ndarray[Any, Any]]) -> None:
        self._make = make

    @cached_property
    def real(self) -> np.ndarray[Any, Any]:
        """The array."""
        return self._make()

    def __getitem__(self, key: Any) -> Any:
        """As kernels read it, for Python code."""
        return self.real[key]


KERNELS: dict[str, Kernel] = {}


def kernel(function: Function) -> Function:
    """Compile a function that Python calls: without the interpreter lock, cached on disk, one signature."""
    made = Kernel(function)
    KERNELS[made.name] = made
    return cast(Function, made)


def inline(function: Function) -> Function:
    """Compile a piece of a kernel; LLVM inlines it where it is called."""
    return cast(Function, Piece(function, is_inline=True))


def routine(function: Function) -> Function:
    """Compile a piece of a kernel that is too large, or called from too many places, to be inlined."""
    return cast(Function, Piece(function, is_inline=False))


def uncompiled(function: Function) -> Function:
    """The Python function that a kernel or a piece was compiled from, for Python code that calls a short one."""
    return cast(Function, cast(Any, function).py_func)
