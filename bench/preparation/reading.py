"""Compare reading files of points with reading them by a library alone, in the same run: times and memory.

    python -m bench.preparation.reading [--points 10000000] [--runs 3] [--only LAS ...]

Files are generated first, with colours, intensity, classes and times. "Bare" is the library reading the same arrays:
all columns extracted, coordinates scaled. Memory is the peak of a separate process beyond its memory after reading a
small file, relative to the size of the points. Finally the time until a second `pointray view` of the LAS file has its
model.
"""

from __future__ import annotations

import argparse
import resource
import statistics
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np

import pointray as pr

Bare = Callable[[Path], object]
CHILD = """
import sys
import numpy as np
import pointray as pr
def most(reset=False):
    if reset:
        open("/proc/self/clear_refs", "w").write("5")  # else the most is that of the parent
    return 1024 * next(int(line.split()[1]) for line in open("/proc/self/status") if line.startswith("VmHWM"))
small, large = sys.argv[1:]
pr.read(small)
before = most(True)
points = pr.read(large)
taken = most() - before
arrays = [points.positions, points.normals, points.colors, *points.attributes.values()]
print(taken / sum(array.nbytes for array in arrays if array is not None))
"""


def scan(count: int) -> pr.Points:
    """A wavy field of points, as an aeroplane scans it: coordinates of a map, to the millimetre."""
    dice = np.random.default_rng(1)
    side = np.sqrt(count) / 2
    x, y = dice.random(count) * side, np.sort(dice.random(count)) * side
    z = 20 * np.sin(x / 50) * np.cos(y / 70)
    xyz = np.round(np.stack([x + 512_000, y + 5_400_000, z + 300], axis=1), 3)
    attributes = {
        "intensity": dice.integers(0, 65536, count).astype(np.uint16),
        "classification": dice.integers(1, 7, count).astype(np.uint8),
        "gps_time": np.sort(dice.random(count)) * 1000 + 3e8,
    }
    georeference = pr.Georeference("EPSG:25832", "metre", (0.001,) * 3, (512_000, 5_400_000, 0))
    return pr.Points(
        xyz, colors=dice.integers(0, 256, (count, 3)).astype(np.uint8), attributes=attributes, georeference=georeference
    )


def bare_las(path: Path) -> object:
    import laspy

    las = laspy.read(path)
    return np.array(las.xyz), [np.array(las[name]) for name in las.point_format.dimension_names if name not in "XYZ"]


def bare_ply(path: Path) -> object:
    from plyfile import PlyData

    rows = PlyData.read(path, mmap=False)["vertex"].data
    return [np.array(rows[name]) for name in rows.dtype.names]


def bare_npz(path: Path) -> object:
    with np.load(path) as file:
        return [file[name] for name in file.files]


def bare_npy(path: Path) -> object:
    rows = np.load(path)
    return [np.array(rows[name]) for name in rows.dtype.names]


def bare_text(path: Path) -> object:
    return np.loadtxt(path)


def bare_e57(path: Path) -> object:
    import pye57

    return pye57.E57(str(path)).read_scan(0, colors=True, intensity=True, ignore_missing_fields=True)


def write_text(path: Path, points: pr.Points) -> None:
    np.savetxt(path, np.column_stack([points.world, points.colors]), ["%.3f"] * 3 + ["%d"] * 3)


def write_e57(path: Path, points: pr.Points) -> None:
    import pye57

    x, y, z = points.world.T
    red, green, blue = np.asarray(points.colors).T
    data = {
        "cartesianX": x,
        "cartesianY": y,
        "cartesianZ": z,
        "intensity": points.attributes["intensity"].astype(float),
    }
    data |= {"colorRed": red, "colorGreen": green, "colorBlue": blue}
    with pye57.E57(str(path), mode="w") as file:
        file.write_scan_raw({name: np.ascontiguousarray(column) for name, column in data.items()})


FORMATS: dict[str, tuple[str, Bare, Callable[[Path, pr.Points], None], float]] = {
    # name: extension, the library's reading, how the file is made, the share of the points in it
    "LAS": (".las", bare_las, pr.write, 1.0),
    "LAZ": (".laz", bare_las, pr.write, 1.0),
    "PLY": (".ply", bare_ply, pr.write, 1.0),
    "NPZ": (".npz", bare_npz, pr.write, 1.0),
    "NPY": (".npy", bare_npy, pr.write, 1.0),
    "E57": (".e57", bare_e57, write_e57, 1.0),
    "text": (".xyz", bare_text, write_text, 0.2),
}


def seconds(work: Callable[[], object]) -> float:
    begun = time.perf_counter()
    work()
    return time.perf_counter() - begun


def measure(name: str, folder: Path, points: pr.Points, runs: int) -> str:
    """A row of the table."""
    extension, bare, write, share = FORMATS[name]
    count = int(len(points) * share)
    large, small = folder / f"large{extension}", folder / f"small{extension}"
    write(large, points.select(np.arange(count)) if share < 1 else points)
    write(small, points.select(np.arange(1000)))
    pr.read(small)
    bare(small)
    pairs = [(seconds(lambda: pr.read(large)), seconds(lambda: bare(large))) for _ in range(runs)]
    own, library = (statistics.median(column) for column in zip(*pairs, strict=True))
    ratio = statistics.median(a / b for a, b in pairs)
    child = subprocess.run([sys.executable, "-c", CHILD, small, large], capture_output=True, text=True, check=True)
    return (
        f"{name:6} {count / own / 1e6:8.2f} {count / library / 1e6:8.2f}  {ratio:6.2f}  {float(child.stdout):8.2f}"
        f"  {large.stat().st_size / count:7.1f}"
    )


def second_view(folder: Path) -> str:
    """Compare the time to open a cached model with that to build it."""
    from pointray.model import model_cache

    path = folder / "large.las"
    entry = model_cache.entry_of([path], {"bench": True})
    begun = time.perf_counter()
    model = pr.Model(pr.read(path))
    model.make_levels()
    building = time.perf_counter() - begun
    time.sleep(model_cache.SETTLED)
    storing = seconds(lambda: entry.store(model))
    loading = seconds(entry.load)
    size = entry.path.stat().st_size / 2**20
    entry.path.unlink()
    return f"built in {building:.1f} s, kept in {storing:.1f} s ({size:,.0f} MiB), loaded in {loading:.2f} s"


def main() -> None:
    warnings.simplefilter("ignore")  # what formats cannot hold
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--points", type=int, default=10_000_000)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--only", nargs="+", choices=[*FORMATS, "view"], default=[*FORMATS, "view"])
    options = parser.parse_args()
    points = scan(options.points)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        print("       million points a second")
        print("format    ours     bare   times    memory  bytes a point")
        for format in FORMATS:
            if format in options.only:
                print(measure(format, folder, points, options.runs), flush=True)
        if "view" in options.only:
            if not (folder / "large.las").exists():
                pr.write(folder / "large.las", points)
            del points
            print(second_view(folder))
    print(f"at most {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20:.1f} GiB in this process")


if __name__ == "__main__":
    main()
