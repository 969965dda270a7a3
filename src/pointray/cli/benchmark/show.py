"""The table of frame rates as text, JSON or a plot."""

from __future__ import annotations

import importlib.util
import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import IO, cast

from ...base.atomic_write import check_writable, replacing
from .frames import Row

PLOTS = (".png", ".svg", ".pdf")


def show_rows(rows: Sequence[Row], threads: int, as_json: bool) -> None:
    """Print the measured cases as a table or as JSON. threads : number of threads that rendered"""
    if as_json:
        print(json.dumps({"threads": threads, "cases": [asdict(row) for row in rows]}))
        return
    from rich.console import Console
    from rich.table import Table

    table = Table(box=None, pad_edge=False, title=f"the statue on {threads} threads", title_justify="left")
    for name in ("points", "view", "size", "light", "hit", "ms", "fps", "paper", "B/point", "model s"):
        table.add_column(name, justify="left" if name in ("view", "light") else "right")
    for r in rows:
        paper = "" if r.paper_frames_per_second is None else f"{r.paper_frames_per_second:.1f}"
        table.add_row(
            f"{r.points:,}",
            r.view,
            r.size,
            r.light,
            f"{r.covered:.0%}",
            f"{r.frame_ms:.1f}",
            f"{r.frames_per_second:.1f}",
            paper,
            f"{r.bytes_per_point:.0f}",
            f"{r.seconds_for_model:.2f}",
        )
    Console().print(table)
    print("paper: Wald and Seidel (2005), two 2.4 GHz Opterons; for 32,000 points it says 'comparable' to 1,000,000")


def check_plot(path: Path) -> None:
    """Raise an error if a plot cannot be written: unsupported extension, missing folder, or missing matplotlib."""
    if path.suffix.lower() not in PLOTS:
        raise ValueError(f"{path}: a plot must be {', '.join(PLOTS)}, not {path.suffix or 'a file without extension'}")
    check_writable(path)
    if importlib.util.find_spec("matplotlib") is None:
        raise ValueError("--plot needs matplotlib: pip install 'pointray[plot]'")


def plot(path: Path, rows: Sequence[Row]) -> None:
    """Draw a bar chart of the measured frame rates beside those that the paper reports, and write it to a file."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axis = pyplot.subplots(figsize=(7.2, 0.9 + 0.5 * len(rows)), layout="constrained")
    heights = range(len(rows))[::-1]
    here = axis.barh([y + 0.2 for y in heights], [r.frames_per_second for r in rows], 0.38, label="here")
    reported = [r.paper_frames_per_second or 0.0 for r in rows]
    paper = axis.barh([y - 0.2 for y in heights], reported, 0.38, label="paper (2005)")
    axis.bar_label(here, fmt="%.1f", padding=3)
    axis.bar_label(paper, [f"{t:.1f}" if t else "no figure" for t in reported], padding=3)
    axis.set_yticks(list(heights), [f"{r.points:,}, {r.view}" for r in rows])
    axis.set_xlabel("frames a second")
    axis.margins(x=0.12)
    axis.spines[["top", "right"]].set_visible(False)
    axis.legend(frameon=False)
    with replacing(path) as beside:
        figure.savefig(cast(IO[bytes], beside), dpi=150, format=path.suffix[1:].lower())
    pyplot.close(figure)
