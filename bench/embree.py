"""pointray beside Embree's oriented discs: the same points, radii and camera rays, in turn, in one run.

    python bench/embree.py [--points 1000000] [--size 512] [--runs 9] [--surface apss] [scan.ply]

Prints million rays a second of both, the ratio (medians of alternating runs; Embree's better query counts), whether
the hit shares agree, and the frame rate at 1 million against 32,000 points.
"""

from __future__ import annotations

import argparse
import statistics
import time
import warnings
from collections.abc import Callable

import numpy as np

import pointray as pr
from embree_discs import ABSENT, Discs, available, tile_order
from pointray.jit import keep, kernel, run, take
from pointray.records import World, lend_world
from pointray.scratch import LANES, lend_scratch, new_scratch
from pointray.trace.world import aim, tile_hit, trace_tile
from pointray.vec import triple

BATCH = 1024


@kernel
def depths(work, world, origins, directions, t):  # type: ignore[no-untyped-def]
    """Closest hit of each ray, t only: what Embree is asked for."""
    memory = new_scratch(world.longest)
    scratch, world = lend_scratch(memory), lend_world(world)
    block = take(work)
    while block >= 0:
        end = min((block + 1) * BATCH, t.size)
        for first in range(block * BATCH, end, LANES):
            for k in range(LANES):
                i = min(first + k, end - 1)
                aim(scratch, k, (triple(origins, 3 * i), triple(directions, 3 * i), 0.0, np.inf))
            trace_tile(world, 1.0, scratch)
            for i in range(first, min(first + LANES, end)):
                t[i] = tile_hit(scratch, i - first).t
        block = take(work)
    keep(memory)
    return 0


class Ours:
    """pointray over a model and fixed rays."""

    def __init__(self, model: pr.Model) -> None:
        scene = pr.Scene()
        scene.add(model)
        self.scene = scene
        self.world: World = scene._world()[0]

    def closest(self, origins: np.ndarray, directions: np.ndarray, threads: int) -> np.ndarray:
        """t of each ray (float64 rays, flat)."""
        t = np.empty(origins.size // 3)
        run(depths, -(-t.size // BATCH), self.world, origins, directions, t, threads=threads)
        return t


def alternate(calls: dict[str, Callable[[], object]], runs: int) -> dict[str, float]:
    """Median seconds of each call, run in turn."""
    for call in calls.values():
        call()
    times: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(runs):
        for name, call in calls.items():
            start = time.perf_counter()
            call()
            times[name].append(time.perf_counter() - start)
    return {name: statistics.median(values) for name, values in times.items()}


def load(name: str | None, count: int) -> pr.Points:
    """A scan, or the statue."""
    return pr.read(name) if name else pr.procedural("statue", count)


def beside(points: pr.Points, options: argparse.Namespace) -> float:
    """Print the comparison for one cloud; returns our seconds a frame."""
    model = pr.Model(points, surface=options.surface)
    camera = pr.Camera.frame(model.bounds, (0.45, -1.0, 0.2), size=(options.size, options.size))
    order = tile_order(options.size, options.size)
    origins, directions = (a.reshape(-1, 3)[order] for a in camera.rays())
    flat = np.ascontiguousarray(origins).reshape(-1), np.ascontiguousarray(directions).reshape(-1)
    single = [np.ascontiguousarray(a, np.float32) for a in (origins - points.origin, directions)]
    ours, discs = Ours(model), Discs(points.positions, points.normals, model.radii)
    times = alternate(
        {
            "pointray": lambda: ours.closest(*flat, options.threads),
            "Embree, single rays": lambda: discs.closest(*single, threads=options.threads),
            "Embree, packets of 16": lambda: discs.closest(*single, threads=options.threads, packets=True),
        },
        options.runs,
    )
    rays = options.size**2
    share = np.isfinite(ours.closest(*flat, options.threads)).mean(), np.isfinite(discs.closest(*single)).mean()
    print(f"{len(points):,} points, surface {model.surface}, {options.size}x{options.size}, {options.threads} threads")
    for name, seconds in times.items():
        print(f"  {name:24s} {1e3 * seconds:7.1f} ms  {rays / seconds / 1e6:6.2f} million rays/s")
    best = min(seconds for name, seconds in times.items() if name != "pointray")
    print(f"  Embree's better / pointray: {best / times['pointray']:.2f}   hits {share[0]:.4f} and {share[1]:.4f}")
    discs.close()
    return times["pointray"]


def main() -> None:
    """Run the comparison for the cloud asked for, and for 32,000 points."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scan", nargs="?")
    parser.add_argument("--points", type=int, default=1_000_000)
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--runs", type=int, default=9)
    parser.add_argument("--surface", default=None)
    parser.add_argument("--threads", type=int, default=2)
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    if not available():
        print(ABSENT)
        return
    large = beside(load(options.scan, options.points), options)
    if options.scan is None:
        small = beside(load(None, 32_000), options)
        print(f"frame rate at {options.points:,} / at 32,000 points: {small / large:.2f}")


if __name__ == "__main__":
    main()
