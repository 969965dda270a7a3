"""Compare pictures of scans with those of other programs, at equal cameras, and write docs/comparison.md.

    python -m bench.beside [SCAN.ply ...] [--only open3d_points ...] [-o docs/comparison.md]

Each program runs in a process of its own, from file to PNG. Default: four scans of ../shared/models, about 10 minutes
on two cores. Runs of less than 10 s are repeated, in turn with the other programs. Programs that are not installed are
named, with the command that installs them.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from pathlib import Path

import pointray as pr
from bench.comparison.measure import Result, coverage, covered, overlap, run
from bench.comparison.page import KINDS, write_page
from bench.comparison.peers import PEERS
from bench.looks.scatter_sheets import size_of

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT.parent / "shared" / "models" / "points"
FAST = 10.0  # seconds: shorter runs are repeated


def compare(scan: Path, options: argparse.Namespace, folder: Path) -> tuple[Path, int, list[Result]]:
    """Run all programs with one scan; return it, its number of points, and the results."""
    points = pr.read(scan)
    camera = pr.frame(points, size=options.size)
    view = folder / "camera.json"
    names = ("eye", "target", "up", "fov", "size")
    view.write_text(json.dumps({name: getattr(camera, name) for name in names}))
    results = [Result(peer, folder / f"{peer.key}.png") for peer in PEERS if peer.key in options.only]
    for result in results:
        if result.peer.missing:
            missing = ", ".join(result.peer.missing)
            result.failure = f"not run: {missing} not installed: {result.peer.install}"
    for turn in range(options.repeat):
        for result in results:
            if not result.failure and (turn == 0 or result.seconds[0] < FAST):
                run(result, result.peer.command(scan, camera, view, result.picture))
    done = [result for result in results if not result.failure]
    surface = coverage(points, camera) if done else None
    for result in done:
        result.overlap = overlap(covered(result.picture), surface)
    for result in results:
        print(f"  {result.peer.name:28}" + (result.failure or _figures(result)), flush=True)
    return scan, len(points), results


def _figures(result: Result) -> str:
    runs = ", ".join(f"{seconds:.1f} s" for seconds in result.seconds)
    memory = f"{result.peak / 1e9:.2f} GB"
    stopped = f", stopped {result.stopped} times" if result.stopped else ""
    return f"{runs}{stopped}; {min(result.processor):.1f} processor seconds, {memory}, silhouette {result.overlap:.3f}"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scans", nargs="*", type=Path, help="PLY files with normals and colours")
    keys = [peer.key for peer in PEERS]
    parser.add_argument("--only", nargs="+", default=keys, choices=keys, help="programs to run (default: all)")
    parser.add_argument("--repeat", type=int, default=3, help=f"runs of programs that take less than {FAST:g} s")
    parser.add_argument("--size", type=size_of, default=(960, 720), help="size of a picture (default: 960x720)")
    parser.add_argument("--output", "-o", type=Path, default=ROOT / "docs" / "comparison.md")
    options = parser.parse_args()
    scans = options.scans or [FOLDER / f"{name}.ply" for name in KINDS]
    if absent := [str(scan) for scan in scans if not scan.exists()]:
        parser.error(f"scans not found: {', '.join(absent)}")
    with tempfile.TemporaryDirectory() as folder:
        results = []
        for k, scan in enumerate(scans):
            print(scan.name, flush=True)
            own = Path(folder) / str(k)
            own.mkdir()
            results.append(compare(scan, options, own))
        write_page(options.output, results, options.size, FAST)
    return 0


if __name__ == "__main__":
    sys.exit(main())
