"""Georeference of a file: coordinate system, units, scanner positions and acquisition format."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.arguments import check_position, check_text, wrong

SCAN = "scan"  # attribute with the station of each point: an index into `Georeference.stations`

RESIDUAL = "grid_residual"  # attribute with float32's rounding error against a file's integers, in `Georeference.scale`


@dataclass(frozen=True, slots=True)
class Georeference:
    """Georeference of points, kept with them and written back to files.

    Parameters
    ----------
    crs : str, optional
        The coordinate reference system: well-known text, or a code like "EPSG:25832".
    unit : str, optional
        The unit of the coordinates, for example "metre".
    scale, offset : (3,) float, optional
        For files with integer coordinates (LAS): coordinate = offset + scale * integer.
    stations : sequence of (3,) float
        Scanner positions in world coordinates. With more than one, the attribute "scan" holds each point's index.
    projection : str, optional
        Local projection, if the file's coordinates are degrees of longitude and latitude and the points' are metres
        east and north of a place. Files are written in degrees again.
    format : str, optional
        The file format, where it suggests which axis is up: "LAS", "E57", "PTX", "PTS", "KITTI", "glTF", "SPZ",
        "COLMAP" or "depth image".

    Raises
    ------
    TypeError
        If an argument has the wrong type.
    ValueError
        If a text is empty, a scale is not positive, a number is not finite, or only one of scale and offset
        is given.

    Examples
    --------
    >>> known = pr.Georeference(crs="EPSG:25832", unit="metre", stations=[(500000, 5400000, 310)])
    >>> known.stations
    ((500000.0, 5400000.0, 310.0),)
    """

    crs: str | None = None
    unit: str | None = None
    scale: tuple[float, float, float] | None = None
    offset: tuple[float, float, float] | None = None
    stations: tuple[tuple[float, float, float], ...] = ()
    projection: str | None = None
    format: str | None = None

    def __post_init__(self) -> None:
        for name in ("crs", "unit", "projection", "format"):
            value = getattr(self, name)
            object.__setattr__(self, name, None if value is None else check_text(value, name))
        for name in ("scale", "offset"):
            value = getattr(self, name)
            object.__setattr__(self, name, None if value is None else check_position(value, name))
        if (self.scale is None) != (self.offset is None):
            raise ValueError("scale and offset must be given together")
        if self.scale is not None and min(self.scale) <= 0:
            raise ValueError(f"scale must be positive, not {self.scale}")
        if not isinstance(self.stations, list | tuple):
            raise wrong("stations", "a sequence of positions", self.stations)
        object.__setattr__(self, "stations", tuple(check_position(station, "stations") for station in self.stations))

    @property
    def facts(self) -> dict[str, Any]:
        """The fields that are set, by name, as JSON types: `Georeference(**facts)` restores the georeference."""
        return {name: value for name, value in asdict(self).items() if value not in (None, ())}


def numbers_of(georeference: Georeference, world: NDArray[Any]) -> NDArray[np.int64]:
    """Return the integers, (n, 3) int64, that encode world coordinates (n, 3) in a file with this scale and offset."""
    numbers = np.rint((world - np.array(georeference.offset)) / np.array(georeference.scale))
    return np.asarray(np.nan_to_num(numbers), np.int64)
