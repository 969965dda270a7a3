"""Measure baked light: what arrives, beside formulas, path tracing and libigl; what it costs; and say what falls short.

    python -m bench.light.bake [--only NAME ...] [--points 1000000] [--seeds 3] [--quick] [--pictures FOLDER]

Each demand is a row with the figure measured; SHORT says that it is not met. Demands on seconds hold for a million
points on two cores; for fewer points they are as many times shorter. Pictures by path tracing take most of the time,
the first time almost an hour. They are kept (--references), keyed by the scene, the camera and the samples, not by the
code that makes them: delete them when path tracing changes. Pictures of the errors (--pictures): path, baked, and the
difference, red where baked light is brighter, blue where it is darker, full colour at a fifth of the mean.
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
    parser.add_argument("--points", type=int, help=f"of the statue; a million, or with --quick {QUICK_POINTS:,}")
    parser.add_argument("--seeds", type=int, default=3, help="bakes of each scene; the worst one counts")
    parser.add_argument("--quick", action="store_true", help="small pictures, few samples, one seed")
    parser.add_argument("--models", type=Path, default=Path(__file__).resolve().parents[3] / "shared" / "models")
    parser.add_argument("--references", type=Path, default=platformdirs.user_cache_path("pointray") / "references")
    parser.add_argument("--pictures", type=Path, help="folder for pictures of the errors")
    told = parser.parse_args(arguments)
    points = told.points or (QUICK_POINTS if told.quick else MILLION)
    seeds = 1 if told.quick else told.seeds
    return told.only, Options(points, seeds, told.quick, told.models, told.references, told.pictures)


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
