"""A source of rows for tests of reading."""

from __future__ import annotations

from pointray.cloud.georeference import Georeference
from pointray.io.formats._source import Listing, Source


class Rows(Source):
    """A file of rows in chunks of `size`, whose total may be unknown."""

    def __init__(self, chunk, size=100, known=True, georeference=None):
        n = len(chunk.positions)
        self.listing = Listing(n if known else None, 64, expected=n, georeference=georeference or Georeference())
        self._chunk, self._size = chunk, size

    def chunks(self):
        for start in range(0, len(self._chunk.positions), self._size):
            yield self._chunk.select(slice(start, start + self._size))
