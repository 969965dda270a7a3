"""The data of a scene file, and errors with file, line and key."""

from __future__ import annotations

import os
import re
import tomllib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ..base.atomic_write import check_regular
from .lines import Key, line_of
from .spelling import suggest_file


class Source:
    """The text of a scene file.

    Attributes
    ----------
    file : Path
    data : dict
        Data as returned by tomllib.

    Raises
    ------
    OSError
        If the file cannot be opened.
    ValueError
        If it is not valid TOML.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.file = check_regular(path)
        try:
            self._text = self.file.read_text(encoding="utf-8-sig")
            self.data: dict[str, Any] = tomllib.loads(self._text)
        except (ValueError, RecursionError) as error:
            line = re.search(r" \(at line (\d+), column \d+\)", str(error))
            message = str(error).replace(line[0], "") if line else str(error)
            raise ValueError(f"{self.file}:{f'{line[1]}:' if line else ''} not valid TOML: {message}") from None

    def path(self, name: str) -> Path:
        """Return a path of the file, relative to the file's folder."""
        return self.file.parent / name

    def error(self, key: Key, message: str) -> ValueError:
        """Return an error about the value of a key."""
        return ValueError(self._message(key, message))

    @contextmanager
    def errors_at(self, key: Key, names: Iterable[str] = ()) -> Iterator[None]:
        """Add file, line and key to errors raised within.

        An error is assigned to the first of `names`, keys of the table, in its message, otherwise to the table.
        """
        try:
            yield
        except ValueError as error:
            message = str(error)
            named = next((name for name in re.findall(r"\w+", message) if name in set(names)), None)
            if named is None:
                raise self.error(key, message) from error
            raise self.error((*key, named), message.removeprefix(f"{named} ")) from error
        except OSError as error:
            raise type(error)(self._message(key, f"{error.filename}: {error.strerror}{suggest_file(error)}")) from error

    def _message(self, key: Key, message: str) -> str:
        line = line_of(self._text, key)
        name = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in key).removeprefix(".")
        return " ".join(f"{self.file}:{f'{line}:' if line else ''} {f'{name}: ' if name else ''}{message}".split())
