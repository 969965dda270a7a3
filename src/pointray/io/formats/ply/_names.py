"""Names of the elements and properties that hold points, ignoring case."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

VERTICES = ("vertex", "vertices", "point", "points")
POSITIONS = (("x", "y", "z"),)
NORMALS = (("nx", "ny", "nz"), ("normal_x", "normal_y", "normal_z"))
COLORS = tuple(  # CloudCompare writes scalar_
    tuple(prefix + channel for channel in channels)
    for prefix in ("", "diffuse_", "scalar_")
    for channels in (("red", "green", "blue"), ("r", "g", "b"))
)


def find(triples: Sequence[tuple[str, ...]], names: Iterable[str]) -> tuple[str, ...]:
    """Find the names of three columns, such as x, y, z, in any case; return () if no triple is complete.

    triples : accepted names in lower case, the first complete triple wins; names : of all columns

    If two names differ in case only, the one in lower case is returned.
    """
    known: dict[str, str] = {}
    for name in sorted(names, key=str.islower):  # the last spelling wins
        known[name.lower()] = name
    return next((tuple(known[n] for n in triple) for triple in triples if known.keys() >= set(triple)), ())
