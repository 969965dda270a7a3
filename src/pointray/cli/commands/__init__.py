"""The commands, in the order in which `pointray --help` lists them.

pictures : `render`, `animate`, `view`
files : `bake`, `prepare`, `info`, `convert`
cache : `cache`
trials : `demo`, `bench`

Heavy modules are imported inside the commands, so that --help answers at once.
"""

from __future__ import annotations

from typing import Annotated, Any

import typer
from typer.core import TyperCommand

from ...base.manual import MANUAL
from ..declare import OUTPUT
from .cache import cache
from .files import bake, convert, info, prepare
from .pictures import animate, render, view
from .trials import bench, demo

EPILOG = f"Manual: {MANUAL}"

app = typer.Typer(
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["--help", "-h"], "max_content_width": 100},
    help="\b\nExamples:\n  pointray view scan.ply\n  pointray render scan.ply -o scan.png\n\n"
    "Ray trace point clouds: smooth, lit, shadowed surfaces straight from points.",
    epilog=EPILOG,
)


class Command(TyperCommand):
    """A command of Typer that lists its option --help in the panel "Output"; all other options are in panels too."""

    def get_help_option(self, ctx: Any) -> Any:
        """Return the option --help, assigned to the panel "Output"."""
        option = super().get_help_option(ctx)
        if option is not None:
            option.rich_help_panel = OUTPUT
        return option


for command in (render, animate, view, bake, prepare, info, convert, cache, demo, bench):
    summary = command.__wrapped__.__doc__.partition("\n")[0]  # type: ignore[attr-defined]
    app.command(cls=Command, short_help=summary, epilog=EPILOG)(command)


@app.callback(invoke_without_command=True)
def _main(version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False) -> None:
    if version:
        from ... import __version__

        print(__version__)
        raise typer.Exit()
