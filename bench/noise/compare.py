"""Measure surfaces of noisy clouds by rays: pointray against screened Poisson (Open3D) and RIMLS (MeshLab).

    python -m bench.noise.compare [--quick] [--only torus clouds edges layers wall time] [--noise 0.1 0.3 0.5 1]
                          [--shapes statue dragon] [--peers Poisson RIMLS | none] [--rays 100000]
                          [--models FOLDER] [--csv FILE] [--plot FILE]

torus   100,000 random points; the errors of the hits against the requirements
clouds  the statue of 1 million points and the dragon's vertices; the errors against those of Poisson of depth 10
edges   a cube near its edges, and the lattice, at 0.3 h
layers  walls of two layers, thin plates, drift between two scans, a veil, strays
wall    normals of a tower's wall that face away
time    preparation of a million points, frames

Noise is Gaussian, alike in all directions, in spacings h = sqrt(area / n). Distances are those of the hits to the
nearest point of the exact surface, signed, in h. pointray gets positions only; its peers get normals with the exact
signs. The column "smooth=0" is pointray without smoothing, "no strays" pointray without the strays that it finds.
--quick measures the torus at 0.3 h with 20,000 points. All takes some half an hour on two cores.
"""

from __future__ import annotations

import argparse
import sys
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path

from rich.console import Console

from bench.helpers.truth import FOLDER
from bench.noise.cases import SHAPES, TORUS, clouds, edges, torus, torus_case
from bench.noise.clouds import Torus, noisy
from bench.noise.measure import RAYS
from bench.noise.scans import layered, times, wall
from bench.noise.surfaces import PEERS, peers, warm_up
from bench.noise.tables import Figure, number, plot, table_of, write_csv

__all__ = ["main", "torus_case"]

QUICK = 20_000  # points


def cases(options: argparse.Namespace, others: list[str]) -> dict[str, Callable[[], Iterator[Figure]]]:
    """The cases by name."""
    n, rays, folder = (QUICK if options.quick else 100_000), options.rays, options.models / "meshes"
    return {
        "torus": lambda: torus(options.noise, others, n, rays),
        "clouds": lambda: clouds(options.shapes, options.noise, others, rays, folder),
        "edges": lambda: edges(others, rays=4 * rays),
        "layers": lambda: layered(others, rays // 2),
        "wall": lambda: wall(others, folder),
        "time": times,
    }


def measured(options: argparse.Namespace, others: list[str], console: Console) -> Iterator[Figure]:
    """The figures of all cases, printed as they are measured. Cases with missing files are skipped with a message."""
    made = cases(options, others)
    for name in options.only:
        try:
            for figure in made[name]():
                line = f"{name}: {figure.cloud}, {figure.surface}: {figure.what} {number(figure.value)}"
                console.print(line, style="dim", highlight=False, soft_wrap=True)
                yield figure
        except ValueError as error:
            console.print(f"{name} stops here: {error}")


def parsed(arguments: list[str] | None) -> argparse.Namespace:
    """The options, where --quick has been expanded."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    names = ("torus", "clouds", "edges", "layers", "wall", "time")
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--only", nargs="+", choices=names, default=names)
    parser.add_argument("--shapes", nargs="+", choices=SHAPES, default=SHAPES, help="shapes of the case clouds")
    parser.add_argument("--noise", nargs="+", type=float, default=list(TORUS), metavar="H")
    parser.add_argument("--peers", nargs="+", choices=(*PEERS, "none"), default=list(PEERS))
    parser.add_argument("--rays", type=int, default=RAYS)
    parser.add_argument("--models", type=Path, default=FOLDER.parent)
    parser.add_argument("--csv", type=Path, default=Path("noise.csv"))
    parser.add_argument("--plot", type=Path, default=Path("noise.png"))
    options = parser.parse_args(arguments)
    if options.quick:
        options.only, options.noise, options.rays = ["torus"], [0.3], min(options.rays, RAYS // 2)
    if options.rays < 2 or not all(0 <= noise < float("inf") for noise in options.noise):
        parser.error("--rays must be at least 2, --noise at least 0")
    return options


def main(arguments: list[str] | None = None) -> None:
    """Measure, print, write."""
    options = parsed(arguments)
    console = Console(width=None if sys.stdout.isatty() else 160)
    warnings.simplefilter("ignore")
    others, missing = peers([name for name in options.peers if name != "none"])
    for message in missing:
        console.print(message)
    warm_up(noisy(Torus(), 5000, 0.3))
    found: list[Figure] = []
    try:
        for figure in measured(options, others, console):
            found.append(figure)  # noqa: PERF402  # those of a run that is broken off count
    finally:
        if found:
            write_csv(options.csv, found)
            console.print(f"wrote {len(found)} figures to {options.csv}")
            console.print(table_of(found))
    if plot(options.plot, found):
        console.print(f"wrote the plot to {options.plot}")
    else:
        console.print("no plot: pip install 'pointray[dev]' brings matplotlib")


if __name__ == "__main__":
    main()
