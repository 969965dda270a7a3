"""The commands that try the ray tracer on this machine with an embedded statue: `demo` and `bench`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..options import SizeOption, ThreadsOption, use_threads
from ..views import View
from ..waiting import Progress, in_background, writing


def demo(
    output: Annotated[Path, typer.Option("--output", "-o", help="The picture.")] = Path("demo.png"),
    points: Annotated[int, typer.Option(min=1000, max=10**8, help="Points of the statue.")] = 1_000_000,
    size: SizeOption = "512x512",
    frames: Annotated[int, typer.Option(min=1, help="Frames that are timed.")] = 10,
    threads: ThreadsOption = None,
    json: Annotated[bool, typer.Option("--json", help="The table as JSON.")] = False,
) -> None:
    """Ray trace the embedded statue, on a ground plane, with a hard shadow; write the picture and print the times."""
    from ...image.write import check_image_path

    check_image_path(output)
    wanted, count = View(size).size, use_threads(threads)
    from ...rendering.settings import Settings
    from ..demo import run_demo
    from ..tables import show_table

    with Progress(Settings()) as progress:
        facts = in_background(lambda: run_demo(output, points, wanted, frames, count, progress.show))
    show_table(facts, json)


def bench(
    points: Annotated[
        list[int] | None,
        typer.Option(min=1000, max=10**8, help="Points of the statue; repeatable. Default: 32000 and 1000000."),
    ] = None,
    runs: Annotated[int, typer.Option(min=1, help="Frames that are timed, of each view.")] = 9,
    threads: ThreadsOption = None,
    plot: Annotated[Path | None, typer.Option(help="Draw the table: .png, .svg or .pdf.")] = None,
    json: Annotated[bool, typer.Option("--json", help="The table as JSON.")] = False,
) -> None:
    """The paper's frame rates beside this machine's; --points 24000000 is its stress test (6 minutes, 8 GiB)."""
    from .. import benchmark

    if plot is not None:
        benchmark.check_plot(plot)
    count, counts = use_threads(threads), points or [32_000, 1_000_000]
    from ...rendering.settings import Settings

    with Progress(Settings()) as progress:
        rows = in_background(lambda: benchmark.measure(counts, runs, count, progress.show))
    benchmark.show_rows(rows, count, json)
    if plot is not None:
        with writing(plot):
            benchmark.plot(plot, rows)
