"""Stages `make` and `prepare` of `scale.py`: generate a city on disk, and measure `pointray prepare` into parts."""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from bench.scale.city import City, make
from bench.scale.rows import MOST, Row, Rows, table_of
from bench.scale.watch import Watched, disk_of, watched
from pointray.cli.options import bytes_of

OVER = 1.25  # the peak of resident memory, as a multiple of --memory: 2.5 GiB of 2
BLOCK = 1 << 20  # bytes of tiles that are read to find out whether they are the same


@dataclass(frozen=True)
class Options:
    """Settings of the measurements.

    folder : where all is kept: each size of city has a folder in it
    memory : as `pointray prepare` and `Model.load` take it
    part_points : of a part; None: as many as the memory allows
    """

    folder: Path
    city: City
    memory: str = "2GiB"
    resident: str = "1GiB"
    part_points: int | None = None
    size: tuple[int, int] = (640, 480)
    frames: int = 100
    runs: int = 3
    workers: int = 2

    @property
    def there(self) -> Path:
        """The folder of this city."""
        return self.folder / str(self.city.points)

    @property
    def prepared(self) -> Path:
        """The model in parts."""
        return self.there / "city.pointray"

    def tiles(self) -> list[Path]:
        """Return the files of the city, generated if missing."""
        return make(self.city, self.there / "tiles")

    def rows(self) -> Rows:
        """Those of all cities."""
        return Rows(self.folder / "scale.json")

    def row(self, name: str, value: float, unit: str, what: str) -> Row:
        """A figure of this city."""
        return Row(name, self.city.points, float(value), unit, what)


def asked(row: Row, kind: str, limit: float) -> Row:
    """The same figure, with a requirement."""
    return row._replace(kind=kind, limit=limit)


def keep(options: Options, stage: str, rows: Sequence[Row], console: Console) -> None:
    """Store the rows of a stage, and print them."""
    options.rows().put(rows, stage)
    console.print(table_of(stage, rows))


def make_tiles(options: Options) -> list[Row]:
    """Make the city."""
    begun, folder = time.perf_counter(), options.there / "tiles"
    there = folder.exists()
    paths = options.tiles()
    rows = [
        options.row("make.tiles", len(paths), "", "files"),
        options.row("make.disk", disk_of(folder), "bytes", "of all files"),
    ]
    if not there:
        rows.append(options.row("make.time", time.perf_counter() - begun, "s", "to make them"))
    return rows


# Surfaces only: otherwise scattered points would be sought first, and the city has a few single ones.
SURFACE = "--scatter", "surface"


def command_of(options: Options, folder: Path, *more: object) -> list[object]:
    """The words of `pointray prepare`, which makes a model in parts in a folder."""
    words: list[object] = [
        "-m",
        "pointray",
        "prepare",
        *options.tiles(),
        "-o",
        f"{folder}/",
        "--memory",
        options.memory,
        *SURFACE,
    ]
    if options.part_points is not None:
        words += ["--part-points", options.part_points]
    return [*words, *more]


def parts_in(folder: Path) -> int:
    """How many parts a model has."""
    return len(json.loads((folder / "index.json").read_text())["parts"])


def prepared(options: Options) -> Path:
    """Return the model in parts of the city, prepared if missing."""
    if not (options.prepared / "index.json").exists():
        watched(command_of(options, options.prepared))
    return options.prepared


def prepare(options: Options) -> list[Row]:
    """Make parts of the city, and watch that."""
    command = command_of(options, options.prepared)
    shutil.rmtree(options.prepared, ignore_errors=True)
    found = watched(command, options.prepared)
    return list(_rows_of(options, found))


def _rows_of(options: Options, found: Watched) -> Iterator[Row]:
    row = options.row
    limit = OVER * bytes_of(options.memory)
    yield asked(row("prepare.peak", found.resident, "bytes", "resident memory, all processes"), MOST, limit)
    yield row("prepare.anonymous", found.anonymous, "bytes", "the same without pages of files")
    yield row("prepare.processes", found.processes, "", "processes")
    yield row("prepare.time", found.seconds, "s", f"with --memory {options.memory}")
    yield row("prepare.parts", parts_in(options.prepared), "", "parts")
    yield row("prepare.disk", found.left, "bytes", "of the model in parts")
    yield row("prepare.work", found.disk, "bytes", "most of the disk meanwhile")
    for stage in found.stages:
        how = f"{stage.parts} parts, one by one" if stage.parts else "all at once"
        yield row(f"prepare.stage.{stage.name}.time", stage.seconds, "s", how)
        yield row(f"prepare.stage.{stage.name}.peak", stage.resident, "bytes", f"resident, {how}")
