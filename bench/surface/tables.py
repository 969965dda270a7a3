"""Output of `accuracy.py`: a line for each row, the tables of demands and of choice, and the plot."""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from bench.helpers.measure import Row
from bench.helpers.truth import MESHES
from bench.surface.verdicts import Verdict
from pointray.model.model import SURFACE

COLORS = {"disc": "#9a9a9a", "paper": "#d98c21", "imls": "#3a8f5c", "apss": "#1f5fa8"}
HEAD = (
    f"{'shape':8}{'sampling':>9}{'points':>10}{'noise':>6} {'surface':>7} {'N':>2}{'ref.':>5} {'radii':>8}"
    f"{'rays':>12}{'holes':>7}{'missed':>7}{'phantoms':>9}{'depth h':>10}{'99%':>9}{'normal':>8}{'99%':>7}"
    f"{'overlap':>8}{'refs':>6}{'ms':>7}{'cost':>6}"
)


@contextmanager
def beside(path: Path) -> Iterator[Path]:
    """A file to write to, which gets its final name when it is complete."""
    part = path.with_name(f".{os.getpid()}-{path.name}")
    try:
        yield part
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


def line(r: Row) -> str:
    """A row as one line under `HEAD`."""
    return (
        f"{r.shape:8}{r.sampling:>9}{r.n:>10,}{r.noise:>6g} {r.surface:>7} {r.samples:>2}{r.refine:>5} {r.radii:>8}"
        f"{r.rays:>12,}{r.holes:>7,}{r.missed:>7,}{r.phantoms:>9,}{r.depth_rms:>10.3g}{r.depth_p99:>9.4f}"
        f"{r.normal_mean:>8.3f}{r.normal_p99:>7.2f}{r.overlap:>8.2f}{r.references:>6.2f}{r.ms:>7.1f}{r.cost:>6.2f}"
    )


def verdict_table(found: list[Verdict]) -> Table:
    """Every demand with its figure."""
    table = Table("", "demand", "seen", box=None, header_style="bold", padding=(0, 2, 0, 0))
    words = {True: "[green]met[/]", False: "[red]NOT met[/]", None: "[dim]not measured[/]"}
    for verdict in found:
        table.add_row(words[verdict.met], verdict.demand, verdict.seen)
    return table


def choice_table(rows: list[Row]) -> Table:
    """Surfaces, samples and refinements over all clouds of a run, best first. A star: no other is better and cheaper.

    Errors are geometric means, relative to the default's on the same cloud. Holes and phantoms are sums. Cost is the
    geometric mean of the frame times, as multiples of those of flat discs.
    """
    groups: dict[tuple[str, int, int], list[Row]] = defaultdict(list)
    for row in rows:
        groups[row.surface, row.samples, row.refine].append(row)
    baseline = groups[SURFACE, 4, 1]
    figures = {key: _figures(some, baseline) for key, some in groups.items()}
    columns = ("", "surface", "N", "refine", "cost", "holes", "phantoms", "depth", "even", "random", "noise", "normals")
    table = Table(*columns, "even", "random", "noise", box=None, header_style="bold")
    for column in table.columns[2:]:
        column.justify = "right"
    for key, f in sorted(figures.items(), key=lambda item: item[1]["depth"] * item[1]["normal"]):
        rivals = [g for g in figures.values() if g is not f]
        beaten = any(all(g[k] <= f[k] for k in ("cost", "holes", "phantoms", "depth", "normal")) for g in rivals)
        errors = [
            f"{f[what + part]:.2f}" for what in ("depth", "normal") for part in ("", " even", " random", " noise")
        ]
        counts = f"{f['holes']:,.0f}", f"{f['phantoms']:,.0f}"
        table.add_row("" if beaten else "*", *map(str, key), f"{f['cost']:.2f}", *counts, *errors)
    return table


def _figures(rows: list[Row], baseline: list[Row]) -> dict[str, float]:
    """Sums and geometric means over the clouds of one setting."""
    found = {
        "cost": _geometric([r.cost for r in rows]),
        "holes": float(sum(r.holes for r in rows)),
        "phantoms": float(sum(r.phantoms for r in rows)),
    }
    pairs = list(zip(rows, baseline, strict=True))
    parts: dict[str, Any] = {
        "": lambda r: True,
        " even": lambda r: r.sampling == "even" and not r.noise,
        " random": lambda r: r.sampling == "random" and not r.noise,
        " noise": lambda r: r.noise > 0,
    }
    for part, wanted in parts.items():
        some = [(r, u) for r, u in pairs if wanted(r)]
        found["depth" + part] = _geometric([r.depth_rms / u.depth_rms for r, u in some])
        found["normal" + part] = _geometric([r.normal_mean / u.normal_mean for r, u in some])
    return found


def _geometric(values: list[float]) -> float:
    return float(np.exp(np.mean(np.log(values)))) if values else np.nan


def plot(path: Path, rows: list[Row]) -> bool:
    """Plot depth and normal errors over the number of points, a column a shape; False without matplotlib."""
    try:
        import matplotlib
    except ImportError:
        return False
    matplotlib.use("Agg")
    from matplotlib import pyplot

    rows = [r for r in rows if r.noise == 0 and r.radii == "auto" and r.hits]
    shapes = list(dict.fromkeys("meshes" if r.shape in MESHES else r.shape for r in rows))
    if not shapes:
        return True
    figure, axes = pyplot.subplots(
        2, len(shapes), figsize=(1 + 2.7 * len(shapes), 6), sharex=True, sharey="row", squeeze=False
    )
    for column, shape in enumerate(shapes):
        some = [r for r in rows if r.shape == shape or (shape == "meshes" and r.shape in MESHES)]
        for axis, attribute in zip(axes[:, column], ("depth_rms", "normal_mean"), strict=True):
            _curves(axis, some, attribute)
        axes[0, column].set_title(shape)
        axes[1, column].set_xlabel("points")
    axes[0, 0].set_ylabel("depth, rms, in h = sqrt(area / n)")
    axes[1, 0].set_ylabel("normal, mean, degrees")
    _legend(figure, axes, rows)
    with beside(path) as part:
        figure.savefig(part, dpi=130, format=path.suffix[1:] or "png")
    pyplot.close(figure)
    return True


def _curves(axis: Any, rows: list[Row], attribute: str) -> None:
    """One panel: a colour for each surface, solid lines for even points, dashed ones for random, marks for meshes."""
    for surface, color in COLORS.items():
        for sampling, style in (("even", "o-"), ("random", "o--"), ("vertices", "D")):
            chosen = {r.n: r for r in rows if (r.surface, r.sampling) == (surface, sampling)}
            some = [chosen[n] for n in sorted(chosen)]
            hollow = "white" if sampling == "random" else color
            values = [getattr(r, attribute) for r in some]
            axis.plot([r.n for r in some], values, style, color=color, markersize=4, markerfacecolor=hollow)
            for r in some if sampling == "vertices" and surface == SURFACE else []:
                axis.annotate(
                    r.shape, (r.n, getattr(r, attribute)), (0, 6), textcoords="offset points", ha="center", fontsize=8
                )
    axis.set_xscale("log")
    axis.set_yscale("log")
    axis.xaxis.set_minor_formatter("")
    axis.margins(x=0.12, y=0.12)
    axis.grid(True, which="major", color="#e4e4e4", linewidth=0.6)
    axis.spines[["top", "right"]].set_visible(False)


def _legend(figure: Any, axes: Any, rows: list[Row]) -> None:
    from matplotlib.lines import Line2D

    surfaces = [s for s in COLORS if any(r.surface == s for r in rows)]
    handles = [Line2D([], [], color=COLORS[s], label=s) for s in surfaces]
    handles += [Line2D([], [], color="black", linestyle=s, label=w) for s, w in (("-", "even"), ("--", "random"))]
    figure.legend(handles=handles, loc="upper center", ncols=len(handles), frameon=False)
    figure.tight_layout(rect=(0, 0, 1, 0.94))
