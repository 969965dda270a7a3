"""Measure scans larger than memory: parts, pictures of them, and workers of Dask.

    python -m bench.scale.stages all --folder FOLDER
    python -m bench.scale.stages make|prepare|view|same|cluster|faults|paper|docs --folder FOLDER [--points 100000000]
                          [--memory 2GiB] [--resident 1GiB] [--part-points N] [--format ply] [--without-normals]

make      a city of distinct points, 40 bytes each, in tiles on disk: statues on relief ground
prepare   `pointray prepare --memory`: resident memory of all processes, time by stage, disk
view      the first picture in a fresh process, from afar and from near, and a flight with a budget of memory
same      the scan whole and in 8 and 64 parts: hits, frames, bytes
cluster   two workers of one thread beside one process of two: a film, paths, rays, `prepare`, and parts on workers
faults    kill -9 of a worker in the middle of each
paper     a billion points on ten machines, from the rows
docs      the tables of docs/scale.md

Stages run in the order given; `all` runs make, prepare and view with --points, then same, cluster and faults with a
tenth of it. Rows are stored in FOLDER/scale.json and replace earlier ones of the same stage and size. All output stays
in FOLDER: 30 GB at most for 100 million points. A stage creates missing inputs.

Memory is read every 50 ms from /proc: "resident" is VmRSS, as shown by `ps`, including pages of mapped files, summed
over all processes of the command (shared pages count for each); the peak of each process (VmHWM) is read too.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

from rich.console import Console

from bench.scale.city import City
from bench.scale.paper import markdown, table
from bench.scale.prepare import Options, keep, make_tiles, prepare
from bench.scale.rows import Row
from bench.scale.same import same
from bench.scale.view import view

LARGE, SMALL = ("make", "prepare", "view"), ("same", "cluster", "faults")
STAGES = (*LARGE, *SMALL, "paper", "docs")
LEAST = 50_000  # points


def cluster(options: Options) -> Iterable[Row]:
    """See `scale_cluster`, which needs Dask."""
    from bench.scale.cluster import cluster

    return cluster(options)


def faults(options: Options) -> Iterable[Row]:
    """See `scale_cluster`, which needs Dask."""
    from bench.scale.cluster import faults

    return faults(options)


WORK: dict[str, Callable[[Options], Iterable[Row]]] = {
    "make": make_tiles,
    "prepare": prepare,
    "view": view,
    "same": same,
    "cluster": cluster,
    "faults": faults,
}


def run(stage: str, options: Options, console: Console) -> None:
    """Run a stage, store its rows and print them."""
    if stage == "paper":
        console.print(table(options.rows()))
    elif stage == "docs":
        print(markdown(options.rows()))
    else:
        keep(options, stage, list(WORK[stage](options)), console)


def main(arguments: list[str] | None = None) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("stages", nargs="+", choices=(*STAGES, "all"))
    parser.add_argument("--folder", type=Path, required=True, help="folder for tiles, models and rows")
    parser.add_argument("--points", type=int, default=100_000_000)
    parser.add_argument("--memory", default="2GiB", help="of `prepare`")
    parser.add_argument("--resident", default="1GiB", help="of `view`")
    parser.add_argument("--part-points", type=int)
    parser.add_argument("--format", choices=("ply", "las", "laz"), default="ply")
    parser.add_argument("--without-normals", action="store_true")
    parser.add_argument("--size", default="640x480")
    parser.add_argument("--frames", type=int, default=100)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--workers", type=int, default=2)
    words = parser.parse_args(arguments)
    if words.points < LEAST or words.runs < 1 or words.frames < 1:
        parser.error(f"--points must be at least {LEAST:,}, --runs and --frames at least 1")
    width, height = map(int, words.size.split("x"))
    options = Options(
        folder=words.folder,
        city=City(words.points, words.format, not words.without_normals),
        memory=words.memory,
        resident=words.resident,
        part_points=words.part_points,
        size=(width, height),
        frames=words.frames,
        runs=words.runs,
        workers=words.workers,
    )
    console = Console(width=None if sys.stdout.isatty() else 160)
    tenth = replace(options, city=replace(options.city, points=max(words.points // 10, LEAST)))
    for stage in STAGES if "all" in words.stages else words.stages:
        run(stage, tenth if "all" in words.stages and stage in SMALL else options, console)


if __name__ == "__main__":
    main()
