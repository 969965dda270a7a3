"""Suggestions for misspelt names."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


def closest(name: str, known: Iterable[str]) -> str | None:
    """Return the known name that is most similar to a misspelt one; None if none is similar."""
    names = {each.lower(): each for each in reversed(list(known))}
    near = difflib.get_close_matches(name.lower(), names, 1)
    return names[near[0]] if near else None


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return the suggestion at the end of a message about a misspelt name; empty if no known name is similar."""
    near = closest(name, known)
    return f" (did you mean {near!r}?)" if near else ""
