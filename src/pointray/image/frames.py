"""A film's frames as numbered pictures: a run that was interrupted is found again, and goes on."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

from numpy.typing import ArrayLike
from PIL import Image

from ..base.atomic_write import check_writable, replacing
from .tone import Backdrop
from .write import SHOWN, write_image


class Frames:
    """Numbered pictures, and beside them a note: what they show, and how many are done.

    Parameters
    ----------
    pattern : path
        Its name has one `%d` or `%04d` for the number, from 0.
    settings : dict
        All that the pictures depend on, as JSON takes it.
    count : int
        Frames of the film.
    size : (int, int)
        Width and height.
    """

    def __init__(self, pattern: Path, settings: dict[str, Any], count: int, size: tuple[int, int]) -> None:
        self.pattern, self.count, self._size = pattern, count, size
        self._settings = json.loads(json.dumps(settings))  # tuples are lists in a file
        self._done = 0

    @property
    def note(self) -> Path:
        """Where it is written what the pictures show; gone when the film is complete."""
        return note_of(self.pattern)

    def path(self, k: int) -> Path:
        """The picture of a frame."""
        return self.pattern.with_name(self.pattern.name % k)

    def find(self) -> tuple[list[int], list[str]]:
        """The frames to render, and which settings are others than those of the frames that are there."""
        try:
            old = json.loads(self.note.read_text())
            settings, done = dict(old["settings"]), int(old["done"])
        except (OSError, ValueError, TypeError, KeyError):  # none, or cut off
            return list(range(self.count)), []
        other = [k for k in {**settings, **self._settings} if settings.get(k) != self._settings.get(k)]
        if other:
            return list(range(self.count)), other if done else []
        self._done = min(done, self.count)
        return [k for k in range(self.count) if k >= self._done or not self._complete(k)], []

    def begin(self) -> None:
        """Make the folder, and note what the pictures will show."""
        self.pattern.parent.mkdir(exist_ok=True)
        self._write_note()

    def keep(
        self, k: int, image: ArrayLike, exposure: float, curve: str = "srgb", backdrop: Backdrop | None = None
    ) -> None:
        """Write a frame, and note that it is done."""
        write_image(self.path(k), image, exposure, curve, backdrop=backdrop)
        self._done = max(self._done, k + 1)
        self._write_note()

    def finish(self) -> None:
        """All frames are done: only the pictures stay."""
        self.note.unlink(missing_ok=True)

    def _write_note(self) -> None:
        with replacing(self.note) as beside:
            beside.write(json.dumps({"settings": self._settings, "done": self._done}, indent=1).encode())

    def _complete(self, k: int) -> bool:
        """Whether a picture is there with all its pixels."""
        try:
            with Image.open(self.path(k)) as picture:
                picture.load()
                return picture.size == self._size
        except (OSError, SyntaxError, ValueError):  # what Pillow says of a file that was cut off
            return False


def note_of(pattern: Path) -> Path:
    """The note beside numbered pictures."""
    return pattern.with_name(f"{pattern.name}.json")


def check_pattern(pattern: Path) -> None:
    """Raise what would keep numbered pictures from being written, before the work is done."""
    if not re.fullmatch(r"[^%]*%(0?[1-9])?d[^%]*", pattern.name):
        raise ValueError(f"{pattern}: the name of a numbered picture has one %d or %04d, no other %")
    if pattern.suffix.lower() not in SHOWN:
        extension = pattern.suffix or "a file without extension"
        raise ValueError(f"{pattern}: cannot write {extension}; can write {', '.join(SHOWN)}")
    # The folder is made when it is needed, those above it are not.
    check_writable(pattern if pattern.parent.exists() else pattern.parent)
