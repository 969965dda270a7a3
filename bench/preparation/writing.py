"""Compare writing files of points with a library that writes the same columns, in the same run: times, size, memory.

    python -m bench.preparation.writing [--points 10000000] [--runs 1] [--only PCD ...]

The cloud is that of `bench.preparation.reading`: coordinates of a map with colours, intensity, classes and times. Times
are those of the processor, of all threads, and of the wall clock. Text by NumPy is measured with a tenth of the rows.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np

import pointray as pr
from bench.preparation.reading import scan, write_e57

Write = Callable[[Path, pr.Points], object]


def bare_rows(path: Path, points: pr.Points) -> None:
    """The bytes of a binary PCD file, by NumPy alone."""
    fields = [("xyz", "<f8", 3), ("rgb", "<u4"), ("intensity", "<u2"), ("classification", "u1"), ("gps_time", "<f8")]
    rows = np.zeros(len(points), fields)
    rows["xyz"] = points.world
    for name, values in points.attributes.items():
        if name in rows.dtype.names:
            rows[name] = values
    rows.tofile(path)


def bare_text(path: Path, points: pr.Points) -> None:
    world, columns = points.world, [v for name, v in points.attributes.items() if name != "grid_residual"]
    rows = np.column_stack([world, points.colors, *columns])[::10]
    np.savetxt(path, rows, ["%.3f"] * 3 + ["%d"] * 5 + ["%.17g"])


def bare_ptx(path: Path, points: pr.Points) -> None:
    rows = np.column_stack([points.world, points.attributes["intensity"] / 65535, points.colors])[::10]
    np.savetxt(path, rows, ["%.3f"] * 3 + ["%.6f"] + ["%d"] * 3)


def bare_laz(path: Path, points: pr.Points) -> None:
    pr.write(path.with_name("bare.laz"), points)


def bare_glb(path: Path, points: pr.Points) -> None:
    import trimesh

    trimesh.PointCloud(points.positions, np.asarray(points.colors)).export(path)


def write_compressed(path: Path, points: pr.Points) -> None:
    pr.write(path, points, compressed=True)


FORMATS: dict[str, tuple[str, Write, str, Write, float]] = {
    # name: extension, writer, the peer and its writer, the share of the points that it writes
    "PCD": (".pcd", pr.write, "numpy.tofile", bare_rows, 1.0),
    "PCD compressed": (".pcd", write_compressed, "numpy.tofile", bare_rows, 1.0),
    "E57": (".e57", pr.write, "pye57", write_e57, 1.0),
    "LAZ": (".laz", pr.write, "numpy.tofile", bare_rows, 1.0),
    "COPC": (".copc.laz", pr.write, "LAZ", bare_laz, 1.0),
    "text": (".xyz", pr.write, "numpy.savetxt", bare_text, 0.1),
    "CSV": (".csv", pr.write, "numpy.savetxt", bare_text, 0.1),
    "PTX": (".ptx", pr.write, "numpy.savetxt", bare_ptx, 0.1),
    "GLB": (".glb", pr.write, "trimesh", bare_glb, 1.0),
}


def seconds(work: Callable[[], object]) -> tuple[float, float]:
    """Time of the processor and of the wall clock."""
    begun, wall = time.process_time(), time.perf_counter()
    work()
    return time.process_time() - begun, time.perf_counter() - wall


def measure(name: str, folder: Path, points: pr.Points, runs: int) -> str:
    """A row of the table."""
    extension, write, peer, bare, share = FORMATS[name]
    path = folder / f"a{extension}"
    own = [seconds(lambda: write(path, points)) for _ in range(runs)]
    size = path.stat().st_size / 1e6
    other = [seconds(lambda: bare(folder / f"b{extension}", points)) for _ in range(runs)]
    for file in folder.iterdir():
        file.unlink()
    cpu, wall = (statistics.median(t) for t in zip(*own, strict=True))
    bare_cpu = statistics.median(t for t, _ in other) / share
    return f"| {name} | {size:,.0f} | {wall:.1f} | {cpu:.1f} | {peer} | {bare_cpu:.1f} | {cpu / bare_cpu:.2f} |"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--points", type=int, default=10_000_000)
    parser.add_argument("--runs", type=int, default=1)
    parser.add_argument("--only", nargs="+", choices=FORMATS, default=list(FORMATS))
    given = parser.parse_args()
    warnings.simplefilter("ignore", UserWarning)
    points = scan(given.points)
    print("| format | MB | seconds | CPU seconds | peer | its CPU seconds | ratio |\n|---|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        for name in given.only:
            print(measure(name, Path(folder), points, given.runs), flush=True)


if __name__ == "__main__":
    main()
