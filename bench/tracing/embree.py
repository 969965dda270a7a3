"""Compare the speed of pointray with Embree's oriented discs: the same points, radii and rays, in turn, in one run.

    python -m bench.tracing.embree [--points 1000000 32000] [--size 512] [--runs 9] [--threads 2] [--mesh MESH]
        [--reach 1.25] [--level v3] [scan.ply ...]

Each cloud is traced in the far and near views of `pointray.cli.benchmark.views`, by shadow rays from all hits of the
far view to a point light, and by one diffuse bounce from each of them. The program prints million rays a second of
both, the ratio (medians of alternating runs; Embree's faster query counts), the fractions of hits, and the frame rate
of the first cloud against the second.

With --level both use the instructions of an older processor: v3 is AVX2, v2 SSE4.2.

Both use pointray's own radii, or with --reach a multiple of the distance to the eighth neighbour, a common rule for
discs.
"""

from __future__ import annotations

import argparse
import statistics
import time
import warnings
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import pointray as pr
from bench.helpers.levels import EMBREE, add_level, restart_at
from bench.tracing.embree_peers import ABSENT, Discs, Mesh, Peer, available, tile_order
from bench.tracing.views import bounce_rays, shadow_rays
from pointray.cli.benchmark.views import far_view, near_view
from pointray.cloud.neighbors import neighbors
from pointray.engine.jit import borrow, keep_alive, kernel, next_tile, run
from pointray.engine.kernels.records import World
from pointray.engine.kernels.scratch import TILE, new_scratch
from pointray.engine.kernels.vec import load3_flat
from pointray.procedural_models import mesh, solid
from pointray.procedural_models.creases import edges_of, quarter, settled
from pointray.surface.trace.cast import _occluded
from pointray.surface.trace.hits import tile_hit
from pointray.surface.trace.world import set_ray, trace_tile

BATCH = 1024


@kernel
def depths(work, world, origins, directions, t):  # type: ignore[no-untyped-def]
    """t of the closest hit of each ray, and nothing else: what Embree is asked for."""
    memory = new_scratch(world.longest)
    scratch, world = borrow(memory), borrow(world)
    block = next_tile(work)
    while block >= 0:
        end = min((block + 1) * BATCH, t.size)
        for first in range(block * BATCH, end, TILE):
            for k in range(TILE):
                i = min(first + k, end - 1)
                set_ray(scratch, k, (load3_flat(origins, 3 * i), load3_flat(directions, 3 * i), 0.0, np.inf))
            trace_tile(world, scratch)
            for i in range(first, min(first + TILE, end)):
                t[i] = tile_hit(scratch, i - first).t
        block = next_tile(work)
    keep_alive(memory)
    return 0


class Ours:
    """pointray with a model: takes flat float64 rays, returns t or whether they are blocked."""

    def __init__(self, model: pr.Model) -> None:
        self.scene = pr.Scene()
        self.scene.add(model)
        self.world: World = self.scene.snapshot().world

    def closest(self, origins: np.ndarray, directions: np.ndarray, threads: int) -> np.ndarray:
        """t of each ray."""
        t = np.empty(origins.size // 3)
        run(depths, -(-t.size // BATCH), self.world, origins, directions, t, threads=threads)
        return t

    def occluded(self, origins: np.ndarray, directions: np.ndarray, threads: int) -> np.ndarray:
        """Whether something is within one length of each direction."""
        blocked = np.zeros(origins.size // 3, np.uint8)
        limits = np.tile([0.0, 1.0], len(blocked))
        rays = origins, directions, limits, (1, len(blocked))
        run(_occluded, -(-len(blocked) // BATCH), self.world, *rays, blocked, threads=threads)
        return blocked.view(np.bool_)


class Case(NamedTuple):
    """Rays of one kind through one cloud. shadow : whether they only ask if anything is in the way"""

    name: str
    origins: np.ndarray
    directions: np.ndarray
    shadow: bool = False
    coherent: bool = True


def alternate(calls: dict[str, Callable[[], object]], runs: int, pause: float = 0.0) -> dict[str, float]:
    """Median seconds of each call, run in turn. A pause before each lets the threads of the last one go to sleep."""
    for call in calls.values():
        call()
    times: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(runs):
        for name, call in calls.items():
            time.sleep(pause)
            start = time.perf_counter()
            call()
            times[name].append(time.perf_counter() - start)
    return {name: statistics.median(values) for name, values in times.items()}


def cases(ours: Ours, model: pr.Model, size: int) -> Iterator[Case]:
    """The rays of the comparison."""
    order, radius = tile_order(size, size), float(np.median(model.radii))
    far = far_view(model.points, model.bounds, (size, size))
    near = near_view(ours.scene, far, (size, size))
    for name, camera in (("far", far), ("near", near)):
        origins, directions = (rays.reshape(-1, 3)[order] for rays in camera.rays())
        yield Case(name, origins, directions)
    origins, directions = (rays.reshape(-1, 3)[order] for rays in far.rays())
    hits = ours.scene.intersect(origins, directions)
    yield Case("shadow", *shadow_rays(hits, model.bounds, radius), shadow=True)
    yield Case("bounce", *bounce_rays(hits, radius), coherent=False)


def compare(case: Case, ours: Ours, peers: dict[str, Peer], origin: np.ndarray, options: argparse.Namespace) -> float:
    """Print a line for each peer; returns our seconds."""
    flat = [np.ascontiguousarray(rays).reshape(-1) for rays in (case.origins, case.directions)]
    single = [np.ascontiguousarray(rays, np.float32) for rays in (case.origins - origin, case.directions)]
    mine = ours.occluded if case.shadow else ours.closest
    choices = {"threads": options.threads, "coherent": case.coherent}
    calls: dict[str, Callable[[], object]] = {"pointray": lambda: mine(*flat, options.threads)}
    for name, peer in peers.items():
        theirs = peer.occluded if case.shadow else peer.closest
        calls[name] = partial(theirs, *single, **choices)
        calls[f"{name}, packets"] = partial(theirs, *single, **choices, packets=True)
    times = alternate(calls, options.runs)
    rate = {name: len(case.origins) / seconds / 1e6 for name, seconds in times.items()}
    hits = {name: _share(calls[name](), case.shadow) for name in ("pointray", *peers)}
    for name in peers:
        better = max(rate[name], rate[f"{name}, packets"])
        print(
            f"  {case.name:8s}{len(case.origins):8,} rays {rate['pointray']:9.2f}{better:9.2f} {name:6s}"
            f"{rate['pointray'] / better:7.2f}{hits['pointray']:12.4f}{hits[name]:9.4f}",
            flush=True,
        )
    return times["pointray"]


def _share(result: Any, shadow: bool) -> float:
    """Share of the rays that hit."""
    return float(np.mean(result if shadow else np.isfinite(result)))


def statues(counts: list[int]) -> Iterator[tuple[pr.Points, np.ndarray | None]]:
    """The statue with the first number of points; then subsets (part II of the paper) with the others, and radii."""
    points = pr.procedural("statue", counts[0])
    yield points, None
    for count in counts[1:]:
        print(f"making {count:,} points of {len(points):,}: a minute", flush=True)
        yield pr.subsample(points, count=count)


def statue_mesh(triangles: int) -> tuple[np.ndarray, np.ndarray]:
    """A mesh of the statue: triangles are cut into four up to about this number, with vertices on the exact surface."""
    body = solid("statue")
    vertices, faces = mesh("statue")
    vertices = settled(body, vertices.copy())
    while 2 * len(faces) < triangles:
        ends, sides = edges_of(faces, len(vertices))
        faces = quarter(faces, sides + len(vertices))
        vertices = np.concatenate([vertices, settled(body, vertices[ends].mean(axis=1))])
    return vertices, faces


def mesh_of(options: argparse.Namespace, points: pr.Points) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (relative to the points' origin) and triangles of the mesh asked for."""
    if options.mesh == Path("statue"):
        return statue_mesh(2 * len(points))
    import trimesh

    loaded = trimesh.load(options.mesh, process=False)
    return loaded.vertices - points.origin, loaded.faces


def beside(name: str, points: pr.Points, radii: np.ndarray | None, options: argparse.Namespace) -> float:
    """Print the comparison for one cloud; returns our seconds for the far view."""
    if options.reach:
        radii = options.reach * neighbors(points.positions, 9)[0][:, -1]
    model = pr.Model(points, radii, surface=options.surface, scatter="surface")
    ours = Ours(model)
    config = EMBREE.get(options.level, "")
    peers: dict[str, Peer] = {"discs": Discs(points.positions, points.normals, model.radii, config)}
    if options.mesh:
        vertices, faces = mesh_of(options, points)
        peers["mesh"] = Mesh(vertices, faces, config)
        print(f"mesh: {len(vertices):,} vertices, {len(faces):,} triangles")
    print(f"{name}: {len(points):,} points, surface {model.surface}, {options.size}x{options.size}")
    print("          million rays/s:   pointray   Embree          ratio        hits   Embree")
    seconds = [compare(case, ours, peers, points.origin, options) for case in cases(ours, model, options.size)]
    for peer in peers.values():
        peer.close()
    return seconds[0]


def main() -> None:
    """Run the comparison for the clouds asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scans", nargs="*")
    parser.add_argument(
        "--points",
        type=int,
        nargs="+",
        default=[1_000_000, 32_000],
        help="numbers of points of the statue; all but the first are subsampled",
    )
    parser.add_argument(
        "--mesh", type=Path, help="also trace this mesh with Embree: a file of the only scan (needs trimesh), or statue"
    )
    parser.add_argument("--reach", type=float, help="radii as multiples of the distance to the eighth neighbour")
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--runs", type=int, default=9)
    parser.add_argument("--surface", default=None)
    parser.add_argument("--threads", type=int, default=2)
    add_level(parser)
    options = parser.parse_args()
    restart_at(options.level, "bench.tracing.embree")
    warnings.simplefilter("ignore")
    if not available():
        print(ABSENT)
        return
    if options.scans:
        for scan in options.scans:
            beside(Path(scan).name, pr.read(scan), None, options)
        return
    seconds = [beside("statue", *cloud, options) for cloud in statues(options.points)]
    if len(seconds) == 2:
        print(
            f"frame rate at {options.points[0]:,} / at {options.points[1]:,} points, far: {seconds[1] / seconds[0]:.2f}"
        )


if __name__ == "__main__":
    main()
