"""Validation of the arguments of `read` before a file is opened."""

from __future__ import annotations

from inspect import signature
from typing import Any

from .files import read, request_of
from .selection import Selection

CHOICES = [name for name in signature(read).parameters if name not in ("path", "progress")]


def check_reading(choices: dict[str, Any]) -> None:
    """Raise ValueError if one of the arguments of `read` is invalid; the message names it.

    choices : arguments by name: those of `read` except path and progress
    """
    of_formats = signature(request_of).parameters
    request_of(**{name: value for name, value in choices.items() if name in of_formats})
    Selection(**{name: value for name, value in choices.items() if name in Selection.__dataclass_fields__})
