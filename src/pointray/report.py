"""Facts as a table or as JSON."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .data import Points
from .model import Model, _unit_normals
from .neighbors import distinct, neighbors
from .points.cleaning import Flaws, find_flaws
from .splats.radii import radii_in
from .splats.support import find_support

Positions = NDArray[np.float32]

FEW = 500_000  # points of which everything is looked for: a second
SAMPLE = 200_000  # places whose spacing is measured where all neighbours are looked for
SAMPLED = 4_000  # points whose spacing is measured where they are not
GUESS = 20_000  # points that tell how large the cells are in which neighbours are looked for
CELL = 3.0  # the size of a cell, in spacings
TABLE = 1 << 24  # cells are known by so many numbers
CHUNK = 1 << 18  # points that are looked at together


def describe(points: Points, deep: bool = False) -> dict[str, Any]:
    """What is in a cloud, and what pointray does about what is missing.

    Parameters
    ----------
    points : Points
    deep : bool
        Look for what takes long of more than FEW points: `duplicates` and `outliers`, which else are None, and the
        spacing from many points; and, of any number, for `lone` points, as long as a model takes, else None.

    Returns
    -------
    dict
        As JSON can hold it. `spacing` is the median distance from a point to the nearest in another place, and
        `spacing_sample` of how many points.
    """
    low, high = points.bounds
    is_finite = points.finite
    finite = points.positions if is_finite.all() else points.positions[is_finite]
    lone = _count_lone(points, finite) if deep else None
    deep = deep or len(points) <= FEW
    spacing, sample = _spacing(finite) if deep else _sampled_spacing(finite)
    flaws: Flaws | None = find_flaws(points) if deep else None
    facts: dict[str, Any] = {
        "points": len(points),
        "low": [float(x) for x in low],
        "high": [float(x) for x in high],
        "size": [float(x) for x in high - low],
        "spacing": spacing,
        "spacing_sample": sample,
        "origin": [float(x) for x in points.origin],
        "normals": points.normals is not None,
        "colors": points.colors is not None,
        "attributes": sorted(points.attributes),
        "not_finite": len(points) - len(finite),
        "duplicates": None if flaws is None else int(flaws.duplicates.sum()),
        "outliers": None if flaws is None else int(flaws.outliers.sum()),
        "lone": lone,
    }
    missing = []
    if points.normals is None:
        missing.append("normals: they will be estimated")
    else:
        squares = np.einsum("ij,ij->i", points.normals, points.normals)
        lost = int((~((squares > 0) & np.isfinite(squares))).sum())
        if lost:
            which = "all" if lost == len(points) else f"{lost:,} of {len(points):,}"
            missing.append(f"{which} normals: zero or not finite, they will be estimated")
    if points.colors is None:
        missing.append("colors: the surface will be white")
    if facts["not_finite"]:
        missing.append("some positions: those points will be left out")
    facts["missing"] = missing
    return facts


def _count_lone(points: Points, finite: Positions) -> int:
    """Points that a model would draw no larger than their neighbours' supports."""
    if radii_in(points) is not None or len(distinct(finite)[0]) < 2:
        return 0
    normals = _unit_normals(points if len(finite) == len(points) else points.select(points.finite))
    return int(find_support(finite, normals, None, 1.0, borders=False, sheets=False).lone.sum())


def describe_model(model: Model) -> dict[str, Any]:
    """What a model has besides its points: its surface, and the points of each level of detail."""
    radii = model.radii[model.radii > 0]
    return {
        "surface": model.surface,
        "samples": model.settings.samples,
        "median_radius": float(np.median(radii)) if len(radii) else 0.0,
        "levels": [len(level.points) for level in model.levels],
    }


def _spacing(positions: Positions) -> tuple[float, int]:
    """Median distance to the nearest neighbour in another place, and of how many points."""
    places = positions[distinct(positions)[0]]
    queries = places[:: -(-len(places) // SAMPLE)]
    return _median_distance(places, queries), len(queries)


def _median_distance(places: Positions, queries: Positions) -> float:
    """From queries, which are places, to the nearest other place; 0 if there is none."""
    return float(np.median(neighbors(places, 2, queries)[0][:, 1])) if len(places) > 1 else 0.0


def _sampled_spacing(positions: Positions) -> tuple[float, int]:
    """The same of a sample: its neighbours are looked for among all points, but in the cells around it only.

    What is nearer than a cell's size is found, so that a median below it is that of the sample without any error.
    """
    random = np.random.default_rng(0)
    some, queries = (positions[np.unique(random.integers(len(positions), size=n))] for n in (GUESS, SAMPLED))
    diagonal = float(np.linalg.norm(positions.max(axis=0).astype(np.float64) - positions.min(axis=0)))
    guess = _spacing(some)[0] * np.sqrt(len(some) / len(positions))  # of a surface
    cell = CELL * (guess or diagonal / np.sqrt(len(positions)))
    while cell < diagonal:
        near = _in_cells_around(positions, queries, cell)
        spacing = _median_distance(near[distinct(near)[0]], queries)
        if 0 < spacing <= cell:
            return spacing, len(queries)
        cell *= 2
    return _spacing(positions)


def _in_cells_around(positions: Positions, queries: Positions, cell: float) -> Positions:
    """The positions in the cells of the queries and in the cells beside these; and a few others."""
    beside = np.stack(np.meshgrid(*[[-1, 0, 1]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    wanted = np.zeros(TABLE, np.bool_)
    for step in beside:
        wanted[_numbers_of(queries, cell, step)] = True
    chunks = (positions[start : start + CHUNK] for start in range(0, len(positions), CHUNK))
    return np.concatenate([rows[wanted[_numbers_of(rows, cell)]] for rows in chunks])


def _numbers_of(rows: Positions, cell: float, step: Any = (0, 0, 0)) -> NDArray[np.int64]:
    """A number below TABLE for the cell that is so many cells beside each row's."""
    number = np.zeros(len(rows), np.int64)
    for axis, factor in enumerate((73856093, 19349663, 83492791)):
        index = np.floor(np.clip(rows[:, axis] / np.float64(cell), -(2.0**62), 2.0**62)).astype(np.int64)
        number ^= (index + step[axis]) * factor
    return number & (TABLE - 1)


def show_table(facts: dict[str, Any], as_json: bool) -> None:
    """Print facts, one a line, or as one JSON object."""
    if as_json:
        print(json.dumps(facts))
        return
    from rich.console import Console
    from rich.table import Table

    table = Table(show_header=False, box=None, pad_edge=False)
    for name, value in facts.items():
        table.add_row(name.replace("_", " "), _text(value))
    Console().print(table)


def _text(value: Any) -> str:
    if value is None:
        return "not looked for (--deep does)"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return f"{value:,}"
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, list):
        return ", ".join(f"{v:.12g}" if isinstance(v, float) else str(v) for v in value) or "none"
    return str(value)
