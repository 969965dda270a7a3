"""The commands that try the ray tracer on this computer with an embedded statue: `demo` and `bench`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from ..declare import INPUT, OUTPUT, QUALITY, single, with_options
from ..options import use_threads
from ..picture_options import PictureOptions
from ..views import View
from ..waiting import Progress, in_background, writing

COUNTS = "Points of the statue; repeatable. Default: 32000 and 1000000."
JsonOption = Annotated[bool, single(OUTPUT, None, "Print the table as JSON.", "--json")]


@with_options("pointray demo", "pointray demo -o statue.png --points 100000 --size 800x600", size="512x512")
def demo(
    options: PictureOptions,
    output: Annotated[Path, single(OUTPUT, "FILE", "Image.", "--output", "-o")] = Path("demo.png"),
    points: Annotated[int, single(INPUT, "COUNT", "Points of the statue.", min=1000, max=10**8)] = 1_000_000,
    frames: Annotated[int, single(QUALITY, "COUNT", "Number of timed frames.", min=1)] = 10,
    json: JsonOption = False,
) -> None:
    """Ray trace the embedded statue on a ground plane, with a hard shadow; write the image and print the times."""
    from ...image.write import check_image_path

    check_image_path(output)
    wanted, count = View(options).size, use_threads(options.threads)
    from ...rendering.settings import Settings
    from ..demo import run_demo
    from ..tables import show_table

    with Progress(Settings()) as progress:
        facts = in_background(lambda: run_demo(output, points, wanted, frames, count, progress.show))
    show_table(facts, json)


@with_options("pointray bench", "pointray bench --points 100000 --plot rates.png")
def bench(
    options: PictureOptions,
    points: Annotated[list[int] | None, single(INPUT, "COUNT", COUNTS, min=1000, max=10**8)] = None,
    runs: Annotated[int, single(QUALITY, "COUNT", "Number of timed frames per view.", min=1)] = 9,
    plot: Annotated[Path | None, single(OUTPUT, "FILE", "Draw the table: .png, .svg or .pdf.")] = None,
    json: JsonOption = False,
) -> None:
    """Compare the paper's frame rates with those of this computer.

    --points 24000000 is the paper's stress test (6 minutes, 8 GiB).
    """
    from .. import benchmark

    if plot is not None:
        benchmark.check_plot(plot)
    count, counts = use_threads(options.threads), points or [32_000, 1_000_000]
    from ...rendering.settings import Settings

    with Progress(Settings()) as progress:
        rows = in_background(lambda: benchmark.measure(counts, runs, count, progress.show))
    benchmark.show_rows(rows, count, json)
    if plot is not None:
        with writing(plot):
            benchmark.plot(plot, rows)
