"""A child of `prepare.py`: neighbours and normals of one cloud by pointray and its peers, in turn.

    python -m bench.preparation.peers FILE [--runs 3] [--k 20] [--neighbors 16]

Prints JSON: for each way the median seconds and processor seconds, and the errors of its normals in degrees. Peers
that are not installed are left out with a message. All get the same points in random order and as many threads.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import pointray as pr
from pointray.engine.jit import thread_count

os.environ["OMP_NUM_THREADS"] = str(thread_count())  # pykdtree and Open3D read it when they are imported

Floats = NDArray[Any]
Way = Callable[[Floats, int], Any]  # positions (n, 3) float32 and a number of neighbours -> result to compare


def ours(positions: Floats, k: int) -> Floats:
    from pointray.cloud.neighbors import neighbors

    return neighbors(positions, k)[1]


def scipy_tree(positions: Floats, k: int) -> Floats:
    from scipy.spatial import cKDTree

    return np.asarray(cKDTree(positions).query(positions, k, workers=thread_count())[1])


def pykdtree(positions: Floats, k: int) -> Floats:
    from pykdtree.kdtree import KDTree

    return np.asarray(KDTree(positions).query(positions, k)[1])


def small_gicp(positions: Floats, k: int) -> Floats:
    import small_gicp

    tree = small_gicp.KdTree(positions.astype(np.float64), num_threads=thread_count())
    return np.asarray(tree.batch_knn_search(positions.astype(np.float64), k, num_threads=thread_count())[0])


def open3d(positions: Floats, k: int) -> Floats:
    import open3d

    search = open3d.core.nns.NearestNeighborSearch(open3d.core.Tensor.from_numpy(positions))
    search.knn_index()
    return np.asarray(search.knn_search(open3d.core.Tensor.from_numpy(positions), k)[0].numpy())


def our_normals(positions: Floats, k: int) -> Floats:
    """A viewpoint outside makes the signs cheap, as no sign passes from point to point."""
    return np.asarray(pr.estimate_normals(pr.Points(positions), k or None, viewpoint=_outside(positions)).normals)


def our_oriented_normals(positions: Floats, k: int) -> Floats:
    return np.asarray(pr.estimate_normals(pr.Points(positions)).normals)


def open3d_normals(positions: Floats, k: int) -> Floats:
    import open3d

    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(positions.astype(np.float64)))
    cloud.estimate_normals(open3d.geometry.KDTreeSearchParamKNN(k))
    return np.asarray(cloud.normals)


def small_gicp_normals(positions: Floats, k: int) -> Floats:
    import small_gicp

    cloud = small_gicp.PointCloud(positions.astype(np.float64))
    tree = small_gicp.KdTree(cloud, num_threads=thread_count())
    small_gicp.estimate_normals(cloud, tree, num_neighbors=k, num_threads=thread_count())
    return np.asarray(cloud.normals())[:, :3]


NEIGHBORS: dict[str, Way] = {
    "pointray": ours,
    "scipy cKDTree": scipy_tree,
    "pykdtree": pykdtree,
    "small_gicp": small_gicp,
    "Open3D": open3d,
}
NORMALS: dict[str, Way] = {
    "pointray": our_normals,
    "pointray, oriented": our_oriented_normals,
    "Open3D": open3d_normals,
    "small_gicp": small_gicp_normals,
}


def _outside(positions: Floats) -> Floats:
    low, high = positions.min(axis=0), positions.max(axis=0)
    return np.asarray(high + 10.0 * (high - low), np.float64)


def installed(ways: dict[str, Way], sample: Floats, k: int) -> dict[str, Way]:
    """The available methods. Running them on the sample also compiles their kernels."""
    there = {}
    for name, way in ways.items():
        try:
            way(sample, k)
            there[name] = way
        except (ImportError, OSError) as error:
            print(f"{name} skipped: {error}", file=sys.stderr)
    return there


def alternated(ways: dict[str, Way], positions: Floats, k: int, runs: int) -> dict[str, dict[str, Any]]:
    """Medians of each way's seconds and processor seconds over `runs` rounds, and its last result."""
    spent: dict[str, list[tuple[float, float]]] = {name: [] for name in ways}
    results = {}
    for _ in range(runs):
        for name, way in ways.items():
            wall, processor = time.perf_counter(), time.process_time()
            results[name] = way(positions, k)
            spent[name].append((time.perf_counter() - wall, time.process_time() - processor))
    return {
        name: {
            "seconds": statistics.median(wall for wall, _ in times),
            "processor": statistics.median(processor for _, processor in times),
            "result": results[name],
        }
        for name, times in spent.items()
    }


def errors(found: Floats, exact: Floats) -> dict[str, float]:
    """Degrees between lines: the median and the root of the mean square."""
    wide, true = found.astype(np.float64), exact.astype(np.float64)
    cosine = np.abs(np.einsum("ij,ij->i", wide, true)) / np.linalg.norm(true, axis=1)
    degrees = np.degrees(np.arccos(np.clip(cosine / np.maximum(np.linalg.norm(wide, axis=1), 1e-30), 0, 1)))
    return {"median": float(np.median(degrees)), "rms": float(np.sqrt((degrees**2).mean()))}


def measure(points: pr.Points, options: argparse.Namespace) -> dict[str, Any]:
    """Figures of all ways."""
    mixed = np.random.default_rng(2).permutation(len(points))
    positions, exact = points.positions[mixed], np.asarray(points.normals)[mixed]
    sample = positions[:5000]
    near = alternated(installed(NEIGHBORS, sample, options.k), positions, options.k, options.runs)
    for row in near.values():
        del row["result"]
    found = alternated(installed(NORMALS, sample, options.neighbors), positions, options.neighbors, options.runs)
    for row in found.values():
        row |= errors(row.pop("result"), exact)
    return {"points": len(points), "neighbours": near, "normals": found}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", type=Path, help="cloud with exact normals")
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--k", type=int, default=20, help="number of neighbours to find")
    parser.add_argument("--neighbors", type=int, default=16, help="number of neighbours for a normal")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    print(json.dumps(measure(pr.read(options.file), options)))


if __name__ == "__main__":
    main()
