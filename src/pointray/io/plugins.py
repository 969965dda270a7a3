"""Readers of other packages: entry points of the group "pointray.readers".

The name of an entry point is a file extension, such as ".foo". Its value is a function that takes a path and returns
anything that `as_points` accepts. The package is imported when such a file is read.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

from ..base.registered import registered
from ..cloud.geographic import in_file
from ..cloud.points import Points
from .formats._source import MAYBE, NO, Chunk, Format, Listing, Request, Source

GROUP = "pointray.readers"


class PluginSource(Source):
    """The points that a reader of another package returns for a file, as one chunk."""

    def __init__(self, entry: EntryPoint, path: Path, request: Request) -> None:
        points = read_by(entry, path)
        self._points = points
        row = points.positions.itemsize * 6 + sum(values.nbytes for values in points.attributes.values()) // len(points)
        self.listing = Listing(None, row, len(points), replace(points.georeference, projection=None))

    def chunks(self) -> Iterator[Chunk]:
        """Yield all rows at once."""
        points = self._points
        yield Chunk(in_file(points.georeference, points.world), points.normals, points.colors, points.attributes)


def read_by(entry: EntryPoint, path: Path) -> Points:
    """Call the reader of another package for a file; return its result as points.

    Raises
    ------
    OSError
        If the reader raises it.
    ValueError
        If the package cannot be imported, the reader fails in any other way, or its result is no point cloud.
    """
    try:
        result: Any = entry.load()(path)
        if isinstance(result, str | os.PathLike):
            raise TypeError("it returned a path: it must return points")
        return registered("exchange").as_points(result, "result")
    except OSError:
        raise
    except Exception as error:
        package = entry.dist.name if entry.dist is not None else entry.value
        raise ValueError(f"the reader {entry.value} of {package} failed: {type(error).__name__}: {error}") from error


def plugin_formats() -> dict[str, Format]:
    """Return a format for each extension that a reader of another package is registered for, by extension.

    Formats of pointray that recognise a file by its contents take precedence.
    """
    found: dict[str, Format] = {}
    for entry in entry_points(group=GROUP):
        extension = f".{entry.name.lower().lstrip('.')}"
        package = entry.dist.name if entry.dist is not None else entry.value
        found.setdefault(
            extension,
            Format(
                name=f"{extension[1:]} ({package})",
                extensions=(extension,),
                recognise=partial(_recognise, extension),
                open=partial(PluginSource, entry),
                keeps={"note": f"read by {package}"},
            ),
        )
    return found


def _recognise(extension: str, head: bytes, path: Path) -> int:
    return MAYBE if path.name.lower().endswith(extension) else NO
