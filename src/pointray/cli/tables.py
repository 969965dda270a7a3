"""Facts as tables on the terminal, or as JSON."""

from __future__ import annotations

import json
import math
from typing import Any

from .facts import class_name
from .printable import printable

GEOREFERENCE = ("crs", "crs_name", "unit", "projection", "scale", "stations")
# Facts without a line of their own.
APART = ("normals_off", "normals_wrong", "files", "ranges", "first_picture", *GEOREFERENCE)
OF_FILES = ("file", "format", "bytes", "rows")
LABELS = {"low": "min", "high": "max", "lone": "isolated points"}  # names in the table
BLANKS = {" ": "blank", "\t": "tab"}  # invisible texts
MOST_STATIONS = 12  # that the table lists


def show_table(facts: dict[str, Any], as_json: bool) -> None:
    """Print facts as a table, one a line, followed by tables of files, attributes, LAS classes and automatic choices.

    facts : values by name, such as those of `describe_all`; as_json : whether to print them as one JSON object instead
    """
    if as_json:
        print(json.dumps(facts))
        return
    from rich.console import Console

    console = Console(highlight=False)
    rows = [[LABELS.get(name, name.replace("_", " ")), _text(value)] for name, value in _rows(facts).items()]
    console.print(table_of(rows))
    if len(facts.get("files", ())) > 1:
        console.print("", _files(facts["files"]), sep="\n")
    if facts.get("ranges"):
        console.print("", _ranges(facts["ranges"]), sep="\n")
    for name, about in facts.get("ranges", {}).items():
        if "counts" in about:
            rows = [[value, class_name(value), f"{count:,}"] for value, count in about["counts"].items()]
            console.print("", table_of([[name, "", "points"], *rows], right=(0, 2), heads=True), sep="\n")
    if "first_picture" in facts:
        console.print("", _picture(facts["first_picture"]), sep="\n")


def _picture(facts: dict[str, Any]) -> Any:
    """Return a Rich table of what `render` would choose automatically: up direction, view, colours and normals."""
    view = f"{facts['view']} (azimuth {facts['azimuth']:.0f}, elevation {facts['elevation']:.0f})"
    rows = [["up", facts["up"]], ["view", view], ["colours", facts["colors"]], ["normals", facts["normals"]]]
    if facts["ignored"]:
        rows.append(["ignored", facts["ignored"].removeprefix("Not framed: ").rstrip(".")])
    return table_of([["picture", "automatic: --up, --view, --color, --normals change it"], *rows], heads=True)


def table_of(rows: list[list[str]], right: tuple[int, ...] = (), heads: bool = False) -> Any:
    """Return a Rich table of texts. right : indices of right-aligned columns; heads : whether row 0 has titles"""
    from rich.table import Table
    from rich.text import Text

    table = Table(show_header=False, box=None, pad_edge=False)
    for k in range(len(rows[0])):
        table.add_column(justify="right" if k in right else "left", overflow="fold")
    for k, row in enumerate(rows):
        table.add_row(*(Text(printable(cell), "dim" if heads and k == 0 else "") for cell in row))
    return table


def _files(files: list[dict[str, Any]]) -> Any:
    """Return a Rich table with one row per file: its path, format, number of points, and other facts of its header.

    files : facts by name of each file
    """
    rows = [[file["file"], file["format"], _count(file.get("rows")), _describe_header(file)] for file in files]
    return table_of([["file", "format", "rows", ""], *rows], right=(2,), heads=True)


def _ranges(ranges: dict[str, dict[str, Any]]) -> Any:
    """Return a Rich table with one row per attribute: dtype, minimum, maximum, and number of values not finite."""
    rows = []
    for name, about in ranges.items():
        low, high = (_exact(about[end], about["dtype"]) for end in ("low", "high"))
        lost = about.get("not_finite")
        rows.append([name, about["dtype"], low, high, f"{lost:,} not finite" if lost else ""])
    return table_of([["attribute", "", "min", "max", ""], *rows], right=(2, 3), heads=True)


def _exact(value: Any, dtype: str) -> str:
    """Return a number, or a list of them, as text with all digits; "-" for None. dtype : that of the attribute"""
    if isinstance(value, list):
        return ", ".join(_exact(one, dtype) for one in value)
    if value is None:
        return "-"
    if dtype == "float32":
        import numpy as np

        return str(np.float32(value))
    return str(value)


def _count(rows: int | None) -> str:
    return "" if rows is None else f"{rows:,}"


def _describe_header(file: dict[str, Any]) -> str:
    """Return the facts of a file's header as one line, besides those with columns of their own. file : facts by name"""
    return "; ".join(f"{name.replace('_', ' ')} {_text(value)}" for name, value in _others(file).items())


def _rows(facts: dict[str, Any]) -> dict[str, Any]:
    """Return the facts that the main table lists, one a row: value by name, in order.

    Facts with tables of their own, such as files and attributes, and empty `steps` and `notes` are left out.
    """
    shown: dict[str, Any] = {}
    for name, value in facts.items():
        if name == "points":
            shown |= _of_one_file(facts) | _georeference(facts)
        if name not in APART:
            shown[name] = value
    if facts.get("scale") and "low" in facts:  # without digits beyond the resolution of the file
        digits = [max(0, math.ceil(-math.log10(step) - 1e-9)) for step in facts["scale"]]
        for name in ("low", "high", "size"):
            shown[name] = [round(x, n) for x, n in zip(facts[name], digits, strict=True)]
    if shown.get("normals"):
        off, verdict = facts["normals_off"], "wrong" if facts["normals_wrong"] else "good"
        known = "not checked" if off is None else f"{off:.1f} degrees off the surface (median): {verdict}"
        shown["normals"] = f"yes, {known}"
    for name in ("steps", "notes"):
        if name in shown and not any(shown[name]):
            del shown[name]
    if facts.get("ranges"):  # they have their own table
        del shown["attributes"]
    return shown


def _of_one_file(facts: dict[str, Any]) -> dict[str, Any]:
    """Return the facts of the file's header for the main table; empty if the scan has several files."""
    if len(facts.get("files", ())) != 1:
        return {}
    file = facts["files"][0]
    rows = {} if file.get("rows") in (None, facts["points"]) else {"rows of the file": file["rows"]}
    return {**_others(file), **rows}


def _others(file: dict[str, Any]) -> dict[str, Any]:
    """Return the facts of a file's header besides path, format, size and number of points; empty ones are left out.

    file : facts by name
    """
    return {name: value for name, value in file.items() if name not in OF_FILES and value not in (None, "", [], {})}


def _georeference(facts: dict[str, Any]) -> dict[str, Any]:
    """Return rows of the main table, value by label: coordinate system, unit, resolution and scanner positions."""
    shown = {}
    if facts.get("crs_name"):
        shown["coordinate system"] = facts["crs_name"]
    if facts.get("unit"):
        shown["unit"] = facts["unit"]
    if facts.get("projection"):
        shown["shown in"] = facts["projection"]
    if facts.get("scale"):
        shown["coordinate resolution"] = facts["scale"]
    stations = facts.get("stations") or []
    if stations:
        lines = ["; ".join(f"{x:.12g}, {y:.12g}, {z:.12g}" for x, y, z in stations[:MOST_STATIONS])]
        lines += [f"and {len(stations) - MOST_STATIONS:,} more"] if len(stations) > MOST_STATIONS else []
        shown["scanner at" if len(stations) == 1 else f"{len(stations):,} scanners at"] = " ".join(lines)
    return shown


def _text(value: Any) -> str:
    if value is None:
        return "not checked (use --deep)"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return f"{value:,}"
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, dict):
        return ", ".join(f"{name.replace('_', ' ')} {_text(one)}" for name, one in value.items()) or "none"
    if isinstance(value, list | tuple):
        between = "; " if any(isinstance(one, dict | list) for one in value) else ", "
        return between.join(f"{v:.12g}" if isinstance(v, float) else _part(v) for v in value) or "none"
    return BLANKS.get(value) or str(value)


def _part(value: Any) -> str:
    return _text(value) if isinstance(value, dict | list) else str(value)
