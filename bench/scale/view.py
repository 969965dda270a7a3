"""Stage `view` of `stages.py`: the first picture of a model in parts in a fresh process, and a flight through it."""

from __future__ import annotations

import json
import os
import statistics
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pointray as pr
from bench.scale.prepare import Options, asked
from bench.scale.rows import LEAST, MOST, Row
from bench.scale.watch import Watched, watched
from pointray.cli.options import bytes_of

CHILD = Path(__file__).parent / "pictures.py"
FIRST, RATE = 1.5, 10.0  # asked: seconds, frames a second


def child(options: Options, name: str, cameras: Sequence[pr.Camera]) -> tuple[dict[str, Any], Watched]:
    """Figures of a fresh process that renders pictures, and its memory."""
    there = options.there / f"{name}.json"
    there.write_text(json.dumps([asdict(camera) for camera in cameras]))
    words = [options.prepared, bytes_of(options.resident), repr(time.time()), there, options.there / f"{name}.png"]
    found = watched([CHILD, *words])
    return json.loads(found.output.splitlines()[-1]), found


def forget(folder: Path) -> None:
    """Have the system drop the pages of all files in a folder, so that they are read from the disk again."""
    if hasattr(os, "posix_fadvise"):
        for path in folder.rglob("*"):
            with suppress(OSError), path.open("rb") as file:
                os.fsync(file.fileno())
                os.posix_fadvise(file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)


def view(options: Options) -> list[Row]:
    """Pictures of the prepared city."""
    if not (options.prepared / "index.json").exists():
        raise ValueError(f"{options.prepared}: not found: run the stage `prepare` with this number of points first")
    return [*_first_pictures(options), *_flight(options)]


def _first_pictures(options: Options) -> Iterator[Row]:
    views = {"far": options.city.far(options.size), "near": options.city.near(options.size)}
    for name, camera in views.items():
        child(options, name, [camera])  # compiles kernels
        for kind, prepared in (
            ("", "its files were read before"),
            (".cold", "its files have to be read from the disk"),
        ):
            runs = []
            for _ in range(options.runs):
                if kind:
                    forget(options.prepared)
                runs.append(child(options, name, [camera]))
            seconds, opened = (statistics.median(found[what] for found, _ in runs) for what in ("first", "opened"))
            what = (
                f"time from the start of a process to a picture from {'afar' if name == 'far' else 'near'}, {prepared}"
            )
            row = options.row(f"view.{name}{kind}", seconds, "s", what)
            yield row if kind else asked(row, MOST, FIRST)
            if not kind:
                yield options.row(f"view.{name}.opened", opened, "s", "part of it until the model was open")
                yield options.row(f"view.{name}.peak", max(w.resident for _, w in runs), "bytes", "resident")


def _flight(options: Options) -> Iterator[Row]:
    cameras = options.city.flight(options.frames + 1, options.size)
    forget(options.prepared)
    found, seen = child(options, "flight", cameras)
    spent, what = found["frames"], f"{options.frames} frames, --memory {options.resident}"
    yield asked(options.row("view.flight", len(spent) / sum(spent), "frames/s", f"flight of {what}"), LEAST, RATE)
    yield options.row("view.flight.median", statistics.median(spent), "s", "a frame of it, median")
    yield options.row("view.flight.slowest", max(spent), "s", "its slowest frame")
    seconds, scales = zip(*found["moving"], strict=True)
    what = "the same flight as the viewer draws it, with fewer pixels while it moves"
    yield options.row("view.flight.moving", len(seconds) / sum(seconds), "frames/s", what)
    yield options.row("view.flight.moving.scale", statistics.mean(scales), "", "share of the width with pixels there")
    row = options.row("view.flight.resident", found["resident"], "bytes", "of parts and levels, at its end")
    yield asked(row, MOST, bytes_of(options.resident))
    yield options.row("view.flight.peak", seen.resident, "bytes", "resident memory of the process")
    yield options.row("view.flight.anonymous", seen.anonymous, "bytes", "the same without pages of files")
