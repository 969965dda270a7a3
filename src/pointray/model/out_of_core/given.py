"""Input data of a cloud on disk, in file order or kd order: radii, and stations that saw it."""

from __future__ import annotations

import numpy as np

from ...base.disk_columns import Column, Columns
from ...cloud.georeference import SCAN
from ...cloud.normals.visibility import ignored_stations, station_sample
from ...cloud.points import Points
from ...io.spooling.spooled import Spooled
from ...surface.splats.radii import radii_among
from .arrange import chunks_of

# Names of cached results: ignored stations, and whether there are radii.
IGNORED, GIVEN_RADII = "ignored-stations", "given-radii"
RADIUS = "radius"  # attribute that holds given radii


class GivenColumns:
    """Data of a cloud on disk that come from its files: column names, whether there are radii, and scanner stations.

    The columns may be in the order of the files or in kd order.

    Parameters
    ----------
    columns : Columns
    spooled : Spooled
        Description of the cloud: number of rows, names of attributes, georeference with the stations.

    Attributes
    ----------
    names : dict of str to str
        Column on disk of each attribute.
    """

    def __init__(self, columns: Columns, spooled: Spooled) -> None:
        self._columns, self._spooled = columns, spooled
        self.names = {name: f"attribute.{k}" for k, name in enumerate(spooled.attributes)}

    @property
    def all(self) -> list[str]:
        """Names of the columns that exist, in file order or kd order: positions, normals, colors, attributes."""
        return [name for name in ("positions", "normals", "colors", *self.names.values()) if self.find(name)]

    def find(self, name: str) -> Column | None:
        """Return the column with this name, in kd order ("points." and the name) or file order; None if missing."""
        return self._columns.find(name) or self._columns.find(f"points.{name}")

    def have_radii(self) -> bool:
        """Return whether the cloud has an attribute "radius" whose values are all positive and finite; found once."""
        return bool(self._columns.get_or_put(GIVEN_RADII, lambda: {"given": self._find_radii()})["given"])

    def _find_radii(self) -> bool:
        column = self.find(self.names.get(RADIUS, RADIUS))
        if column is None or column.width or column.dtype == np.bool_:
            return False
        return all(radii_among(chunk) is not None for chunk in chunks_of(column))

    def _scans(self) -> Column | None:
        """Return the column with the number of the scanner station that saw each point; None if it does not exist."""
        column = self.find(self.names[SCAN]) if SCAN in self.names else None
        return None if column is None or column.width else column

    def ignored_stations(self) -> tuple[int, ...]:
        """Return the numbers of scanner stations to ignore, which a sample of the points contradicts; found once."""
        spooled, columns, scans = self._spooled, self._columns, self._scans()
        stations, positions = len(spooled.georeference.stations), self.find("positions")
        if not stations or positions is None:
            return ()
        facts = columns.get(IGNORED)
        if facts is None:
            rows = station_sample(spooled.rows, stations)
            attributes = {} if scans is None else {SCAN: scans[rows]}
            sample = Points.about(spooled.origin, positions[rows], None, None, attributes, spooled.georeference)
            facts = {"stations": ignored_stations(sample)}
            columns.put(IGNORED, facts)
        return tuple(facts["stations"])

    def are_seen(self, ignored: tuple[int, ...]) -> bool:
        """Return whether any point has a known scanner position.

        ignored : numbers of stations whose positions are not believed
        """
        believed = np.setdiff1d(np.arange(len(self._spooled.georeference.stations)), ignored)
        scans = self._scans()
        if scans is None:
            return len(self._spooled.georeference.stations) == 1 and len(believed) == 1
        return any(bool(np.isin(chunk, believed).any()) for chunk in chunks_of(scans))
