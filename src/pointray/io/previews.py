"""How coarsely remote files must be read so that few points are fetched, to show these before the others."""

from __future__ import annotations

from collections.abc import Sequence

from .files import headers
from .formats._source import Request
from .inputs import pieces_of
from .remote.remote_file import Location, RemoteFile

COARSEST = 1e150  # a resolution at which only the coarsest level of detail is read
LEVELS = 32
SPACING = "COPC spacing"


def preview_resolution(files: Sequence[Location], request: Request, most: int) -> float | None:
    """Return the finest resolution at which at most `most` points of remote COPC files are read.

    It is that of the coarsest level of detail if even this has more points. Return None if a file is local, cannot be
    read in pieces, or if all points together are at most `most`.

    request : options of reading, such as bounds; its resolution is a limit
    """
    coarse = request._replace(resolution=COARSEST)
    if not all(isinstance(file, RemoteFile) and pieces_of(file, coarse) is not None for file in files):
        return None
    spacings = [float(listing.facts[SPACING]) for _, _, listing in headers(files, coarse)]
    found = None
    for level in range(LEVELS):
        resolution = max(spacings) / 2**level
        rows = sum(listing.rows for _, _, listing in headers(files, request._replace(resolution=resolution)))
        if rows > most:
            return resolution if found is None else found
        if request.resolution is not None and resolution <= request.resolution:
            return None
        found = resolution
    return None
