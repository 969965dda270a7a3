"""Scattered points: how large their spheres are, and in which direction their neighbourhood lies open."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ....base.arguments import check_choice, check_positive
from ....base.choices import AS_SPHERES, AS_SURFACE, AUTO, SCATTER
from ....cloud.kd_ordering import Path, along_path
from ....cloud.neighbors import NeighborTree
from ....cloud.points import Points
from ....cloud.statistics import CloudStatistics
from ....engine.kernels.tree import DISCS, SPHERES
from ...tree.build import Splats
from ..gaps import largest_reach
from ..local_planes import columns_of, fit_planes

NEIGHBORS = 8  # whose distances give the local spacing
AROUND = 24  # neighbours that the direction of a neighbourhood follows from
SIZE = 0.35  # a radius, in local spacings
CLOSEST = 0.75  # the most, in distances to the nearest other place: spheres overlap by up to a half
LEAST = 0.5  # the least of a chosen radius that is left, however close the nearest place is: double points stay visible
WIDEST = 1.5  # the most, in radii of the neighbours: isolated points are not drawn much larger than others
LARGEST = 0.98  # share of all places whose radii limit those of the others: a few points far off are no balloons
FLAT = 17  # points that a disc's normal is fitted to, where points have none
PIECE = 1 << 18  # rows whose neighbours are held at once

Floats = NDArray[np.float32]


class Drawing(NamedTuple):
    """How scattered points are drawn.

    scatter : "spheres", "discs", "surface" (as all others) or "none" (left out)
    size : factor for their radii
    """

    scatter: str = AS_SURFACE
    size: float = 1.0

    @property
    def is_apart(self) -> bool:
        """Whether scattered points are sought, and drawn by themselves or left out."""
        return self.scatter != AS_SURFACE

    @property
    def facts(self) -> dict[str, Any]:
        """What files say of it; nothing where points are drawn as a surface, as in files of earlier releases."""
        if self == ALL_SURFACE:
            return {}
        return {"scatter": self.scatter, "scatter_size": self.size}

    @property
    def kind(self) -> int:
        """SPHERES or DISCS."""
        return DISCS if self.scatter == "discs" else SPHERES


ALL_SURFACE = Drawing(AS_SURFACE, 1.0)


def check_drawing(scatter: str, scatter_size: float, sized: bool = False) -> Drawing:
    """Check the parameters `scatter` and `scatter_size` of `Model`; sized : whether the points have radii."""
    if check_choice(scatter, "scatter", (AUTO, *SCATTER)) == AUTO:
        scatter = AS_SURFACE if sized else AS_SPHERES
    return Drawing(scatter, check_positive(scatter_size, "scatter_size"))


def check_mask(mask: ArrayLike | None, count: int) -> NDArray[np.bool_] | None:
    """Check a mask of scattered points: `count` bools, or None."""
    if mask is None:
        return None
    try:
        checked = np.asarray(mask)
    except ValueError as error:  # of rows of several lengths
        raise ValueError(f"_scattered must be {count} bools: {error}") from None
    if checked.dtype != np.bool_ or checked.shape != (count,):
        raise ValueError(f"_scattered must be {count} bools, not {checked.dtype} of shape {checked.shape}")
    return checked


def make_scattered(
    points: Points, mask: NDArray[np.bool_], rows: NDArray[np.int32], drawing: Drawing, given: Floats | None = None
) -> Splats:
    """Return the scattered points among some points, with radii and directions, see `shapes_of`.

    Parameters
    ----------
    points : Points
        All points, finite, also those of the surface: they are neighbours too.
    mask : (n,) bool
        Which of them are scattered, at least one.
    rows : (n,) int32
        The caller's row of each point.
    drawing : Drawing
        How they are drawn.
    given : (n,) float32, optional
        Radii of all points. None: chosen.

    Raises
    ------
    ValueError
        If all positions are equal and no radii are given.
    """
    some, along = np.flatnonzero(mask), along_path(points)
    usual = CloudStatistics.of(len(along.positions))
    radii, directions = shapes_of(points, along, drawing, given, usual, mask)
    colors = None if points.colors is None else points.colors[some]
    return Splats(points.positions[some], directions[some], radii[some], rows[some], colors)


def shapes_of(
    points: Points,
    along: Path,
    drawing: Drawing,
    given: Floats | None,
    usual: CloudStatistics,
    mask: NDArray[np.bool_] | None = None,
) -> tuple[Floats, Floats]:
    """Return the radii (n,) and directions (n, 3) that points have if they are drawn as spheres or discs.

    A sphere's direction is the mean one of its neighbourhood, from the middle of the neighbours outwards; a disc's is
    its normal, or where points have none that of the plane through its neighbours, on the side of that direction.

    Parameters
    ----------
    points : Points
        Finite.
    along : Path
        The path through them.
    given : (n,) float32, optional
        Radii. None: 0.35 of the mean distance to the 8 nearest other places, limited by the neighbours, and by the
        98th percentile of all (rounded up to 8 bits), and so that none covers 2% of a picture of the cloud.
    usual : CloudStatistics
        Knows that percentile, or finds it among the points.
    mask : (n,) bool, optional
        Which points are asked for; what is returned of others is not valid. None: all.
    """
    places = along.positions
    if len(places) > 1:
        wanted, asked = np.ones(len(places), np.bool_), usual.rows_to_ask(len(places))
        if mask is not None:
            wanted[:] = False
            wanted[along.ids[mask]] = True
            wanted[asked] = True
        chosen, outwards = _at_places(places, np.flatnonzero(wanted), asked, usual)
        if drawing.kind == DISCS and points.normals is None:
            outwards = _across(places, outwards)
        radii, directions = chosen[along.ids] if given is None else given, outwards[along.ids]
    elif given is None:
        raise ValueError(
            f"scatter: no radius can be chosen for {drawing.scatter}, as all points are at one place: give radii, or "
            "an attribute radius in the file"
        )
    else:
        radii, directions = given, np.tile(np.array([0, 0, 1], np.float32), (len(points), 1))
    if drawing.kind == DISCS and points.normals is not None:
        directions = unit_vectors(np.nan_to_num(points.normals))
    return np.asarray(radii * np.float32(drawing.size), np.float32), directions


def _at_places(
    places: Floats, some: NDArray[np.int64], asked: NDArray[np.int64], usual: CloudStatistics
) -> tuple[Floats, Floats]:
    """Radii (m,) and directions (m, 3) of spheres at some of different places in kd order, and 0 at the others.

    asked : which of these tell how large the largest are
    """
    tree, count = NeighborTree(places, in_order=True), min(AROUND + 1, len(places))
    radii, outwards = np.zeros(len(places), np.float32), np.zeros_like(places)
    near = np.zeros((len(places), min(NEIGHBORS, len(places) - 1)), np.int32)
    inner = some
    if len(some) < len(places):  # and those beside them
        beside = np.zeros(len(places), np.bool_)
        beside[tree.rows_at(near.shape[1] + 1, places[some])] = True
        inner = np.flatnonzero(beside)
    for start in range(0, len(inner), PIECE):
        part = inner[start : start + PIECE]
        found = tree.query(count, places[part])
        distances = found.distances[:, 1 : NEIGHBORS + 1]
        spacing = distances.mean(axis=1)
        radii[part] = SIZE * np.minimum(spacing, np.maximum(CLOSEST / SIZE * distances[:, 0], LEAST * spacing))
        near[part] = found.indices[:, 1 : NEIGHBORS + 1]
        outwards[part] = unit_vectors(places[part] - places[found.indices].mean(axis=1))
    limited, directions, around = np.zeros_like(radii), np.zeros_like(outwards), near[some]
    limited[some] = np.minimum(radii[some], WIDEST * np.median(radii[around], axis=1))
    most = min(usual.quantile_among("largest sphere", limited, asked, LARGEST), largest_reach(places, usual))
    np.minimum(limited, np.float32(most), out=limited)
    directions[some] = unit_vectors(outwards[some] + outwards[around].sum(axis=1))
    return limited, directions


def _across(places: Floats, outwards: Floats) -> Floats:
    """Normals of the planes through the neighbours of places in kd order, on the side of their directions."""
    if len(places) <= FLAT:
        return outwards
    planes = fit_planes(columns_of(places), NeighborTree(places, in_order=True).rows(FLAT), (0, FLAT))
    normals = unit_vectors(np.column_stack(planes[:3]))
    return np.where((normals * outwards).sum(axis=1, keepdims=True) < 0, -normals, normals)


def unit_vectors(vectors: Floats) -> Floats:
    """Vectors of unit length; up where there is no direction."""
    size = np.linalg.norm(vectors, axis=1, keepdims=True)
    known = size > 0
    out = np.divide(vectors, size, out=np.zeros_like(vectors), where=known)
    out[~known[:, 0], 2] = 1.0
    return np.asarray(out, np.float32)
