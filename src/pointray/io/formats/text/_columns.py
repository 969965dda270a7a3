"""Meaning of the columns of a text file by their names."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .._source import Chunk
from .._unnamed_columns import COLORS, NORMALS, POSITIONS
from ._numbers import FLOAT, INT, SCAN, SKIP, Block, smallest

LONGEST = 200  # maximum length of a name
NONE = "-"  # name of an ignored column
LONGITUDES, LATITUDES = ("longitude", "lon", "long", "lng"), ("latitude", "lat")
HEIGHTS = ("altitude", "alt", "elevation", "ellipsoidal_height", "height", "h", "z")
OTHER_POSITIONS = (
    ("easting", "northing", "height"),
    ("easting", "northing", "elevation"),
    ("easting", "northing", "altitude"),
    ("easting", "northing", "z"),
    ("east", "north", "height"),
    ("east", "north", "elevation"),
    ("east", "north", "up"),
    ("e", "n", "h"),
    ("e", "n", "z"),
    ("e", "n", "u"),
    ("rechtswert", "hochwert", "hoehe"),
    *itertools.product(LONGITUDES, LATITUDES, HEIGHTS),
)
ALIASES = {
    **{f"{word}{axis}": axis for axis in "xyz" for word in ("coord_", "point_", "pos_", "position_")},
    **{f"{axis}{word}": axis for axis in "xyz" for word in ("_coord", "_coordinate", "coord", "coordinate")},
    **{f"{word}{axis}": f"n{axis}" for axis in "xyz" for word in ("normal_", "normal", "n_")},
    **dict.fromkeys(("red", "diffuse_red", "rgb_r", "color_r", "colour_r", "rf"), "r"),
    **dict.fromkeys(("green", "diffuse_green", "rgb_g", "color_g", "colour_g", "gf"), "g"),
    **dict.fromkeys(("blue", "diffuse_blue", "rgb_b", "color_b", "colour_b", "bf"), "b"),
    **{"a": "alpha", "i": "intensity", "class": "classification", "gpstime": "gps_time"},
}


def name_of(text: str) -> str:
    """Return the canonical name of a column, given its title: lower case, without units, and "r" for "Red"."""
    text = re.sub(r"[\[(].*?[\])]", "", text.strip().strip('"').lower()[:LONGEST])  # removes units: X [m]
    text = re.sub(r"[\s.]+", "_", text.strip()).strip("_")
    return ALIASES.get(text, text)


def names_of(texts: Sequence[str]) -> list[str] | None:
    """Return the names of columns as pointray uses them, with the coordinates as x, y, z; None if these are missing.

    Duplicate names and empty ones get the number of the column.

    texts : names in the file
    """
    names = [name_of(text) for text in texts]
    axes = next((axes for axes in (POSITIONS, *OTHER_POSITIONS) if set(axes) <= set(names)), None)
    if axes is None:
        return None
    known = dict(zip(axes, POSITIONS, strict=True))
    names = [known.get(name, name or f"column_{k}") for k, name in enumerate(names, 1)]
    again = [name in names[:k] and name not in POSITIONS for k, name in enumerate(names)]  # duplicate scalar fields
    return [f"{name}_{k}" if twice else name for k, (name, twice) in enumerate(zip(names, again, strict=True), 1)]


def has_degrees(header: str) -> bool:
    """Whether a header calls the coordinates longitude and latitude."""
    words = set(re.findall("[a-z]+", header.lower()))
    return bool(words & set(LONGITUDES) and words & set(LATITUDES)) and "x" not in words


def check_names(names: Sequence[str]) -> None:
    """Raise ValueError if a name is duplicated, except "-" for ignored columns."""
    twice = [name for name in dict.fromkeys(names) if name != NONE and names.count(name) > 1]
    if twice:
        raise ValueError(f"duplicate column name {twice[0]!r}: {','.join(names)}")


class Layout(NamedTuple):
    """Roles of the columns of a text file.

    Attributes
    ----------
    positions, normals, colors : list of int
        Column numbers, from 0; may be empty.
    attributes : dict of str to int
        Column numbers of the attributes by name.
    types : dict of int to dtype
        Types of integer columns; the others are floats.
    """

    positions: list[int]
    normals: list[int]
    colors: list[int]
    attributes: Mapping[str, int]
    types: Mapping[int, np.dtype[Any]] = {}

    @classmethod
    def of(cls, names: Sequence[str]) -> Layout:
        """Find the roles of columns by their names: x, y, z, nx, ny, nz and r, g, b.

        Columns with other names are attributes; those named "-" are ignored.
        """
        check_names(names)
        left = {name: k for k, name in enumerate(names) if name != NONE}

        def pop(three: tuple[str, ...]) -> list[int]:
            return [left.pop(name) for name in three] if left.keys() >= set(three) else []

        return cls(pop(POSITIONS), pop(NORMALS), pop(COLORS), left)

    def modes(self, k: int) -> list[int]:
        """Return how the parser reads each of k columns: `INT` for integers, `FLOAT`, or `SKIP` for ignored ones."""
        used = {*self.positions, *self.normals, *self.colors, *self.attributes.values()}
        return [INT if c in self.types else FLOAT if c in used else SKIP for c in range(k)]

    def doubtful(self, whole: Sequence[bool]) -> list[int]:
        """Return the numbers of columns that are integers in the first rows: their type depends on all other rows.

        Colours are among them if all three channels are integers.

        whole : whether the first rows of each column are all integers
        """
        some = list(self.attributes.values())
        if self.colors and all(whole[c] for c in self.colors):
            some += self.colors
        return [c for c in some if whole[c]]

    def typed(self, stats: NDArray[np.int64], columns: Sequence[int]) -> Layout:
        """Return this layout with the types of integer columns, the smallest that hold all rows.

        Colours are integers only if all three channels are.

        stats : (k, 3), of all rows of each column: whether they are integers, minimum, maximum
        columns : numbers of the columns that may be integers
        """
        types = {c: smallest(int(stats[c, 1]), int(stats[c, 2])) for c in columns if stats[c, 0]}
        if not all(c in types for c in self.colors):
            types = {c: dtype for c, dtype in types.items() if c not in self.colors}
        return self._replace(types=types)

    def row(self) -> int:
        """Return the bytes per row of all columns in memory while reading."""
        return 36 + 12 * bool(self.normals) + 6 * bool(self.colors) + 8 * len(self.attributes)

    def chunk(self, block: Block, share: float) -> Chunk:
        """Return parsed rows as a chunk, in the types of this layout. share : fraction of the file read so far"""
        colors = np.result_type(*(self.types.get(c, np.float32) for c in self.colors)) if self.colors else None
        return Chunk(
            block.take(self.positions, np.float64),
            block.take(self.normals, np.float32) if self.normals else None,
            block.take(self.colors, colors) if self.colors else None,
            {name: block.take([c], self.types.get(c, np.float64))[:, 0] for name, c in self.attributes.items()},
            share,
        )


def merged(blocks: Iterator[Block], before: NDArray[np.int64] | None) -> NDArray[np.int64] | None:
    """Return statistics of the columns over all blocks of rows, (k, 3): whether all are integers, minimum, maximum.

    Return None without any block.

    before : statistics of earlier blocks, or None
    """
    for block in blocks:
        own = block.stats
        if before is not None:
            own = np.stack(
                [np.minimum(own[:, 0], before[:, 0]), np.minimum(own[:, 1], before[:, 1])]
                + [np.maximum(own[:, 2], before[:, 2])],
                axis=1,
            )
        before = own
    return before


def scanning(k: int, columns: Sequence[int]) -> list[int]:
    """Return how the parser reads k columns to find their limits: `SCAN` for those listed, `SKIP` for the others."""
    return [SCAN if c in columns else SKIP for c in range(k)]
