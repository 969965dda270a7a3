"""Compare the speed of scattered points drawn as spheres with Embree's spheres: the same centres, radii and rays.

    python -m bench.tracing.spheres [--points 1000000] [--size 512] [--runs 9] [--threads 2] [--scale 1.0]

The cloud is a forest: crowns of leaves, trunks and the ground's undergrowth, all of them spheres. Rays as in
`bench/tracing/embree.py`: a far and a near view, shadow rays from all hits of the far view to a point light, and one
diffuse bounce from each of them. Both run in turn; Embree's faster query counts. Needs Embree 3, see `embree_peers.py`.
"""

from __future__ import annotations

import argparse
import time
import warnings

import numpy as np
from numpy.typing import NDArray

import pointray as pr
from bench.tracing.embree import Ours, cases, compare
from bench.tracing.embree_peers import ABSENT, Peer, Spheres, available

PER_TREE = 5000  # points


def forest(count: int, seed: int = 7) -> NDArray[np.float32]:
    """Points of trees on a square, (count, 3): crowns of clumps of leaves, denser outside, and thin trunks."""
    random = np.random.default_rng(seed)
    trees = max(count // PER_TREE, 1)
    side = 3.0 * np.sqrt(trees)
    feet = np.column_stack([random.uniform(0, side, (trees, 2)), np.zeros(trees)])
    height, width = random.uniform(5, 12, trees), random.uniform(1.2, 2.2, trees)
    tree = random.integers(trees, size=count)
    direction = random.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    reach = random.random(count) ** 0.2  # most leaves are far out
    clumps = 0.8 + 0.2 * np.sin(5 * direction[:, 0] + tree) * np.sin(5 * direction[:, 1]) * np.sin(5 * direction[:, 2])
    size = np.column_stack([width[tree], width[tree], 0.35 * height[tree]])
    points = feet[tree] + direction * size * (reach * clumps)[:, None]
    points[:, 2] += 0.65 * height[tree]
    trunk = random.random(count) < 0.05
    points[trunk] = feet[tree[trunk]] + random.normal(size=(trunk.sum(), 3)) * [0.08, 0.08, 0]
    points[trunk, 2] = random.uniform(0, 0.5, trunk.sum()) * height[tree[trunk]]
    grass = random.random(count) < 0.1
    points[grass] = np.column_stack([random.uniform(0, side, (grass.sum(), 2)), random.exponential(0.1, grass.sum())])
    return points.astype(np.float32)


def main() -> None:
    """Run the comparison."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, default=1_000_000)
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--runs", type=int, default=9)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--scale", type=float, default=1.0, help="factor for all radii")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    if not available():
        print(ABSENT)
        return
    positions = forest(options.points)
    points = pr.Points(positions, np.tile([0.0, 0.0, 1.0], (len(positions), 1)))
    start = time.perf_counter()
    mask = np.ones(len(points), np.bool_)
    model = pr.Model(points, scatter="spheres", scatter_size=options.scale, smooth=0.0, _scattered=mask)
    built = time.perf_counter()
    peers: dict[str, Peer] = {"spheres": Spheres(points.positions, model.radii)}
    print(
        f"forest: {len(points):,} spheres, median radius {np.median(model.radii):.3g}; "
        f"seconds to build: {built - start:.2f}, Embree {time.perf_counter() - built:.2f} (radii given)"
    )
    print("          million rays/s:   pointray   Embree          ratio        hits   Embree")
    ours = Ours(model)
    for case in cases(ours, model, options.size):
        compare(case, ours, peers, points.origin, options)
    peers["spheres"].close()


if __name__ == "__main__":
    main()
