"""Measure the surface's accuracy by rays through clouds of known surfaces, beside flat discs on the same points.

    python -m bench.surface.accuracy [--quick | --full | --choice] [--shapes sphere statue bunny ...]
                             [--surfaces apss disc ...] [--points 10000 ...] [--noise 0 0.1 ...] [--rays 200000]
                             [--csv FILE] [--plot FILE]

Prints a row for each cloud and surface (`measure.Row` explains the columns), then every requirement with the measured
figure. It also writes the rows as CSV and as a plot. It takes some 5 minutes on two cores. --full
goes up to 1 million points and 10 million rays, and takes some two hours. --quick measures sphere and torus only, in a
minute. --choice compares surfaces, samples N and refinement by quality and cost (some 15 minutes).

Meshes are looked for in --meshes. They need trimesh and embreex, and the plot needs matplotlib:
pip install 'pointray[dev]'.
"""

from __future__ import annotations

import argparse
import csv
import sys
import warnings
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from bench.helpers.measure import WIDE, Row, Setting, cloud_of, measure
from bench.helpers.truth import FOLDER, MESHES, Truth, truth
from bench.surface.tables import HEAD, beside, choice_table, line, plot, verdict_table
from bench.surface.verdicts import MANY, SOLID, verdicts
from pointray.model.model import SURFACE

SHAPES = ("sphere", "torus", "lattice", "statue", *MESHES)
SURFACES = ("paper", "imls", "apss", "disc")
CHOICE = [Setting("disc"), *(Setting(s, n, r) for s in SURFACES[:3] for n in (2, 3, 4, 6, 8) for r in (0, 1, 2))]


@dataclass(frozen=True)
class Case:
    """A cloud to be measured, and the settings to measure it with."""

    shape: str
    sampling: str
    n: int
    noise: float
    settings: tuple[Setting, ...]
    rays: int


def cases(options: argparse.Namespace) -> Iterator[Case]:
    """The cases of a run, in the order of the table."""
    settings = tuple(Setting(s) for s in options.surfaces)
    for shape in options.shapes:
        for sampling in ("vertices",) if shape in MESHES else ("even", "random"):
            for n in (0,) if shape in MESHES else options.points:
                for noise in options.noise if options.full or n in (0, options.points[-1]) else options.noise[:1]:
                    some = settings
                    if noise == 0 and n in (0, 100_000) and SURFACE in options.surfaces:
                        some = (*settings, Setting(SURFACE, radii=WIDE))
                    yield Case(shape, sampling, n, noise, some, options.rays)
            if shape in SOLID and options.full and SURFACE in options.surfaces:
                yield Case(shape, sampling, 100_000, 0.0, (Setting(SURFACE),), MANY)
        if shape == "statue" and not options.quick and 1_000_000 not in options.points:
            yield Case(shape, "even", 1_000_000, 0.0, settings, options.rays)


def choice_cases(options: argparse.Namespace) -> Iterator[Case]:
    """The cases by which surface, samples and refinement are chosen."""
    for shape in ("torus", "statue"):
        for sampling in ("even", "random"):
            for noise in (0.0, 0.1):
                yield Case(shape, sampling, options.points[0], noise, tuple(CHOICE), options.rays)


def measured(todo: list[Case], folder: Path, console: Console) -> Iterator[Row]:
    """Yield the rows of all cases and print them. Missing meshes are skipped with a message."""
    columns = TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), TimeRemainingColumn()
    known: dict[str, Truth] = {}
    console.print(HEAD, style="bold", soft_wrap=True, highlight=False)
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bars:
        bar = bars.add_task("", total=sum(case.rays * len(case.settings) for case in todo))
        for case in todo:
            bars.update(bar, description=f"{case.shape} {case.n or ''} {case.sampling}")
            if case.shape not in known:
                try:
                    known = {case.shape: truth(case.shape, folder)}
                except ValueError as error:
                    console.print(f"{case.shape} skipped: {error}")
                    continue
            cloud = cloud_of(known[case.shape], case.sampling, case.n, case.noise)
            for row in measure(cloud, list(case.settings), case.rays, lambda done: bars.advance(bar, done)):
                console.print(line(row), soft_wrap=True, highlight=False)
                yield row


def write_csv(path: Path, rows: list[Row]) -> None:
    """All figures of all rows."""
    with beside(path) as part, part.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(asdict(rows[0])))
        writer.writeheader()
        writer.writerows(asdict(row) for row in rows)


def parsed(arguments: list[str] | None) -> argparse.Namespace:
    """The options, where --quick, --full and --choice have been expanded."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    size = parser.add_mutually_exclusive_group()
    for name in ("quick", "full", "choice"):
        size.add_argument(f"--{name}", action="store_true")
    parser.add_argument("--shapes", nargs="+", choices=SHAPES, metavar="NAME")
    parser.add_argument("--surfaces", nargs="+", choices=SURFACES, metavar="NAME")
    parser.add_argument("--points", nargs="+", type=int, metavar="N")
    parser.add_argument("--noise", nargs="+", type=float, metavar="H")
    parser.add_argument("--rays", type=int)
    parser.add_argument("--meshes", type=Path, default=FOLDER)
    parser.add_argument("--csv", type=Path, default=Path("accuracy.csv"))
    parser.add_argument("--plot", type=Path, default=Path("accuracy.png"))
    options = parser.parse_args(arguments)
    shapes, surfaces, points, noise, rays = SHAPES, (SURFACE, "disc"), (10_000, 100_000), (0.0, 0.1), 200_000
    if options.quick:
        shapes, noise, rays = SHAPES[:2], (0.0,), 100_000
    if options.full:
        surfaces, noise, rays = SURFACES, (0.0, 0.1, 0.5), 1_000_000
        points = (10_000, 30_000, 100_000, 300_000, 1_000_000)
    if options.choice:
        points, rays = (20_000,), 40_000
    for name, value in (
        ("shapes", shapes),
        ("surfaces", surfaces),
        ("points", points),
        ("noise", noise),
        ("rays", rays),
    ):
        if getattr(options, name) is None:
            setattr(options, name, value)
    if options.rays < 1 or min(options.points) < 1 or min(options.noise) < 0:
        parser.error("--rays and --points must be at least 1, --noise at least 0")
    return options


def main(arguments: list[str] | None = None) -> None:
    """Measure, print, write."""
    options = parsed(arguments)
    console = Console(width=None if sys.stdout.isatty() else 160)
    warnings.simplefilter("ignore")
    todo = list((choice_cases if options.choice else cases)(options))
    rows: list[Row] = []
    try:
        for row in measured(todo, options.meshes, console):
            rows.append(row)  # noqa: PERF402  # those of a run that is broken off count
    finally:
        if rows:
            write_csv(options.csv, rows)
            console.print(f"wrote {len(rows)} rows to {options.csv}")
    if options.choice:
        console.print(choice_table(rows))
        return
    console.print(verdict_table(verdicts(rows, SURFACE)))
    if plot(options.plot, rows):
        console.print(f"wrote the plot to {options.plot}")
    else:
        console.print("no plot: pip install 'pointray[dev]' brings matplotlib")


if __name__ == "__main__":
    main()
