"""pointray prepare: makes a scan smaller or cleaner, or gives it normals."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from typing import Any

from ..base.choices import AUTO
from ..io.remote.remote_file import Location
from ..io.selection import Selection
from ..model.preparation import Plan, plan_preparation, prepare_by_parts, prepare_in_memory, write_result
from ..model.preparation_options import SEPARATORS, Cleaning, NormalsChoice, PreparationOptions, ReadOptions, Storage
from .cluster import working_on
from .options import bytes_of, numbers, smooth_of
from .read_options import Reading
from .scan_surface import check_saved
from .waiting import Progress, in_background, writing

SHARING = ("cluster", "workers")  # options that make a client
CLEANING = ("tolerance", "count", "drop_duplicates", "drop_outliers")
STORAGE = ("part_points", "levels", "force", "scatter", "scatter_size")
VALUES = {"out": "-o", "fit": "--estimate-normals", "file": "--normals file"}


def options_of(reading: Reading, output: str, given: dict[str, Any]) -> PreparationOptions:
    """Convert the options of the command `prepare` to checked `PreparationOptions`.

    reading : options of reading the scan; output : value of -o; given : values of all other options by parameter name
    """
    sharing = next((name for name in SHARING if given[name] is not None), "")
    names = {**VALUES, "client": f"--{sharing}"}
    memory = None if given["memory"] is None else bytes_of(given["memory"])
    in_parts = output.endswith(SEPARATORS) or given["part_points"] is not None or memory is not None
    smooth = None if given["smooth"] is None else smooth_of(given["smooth"])
    viewpoint = None if given["viewpoint"] is None else numbers(given["viewpoint"], "--viewpoint")
    normals = "fit" if given["estimate_normals"] else given["normals"]
    selection = Selection(reading.every, reading.max_points, reading.request.bounds, reading.keep, reading.drop)
    return PreparationOptions(
        Storage(Path(output), in_parts, memory=memory, **{name: given[name] for name in STORAGE}),
        Cleaning(**{name: given[name] for name in CLEANING}, smooth=smooth),
        NormalsChoice(normals, viewpoint, given["trajectory"]),
        ReadOptions(reading.request, selection, reading.drop_strays),
        bool(sharing),
        lambda name: names.get(name, f"--{name.replace('_', '-')}"),
    )


def prepare(paths: Sequence[Location], reading: Reading, output: str, given: dict[str, Any]) -> str:
    """Run the command `prepare`: clean, reduce or convert a scan, write the result, and return the line to print.

    reading : options of reading the scan; output : value of -o; given : values of all other options by parameter name
    """
    options = options_of(reading, output, given)
    check_saved(paths[0], given["normals"] == AUTO and options.storage.drawing is None)
    plan = _planned(paths, options)
    if plan.by_parts:
        with working_on(*(given[name] for name in SHARING)) as client, Progress() as progress:
            return str(in_background(lambda: prepare_by_parts(plan, client, progress.show)))
    storage = plan.options.storage
    with Progress() as progress:
        result = in_background(lambda: prepare_in_memory(plan, progress.show))
        write = partial(write_result, plan, result, progress.show)
        with nullcontext() if storage.in_parts else writing(storage.out):
            return str(in_background(write) if storage.is_model else write())


def _planned(paths: Sequence[Location], options: PreparationOptions) -> Plan:
    """Check inputs and options, and download remote files if that is necessary for a decision, with a progress bar."""
    if all(isinstance(path, Path) for path in paths):
        return plan_preparation(paths, options)
    with Progress() as progress:
        return in_background(lambda: plan_preparation(paths, options, progress.show))
