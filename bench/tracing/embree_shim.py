"""Measure what calling Embree from Numba costs: the loop of `embree_peers.py` against `embree_loop.cpp`.

    python -m bench.tracing.embree_shim [--points 1000000] [--size 512] [--repeats 15]

Both trace the same camera rays at a torus of splats, with the rays in tiles of 4 x 4 pixels. Needs g++ and Embree's
headers (Debian and Ubuntu: `libembree-dev`) besides the library.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bench.tracing.embree_peers import ABSENT, Discs, available, tile_order

SOURCE = Path(__file__).with_name("embree_loop.cpp")
THREADS = 2
KINDS = ("singles", "packets")
FILES = ("spheres", "normals", "origins", "directions")

Floats = NDArray[np.float32]


def torus(count: int, major: float = 1.0, minor: float = 0.4) -> tuple[Floats, Floats, np.float32]:
    """Positions and normals (count, 3), evenly random over a torus, and a radius: 8 splats over a point."""
    random = np.random.default_rng(7)
    angles = random.uniform(0, 2 * np.pi, (3 * count, 2))
    keep = random.uniform(0, major + minor, 3 * count) < major + minor * np.cos(angles[:, 1])
    around, tube = angles[keep][:count].T
    normals = np.stack([np.cos(around) * np.cos(tube), np.sin(around) * np.cos(tube), np.sin(tube)], 1)
    centres = major * np.stack([np.cos(around), np.sin(around), np.zeros_like(around)], 1)
    spacing = np.sqrt(4 * np.pi**2 * major * minor / count)
    return (centres + minor * normals).astype(np.float32), normals.astype(np.float32), np.float32(1.6 * spacing)


def camera(size: int) -> tuple[Floats, Floats]:
    """Origins and unit directions (size * size, 3), row by row, of a camera that looks down at the torus."""
    eye = np.array([0.0, -3.2, 2.4])
    forward = -eye / np.linalg.norm(eye)
    right = np.array([1.0, 0.0, 0.0])
    up = np.cross(right, forward)
    pixel = ((np.arange(size) + 0.5) / size * 2 - 1) * 0.42
    directions = forward + pixel[None, :, None] * right - pixel[:, None, None] * up
    directions = (directions / np.linalg.norm(directions, axis=-1, keepdims=True)).reshape(-1, 3)
    return np.broadcast_to(eye, directions.shape).astype(np.float32), directions.astype(np.float32)


def compile_loop(folder: Path) -> Path | str:
    """The compiled C++ program, or the reason why there is none."""
    compiler = shutil.which("g++")
    if compiler is None:
        return "g++ is not installed"
    program = folder / "embree_loop"
    command = [compiler, "-std=c++17", "-O3", "-march=native", str(SOURCE), "-o", str(program), "-lembree3", "-pthread"]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    if done.returncode:
        return "the C++ loop does not compile (are Embree's headers installed?): " + done.stderr.strip()[:300]
    return program


class Frame(NamedTuple):
    """Cost and result of one frame. `cpu` sums the threads and is hardly affected by other programs."""

    wall: float  # milliseconds
    cpu: float  # milliseconds
    hits: int
    mean: float  # distance of the hits


def native(process: subprocess.Popen[str], kind: str) -> Frame:
    """One frame of the C++ program."""
    assert process.stdin is not None and process.stdout is not None
    print(kind, file=process.stdin, flush=True)
    wall, cpu, hits, mean = process.stdout.readline().split()
    return Frame(float(wall), float(cpu), int(hits), float(mean))


def shim(discs: Discs, origins: Floats, directions: Floats, kind: str) -> Frame:
    """One frame from Numba."""
    wall, cpu = time.perf_counter(), time.process_time()
    t = discs.closest(origins, directions, threads=THREADS, packets=kind == "packets")
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    hit = np.isfinite(t)
    return Frame(1e3 * wall, 1e3 * cpu, int(hit.sum()), float(t[hit].mean(dtype=np.float64)))


def compare(discs: Discs, process: subprocess.Popen[str], rays: tuple[Floats, Floats], repeats: int) -> None:
    """Print the medians and the median of the ratios of neighbouring frames, for singles and packets."""
    for kind in KINDS:
        pairs = []
        for _ in range(repeats + 1):
            ours, theirs = shim(discs, *rays, kind), native(process, kind)
            if ours.hits != theirs.hits or abs(ours.mean - theirs.mean) > 1e-6 * theirs.mean:
                raise SystemExit(f"{kind}: results of the two loops differ: {ours} and {theirs}")
            pairs.append((ours[:2], theirs[:2]))
        times = np.array(pairs[1:])  # the first frame compiles; axes: frame, Numba or C++, wall or processor
        ratio = np.median(times[:, 0] / times[:, 1], axis=0)
        (numba_wall, numba_cpu), (cpp_wall, cpp_cpu) = np.median(times, axis=0)
        print(f"{kind}: {ours.hits / len(rays[0]):.1%} of the rays hit")
        print(f"    wall       Numba {numba_wall:6.1f} ms, C++ {cpp_wall:6.1f} ms, ratio {ratio[0]:.3f}")
        print(f"    processor  Numba {numba_cpu:6.1f} ms, C++ {cpp_cpu:6.1f} ms, ratio {ratio[1]:.3f}")


def main() -> None:
    """Compile, dump, run both in turn."""
    parser = argparse.ArgumentParser(description="Cost of calling Embree from Numba, against C++.")
    parser.add_argument("--points", type=int, default=1_000_000)
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--repeats", type=int, default=15)
    options = parser.parse_args()
    if not available():
        print(f"skipped: {ABSENT}")
        return
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        program = compile_loop(folder)
        if isinstance(program, str):
            print(f"skipped: {program}")
            return
        positions, normals, radius = torus(options.points)
        order = tile_order(options.size, options.size)
        origins, directions = (rays[order] for rays in camera(options.size))
        spheres = np.column_stack([positions, np.full(len(positions), radius)])
        for item, array in zip(FILES, (spheres, normals, origins, directions), strict=True):
            np.ascontiguousarray(array, np.float32).tofile(folder / item)
        discs = Discs(positions, normals, radius)
        command = [str(program), name, str(THREADS)]
        with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
            compare(discs, process, (origins, directions), options.repeats)
            assert process.stdin is not None
            process.stdin.close()
        print(f"Embree {discs.version}, packets of 16 {'native' if discs.native_packets else 'split'}")
        discs.close()


if __name__ == "__main__":
    main()
