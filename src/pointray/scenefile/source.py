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
from ..base.spelling import suggest_file
from .lines import Key, line_of


class Source:
    """The text and data of a scene file (TOML). It makes error messages with the line of a key.

    Attributes
    ----------
    file : Path
    data : dict
        The data as nested dicts and lists, as parsed by tomllib.

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
        """Return the path of a file that the scene file names; relative paths start at the scene file's folder."""
        return self.file.parent / name

    def error(self, key: Key, message: str) -> ValueError:
        """Return a ValueError whose message begins with the file, the line of a key and its name.

        key : names and row numbers, such as ("instances", 0, "model")
        """
        return ValueError(self._message(key, message))

    @contextmanager
    def errors_at(self, key: Key, names: Iterable[str] = ()) -> Iterator[None]:
        """Add file, line and key to the message of a ValueError or OSError raised in this context.

        key : path of a table in the file, or of a value, such as ("instances", 0)
        names : keys of the table; if the message of a ValueError contains one, the error is reported at its line
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
