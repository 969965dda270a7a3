"""The surface of a scan: its default, and errors about the options that change it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..model.scan_inputs import is_saved
from .picture_options import OF_SURFACE, PictureOptions

if TYPE_CHECKING:
    from ..io.remote.remote_file import Location

PLAIN = PictureOptions().of(OF_SURFACE)  # the surface without options


def as_option(error: ValueError) -> str:
    """Return the message of an error of `Model` for the command line: "scatter: ..." becomes "--scatter: ..."."""
    text = str(error)
    return f"--{text}" if text.startswith("scatter: ") else text


def check_saved(file: Location, is_plain: bool) -> None:
    """Raise ValueError if a file is a saved model, but options change the surface or the normals, which it contains.

    is_plain : whether these options have their defaults
    """
    if is_saved(file) and not is_plain:
        names = [f"--{name.replace('_', '-')}" for name in PLAIN]
        raise ValueError(f"{file}: {', '.join(names)} and --normals are part of a saved model")
