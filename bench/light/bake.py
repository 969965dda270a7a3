"""Measure the accuracy of baked light against formulas, path tracing and libigl, and its cost; report missed targets.

    python -m bench.light.bake [--only NAME ...] [--points 1000000] [--seeds 3] [--quick] [--pictures FOLDER]

Each target is a row with the measured figure; SHORT marks those that are missed. Time limits hold for a million points
on two cores, and are proportional to the number of points. Path-traced pictures take most of the time, almost an hour
on the first run. They are stored (--references), keyed by the scene, the camera and the samples, not by the code:
delete them when path tracing changes. Pictures of the errors (--pictures): path, baked, and the difference, red where
baked light is brighter, blue where it is darker, full colour at a fifth of the mean.
"""

from __future__ import annotations

import argparse
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path

import platformdirs

from bench.light.bake_exact import at_wall, below_ball, in_sphere, leaks, moved_sun, sums
from bench.light.bake_memory import memory
from bench.light.bake_occlusion import occlusion
from bench.light.bake_pictures import gloss, pictures
from bench.light.bake_rows import MILLION, Options, Row, show, show_head
from bench.light.bake_speed import baking, frames
from pointray.engine.jit import thread_count

QUICK_POINTS = 40_000
TESTS: dict[str, Callable[[Options], list[Row]]] = {
    "sphere": in_sphere,
    "ball": below_ball,
    "wall": at_wall,
    "pictures": pictures,
    "gloss": gloss,
    "bake": baking,
    "occlusion": occlusion,
    "frames": frames,
    "update": moved_sun,
    "memory": memory,
    "leaks": leaks,
    "sums": sums,
}


def options_of(arguments: list[str] | None) -> tuple[list[str], Options]:
    """The tests that are asked for, and how they are run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=list(TESTS), default=list(TESTS))
    parser.add_argument(
        "--points", type=int, help=f"number of points of the statue (default: a million, with --quick {QUICK_POINTS:,})"
    )
    parser.add_argument("--seeds", type=int, default=3, help="number of bakes of each scene; the worst one counts")
    parser.add_argument("--quick", action="store_true", help="small pictures, few samples, one seed")
    parser.add_argument("--models", type=Path, default=Path(__file__).resolve().parents[3] / "shared" / "models")
    parser.add_argument("--references", type=Path, default=platformdirs.user_cache_path("pointray") / "references")
    parser.add_argument("--pictures", type=Path, help="write pictures of the errors to this folder")
    given = parser.parse_args(arguments)
    points = given.points or (QUICK_POINTS if given.quick else MILLION)
    seeds = 1 if given.quick else given.seeds
    return given.only, Options(points, seeds, given.quick, given.models, given.references, given.pictures)


def main(arguments: list[str] | None = None) -> int:
    """Print the table."""
    names, options = options_of(arguments)
    warnings.simplefilter("ignore", UserWarning)
    print(f"{options.points:,} points, {options.seeds} seeds, {thread_count()} threads")
    show_head()
    short = 0
    for name in names:
        begun = time.perf_counter()
        rows = TESTS[name](options)
        show(rows)
        short += sum(row.ok is False for row in rows)
        print(f"  ({name}: {time.perf_counter() - begun:.0f} s)", flush=True)
    print(f"{short} short")
    return 0


if __name__ == "__main__":
    sys.exit(main())
