"""The text of a scene file: its data, and on which line a key stands when something is wrong with it."""

from __future__ import annotations

import os
import re
import tomllib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ..points.files import check_regular
from .lines import Key, line_of


class Source:
    """A scene file that has been read.

    Attributes
    ----------
    file : Path
    data : dict
        As tomllib has it.

    Raises
    ------
    OSError
        If the file cannot be opened.
    ValueError
        If it is no TOML.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.file = check_regular(path)
        try:
            self._text = self.file.read_text(encoding="utf-8-sig")
            self.data: dict[str, Any] = tomllib.loads(self._text)
        except (ValueError, RecursionError) as error:
            line = re.search(r" \(at line (\d+), column \d+\)", str(error))
            message = str(error).replace(line[0], "") if line else str(error)
            raise ValueError(f"{self.file}:{f'{line[1]}:' if line else ''} this is no TOML: {message}") from None

    def path(self, name: str) -> Path:
        """A path as the file gives it: relative to where the file is."""
        return self.file.parent / name

    def error(self, key: Key, message: str) -> ValueError:
        """What is wrong with the value of a key."""
        return ValueError(self._tell(key, message))

    @contextmanager
    def telling(self, key: Key, words: Iterable[str] = ()) -> Iterator[None]:
        """Errors in here are of the table at `key`, or of the one of its words that they name first."""
        try:
            yield
        except ValueError as error:
            message = str(error)
            named = next((name for name in re.findall(r"\w+", message) if name in set(words)), None)
            if named is None:
                raise self.error(key, message) from error
            raise self.error((*key, named), message.removeprefix(f"{named} ")) from error
        except OSError as error:
            raise type(error)(self._tell(key, f"{error.filename}: {error.strerror}")) from error

    def line_of(self, key: Key) -> int:
        """The line on which a key, or the longest part of it that is there, begins; 0 where there is none."""
        return line_of(self._text, key)

    def _tell(self, key: Key, message: str) -> str:
        line = self.line_of(key)
        name = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in key).removeprefix(".")
        return " ".join(f"{self.file}:{f'{line}:' if line else ''} {f'{name}: ' if name else ''}{message}".split())
