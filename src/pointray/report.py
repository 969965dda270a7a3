"""Facts as a table or as JSON."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from .data import Points
from .neighbors import distinct, neighbors
from .points.cleaning import find_flaws

SAMPLE = 200_000  # rows whose spacing is measured


def describe(points: Points) -> dict[str, Any]:
    """What is in a cloud, and what pointray does about what is missing."""
    low, high = points.bounds
    finite, flaws = points.positions[points.finite], find_flaws(points)
    facts: dict[str, Any] = {
        "points": len(points),
        "low": [float(x) for x in low],
        "high": [float(x) for x in high],
        "size": [float(x) for x in high - low],
        "spacing": _spacing(finite),
        "origin": [float(x) for x in points.origin],
        "normals": points.normals is not None,
        "colors": points.colors is not None,
        "attributes": sorted(points.attributes),
        "not_finite": len(points) - len(finite),
        "duplicates": int(flaws.duplicates.sum()),
        "outliers": int(flaws.outliers.sum()),
    }
    missing = []
    if points.normals is None:
        missing.append("normals: they will be estimated")
    else:
        lengths = np.linalg.norm(points.normals, axis=1)
        lost = int((~((lengths > 0) & np.isfinite(lengths))).sum())
        if lost:
            which = "all" if lost == len(points) else f"{lost:,} of {len(points):,}"
            missing.append(f"{which} normals: zero or not finite, they will be estimated")
    if points.colors is None:
        missing.append("colors: the surface will be white")
    if facts["not_finite"]:
        missing.append("some positions: those points will be left out")
    facts["missing"] = missing
    return facts


def _spacing(positions: np.ndarray[Any, Any]) -> float:
    """Median distance to the nearest neighbour in another place."""
    positions = positions[distinct(positions)[0]]
    if len(positions) < 2:
        return 0.0
    step = -(-len(positions) // SAMPLE)
    distances, _ = neighbors(positions, 2, positions[::step])
    return float(np.median(distances[:, 1]))


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
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return f"{value:,}"
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, list):
        return ", ".join(f"{v:.12g}" if isinstance(v, float) else str(v) for v in value) or "none"
    return str(value)
