"""Suggestions for misspelt names of keys, options, attributes and files."""

from __future__ import annotations

import difflib
import errno
from collections.abc import Iterable
from itertools import islice
from pathlib import Path

MOST_FILES = 10_000  # names in a folder that are compared


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return " (did you mean ...?)" with the name most similar to a misspelt one, for a message.

    known : the valid names; the result is empty if none is similar
    """
    names = {each.lower(): each for each in known}
    near = difflib.get_close_matches(name.lower(), names, 1)
    return f" (did you mean {names[near[0]]!r}?)" if near else ""


def suggest_file(error: OSError) -> str:
    """Return " (did you mean ...?)" with the most similar name, for a message about a missing file or folder.

    error : raised when the file was opened; the result is empty for other errors, or if no name is similar
    """
    if error.errno != errno.ENOENT or not isinstance(error.filename, str | Path):
        return ""
    path = Path(error.filename)
    missing = next((part for part in (path, *path.parents) if not part.exists() and part.parent.is_dir()), None)
    if missing is None:
        return ""
    try:
        return did_you_mean(missing.name, [each.name for each in islice(missing.parent.iterdir(), MOST_FILES)])
    except OSError:  # the folder cannot be read
        return ""
