"""Frames of a film as numbered images, with a note that allows an interrupted run to continue."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

from numpy.typing import ArrayLike
from PIL import Image

from ..base.atomic_write import check_writable, replacing, unsupported_extension
from .tone import Backdrop
from .write import SHOWN, write_image


class Frames:
    """Numbered images of an animation, and a JSON note beside them by which an interrupted run continues.

    The note holds the settings of the images and the number of finished frames.

    Parameters
    ----------
    pattern : path
        Its name contains one `%d` or `%04d` for the frame number, from 0.
    settings : dict
        Everything that the images depend on, as JSON values.
    count : int
        Number of frames.
    size : (int, int)
        Width and height.
    """

    def __init__(self, pattern: Path, settings: dict[str, Any], count: int, size: tuple[int, int]) -> None:
        self.pattern, self.count, self._size = pattern, count, size
        self._settings = json.loads(json.dumps(settings))  # tuples are lists in a file
        self._done = 0

    @property
    def note(self) -> Path:
        """Path of the JSON note with settings and progress, which is deleted when the animation is complete."""
        return note_of(self.pattern)

    def path(self, k: int) -> Path:
        """Return the path of the image of frame k, from 0."""
        return self.pattern.with_name(self.pattern.name % k)

    def find(self) -> tuple[list[int], list[str]]:
        """Find out from the JSON note of an earlier, interrupted run which frames are finished.

        Returns
        -------
        list of int
            Numbers of the frames to render: all if the settings differ.
        list of str
            Names of the settings that differ from those of existing frames.
        """
        try:
            old = json.loads(self.note.read_text())
            settings, done = dict(old["settings"]), int(old["done"])
        except (OSError, ValueError, TypeError, KeyError):  # missing or incomplete
            return list(range(self.count)), []
        other = [k for k in {**settings, **self._settings} if settings.get(k) != self._settings.get(k)]
        if other:
            return list(range(self.count)), other if done else []
        self._done = min(done, self.count)
        return [k for k in range(self.count) if k >= self._done or not self._complete(k)], []

    def begin(self) -> None:
        """Create the folder of the images if needed, and write the note with settings and number of finished frames."""
        self.pattern.parent.mkdir(exist_ok=True)
        self._write_note()

    def keep(
        self, k: int, image: ArrayLike, exposure: float, curve: str = "srgb", backdrop: Backdrop | None = None
    ) -> None:
        """Write the image of frame k, and record in the note that it is finished.

        image : (h, w, 3 or 4), linear; exposure : stops; curve : tone curve
        backdrop : sRGB colours at the top and the bottom of a gradient behind transparent pixels
        """
        write_image(self.path(k), image, exposure, curve, backdrop=backdrop)
        self._done = max(self._done, k + 1)
        self._write_note()

    def finish(self) -> None:
        """Delete the note, after the last frame."""
        self.note.unlink(missing_ok=True)

    def _write_note(self) -> None:
        with replacing(self.note) as beside:
            beside.write(json.dumps({"settings": self._settings, "done": self._done}, indent=1).encode())

    def _complete(self, k: int) -> bool:
        """Return whether the image of frame k exists, can be decoded, and has the size of the animation."""
        try:
            with Image.open(self.path(k)) as picture:
                picture.load()
                return picture.size == self._size
        except (OSError, SyntaxError, ValueError):  # Pillow's errors for truncated files
            return False


def note_of(pattern: Path) -> Path:
    """Return the path of the JSON note beside numbered images, with settings and progress: pattern + ".json"."""
    return pattern.with_name(f"{pattern.name}.json")


def check_pattern(pattern: Path) -> None:
    """Raise ValueError if a path pattern for numbered images, such as "f_%04d.png", is invalid.

    Raise OSError if images cannot be written there.
    """
    if not re.fullmatch(r"[^%]*%(0?[1-9])?d[^%]*", pattern.name):
        raise ValueError(f"{pattern}: the name must contain one %d or %04d for the frame number, and no other %")
    if pattern.suffix.lower() not in SHOWN:
        raise unsupported_extension(pattern, SHOWN)
    # The folder is created if needed, its parents are not.
    check_writable(pattern if pattern.parent.exists() else pattern.parent)
