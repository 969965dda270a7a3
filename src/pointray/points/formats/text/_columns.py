"""What the columns of a text file are: by name, or judged from their numbers."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .._source import Chunk
from ._numbers import FLOAT, INT, SCAN, SKIP, Block, smallest

LONGEST = 200  # letters of a name
NONE = "-"  # the name of a column that is left out
POSITIONS, NORMALS, COLORS = ("x", "y", "z"), ("nx", "ny", "nz"), ("r", "g", "b")
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
)
ALIASES = {
    **{f"{word}{axis}": axis for axis in "xyz" for word in ("coord_", "point_", "pos_", "position_")},
    **{f"{axis}{word}": axis for axis in "xyz" for word in ("_coord", "_coordinate", "coord", "coordinate")},
    **{f"{word}{axis}": f"n{axis}" for axis in "xyz" for word in ("normal_", "normal", "n_")},
    **dict.fromkeys(("red", "diffuse_red", "rgb_r", "color_r", "colour_r"), "r"),
    **dict.fromkeys(("green", "diffuse_green", "rgb_g", "color_g", "colour_g"), "g"),
    **dict.fromkeys(("blue", "diffuse_blue", "rgb_b", "color_b", "colour_b"), "b"),
    **{"a": "alpha", "i": "intensity", "class": "classification", "gpstime": "gps_time"},
}
UNIT = 0.03  # how much the length of a normal may differ from 1: of one with two decimals by 0.01
MOSTLY = 0.99  # share of rows in which normals have this length, among those that are not 0 0 0
COLOR, NORMAL, SCALAR = "cns"
# What may follow x, y, z, by the number of columns.
ORDERS = {4: ["s"], 6: ["c", "n"], 7: ["sc", "cs", "sn", "ns"], 9: ["cn", "nc"]}
ORDERS[10] = ["scn", "csn", "cns", "snc", "nsc", "ncs"]
NAMES = {COLOR: COLORS, NORMAL: NORMALS, SCALAR: ("intensity",)}
# Orders that a file's extension decides between.
USUAL = {".pts": ("sc", "scn"), ".xyzn": ("n",), ".xyzrgb": ("c",)}


class UndecidedError(ValueError):
    """Numbers from which it cannot be told what they are."""


def name_of(text: str) -> str:
    """A column's name as we call it."""
    text = re.sub(r"[\[(].*?[\])]", "", text.strip().strip('"').lower()[:LONGEST])  # without units: X [m]
    text = re.sub(r"[\s.]+", "_", text.strip()).strip("_")
    return ALIASES.get(text, text)


def names_of(texts: Sequence[str]) -> list[str] | None:
    """The names of columns, the coordinates as x, y, z; None if these are not among them."""
    names = [name_of(text) for text in texts]
    axes = next((axes for axes in (POSITIONS, *OTHER_POSITIONS) if set(axes) <= set(names)), None)
    if axes is None:
        return None
    known = dict(zip(axes, POSITIONS, strict=True))
    names = [known.get(name, name or f"column_{k}") for k, name in enumerate(names, 1)]
    again = [name in names[:k] and name not in POSITIONS for k, name in enumerate(names)]  # two scalar fields
    return [f"{name}_{k}" if twice else name for k, (name, twice) in enumerate(zip(names, again, strict=True), 1)]


def check_names(names: Sequence[str]) -> None:
    """ValueError if a name comes twice."""
    twice = [name for name in dict.fromkeys(names) if name != NONE and names.count(name) > 1]
    if twice:
        raise ValueError(f"two columns are named {twice[0]!r}: {','.join(names)}")


def judged(values: NDArray[np.float64], whole: Sequence[bool], extension: str) -> list[str]:
    """What columns without names are.

    Parameters
    ----------
    values : (n, k) float64
        The first rows.
    whole : sequence of bool
        Whether all numbers of a column are written as whole ones.
    extension : str
        Of the file, which decides where the numbers do not.

    Raises
    ------
    UndecidedError
        If several orders are possible.
    """
    k = values.shape[1]
    possible = [order for order in ORDERS.get(k, []) if _fits(values, whole, order)]
    if len(possible) > 1:  # colours of 8 bits are likelier than of 16
        possible = [order for order in possible if _fits(values, whole, order, 255)] or possible
    if len(possible) > 1:
        usual = [order for order in possible if order in USUAL.get(extension, ())]
        if len(usual) != 1:
            raise UndecidedError("which of its columns are colours, normals and intensity cannot be told")
        possible = usual
    if possible:
        return [*POSITIONS, *(name for part in possible[0] for name in NAMES[part])]
    return [*POSITIONS, *(f"column_{c}" for c in range(4, k + 1))]


def _fits(values: NDArray[np.float64], whole: Sequence[bool], order: str, most: int = 65535) -> bool:
    """Whether columns can be what an order says; most : of whole colours"""
    at = 3
    for part in order:
        if part == SCALAR:
            at += 1
            continue
        three = values[:, at : at + 3]
        is_unit = _are_unit(three)
        if part == NORMAL and not is_unit:
            return False
        if part == COLOR and (is_unit or not _are_colors(three, all(whole[at : at + 3]), most)):
            return False
        at += 3
    return True


def _are_unit(rows: NDArray[np.float64]) -> bool:
    with np.errstate(over="ignore", invalid="ignore"):
        length = np.sqrt((rows * rows).sum(axis=1))
    length = length[np.isfinite(length) & (length > 0)]
    return len(length) > 0 and bool((np.abs(length - 1) <= UNIT).mean() >= MOSTLY)


def _are_colors(rows: NDArray[np.float64], whole: bool, most: int) -> bool:
    """Whole numbers of 8 or 16 bits, or floats from 0 to 1."""
    return bool((rows >= 0).all() and (rows <= (most if whole else 1)).all())


class Layout(NamedTuple):
    """Which columns become what.

    Attributes
    ----------
    positions, normals, colors : list of int
        Numbers of columns, from 0; empty if there are none.
    attributes : dict of str to int
    types : dict of int to dtype
        Of columns that are whole; the others are floats.
    """

    positions: list[int]
    normals: list[int]
    colors: list[int]
    attributes: Mapping[str, int]
    types: Mapping[int, np.dtype[Any]] = {}

    @classmethod
    def of(cls, names: Sequence[str]) -> Layout:
        """Columns by their names."""
        check_names(names)
        left = {name: k for k, name in enumerate(names) if name != NONE}

        def pop(three: tuple[str, ...]) -> list[int]:
            return [left.pop(name) for name in three] if left.keys() >= set(three) else []

        return cls(pop(POSITIONS), pop(NORMALS), pop(COLORS), left)

    def modes(self, k: int) -> list[int]:
        """How k columns are read."""
        used = {*self.positions, *self.normals, *self.colors, *self.attributes.values()}
        return [INT if c in self.types else FLOAT if c in used else SKIP for c in range(k)]

    def doubtful(self, whole: Sequence[bool]) -> list[int]:
        """Columns that are whole in the first rows, and whose type depends on all others."""
        some = list(self.attributes.values())
        if self.colors and all(whole[c] for c in self.colors):
            some += self.colors
        return [c for c in some if whole[c]]

    def typed(self, stats: NDArray[np.int64], columns: Sequence[int]) -> Layout:
        """With the types of whole columns, by what was noted of all rows."""
        types = {c: smallest(int(stats[c, 1]), int(stats[c, 2])) for c in columns if stats[c, 0]}
        if not all(c in types for c in self.colors):
            types = {c: dtype for c, dtype in types.items() if c not in self.colors}
        return self._replace(types=types)

    def row(self) -> int:
        """Bytes of a row while it is read."""
        return 36 + 12 * bool(self.normals) + 6 * bool(self.colors) + 8 * len(self.attributes)

    def chunk(self, block: Block, share: float) -> Chunk:
        """Rows as a chunk."""
        colors = np.result_type(*(self.types.get(c, np.float32) for c in self.colors)) if self.colors else None
        return Chunk(
            block.take(self.positions, np.float64),
            block.take(self.normals, np.float32) if self.normals else None,
            block.take(self.colors, colors) if self.colors else None,
            {name: block.take([c], self.types.get(c, np.float64))[:, 0] for name, c in self.attributes.items()},
            share,
        )


def merged(blocks: Iterator[Block], before: NDArray[np.int64] | None) -> NDArray[np.int64] | None:
    """What is noted of the columns of all blocks together; before : of earlier ones."""
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
    """How k columns are read to find the limits of some of them."""
    return [SCAN if c in columns else SKIP for c in range(k)]
