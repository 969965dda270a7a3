"""Survey: what a file says of where its points lie on Earth, how they were measured and from where."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.arguments import check_position, check_text, wrong

SCAN = "scan"  # the attribute that tells from which station each point was seen: a row of `Survey.stations`

RESIDUAL = "grid_residual"  # the attribute for what float32 loses of a file's whole numbers, in steps of `Survey.scale`


@dataclass(frozen=True, slots=True)
class Survey:
    """What a file says of its coordinates, carried along with the points and written again.

    Attributes
    ----------
    crs : str or None
        The coordinate reference system: well-known text, or a code like "EPSG:25832".
    unit : str or None
        The unit of the coordinates, in words: "metre".
    scale, offset : (3,) tuple of float or None
        The file's coordinates are whole numbers: coordinate = offset + scale * number (LAS).
    stations : tuple of (3,) tuple of float
        Where scanners stood, world coordinates. With more than one, the attribute `SCAN` tells each point's.
    projection : str or None
        The file's coordinates are degrees of longitude and latitude; those of the points are metres east and north of a
        place, by this projection. Files are written in degrees again.
    format : str or None
        The format of the file, if it suggests which axis is up: "LAS", "E57", "PTX", "PTS", "KITTI", "glTF", "SPZ",
        "COLMAP" or "depth image".

    Raises
    ------
    ValueError
        If a value has another type, a scale is not positive or a number is not finite.
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
            raise ValueError("scale and offset are given together, or not at all")
        if self.scale is not None and min(self.scale) <= 0:
            raise ValueError(f"scale must be positive, not {self.scale}")
        if not isinstance(self.stations, list | tuple):
            raise wrong("stations", "a sequence of positions", self.stations)
        object.__setattr__(self, "stations", tuple(check_position(station, "stations") for station in self.stations))

    @property
    def facts(self) -> dict[str, Any]:
        """What it holds, as values of JSON, for `Survey(**facts)`."""
        return {name: value for name, value in asdict(self).items() if value not in (None, ())}


def numbers_of(survey: Survey, world: NDArray[Any]) -> NDArray[np.int64]:
    """The whole numbers that coordinates (n, 3) are in a file with a survey's scale and offset, (n, 3) int64."""
    numbers = np.rint((world - np.array(survey.offset)) / np.array(survey.scale))
    return np.asarray(np.nan_to_num(numbers), np.int64)
