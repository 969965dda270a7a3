"""The commands, in the order in which `pointray --help` lists them.

pictures : `render`, `animate`, `view`
files : `bake`, `prepare`, `info`, `convert`
cache : `cache`
trials : `demo`, `bench`

Nothing heavy is imported before it is needed, so that --help answers at once.
"""

from __future__ import annotations

from typing import Annotated

import typer

from .cache import cache
from .files import bake, convert, info, prepare
from .pictures import animate, render, view
from .trials import bench, demo

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["--help", "-h"]},
    help="Ray traces point clouds: smooth, lit, shadowed surfaces straight from points.",
)

app.command()(render)
app.command()(animate)
app.command()(view)
app.command()(bake)
app.command()(prepare)
app.command()(info)
app.command()(convert)
app.command()(cache)
app.command()(demo)
app.command()(bench)


@app.callback(invoke_without_command=True)
def _main(version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False) -> None:
    if version:
        from ... import __version__

        print(__version__)
        raise typer.Exit()
