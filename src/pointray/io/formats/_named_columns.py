"""Named columns -> chunks: the names of positions, normals and colours; all other columns are attributes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ._source import Chunk

# Names of one array with three columns, and of three arrays with one; the first match wins.
POSITIONS = (
    *("positions", "position", "points", "xyz", "pos", "pts", "coords", "coord"),
    *("pts3d", "points3d", "world_points", "pointmap"),  # of depth networks: DUSt3R, VGGT and others
)
NORMALS = ("normals", "normal")
COLORS = ("colors", "colours", "color", "colour", "rgb", "rgba")
AXES = (("x", "y", "z"),)
NORMAL_AXES = (("nx", "ny", "nz"), ("normal_x", "normal_y", "normal_z"), ("normalx", "normaly", "normalz"))
CHANNELS = (("red", "green", "blue"), ("r", "g", "b"))
SPECIAL = frozenset(
    (*POSITIONS, *NORMALS, *COLORS, *(name for triples in (AXES, NORMAL_AXES, CHANNELS) for t in triples for name in t))
)

Columns = dict[str, NDArray[Any]]


class Roles(NamedTuple):
    """Names of the columns that hold positions, normals and colours.

    Each is a tuple of one name, of an array with three columns (four for RGBA), or of three names; () if there is none.
    """

    positions: tuple[str, ...]
    normals: tuple[str, ...]
    colors: tuple[str, ...]

    def chunk(self, columns: Mapping[str, NDArray[Any]], share: float) -> Chunk:
        """Return columns, (m,) or (m, k) arrays by name, as a chunk; those without a role become attributes.

        share : fraction of the file read so far
        """
        taken = {name for names in self for name in names}
        attributes = {name: own(column) for name, column in columns.items() if name not in taken}
        positions, normals, colors = (
            stack([columns[name] for name in names]) if names else None
            for names in (self.positions, self.normals, self.colors)
        )
        assert positions is not None
        return Chunk(positions, normals, colors, attributes, share)


def roles_of(types: Mapping[str, tuple[np.dtype[Any], int]]) -> Roles:
    """Find the columns of positions, normals and colours by their names, ignoring case.

    Parameters
    ----------
    types : dict of str to (dtype, int)
        dtype and width of each column; width 0 for (n,) arrays.

    Raises
    ------
    ValueError
        If there are no positions.
    """
    numbers: dict[str, tuple[str, int]] = {}
    for name, (dtype, width) in types.items():
        if dtype.kind in "iuf" and (name.lower() not in numbers or name == name.lower()):  # x before X
            numbers[name.lower()] = (name, width)

    def find(arrays: Sequence[str], triples: Sequence[tuple[str, ...]], widths: tuple[int, ...]) -> tuple[str, ...]:
        for names in triples:
            if all(numbers.get(name, ("", -1))[1] in (0, 1) for name in names):
                return tuple(numbers[name][0] for name in names)
        for name in arrays:
            if name in numbers and numbers[name][1] in widths:
                return (numbers[name][0],)
        return ()

    positions = find(POSITIONS, AXES, (3,))
    if not positions:
        names = ", ".join(repr(name[:30])[1:-1] for name in list(types)[:20])
        raise ValueError(f"columns x, y, z not found; available: {names or 'none'}")
    return Roles(positions, find(NORMALS, NORMAL_AXES, (3,)), find(COLORS, CHANNELS, (3, 4)))


def names_with_roles(widths: Mapping[str, int], triples: Sequence[tuple[str, ...]] = ()) -> set[str]:
    """Return the names of attributes that readers would take for positions, normals or colours.

    widths : numbers per row of each attribute, by name
    triples : names in lower case of three columns of one number each, such as those of normals
    """
    single = {name.lower() for name, width in widths.items() if width == 1}
    found = {name for triple in triples if single >= set(triple) for name in triple}
    arrays = {**dict.fromkeys((*POSITIONS, *NORMALS), (3,)), **dict.fromkeys(COLORS, (3, 4))}
    return {n for n, width in widths.items() if n.lower() in found or width in arrays.get(n.lower(), ())}


def own(column: NDArray[Any]) -> NDArray[Any]:
    """Return a contiguous array in native byte order: the column itself if it is one."""
    return np.asarray(column, column.dtype.newbyteorder("="), order="C")


def stack(columns: Sequence[NDArray[Any]] | NDArray[Any]) -> NDArray[Any]:
    """Return three columns of (m,), or the first three of one (m, k) array, as (m, 3).

    The dtype is common to all. Floats of other than 4 or 8 bytes become float32 or float64.
    """
    dtype = np.result_type(*(column.dtype.newbyteorder("=") for column in columns))
    if dtype.kind == "f" and dtype.itemsize not in (4, 8):
        dtype = np.dtype(np.float32 if dtype.itemsize < 4 else np.float64)
    if len(columns) == 1:
        return np.asarray(columns[0][:, :3], dtype, order="C")
    out = np.empty((len(columns[0]), 3), dtype)
    for k, column in enumerate(columns):
        out[:, k] = column.reshape(len(out))
    return out
