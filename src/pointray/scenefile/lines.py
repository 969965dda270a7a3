"""Lines of the keys of a TOML text, which tomllib does not report. It parses the first lines until they have a key."""

from __future__ import annotations

import tomllib
from bisect import bisect_left
from contextlib import suppress
from typing import Any

Key = tuple[str | int, ...]

LIMIT = 10**7  # characters parsed to find a line, which take some seconds


def line_of(text: str, key: Key) -> int:
    """Return the number, from 1, of the line in a TOML text where the statement begins that defines a key.

    Return the line of the table that should have the key if the key is missing, and 0 if that is missing too, or if the
    search would take long.

    text : valid TOML; key : names and row numbers, such as ("instances", 0, "model")
    """
    lines, parsed = text.split("\n"), 0

    def depth(end: int) -> int:
        """Return how many leading names of the key are defined by statements that begin in the first `end` lines.

        For ("instances", 0, "model") it is 2 where these lines begin the first table of `instances`, but not its
        "model".
        """
        nonlocal parsed
        for stop in range(end, len(lines) + 1):
            start = "\n".join(lines[:stop])
            parsed += len(start)
            if parsed > LIMIT:
                raise LookupError
            with suppress(ValueError, RecursionError):  # within an array or a string of several lines
                return _depth(tomllib.loads(start), key)
        raise LookupError

    try:
        wanted = depth(len(lines))
        return bisect_left(range(len(lines)), wanted, key=depth) if wanted else 0
    except LookupError:
        return 0


def _depth(data: Any, key: Key) -> int:
    """Return how many leading names and row numbers of a key lead to an existing value in nested dicts and lists.

    data : contents of a TOML text; key : such as ("instances", 0, "model"): 2 if only "model" is missing
    """
    for depth, part in enumerate(key):
        try:
            data = data[part]
        except (KeyError, IndexError, TypeError):
            return depth
    return len(key)
