"""Compare converting clouds of Open3D to points and back with a NumPy copy of their arrays, in the same run.

    python -m bench.preparation.conversion [--points 10000000] [--runs 9]

Coordinates are those of a map. The copy is of all arrays of the cloud: positions, normals and colours. The ratio is
the median of those of alternating runs.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable
from typing import Any

import numpy as np

import pointray as pr


def seconds(work: Callable[[], Any]) -> float:
    """Return the wall time of a call."""
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def compare(name: str, cloud: Any, arrays: list[np.ndarray], runs: int, **options: Any) -> None:
    """Print the times of both conversions and of a copy of the arrays, and the median of their ratio."""
    points = pr.as_points(cloud)
    assert np.abs(points.world - arrays[0]).max() < 1e-3  # both did the same work
    times = []
    for _ in range(runs):
        copy = seconds(lambda: [array.copy() for array in arrays])
        times.append((copy, seconds(lambda: pr.as_points(cloud)), seconds(lambda: points.to_open3d(**options))))
    copy, there, back = map(statistics.median, zip(*times, strict=True))
    ratio = statistics.median((there + back) / copy for copy, there, back in times)
    print(f"{name:28} copy {copy:.3f} s, to points {there:.3f} s, back {back:.3f} s: {ratio:.2f} times the copy")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, default=10_000_000)
    parser.add_argument("--runs", type=int, default=9)
    options = parser.parse_args()
    import open3d

    rng, n, tensor = np.random.default_rng(0), options.points, open3d.core.Tensor.from_numpy
    world = rng.random((n, 3)) * [1000, 1000, 50] + [512000, 5400000, 300]
    normals, colors = rng.random((n, 3)).astype(np.float32), rng.integers(0, 256, (n, 3)).astype(np.uint8)
    bare = open3d.t.geometry.PointCloud(tensor(world))
    compare("t.PointCloud, positions", bare, [world], options.runs)
    full = bare.clone()
    full.point["normals"], full.point["colors"] = tensor(normals), tensor(colors)
    compare("t.PointCloud", full, [world, normals, colors], options.runs)
    older = full.to_legacy()
    arrays = [np.asarray(values) for values in (older.points, older.normals, older.colors)]
    compare("geometry.PointCloud", older, arrays, max(options.runs // 3, 1), legacy=True)


if __name__ == "__main__":
    main()
