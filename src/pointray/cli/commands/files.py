"""The commands about the files of scans: `prepare` makes better ones, `info` tells what they hold."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..options import SCANS, Normals, NormalsOption, ThreadsOption, numbers, use_threads
from ..waiting import Progress, in_background


def prepare(
    file: Annotated[Path, typer.Argument(help=f"A scan, {SCANS}, or a saved model, .pointray: its points.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="The result: .ply, or .pointray: the model, ready.")],
    tolerance: Annotated[
        str | None,
        typer.Option(help="Leave out what the surface can spare: it stays within 0.5 (units), or 0.05% (diagonal)."),
    ] = None,
    count: Annotated[int | None, typer.Option(help="Leave so many points.")] = None,
    drop_duplicates: Annotated[bool, typer.Option("--drop-duplicates", help="Of equal positions keep one.")] = False,
    drop_outliers: Annotated[bool, typer.Option("--drop-outliers", help="Drop what lies far from the rest.")] = False,
    normals: NormalsOption = Normals["auto"],
    estimate_normals: Annotated[bool, typer.Option("--estimate-normals", help="The same as --normals fit.")] = False,
    viewpoint: Annotated[str | None, typer.Option(help="The scanner, x,y,z: normals are turned to it.")] = None,
    levels: Annotated[
        bool, typer.Option("--levels/--no-levels", help="Of a .pointray: levels of detail too, a third more bytes.")
    ] = True,
    force: Annotated[bool, typer.Option("--force", help="The result may be the input itself: overwrite it.")] = False,
    threads: ThreadsOption = None,
) -> None:
    """Make a scan smaller, cleaner, or give it normals; radii are kept as the attribute 'radius', which render uses."""
    from ..prepare import prepare as work

    if estimate_normals and normals == "file":
        raise ValueError("--estimate-normals and --normals file exclude each other")
    estimate_normals = estimate_normals or normals == "fit"
    if viewpoint is not None and not estimate_normals:
        raise ValueError("--viewpoint is for --estimate-normals or --normals fit, which is not given")
    use_threads(threads)
    options = {
        "tolerance": tolerance,
        "count": count,
        "drop_duplicates": drop_duplicates,
        "drop_outliers": drop_outliers,
        "normals": normals.value,
        "estimate_normals": estimate_normals,
        "viewpoint": None if viewpoint is None else numbers(viewpoint, "--viewpoint"),
        "levels": levels,
        "force": force,
    }
    print(work(file, output, options))


def info(
    file: Annotated[Path, typer.Argument(help=f"A scan, {SCANS}, or a saved model, .pointray.")],
    deep: Annotated[
        bool, typer.Option("--deep", help="Look at the neighbours of all points: 10 million take a minute and 7 GB.")
    ] = False,
    json: Annotated[
        bool, typer.Option("--json", help="As JSON: null is what only --deep finds of so many points.")
    ] = False,
) -> None:
    """What is in a scan or a saved model, and what is missing; of large ones a sample tells the spacing."""
    from ..prepare import read_scan
    from ..report import describe, describe_model, show_table
    from ..scan_scene import check_scan

    check_scan(file)
    with Progress() as progress:
        progress.show("reading", 0.0)
        points, model = in_background(lambda: read_scan(file, progress))
        progress.show("looking", 0.0)
        facts = in_background(lambda: describe(points, deep, lambda share: progress.show("looking", share)))
    if model is not None:
        facts |= describe_model(model)
    show_table({"file": str(file), **facts}, json)
