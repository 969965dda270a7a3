"""Mutated files of points of all formats that can be written, and of those that other programs wrote, where they are.

A whole file that was only cut off must not be read as if it were whole, and no file may take more memory than
64 MiB and eight times what it holds.
"""

from __future__ import annotations

import resource
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np

import pointray as pr
from attack import Attack, WrongError
from attack.mutate import Rng, corrupt, pick
from conftest import MODELS
from pointray.points.files import written

ROWS = 400
SPARE, TIMES = 64 << 20, 8  # memory that a file may take: bytes, and times what it holds
LARGEST = 3 << 20  # bytes of files of other programs that are mutated


class Seed(NamedTuple):
    """A whole file.

    Attributes
    ----------
    name : str
    data : bytes
    count : int
        Its points.
    held : int
        Bytes of all its arrays.
    """

    name: str
    data: bytes
    count: int
    held: int


def points_of(rng: Rng) -> pr.Points:
    """Points with all that formats keep."""
    xyz = rng.random((ROWS, 3)) + [500_000, 5_400_000, 100]
    attributes = {
        "classification": rng.integers(0, 9, ROWS).astype(np.uint8),
        "intensity": rng.integers(0, 65536, ROWS).astype(np.uint16),
        "gps_time": rng.random(ROWS) + 3e8,
        "height above ground": rng.random(ROWS).astype(np.float32),
    }
    normals = rng.normal(size=(ROWS, 3)).astype(np.float32)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    colors = rng.integers(0, 256, (ROWS, 3)).astype(np.uint8)
    return pr.Points(xyz, normals, colors, attributes, survey=pr.Survey("EPSG:25832"))


def seeds(folder: Path) -> list[Seed]:
    """A file of each format that can be written, and those of other programs."""
    paths, points = [], points_of(np.random.default_rng(1))
    attributes = {name.replace(" ", "_"): values for name, values in points.attributes.items()}
    for extension in written():
        path = folder / f"whole{extension}"
        pr.write(path, points.changed(attributes=attributes))
        paths.append(path)
    with suppress(OSError):
        paths += sorted(path for path in (MODELS / "raw").iterdir() if path.stat().st_size <= LARGEST)
    found = []
    for path in paths:
        with suppress(ValueError):
            read = pr.read(path)
            arrays = [read.positions, read.normals, read.colors, *read.attributes.values()]
            held = sum(array.nbytes for array in arrays if array is not None)
            found.append(Seed(path.name, path.read_bytes(), len(read), held))
    return found


def is_text(data: bytes) -> bool:
    """Whether a file is text, of which a part may be a whole file."""
    return not set(data[:2000]) - set(range(32, 127)) - {9, 10, 13}


def begin(folder: Path) -> Attack:
    """Mutated files of points."""
    known = seeds(folder)
    for seed in known:  # what is loaded and compiled is no file's memory
        for data in (seed.data, seed.data[: len(seed.data) // 2]):
            (folder / f"warm-{seed.name}").write_bytes(data)
            with suppress(ValueError):
                pr.read(folder / f"warm-{seed.name}")

    def attack(rng: Rng, index: int) -> bool:
        seed = pick(rng, known)
        cut = rng.random() < 0.2
        data = seed.data[: int(rng.random() * len(seed.data))] if cut else corrupt(rng, seed.data)
        path = folder / seed.name
        path.write_bytes(data)
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        try:
            points = pr.read(path)
        except (ValueError, OSError) as error:
            if "\n" in str(error):
                raise WrongError(f"{seed.name}: more than one line: {error}") from error
            points = None
        taken = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * 1024
        if taken > SPARE + TIMES * max(seed.held, len(data)):
            raise WrongError(f"{seed.name}: {taken >> 20} MiB of memory for {len(data)} bytes")
        if points is None:
            return False
        if cut and not is_text(data) and len(points) >= seed.count > 0 and len(data) < len(seed.data) - 4096:
            raise WrongError(f"{seed.name}: {len(data)} of {len(seed.data)} bytes are read as {len(points)} points")
        return True

    np.seterr(all="ignore")
    return attack
