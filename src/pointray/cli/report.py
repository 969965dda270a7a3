"""pointray info: facts about the points of a scan or of a model."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np

from ..base.arrays import Floats
from ..base.progress import Progress, part_of, report_progress
from ..cloud.cleaning import Flaws, find_flaws
from ..cloud.denoising.smooth import place
from ..cloud.neighbors import distinct, kd_order, neighbors
from ..cloud.neighbors.few_queries import rows_around
from ..cloud.normals.comparison import compare_normals
from ..cloud.normals.validation import describe_normals
from ..cloud.points import Points
from ..cloud.rounding import find_rounding
from ..model.model import Model
from ..surface.splats.radii import radii_in
from ..surface.splats.support import find_support

Positions = Floats

FEW = 500_000  # maximum number of points that are always checked completely, which takes a second
SAMPLE = 200_000  # points whose spacing is measured by a search among all points
SAMPLED = 4_000  # points whose spacing is measured by a search in nearby cells
GUESS = 20_000  # points for a first estimate of the spacing, which sets the size of these cells
MEASURED, FLAWLESS, COUNTED = 0.1, 0.4, 0.95  # progress once spacing, flaws and isolated points are known
CELL = 3.0  # size of a cell in estimated spacings


def describe(points: Points, deep: bool = False, progress: Progress | None = None) -> dict[str, Any]:
    """Describe the points of a scan, and how missing normals and colours are replaced, for the command `info`.

    Parameters
    ----------
    points : Points
    deep : bool
        Whether to compute slow facts: for more than 500,000 points `duplicates`, `outliers` and a spacing from many
        points; for any number of points `lone`, which takes as long as building a model.
    progress : callable, optional
        Called with the share done.

    Returns
    -------
    dict
        JSON values; None: not measured. `spacing` is the median distance to the nearest point at another position, and
        `spacing_sample` the number of points measured. `duplicates`, `outliers` and `lone` count points: at the
        position of an earlier one, far from all others, and isolated. `steps` are the steps to which coordinates were
        rounded, 0 if fine compared with the spacing. `normals_off` is the median angle between the given and the fitted
        normals in degrees; None if there are no normals, or none can be fitted. `notes` are warnings about normals and
        rounding.
    """
    low, high = points.bounds
    is_finite = points.finite
    finite = points.positions if is_finite.all() else points.positions[is_finite]
    counts_isolated, deep = deep, deep or len(points) <= FEW
    spacing, sample = _spacing(finite) if deep else _sampled_spacing(finite)
    report_progress(progress, MEASURED)
    part = part_of(progress, MEASURED, FLAWLESS)
    flaws: Flaws | None = find_flaws(points, lambda _, share: report_progress(part, share)) if deep else None
    isolated = _count_isolated(points, finite, part_of(progress, FLAWLESS, COUNTED)) if counts_isolated else None
    report_progress(progress, COUNTED)
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
        "lone": isolated,
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
    wrong = (
        f"{describe_normals(compared)}: they will be estimated (use --normals file to keep them)"
        if compared.wrong
        else None
    )
    facts["notes"] = [note for note in (wrong, rounded) if note]
    return facts


def _count_isolated(points: Points, finite: Positions, progress: Progress | None) -> int:
    """Return the number of isolated points: a model would limit their radii, as their neighbours are far away.

    The result is 0 if the points have given radii. finite : (m, 3) float32, the positions that are finite
    """
    if radii_in(points) is not None or len(distinct(finite)[0]) < 2:
        return 0
    cloud = points if len(finite) == len(points) else points.select(points.finite)
    smoothed = place(cloud, "auto", part_of(progress, 0.0, 0.5))[0].points
    assert smoothed.normals is not None
    path = kd_order(smoothed.positions)
    positions, normals = smoothed.positions[path], smoothed.normals[path]
    rest = part_of(progress, 0.5, 1.0)
    return int(find_support(positions, normals, None, 1.0, borders=False, sheets=False, progress=rest).isolated.sum())


def describe_model(model: Model) -> dict[str, Any]:
    """Return facts about a saved model as JSON values.

    These are the kind of surface, samples in the diameter of a support, the median radius, the number of points in each
    level of detail, and the number of parts.
    """
    radii = model.radii[model.radii > 0]
    return {
        "surface": model.surface,
        "samples": model.settings.samples,
        "median_radius": float(np.median(radii)) if len(radii) else 0.0,
        "levels": [len(level.points) for level in model.levels] or _levels_of_parts(model),
        "parts": len(model.parts),
    }


def _levels_of_parts(model: Model) -> list[int]:
    """Return the number of points in each level of detail of a model in parts, without opening the parts."""
    sizes = [[level.source.file.points for level in part.levels if level.source is not None] for part in model.parts]
    return [sum(level) for level in itertools.zip_longest(*sizes, fillvalue=0)]


def _spacing(positions: Positions) -> tuple[float, int]:
    """Measure the spacing of a cloud: the median distance from a point to the nearest one at another position.

    Return it, and the number of points measured, at most 200,000, whose neighbours are searched among all points.
    """
    unique = positions[distinct(positions)[0]]
    queries = unique[:: -(-len(unique) // SAMPLE)]
    return _median_distance(unique, queries), len(queries)


def _median_distance(unique: Positions, queries: Positions) -> float:
    """Return the median distance from some positions to the nearest other one; 0 if there is none.

    unique : (n, 3) float32, without duplicates; queries : (m, 3) float32, some of them
    """
    return float(np.median(neighbors(unique, 2, queries)[0][:, 1])) if len(unique) > 1 else 0.0


def _sampled_spacing(positions: Positions) -> tuple[float, int]:
    """Measure the spacing of a large cloud: the median distance from a point to the nearest one at another position.

    Return it, and the number of points measured, about 4,000. Their neighbours are searched only in nearby cells of a
    grid: all within a cell's size are found, so a median below that size is exact for the sample.
    """
    random = np.random.default_rng(0)
    some, queries = (positions[np.unique(random.integers(len(positions), size=n))] for n in (GUESS, SAMPLED))
    diagonal = float(np.linalg.norm(positions.max(axis=0).astype(np.float64) - positions.min(axis=0)))
    guess = _spacing(some)[0] * np.sqrt(len(some) / len(positions))  # if the points lie on a surface
    cell = CELL * (guess or diagonal / np.sqrt(len(positions)))
    while cell < diagonal:
        near = positions[rows_around(positions, queries, cell)]
        spacing = _median_distance(near[distinct(near)[0]], queries)
        if 0 < spacing <= cell:
            return spacing, len(queries)
        cell *= 2
    return _spacing(positions)
