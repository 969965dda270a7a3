"""pointray convert: writes the points of a scan in another format."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

from ..io.remote.remote_file import Location
from ..model.scan_inputs import check_not_input, check_result
from .read_options import Reading
from .scan_files import read_scan, scan_of
from .waiting import Progress, in_background, writing


def convert(paths: Sequence[Location], reading: Reading, output: Path, force: bool) -> str:
    """Read a scan and write it in the format of the output's extension; return the line that the command prints.

    force : whether the output may overwrite an input
    """
    check_result(output)
    scan = scan_of(paths, reading)
    check_not_input(scan.files, output, force)
    scan.check()
    with Progress() as progress:
        progress.show("reading", 0.0)
        points, _ = in_background(lambda: read_scan(scan, progress.show))
        progress.show("writing", 0.0)
        with writing(output):
            lost = in_background(partial(_write, output, points, progress))
    return "; ".join([f"{output}: {len(points):,} points", *lost])


def _write(output: Path, points: Any, progress: Progress) -> list[str]:
    """Write points to a file and return messages about what its format cannot store."""
    from ..io.files import write_points

    return write_points(output, points, lambda share: progress.show("writing", share))
