"""Warnings for names that have changed."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any, TypeVar

from .warning_log import warn

Function = TypeVar("Function", bound=Callable[..., Any])


def warn_renamed(old: str, new: str) -> None:
    """Warn the caller of a deprecated alias, which is removed after one release."""
    warn(f"{old} is deprecated: use {new}", DeprecationWarning, stacklevel=3)


def accept_renamed(old: str, new: str) -> Callable[[Function], Function]:
    """Return a decorator for functions that still accept an argument by its old keyword, with a warning."""

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
