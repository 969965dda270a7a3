"""Facts as a table or as JSON."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..data import Points
from ..model import Model, _unit_normals
from ..neighbors import distinct, neighbors
from ..points.cleaning import Flaws, find_flaws
from ..points.nearby import rows_around
from ..points.normals.given import compare_normals
from ..points.rounding import find_rounding
from ..points.trust import told
from ..progress import Progress, part_of, tell
from ..splats.radii import radii_in
from ..splats.support import find_support

Positions = NDArray[np.float32]

FEW = 500_000  # points of which everything is looked for: a second
SAMPLE = 200_000  # places whose spacing is measured where all neighbours are looked for
SAMPLED = 4_000  # points whose spacing is measured where they are not
GUESS = 20_000  # points that tell how large the cells are in which neighbours are looked for
MEASURED, FLAWLESS, COUNTED = 0.1, 0.4, 0.95  # shares of the time after which spacing, flaws, lone points are known
CELL = 3.0  # the size of a cell, in spacings


def describe(points: Points, deep: bool = False, progress: Progress | None = None) -> dict[str, Any]:
    """What is in a cloud, and what pointray does about what is missing.

    Parameters
    ----------
    points : Points
    deep : bool
        Look for what takes long of more than FEW points: `duplicates` and `outliers`, which else are None, and the
        spacing from many points; and, of any number, for `lone` points, as long as a model takes, else None.
    progress : callable, optional
        Called with the share done.

    Returns
    -------
    dict
        As JSON can hold it. `spacing` is the median distance from a point to the nearest in another place, and
        `spacing_sample` of how many points. `steps` is what each coordinate was rounded to, 0 where that is not coarse
        for the spacing; `normals_off` the median angle between normals and surface in degrees, None where there are
        none or the points do not tell. `notes` says what is wrong with either.
    """
    low, high = points.bounds
    is_finite = points.finite
    finite = points.positions if is_finite.all() else points.positions[is_finite]
    lonely, deep = deep, deep or len(points) <= FEW
    spacing, sample = _spacing(finite) if deep else _sampled_spacing(finite)
    tell(progress, MEASURED)
    flaws: Flaws | None = find_flaws(points, part_of(progress, MEASURED, FLAWLESS)) if deep else None
    lone = _count_lone(points, finite, part_of(progress, FLAWLESS, COUNTED)) if lonely else None
    tell(progress, COUNTED)
    steps, rounded = find_rounding(points)
    compared = compare_normals(points, max(steps))
    facts: dict[str, Any] = {
        "points": len(points),
        "low": [float(x) for x in low],
        "high": [float(x) for x in high],
        "size": [float(x) for x in high - low],
        "spacing": spacing,
        "spacing_sample": sample,
        "steps": list(steps),
        "origin": [float(x) for x in points.origin],
        "normals": points.normals is not None,
        "normals_off": compared.angle,
        "normals_wrong": compared.wrong,
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
        missing.append("colors: the surface will be grey")
    if facts["not_finite"]:
        missing.append("some positions: those points will be left out")
    facts["missing"] = missing
    wrong = f"{told(compared)}: fitted ones will be used (--normals file keeps them)" if compared.wrong else None
    facts["notes"] = [note for note in (wrong, rounded) if note]
    return facts


def _count_lone(points: Points, finite: Positions, progress: Progress | None) -> int:
    """Points that a model would draw no larger than their neighbours' supports."""
    if radii_in(points) is not None or len(distinct(finite)[0]) < 2:
        return 0
    cloud = points if len(finite) == len(points) else points.select(points.finite)
    normals = _unit_normals(cloud, part_of(progress, 0.0, 0.5))
    rest = part_of(progress, 0.5, 1.0)
    return int(find_support(finite, normals, None, 1.0, borders=False, sheets=False, progress=rest).lone.sum())


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
        near = positions[rows_around(positions, queries, cell)]
        spacing = _median_distance(near[distinct(near)[0]], queries)
        if 0 < spacing <= cell:
            return spacing, len(queries)
        cell *= 2
    return _spacing(positions)


def show_table(facts: dict[str, Any], as_json: bool) -> None:
    """Print facts, one a line, or as one JSON object."""
    if as_json:
        print(json.dumps(facts))
        return
    from rich.console import Console
    from rich.table import Table

    table = Table(show_header=False, box=None, pad_edge=False)
    for name, value in _shown(facts).items():
        table.add_row(name.replace("_", " "), _text(value))
    Console().print(table)


def _shown(facts: dict[str, Any]) -> dict[str, Any]:
    """Facts for people: what is said of normals in one line, and nothing where there is nothing to be said."""
    shown = {name: value for name, value in facts.items() if name not in ("normals_off", "normals_wrong")}
    if shown.get("normals"):
        off, verdict = facts["normals_off"], "wrong" if facts["normals_wrong"] else "right"
        known = "nothing tells whether right" if off is None else f"a median of {off:.1f} degrees off: {verdict}"
        shown["normals"] = f"yes, {known}"
    for name in ("steps", "notes"):
        if name in shown and not any(shown[name]):
            del shown[name]
    return shown


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
