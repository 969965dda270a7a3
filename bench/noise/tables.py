"""Output of `noise.py`: the table of requirements, targets and measurements, CSV, and the plot."""

from __future__ import annotations

import csv
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from bench.noise.measure import Row
from bench.noise.surfaces import CLEARED, OURS
from bench.surface.tables import beside

COLORS = {"pointray": "#1f5fa8", "smooth=0": "#7fb0df", "Poisson": "#d98c21", "RIMLS": "#3a8f5c"}
WORDS = {
    "depth": "depth rms, h",
    "bias": "bias, h",
    "high": "99.9% of the errors, h",
    "worst": "largest error, h",
    "normals": "normals rms, degrees",
    "flipped": "normals flipped, %",
    "roughness": "roughness, h",
    "lost": "rays lost, %",
    "far": "hits over 10 h away, %",
    "seconds": "made in, s",
}
TOLD = {
    "torus": ("depth", "bias", "normals", "flipped", "lost", "seconds"),
    "clouds": ("depth", "bias", "normals", "flipped", "lost", "far", "seconds"),
    "edges": ("depth", "bias", "high", "worst", "lost"),
    "layers": ("depth", "bias", "roughness", "normals", "flipped", "lost", "far"),
}


@dataclass(frozen=True)
class Limit:
    """The most that is asked, and the aim; times : the surface or cloud whose figure of the same run they multiply"""

    asked: float
    aim: float
    times: str = ""
    least: bool = False  # whether it is the least that is asked, not the most


@dataclass(frozen=True)
class Figure:
    """One number of one surface of one cloud."""

    case: str
    cloud: str
    what: str
    surface: str
    value: float
    limit: Limit | None = None


def figures(case: str, row: Row, limits: dict[str, Limit]) -> Iterator[Figure]:
    """The figures of a row that are printed for the case."""
    for name in TOLD[case]:
        yield Figure(case, row.cloud, WORDS[name], row.surface, getattr(row, name), limits.get(name))


Group = dict[str, Figure]  # the same figure of several surfaces


def grouped(found: list[Figure]) -> dict[tuple[str, str, str], Group]:
    """Figures by case, cloud and what they are, in the order in which they came."""
    groups: dict[tuple[str, str, str], Group] = defaultdict(dict)
    for figure in found:
        groups[figure.case, figure.cloud, figure.what][figure.surface] = figure
    return groups


def limits_of(group: Group) -> tuple[float, float, bool] | None:
    """Asked, aim, and whether they are the least; None if nothing is asked, or the peer did not run."""
    limit = next((figure.limit for figure in group.values() if figure.limit), None)
    if limit is None or (limit.times and limit.times not in group):
        return None
    unit = abs(group[limit.times].value) if limit.times else 1.0
    return limit.asked * unit, limit.aim * unit, limit.least


def verdict(group: Group) -> str:
    """Whether pointray's figure meets the requirement or target; strays count as dropped where they are measured so."""
    limits = limits_of(group)
    mine = group.get(CLEARED) or group.get(OURS)
    if limits is None or mine is None:
        return ""
    asked, aim, least = limits
    value = mine.value if least else -abs(mine.value)
    asked, aim = (asked, aim) if least else (-asked, -aim)
    return "aim" if value >= aim else "met" if value >= asked else "NOT met"


def table_of(found: list[Figure]) -> Table:
    """A line for each figure: asked, aim, and what each surface gave."""
    names = list(dict.fromkeys(figure.surface for figure in found))
    table = Table("cloud", "figure", "asked", "aim", *names, "", box=None, header_style="bold")
    for column in table.columns[2:]:
        column.justify = "right"
    last = ""
    for (case, cloud, what), group in grouped(found).items():
        limits = limits_of(group)
        asked = [number(limits[0]), number(limits[1])] if limits else ["", ""]
        seen = [number(group[name].value) if name in group else "" for name in names]
        table.add_row(cloud if f"{case} {cloud}" != last else "", what, *asked, *seen, verdict(group))
        last = f"{case} {cloud}"
    return table


def number(value: float) -> str:
    """Three digits."""
    return "-" if np.isnan(value) else f"{value:,.0f}" if abs(value) >= 100 else f"{value:.3g}"


def write_csv(path: Path, found: list[Figure]) -> None:
    """All figures, with their limits."""
    with beside(path) as part, part.open("w", newline="") as file:
        writer = csv.DictWriter(file, ["case", "cloud", "what", "surface", "value", "asked", "aim"])
        writer.writeheader()
        for group in grouped(found).values():
            limits = limits_of(group)
            asked, aim = limits[:2] if limits else ("", "")
            for figure in group.values():
                row = asdict(figure) | {"asked": asked, "aim": aim}
                del row["limit"]
                writer.writerow(row)


def plot(path: Path, found: list[Figure]) -> bool:
    """Plot errors over noise for the torus and the clouds, with the requirements; False without matplotlib."""
    try:
        import matplotlib
    except ImportError:
        return False
    matplotlib.use("Agg")
    from matplotlib import pyplot

    panels = [("torus", WORDS["depth"]), ("torus", WORDS["bias"]), ("torus", WORDS["normals"])]
    panels += [(name, WORDS["depth"]) for name in ("statue", "dragon")]
    shown = [panel for panel in panels if any(f.cloud.startswith(panel[0]) and f.what == panel[1] for f in found)]
    if not shown:
        return True
    figure, axes = pyplot.subplots(1, len(shown), figsize=(3.4 * len(shown), 3.4), squeeze=False)
    for axis, (shape, what) in zip(axes[0], shown, strict=True):
        _panel(axis, [f for f in found if f.cloud.startswith(shape) and f.what == what])
        axis.set(title=f"{shape}: {what}", xlabel="noise, h")
    axes[0, 0].legend(frameon=False, fontsize=8)
    figure.tight_layout()
    with beside(path) as part:
        figure.savefig(part, dpi=130, format=path.suffix[1:] or "png")
    pyplot.close(figure)
    return True


def _panel(axis: Any, found: list[Figure]) -> None:
    """A curve for each surface; requirement and target are grey."""
    noise = lambda cloud: float(cloud.split()[-2])  # noqa: E731
    for name in dict.fromkeys(f.surface for f in found):
        some = [(noise(f.cloud), abs(f.value)) for f in found if f.surface == name]
        axis.plot(*zip(*some, strict=True), "o-", color=COLORS.get(name), markersize=4, label=name)
    limits = [(noise(key[1]), limits_of(group)) for key, group in grouped(found).items()]
    for k, (style, word) in enumerate((("--", "asked"), (":", "aim"))):
        some = [(x, limit[k]) for x, limit in limits if limit]
        if some:
            axis.plot(*zip(*some, strict=True), style, color="#909090", label=word)
    axis.set_ylim(bottom=0)
    axis.grid(True, color="#e4e4e4", linewidth=0.6)
    axis.spines[["top", "right"]].set_visible(False)
