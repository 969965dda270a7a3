"""The surface of a scan: its default, and errors about the options that change it."""

from __future__ import annotations

from pathlib import Path

from ..model.scan_inputs import is_saved
from .picture_options import OF_SURFACE, PictureOptions

PLAIN = PictureOptions().of(OF_SURFACE)  # the surface without options


def as_option(error: ValueError) -> str:
    """Return the message of an error of `Model`, with an option in place of the parameter with which it begins."""
    text = str(error)
    return f"--{text}" if text.startswith("scatter: ") else text


def check_saved(file: Path, is_plain: bool) -> None:
    """Raise ValueError if options ask for another surface or other normals than those of a saved model."""
    if is_saved(file) and not is_plain:
        names = [f"--{name.replace('_', '-')}" for name in PLAIN]
        raise ValueError(f"{file}: {', '.join(names)} and --normals are part of a saved model")
