"""Measure estimated normals: errors on exact shapes, fractions of flipped ones on scans, seconds and memory.

    python -m bench.preparation.normals [scan.ply ...] [--count 50000] [--sizes 1000000 10000000]

Angle errors (median, root mean square, fraction over 20 degrees) are relative to exact normals, with noise of 0, 0.1
and 0.5 spacings sqrt(area / n). A scan's own normals are withheld and then compared; those over 90 degrees off are
flipped.
"""

from __future__ import annotations

import argparse
import threading
import time
from pathlib import Path

import numpy as np

import pointray as pr
from pointray.procedural_models import area


def shapes(count: int) -> dict[str, tuple[np.ndarray, np.ndarray, float]]:
    """Positions, normals and area: blue noise on the built-in models, random points on a torus and a cube."""
    rng = np.random.default_rng(5)
    made = {}
    for name in ("sphere", "torus", "statue", "lattice"):
        points = pr.procedural(name, count)
        made[name] = (points.positions, points.normals, area(name))
    u, v = rng.uniform(0, 2 * np.pi, (2, 3 * count))
    kept = rng.uniform(0, 1.4, 3 * count) < 1 + 0.4 * np.cos(v)
    u, v = u[kept][:count], v[kept][:count]
    normals = np.stack([np.cos(v) * np.cos(u), np.cos(v) * np.sin(u), np.sin(v)], axis=1)
    made["torus, random"] = (np.stack([np.cos(u), np.sin(u), 0 * u], 1) + 0.4 * normals, normals, 1.6 * np.pi**2)
    faces, normals = rng.integers(0, 6, count), np.zeros((count, 3))
    normals[np.arange(count), faces // 2] = faces % 2 * 2 - 1
    made["cube, random"] = (np.where(normals != 0, normals, rng.uniform(-1, 1, (count, 3))), normals, 24.0)
    return made


def print_errors(count: int) -> None:
    print(f"degrees off, {count:,} points: median, rms, share over 20")
    for name, (positions, normals, size) in shapes(count).items():
        row = []
        for noise in (0, 0.1, 0.5):
            shift = np.random.default_rng(1).normal(size=positions.shape) * noise * np.sqrt(size / len(positions))
            found = pr.estimate_normals(pr.Points(positions + shift)).normals
            angle = np.degrees(np.arccos(np.clip(np.abs(np.sum(found * normals, axis=1)), 0, 1)))
            rms = np.sqrt((angle**2).mean())
            row.append(f"{noise} h: {np.median(angle):6.2f} {rms:6.2f} {(angle > 20).mean():7.2%}")
        print(f"  {name:15}", " | ".join(row))


def print_flipped(paths: list[Path]) -> None:
    for path in paths:
        points = pr.read(path)
        if points.normals is None:
            continue
        found = pr.estimate_normals(points).normals
        print(f"  {path.stem:35} flipped {(np.sum(found * points.normals, axis=1) < 0).mean():.4%}")


def resident() -> int:
    """Bytes of this process in memory now (Linux)."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096


def print_cost(count: int, noise: float) -> None:
    """Print wall and processor seconds, and the largest growth of memory, sampled a hundred times a second."""
    points = pr.procedural("statue", count)
    shift = np.random.default_rng(0).normal(size=(count, 3)) * noise * np.sqrt(area("statue") / count)
    points = pr.Points(points.positions + shift.astype(np.float32))
    before, most, stop = resident(), [0], threading.Event()

    def watch() -> None:
        while not stop.wait(0.01):
            most[0] = max(most[0], resident() - before)

    watcher = threading.Thread(target=watch)
    watcher.start()
    wall, cpu = time.perf_counter(), time.process_time()
    pr.estimate_normals(points)
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    stop.set()
    watcher.join()
    print(f"  statue, {count:,} points, noise {noise} h: {wall:.1f} s ({cpu:.1f} s of processors), ", end="")
    print(f"{most[0] / 2**20:,.0f} MiB more, {most[0] / count:.0f} bytes a point")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scans", nargs="*", type=Path)
    parser.add_argument("--count", type=int, default=50_000)
    parser.add_argument("--sizes", nargs="*", type=int, default=[1_000_000, 10_000_000])
    args = parser.parse_args()
    pr.estimate_normals(pr.procedural("sphere", 20_000))
    print_errors(args.count)
    print_flipped(args.scans)
    for size in args.sizes:
        for noise in (0, 0.1):
            print_cost(size, noise)


if __name__ == "__main__":
    main()
