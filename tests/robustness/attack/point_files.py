"""Mutated files of points of all formats that are read, and of those that other programs wrote, where they are.

A file that was only cut off must not be read as if it were whole, what a header announces must be there, or a warning
says that it is not, and no file may take more memory than 64 MiB and eight times what it holds.
"""

from __future__ import annotations

import re
import resource
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np

import pointray as pr
from attack import Attack, WrongError
from attack.byte_changes import change, is_text
from attack.mutate import Rng, pick
from attack.told_counts import told
from helpers.places import MODELS
from helpers.small_files import small_scans
from pointray.base.warning_log import collect_warnings

SPARE, TIMES = 64 << 20, 8  # memory that a file may take: bytes, and times what it holds
LARGEST = 400 << 10  # bytes of files of other programs that are mutated
OTHERS = 0.03  # share of the inputs of a kind that are made of files of other programs, which are larger
# A sequence of rows without a header: a part of it is a whole file of fewer points.
HEADLESS = ("kitti", "splat", "text", "obj")
OPTIONS = {"depth": {"intrinsics": (50.0, 55.0, 40.0, 30.0)}, "gaussians": {"opacity": 0.0}, "spz": {"opacity": 0.0}}
OPTIONS |= {"splat": {"opacity": 0.0}, "packed": {"opacity": 0.0, "intrinsics": (50.0, 55.0, 40.0, 30.0)}}
KINDS = {".las": "las", ".laz": "laz", ".e57": "e57", ".pcd": "pcd", ".ptx": "ptx", ".ply": "ply", ".pts": "text"}
KINDS |= {".xyz": "text"}
# Warnings of a file that has other rows than it announces, or of a mesh that is sampled.
REPAIRED = re.compile(r"cut off|announce|expected|more bytes|not a multiple of|points are sampled")


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


def seed_of(path: Path, kind: str) -> Seed:
    """A whole file and what it holds."""
    read = pr.read(path, **OPTIONS.get(kind, {}))
    arrays = [read.positions, read.normals, read.colors, *read.attributes.values()]
    return Seed(path.name, path.read_bytes(), len(read), sum(array.nbytes for array in arrays if array is not None))


def seeds(folder: Path) -> tuple[dict[str, list[Seed]], dict[str, list[Seed]]]:
    """By kind: files that were made here, and files of other programs."""
    own = {}
    for kind, paths in small_scans(folder).items():
        packed_twice = [path for path in paths if kind == "packed" and ".spz." in path.name]
        own[kind] = [seed_of(path, kind) for path in paths if path not in packed_twice]
    others: dict[str, list[Seed]] = {}
    with suppress(OSError):
        for path in sorted((MODELS / "raw").iterdir()):
            kind = KINDS.get(path.suffix)
            if kind in own and path.stat().st_size <= LARGEST:
                others.setdefault(kind, []).append(seed_of(path, kind))
    return {kind: found for kind, found in own.items() if found}, others


class Memory:
    """The most memory that was taken since `begin`."""

    def begin(self) -> None:
        with suppress(OSError):
            Path("/proc/self/clear_refs").write_text("5")  # Linux forgets the most so far
        self._before = self._most()

    def taken(self) -> int:
        """Bytes."""
        return self._most() - self._before

    def _most(self) -> int:
        with suppress(OSError):
            found = re.search(r"VmHWM:\s+(\d+) kB", Path("/proc/self/status").read_text())
            if found:
                return int(found[1]) * 1024
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def check_count(kind: str, seed: Seed, data: bytes, count: int, cut: bool) -> None:
    """WrongError if a file that is accepted without a warning has another number of points than it announces."""
    announced = told(kind, seed.name, data)
    if announced and count not in announced:
        raise WrongError(f"{seed.name}: announces {announced[0]} points, {count} are read")
    partial = kind in HEADLESS or (kind == "packed" and any(f".{x}." in f"{seed.name}." for x in ("bin", "splat")))
    if cut and not partial and not is_text(data) and count != seed.count:
        raise WrongError(f"{seed.name}: {len(data)} of {len(seed.data)} bytes are read as {count} points")


def options_of(rng: Rng, kind: str) -> dict[str, object]:
    """How a file is read; parts of an octree are asked for, too."""
    if kind == "copc" and rng.random() < 0.4:
        return pick(rng, [{"bounds": [-5, 1, -4, 50, 40, 60]}, {"resolution": 6.0}])
    if kind in ("obj", "stl", "glb", "off") and rng.random() < 0.3:
        return {"sample": 50}
    return dict(OPTIONS.get(kind, {}))


def begin(folder: Path) -> Attack:
    """Mutated files of points."""
    own, others = seeds(folder / "whole")
    kinds, memory = list(own), Memory()
    known = [(kind, seed) for found in (own, others) for kind, some in found.items() for seed in some]
    for kind, seed in known:  # what is loaded and compiled is no file's memory
        for data in (seed.data, seed.data[: len(seed.data) // 2]):
            (folder / seed.name).write_bytes(data)
            with suppress(ValueError):
                pr.read(folder / seed.name, **OPTIONS.get(kind, {}))
        (folder / seed.name).unlink()

    def attack(rng: Rng, index: int) -> bool:
        kind = kinds[index % len(kinds)]
        seed = pick(rng, others[kind] if kind in others and rng.random() < OTHERS else own[kind])
        cut = rng.random() < 0.15
        data = seed.data[: int(rng.random() * len(seed.data))] if cut else change(rng, seed.data, seed.name)
        options, path = options_of(rng, kind) | {"strict": bool(rng.random() < 0.5)}, folder / seed.name
        path.write_bytes(data)
        memory.begin()
        words: list[str] = []
        try:
            with collect_warnings() as words:
                points = pr.read(path, **options)  # type: ignore[arg-type]
        except (ValueError, OSError) as error:
            if "\n" in str(error):
                raise WrongError(f"{seed.name}: more than one line: {error}") from error
            points = None
        finally:
            path.unlink()
        if memory.taken() > SPARE + TIMES * max(seed.held, len(data)):
            raise WrongError(f"{seed.name}: {memory.taken() >> 20} MiB of memory for {len(data)} bytes")
        if points is None:
            return False
        if not {"bounds", "resolution", "sample"} & set(options) and not REPAIRED.search("; ".join(words)):
            check_count(kind, seed, data, len(points), cut)
        return True

    np.seterr(all="ignore")
    return attack
