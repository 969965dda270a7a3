"""Names of the element and of the properties that hold points, in capitals or not."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

VERTICES = ("vertex", "vertices", "point", "points")
POSITIONS = (("x", "y", "z"),)
NORMALS = (("nx", "ny", "nz"), ("normal_x", "normal_y", "normal_z"))
COLORS = tuple(  # those with scalar_ are CloudCompare's
    tuple(prefix + channel for channel in channels)
    for prefix in ("", "diffuse_", "scalar_")
    for channels in (("red", "green", "blue"), ("r", "g", "b"))
)


def find(triples: Sequence[tuple[str, ...]], names: Iterable[str]) -> tuple[str, ...]:
    """Those of the names that are the first triple which is there; none if there is none. Lower case comes first."""
    known: dict[str, str] = {}
    for name in sorted(names, key=str.islower):  # the last of a spelling is kept
        known[name.lower()] = name
    return next((tuple(known[n] for n in triple) for triple in triples if known.keys() >= set(triple)), ())
