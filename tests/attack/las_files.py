"""LAS, LAZ and COPC files with damaged bytes: refused in one line, or read with the rows that their header announces.

    python tests/attack/las_files.py COUNT SEED FOLDER [FILE ...]

It prints, as JSON, how many were refused, the longest time and the most memory. libc's limit on memory and an alarm end
it where a file makes it ask for too much, or hang.
"""

from __future__ import annotations

import json
import resource
import signal
import struct
import sys
import time
import warnings
from pathlib import Path

import laspy
import numpy as np

import pointray as pr

SECONDS, SPARE = 5, 64 << 20
NUMBERS = (0, 1, 2, 255, 2**15, 2**16 - 1, 2**31 - 1, 2**31, 2**32 - 1, 2**63 - 1, 2**63, 2**64 - 1)


def make_files(folder: Path) -> list[Path]:
    """A small LAS and LAZ file of an old and of a new point format."""
    files = []
    random = np.random.default_rng(0)
    for version, format, suffix in (("1.2", 3, ".las"), ("1.2", 3, ".laz"), ("1.4", 7, ".laz"), ("1.4", 8, ".las")):
        header = laspy.LasHeader(version=version, point_format=format)
        header.add_extra_dims([laspy.ExtraBytesParams("heat", "f4"), laspy.ExtraBytesParams("two", "2u2")])
        las = laspy.LasData(header)
        las.x, las.y, las.z = random.random((3, 2000)) * 100
        las.red = random.integers(0, 65536, 2000)
        files.append(folder / f"{version}-{format}{suffix}")
        las.write(files[-1])
    return files


def mutate(random: np.random.Generator, data: bytes, start: int) -> bytes:
    """Damage: mostly in the header, the records and the table of chunks, where numbers are believed."""
    if random.random() < 0.15:
        return data[: int(random.integers(len(data)))]
    out = bytearray(data)
    for _ in range(int(random.integers(1, 4))):
        kind = random.random()
        low, high = (0, 375) if kind < 0.4 else (0, start + 16) if kind < 0.6 else (len(data) - 3000, len(data))
        if kind > 0.8:
            low, high = start, len(data)
        at = int(random.integers(max(low, 0), min(high, len(data)) - 8))
        size = int(random.choice([1, 2, 4, 8]))
        number = int(NUMBERS[random.integers(len(NUMBERS))]) if random.random() < 0.6 else int(random.integers(2**62))
        out[at : at + size] = (number % 256**size).to_bytes(size, "little")
    return bytes(out)


def read_one(path: Path, random: np.random.Generator) -> bool:
    """Whether a file is read; AssertionError if with the wrong number of rows."""
    raw = path.read_bytes()[:375]
    options = [{}, {}, {"bounds": [-5, 1, -4, 0, 4, 2]}, {"resolution": 0.02}]
    chosen = options[int(random.integers(4))] if "copc" in path.name else {}
    try:
        points = pr.read(path, **chosen)
    except (ValueError, OSError) as error:
        assert "\n" not in str(error), str(error)
        return False
    legacy, newer = struct.unpack_from("<I", raw, 107)[0], struct.unpack_from("<Q", raw, 247)[0] if raw[25] >= 4 else 0
    assert chosen or len(points) == (newer or legacy), f"{len(points)} rows, not {newer or legacy}"
    return True


def main(count: int, seed: int, folder: Path, others: list[Path]) -> dict[str, float]:
    files = [*make_files(folder), *others]
    for file in files:
        pr.read(file)
    warnings.simplefilter("ignore")
    base, slowest, refused = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, 0.0, 0
    largest = max(len(laspy.read(file).points.array.tobytes()) for file in files)
    resource.setrlimit(resource.RLIMIT_AS, (base * 1024 + (8 << 30),) * 2)
    for number in range(count):
        random = np.random.default_rng([seed, number])
        file = files[number % len(files)]
        data = file.read_bytes()
        path = folder / f"a{file.name}"
        path.write_bytes(mutate(random, data, struct.unpack_from("<I", data, 96)[0]))
        print(f"{seed} {number} {file.name}", file=sys.stderr, flush=True)
        signal.alarm(4 * SECONDS)
        begin = time.perf_counter()
        refused += not read_one(path, random)
        slowest = max(slowest, time.perf_counter() - begin)
    more = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - base) * 1024
    assert more < SPARE + 8 * largest, f"{more >> 20} MiB more"
    return {"files": count, "refused": refused, "slowest": slowest, "MiB": more / 2**20}


if __name__ == "__main__":
    print(json.dumps(main(int(sys.argv[1]), int(sys.argv[2]), Path(sys.argv[3]), [Path(x) for x in sys.argv[4:]])))
