"""Warnings for names that have changed."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any, TypeVar

from .warning_log import warn

Function = TypeVar("Function", bound=Callable[..., Any])


def warn_renamed(old: str, new: str) -> None:
    """Issue a DeprecationWarning at the caller of a deprecated alias `old`, with the advice to use `new`."""
    warn(f"{old} is deprecated: use {new}", DeprecationWarning, stacklevel=3)


def accept_renamed(old: str, new: str) -> Callable[[Function], Function]:
    """Return a decorator for functions whose keyword argument `old` is now called `new`.

    A call with the old keyword still works, with a DeprecationWarning.
    """

    def decorate(function: Function) -> Function:
        @wraps(function)
        def call(*args: Any, **options: Any) -> Any:
            if old in options:
                if new in options:
                    raise TypeError(f"{old} is the former name of {new}: give only {new}")
                warn_renamed(f"the argument {old}", new)
                options[new] = options.pop(old)
            return function(*args, **options)

        return call  # type: ignore[return-value]

    return decorate
