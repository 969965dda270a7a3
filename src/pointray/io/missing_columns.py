"""Columns that only some of several files have."""

from __future__ import annotations

from collections.abc import Sequence

from ..base.warning_log import warn
from .formats._source import Chunk

FEW = 5  # maximum number of files named in a warning


def warn_missing_columns(files: Sequence[tuple[str, Chunk]]) -> None:
    """Warn of columns that only some of several files have, in one line for all files that lack the same ones.

    files : names, each with a chunk of the file
    """
    has = [_names(chunk) for _, chunk in files]
    every = dict.fromkeys(name for names in has for name in names)
    lacking: dict[str, list[str]] = {}
    for (file, _), names in zip(files, has, strict=True):
        missing = ", ".join(name for name in every if name not in names)
        if missing:
            lacking.setdefault(missing, []).append(file)
    for missing, those in lacking.items():
        more = f" and {len(those) - FEW:,} more" if len(those) > FEW else ""
        warn(f"columns that only some files have: {missing}; missing in: {', '.join(those[:FEW])}{more}", stacklevel=2)


def _names(chunk: Chunk) -> list[str]:
    """Return the names of a chunk's columns other than positions, as the warning shows them."""
    known = {"normals": chunk.normals, "colors (set to grey)": chunk.colors, **chunk.attributes}
    return [name for name, values in known.items() if values is not None]
