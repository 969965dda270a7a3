"""Write docs/reference/commands.md, the commands and their options, from the parser.

    python -m bench.maintenance.commands_page

tests/integration/test_commands_page.py compares the document with the parser.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import typer

from pointray.cli.commands import app

TARGET = Path(__file__).parents[2] / "docs" / "reference" / "commands.md"
HEAD = """# Command line

<!-- Written by `python -m bench.maintenance.commands_page`; do not edit. -->

`pointray COMMAND --help` shows the same text. Vectors are `x,y,z`, sizes `640x480`. Exit status: 0, 1 (failed), 2 (bad
input), 130 (interrupted). Environment variables: `POINTRAY_THREADS` (number of threads), `POINTRAY_CACHE` (folder of
compiled kernels and models), `POINTRAY_KERNELS` (`compiled`, `jit` or `auto`).
"""


def command_lines(name: str, command: Any) -> list[str]:
    """Return the section of a command: description, examples, and its options by group."""
    context = command.make_context(f"pointray {name}", [], resilient_parsing=True)
    description, examples = split_examples(command.help or "")
    usage = command.get_usage(context).removeprefix("Usage:").strip()
    lines = ["", f"## {name}", "", description, "", "```console", f"$ {' '.join(usage.split())}", "```"]
    if examples:
        lines += ["", "Examples:", "", "```console", *(f"$ {line}" for line in examples), "```"]
    groups: dict[str, list[tuple[str, str]]] = {}
    for parameter in command.params:
        group = getattr(parameter, "rich_help_panel", None) or "Options"
        if record := parameter.get_help_record(context):
            groups.setdefault("Arguments" if parameter.param_type_name == "argument" else group, []).append(record)
    for group, records in groups.items():
        lines += ["", f"**{group}**", "", "| option | |", "|---|---|"]
        lines += [f"| `{names.split(' <')[0]}` | {cell(text)} |" for names, text in records]
    return lines


def split_examples(text: str) -> tuple[str, list[str]]:
    """Return the description in a command's help, and the lines of its examples."""
    examples = [line.strip() for line in text.splitlines() if line.startswith("  pointray")]
    kept = [line for line in text.replace("\b", "").splitlines() if not line.startswith(("  pointray", "Examples:"))]
    return "\n".join(kept).strip(), examples


def cell(text: str) -> str:
    """Return a text as a cell of a table."""
    return " ".join(text.split()).replace("|", "\\|").replace("<", "&lt;").replace("*", "\\*")


def commands_page() -> str:
    """Return the document."""
    commands = typer.main.get_command(app).commands  # type: ignore[attr-defined]
    lines = [line for name, command in commands.items() for line in command_lines(name, command)]
    return "\n".join([HEAD.rstrip(), *lines]) + "\n"


if __name__ == "__main__":
    TARGET.write_text(commands_page())
    print(TARGET)
