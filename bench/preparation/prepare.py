"""Measure the preparation from raw points to the first picture: stages, points a second, memory, growth, and peers.

    python -m bench.preparation.prepare [--points 100000 1000000 4000000 10000000 24000000] [--shape statue|torus]
                            [--runs 1] [--only normals plain noise scans peers view]
                            [--folder FOLDER] [--models FOLDER] [--json FILE]

normals  points with normals; plain: without; noise: without, and moved by 0.3 spacings in all directions
scans    the clouds of `shared/models`, unchanged
peers    20 neighbours by scipy, pykdtree, small_gicp and Open3D; normals of 16 neighbours by the last two, with errors
view     `pointray view` of a PLY until the full picture, without its cache

Each case runs in a separate process, with all kernels compiled before. The peak is that of the process while a stage
runs. "Own" seconds of a stage exclude nested stages. Growth is the time a point relative to that of the first size.
--runs takes the median of several runs. --folder keeps the clouds for other runs: the statue of 24 million points takes
minutes to make; the torus, which has random points, takes seconds.
"""

from __future__ import annotations

import argparse
import json
import math
import statistics
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

import pointray as pr
from bench.helpers.truth import FOLDER
from bench.preparation.stages import STAGES
from pointray.procedural_models import area

HERE = Path(__file__).parent
CASES = {"normals": (), "plain": ("--without-normals",), "noise": ("--without-normals", "--noise")}
TITLES = {"normals": "with normals", "plain": "without normals", "noise": "without normals, noise of 0.3 h"}
NOISE = 0.3  # spacings
ORDER = ("read", *STAGES, "whole model", "levels")
SIZE = 1280, 720  # of the viewer's picture
SCANS = {".ply", ".las", ".laz", ".pcd", ".e57", ".ptx", ".pts", ".xyz"}

Figures = dict[str, Any]


def torus(count: int) -> pr.Points:
    """Random points of the torus of radii 1 and 0.4, with its normals."""
    from bench.noise.clouds import Torus

    positions, normals = Torus().points(count, np.random.default_rng(1))
    return pr.Points(positions, normals=normals)


def file_of(shape: str, count: int, folder: Path) -> Path:
    """Return the PLY of a cloud with normals, generated if missing."""
    path = folder / f"{shape}_{count}.ply"
    if not path.exists():
        part = path.with_suffix(".part.ply")
        pr.write(part, torus(count) if shape == "torus" else pr.procedural(shape, count))
        part.rename(path)
    return path


def spacing_of(shape: str, count: int) -> float:
    """The root of the area per point."""
    return math.sqrt((1.6 * np.pi**2 if shape == "torus" else area(shape)) / count)


def child(program: str, *words: object) -> Figures:
    """What a program of this folder prints; a ValueError has the last line of its complaint."""
    command = [sys.executable, str(HERE / program), *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise ValueError((done.stderr.strip().splitlines() or ["it ended"])[-1])
    if done.stderr:
        sys.stderr.write(done.stderr)
    found: Figures = json.loads(done.stdout)
    return found


def median_of(rows: list[Figures]) -> Figures:
    """Medians of each stage's figures."""
    names = dict.fromkeys(name for row in rows for name in row["stages"])
    stages = {
        name: {
            what: statistics.median(row["stages"][name][what] for row in rows if name in row["stages"])
            for what in ("seconds", "own", "processor", "peak")
        }
        for name in names
    }
    return {"points": rows[0]["points"], "stages": stages}


def staged(case: str, options: argparse.Namespace, folder: Path) -> Iterator[tuple[str, Figures]]:
    """Figures of a case at each size."""
    for count in options.points:
        words: list[object] = [*CASES[case]]
        if case == "noise":
            words.append(NOISE * spacing_of(options.shape, count))
        file = file_of(options.shape, count, folder)
        rows = [child("stages.py", file, *words) for _ in range(options.runs)]
        yield f"{options.shape} {TITLES[case]}", median_of(rows)


def stage_table(title: str, rows: list[Figures]) -> Table:
    """A row for each stage and size."""
    table = Table(title=title)
    for name in ("stage", "points", "s", "own s", "points/s", "cpu s", "cpu s/million", "peak GiB", "growth"):
        table.add_column(name, justify="left" if name == "stage" else "right")
    for stage in ORDER:
        first = None
        for row in rows:
            spent = row["stages"].get(stage)
            if spent is None:
                continue
            count, seconds = row["points"], max(spent["seconds"], 1e-9)
            first = first or seconds / count
            growth = f"{seconds / count / first:.2f}"
            memory = f"{spent['peak'] / 2**30:.2f}" if spent["peak"] else ""
            cells = [f"{count:,}", f"{seconds:.3f}", f"{spent['own']:.3f}", f"{count / seconds:,.0f}"]
            cells += [f"{spent['processor']:.3f}", f"{1e6 * spent['processor'] / count:.3f}", memory, growth]
            table.add_row(stage, *cells, end_section=row is rows[-1])
    return table


def peer_table(row: Figures) -> Table:
    """Neighbours and normals by each way, and how many times as fast as the fastest peer ours is."""
    table = Table(title=f"peers, {row['points']:,} points")
    for name in ("what", "by", "s", "points/s", "cpu s", "ours is x times as fast", "median, degrees", "rms, degrees"):
        table.add_column(name, justify="left" if name in ("what", "by") else "right")
    for what in ("neighbours", "normals"):
        ours = row[what]["pointray"]["seconds"]
        for name, found in row[what].items():
            cells = [f"{found['seconds']:.3f}", f"{row['points'] / found['seconds']:,.0f}", f"{found['processor']:.3f}"]
            cells.append(f"{found['seconds'] / ours:.2f}")
            cells += [f"{found[key]:.3f}" if key in found else "" for key in ("median", "rms")]
            table.add_row(what, name, *cells)
        table.add_section()
    return table


def scans(models: Path) -> Iterator[tuple[str, Figures]]:
    """Figures of each scan of a folder; unreadable files and files that are not clouds are skipped."""
    for path in sorted(path for part in ("points", "raw") for path in (models / part).glob("*")):
        if path.suffix.lower() in SCANS:
            try:
                yield path.name, child("stages.py", path)
            except ValueError as error:
                print(f"{path.name} skipped: {error}", file=sys.stderr)


def scan_table(rows: list[tuple[str, Figures]]) -> Table:
    """A row for each scan: seconds of the main stages."""
    table, stages = Table(title="scans"), ("read", "noise and layers", "normals", "radii", "tree", "whole model")
    for name in ("scan", "points", *(f"{stage}, s" for stage in stages), "points/s", "cpu s/million", "peak GiB"):
        table.add_column(name, justify="left" if name == "scan" else "right")
    for name, row in rows:
        spent = [row["stages"].get(stage, {"seconds": 0.0}) for stage in stages]
        whole, count = row["stages"]["whole model"], row["points"]
        cells = [f"{found['seconds']:.3f}" for found in spent]
        cells += [f"{count / max(whole['seconds'], 1e-9):,.0f}", f"{1e6 * whole['processor'] / count:.3f}"]
        table.add_row(name, f"{count:,}", *cells, f"{whole['peak'] / 2**30:.2f}")
    return table


def view_table(rows: list[tuple[int, Figures]]) -> Table:
    """Seconds from the command `pointray view` to each event."""
    table = Table(title="pointray view, seconds from the command")
    for name in ("points", "event", "s"):
        table.add_column(name, justify="left" if name == "event" else "right")
    for count, events in rows:
        for event, seconds in events.items():
            table.add_row(f"{count:,}", event, f"{seconds:.2f}")
        table.add_section()
    return table


def views(options: argparse.Namespace, folder: Path) -> Iterator[tuple[int, Figures]]:
    """Events of the viewer at each size: the median of the runs, after one that compiles kernels."""
    from bench.viewer.viewer import measure_opening

    for count in options.points:
        file = file_of(options.shape, count, folder)
        runs = [measure_opening(file, SIZE, count, options=("--no-cache",))["s"] for _ in range(options.runs + 1)][1:]
        names = [name for name in runs[0] if all(name in run for run in runs)]
        yield count, {name: statistics.median(run[name] for run in runs) for name in names}


def measured(options: argparse.Namespace, folder: Path, console: Console) -> Figures:
    """All figures, printed as they come."""
    found: Figures = {}
    for case in options.only:
        try:
            if case in CASES:
                rows = list(staged(case, options, folder))
                console.print(stage_table(rows[0][0], [row for _, row in rows]))
                found[case] = rows
            elif case == "scans":
                found[case] = list(scans(options.models))
                console.print(scan_table(found[case]))
            elif case == "peers":
                found[case] = []
                for count in options.points:
                    row = child("peers.py", file_of(options.shape, count, folder))
                    console.print(peer_table(row))
                    found[case].append(row)
            else:
                found[case] = list(views(options, folder))
                console.print(view_table(found[case]))
        except (ValueError, ImportError) as error:
            console.print(f"{case} stops here: {error}")
    return found


def main(arguments: list[str] | None = None) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    names = (*CASES, "scans", "peers", "view")
    parser.add_argument("--points", type=int, nargs="+", default=[100_000, 1_000_000])
    parser.add_argument("--shape", choices=("statue", "torus"), default="statue")
    parser.add_argument("--only", nargs="+", choices=names, default=names)
    parser.add_argument("--runs", type=int, default=1)
    parser.add_argument("--folder", type=Path, help="keep generated clouds in this folder")
    parser.add_argument("--models", type=Path, default=FOLDER.parent)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args(arguments)
    if min(options.points) < 1000 or options.runs < 1:
        parser.error("--points must be at least 1,000, --runs at least 1")
    warnings.simplefilter("ignore")
    console = Console(width=None if sys.stdout.isatty() else 160)
    with tempfile.TemporaryDirectory(prefix="pointray-") as name:
        folder = options.folder or Path(name)
        folder.mkdir(parents=True, exist_ok=True)
        found = measured(options, folder, console)
    if options.json:
        options.json.write_text(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
