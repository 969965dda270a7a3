"""Geographic coordinates: conversion between degrees of longitude and latitude and metres around a cloud's centre."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.arrays import Doubles
from ..base.warning_log import warn
from .georeference import Georeference

# WGS 84, https://earth-info.nga.mil/?dir=wgs84: equatorial radius in metres, and the square of the eccentricity
RADIUS, ECCENTRICITY2 = 6378137.0, 0.00669437999014
DECIMALS = 6  # of the centre's longitude and latitude in degrees
PROJ, PLANE = "+proj=tmerc", "tangent plane"
NUMBER = r"(-?\d+(?:\.\d+)?)"
WRITTEN = re.compile(rf"({re.escape(PROJ)}|{PLANE}) \+lat_0={NUMBER} \+lon_0={NUMBER} \+ellps=WGS84 \+units=m")
GEOGRAPHIC = re.compile(r"\s*(GEOGCS|GEOGCRS|GEOGRAPHICCRS|GEODCRS|GEODETICCRS)\b", re.IGNORECASE)
COMPOUND = re.compile(r"\s*(COMPD_CS|COMPOUNDCRS)\b", re.IGNORECASE)
CODES = range(4001, 5000)  # EPSG codes of geographic systems
WIDEST = 10.0  # degrees: wider clouds are not projected onto one plane
SLENDER = 300  # without a coordinate system, x and y of a cloud this many times as high as wide are taken for degrees
DISTANT = 100  # widths from the origin, at least: true of degrees, not of models


class LocalFrame(NamedTuple):
    """Local frame of metres east and north of a place; heights are unchanged.

    Attributes
    ----------
    latitude, longitude : float
        Of the place, degrees.
    method : str
        `PROJ`: transverse Mercator projection by pyproj, exact. `PLANE`: tangent plane by the radii of curvature,
        without pyproj, accurate near the place.
    """

    latitude: float
    longitude: float
    method: str

    @classmethod
    def of(cls, georeference: Georeference) -> LocalFrame | None:
        """Return the frame that a georeference's projection describes; None if points have the file's own coordinates.

        Raises
        ------
        ValueError
            If the projection was not written by this class.
        """
        if georeference.projection is None:
            return None
        match = WRITTEN.fullmatch(georeference.projection)
        if match is None or not abs(float(match[2])) < 90 or not abs(float(match[3])) <= 360:
            raise ValueError(f"invalid projection {georeference.projection[:80]!r}")
        return cls(float(match[2]), float(match[3]), match[1])

    def __str__(self) -> str:
        latitude, longitude = (f"{value:.{DECIMALS}f}" for value in self[:2])
        return f"{self.method} +lat_0={latitude} +lon_0={longitude} +ellps=WGS84 +units=m"

    def to_local(self, degrees: NDArray[Any]) -> Doubles:
        """Convert longitudes, latitudes (degrees) and heights, (n, 3), to metres east and north, and heights."""
        rows = np.asarray(degrees, np.float64)
        if self.method == PROJ:
            east, north = _transformer(str(self)).transform(rows[:, 0], rows[:, 1])
            return _finite(np.stack([east, north, rows[:, 2]], axis=1))
        return (rows - (self.longitude, self.latitude, 0.0)) * self._metres

    def to_degrees(self, local: NDArray[Any]) -> Doubles:
        """Convert metres east and north, and heights, (n, 3), to longitudes, latitudes (degrees) and heights."""
        rows = np.asarray(local, np.float64)
        if self.method == PROJ:
            longitude, latitude = _transformer(str(self)).transform(rows[:, 0], rows[:, 1], direction="INVERSE")
            longitude = longitude + 360.0 * np.rint((self.longitude - longitude) / 360.0)  # some files use 0 to 360
            return _finite(np.stack([longitude, latitude, rows[:, 2]], axis=1))
        return rows / self._metres + (self.longitude, self.latitude, 0.0)

    @property
    def _metres(self) -> Doubles:
        """Metres per degree of longitude and of latitude, and 1 for heights, (3,): radii of curvature of the ellipsoid.

        Snyder 1987, eq. 4-18 to 4-21.
        """
        latitude = np.radians(self.latitude)
        across = RADIUS / np.sqrt(1 - ECCENTRICITY2 * np.sin(latitude) ** 2)
        along = across**3 * (1 - ECCENTRICITY2) / RADIUS**2
        return np.array([np.radians(across * np.cos(latitude)), np.radians(along), 1.0])


@lru_cache(maxsize=8)
def _transformer(projection: str) -> Any:
    from ..base.extras import require

    pyproj = require("pyproj", "geo", "a cloud projected by it")
    return pyproj.Transformer.from_crs("+proj=longlat +ellps=WGS84", projection, always_xy=True)


def _finite(rows: Doubles) -> Doubles:
    """Replace rows, (n, 3), that pyproj could not project, which are infinite, by NaN."""
    rows[np.isinf(rows).any(axis=1)] = np.nan
    return rows


def projected(georeference: Georeference, sample: NDArray[Any]) -> Georeference:
    """Add a projection to a georeference, with a warning, if a file's coordinates are degrees; else return it as it is.

    Stations are converted to metres east and north of the sample's median; the caller converts points.

    Parameters
    ----------
    sample : (m, 3) array
        Some of the file's coordinates.
    """
    rows = np.asarray(sample, np.float64)
    rows = rows[np.isfinite(rows).all(axis=1)]
    if not len(rows) or georeference.projection is not None:
        return georeference
    low, middle, high = np.quantile(rows, [0.01, 0.5, 0.99], axis=0)
    width = float((high - low)[:2].max())
    if np.abs(rows[:, 0]).max() > 360 or np.abs(rows[:, 1]).max() > 90 or width > WIDEST or abs(middle[1]) > 89:
        return georeference
    stated = is_geographic(georeference)
    if not stated and not (
        high[2] - low[2] > SLENDER * width > 0
        and np.hypot(middle[0], middle[1]) > DISTANT * width
        and not georeference.crs
    ):
        return georeference
    frame = LocalFrame(round(float(middle[1]), DECIMALS), round(float(middle[0]), DECIMALS), _method())
    why = "longitude and latitude in degrees" if stated else "x and y look like longitude and latitude in degrees"
    warn(
        f"{why}: shown in metres east and north of {frame.latitude}, {frame.longitude}; files are written in degrees",
        stacklevel=3,
    )
    stations = frame.to_local(np.reshape(georeference.stations, (-1, 3))).tolist()
    return replace(
        georeference, unit="metre", stations=tuple(tuple(station) for station in stations), projection=str(frame)
    )


def in_file(georeference: Georeference, world: NDArray[Any]) -> NDArray[Any]:
    """Convert world coordinates, (n, 3), to those of the file: degrees if the georeference has a projection."""
    frame = LocalFrame.of(georeference)
    return world if frame is None else frame.to_degrees(world)


def is_geographic(georeference: Georeference) -> bool:
    """Return whether a file's coordinate system uses degrees of longitude and latitude."""
    crs = georeference.crs or ""
    code = re.fullmatch(r"EPSG:(\d{4,5})", crs.strip(), re.IGNORECASE)
    if code is not None:
        return int(code[1]) in CODES and int(code[1]) != 4978  # geocentric
    if COMPOUND.match(crs):
        return bool(re.search(r"\bGEOG\w+\s*\[", crs, re.IGNORECASE)) and "PROJ" not in crs.upper()
    return bool(GEOGRAPHIC.match(crs)) or georeference.unit == "degree"


def _method() -> str:
    try:
        import pyproj  # noqa: F401
    except ImportError:
        return PLANE
    return PROJ
