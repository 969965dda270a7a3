"""Rows of `scale.py`: measurements in a JSON file, so that stages can run separately and use earlier results."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

from rich.table import Table

UNITS = {"bytes": (2**20, "MiB"), "s": (1, "s"), "points": (1, ""), "": (1, "")}
LEAST, MOST = "least", "most"


class Row(NamedTuple):
    """A figure.

    Attributes
    ----------
    name : str
        Of the stage, and what it is: "prepare.peak".
    points : int
        Of the scan.
    value : float
    unit : str
    what : str
        What the figure is, for people.
    kind : str
        "least" or "most": what the limit is; "" if nothing is asked.
    limit : float
    """

    name: str
    points: int
    value: float
    unit: str
    what: str
    kind: str = ""
    limit: float = math.nan

    @property
    def key(self) -> str:
        """The key of the row."""
        return f"{self.name} @ {self.points:,}"

    @property
    def asked(self) -> str:
        """What is asked, in words; "" if nothing is."""
        return f"at {self.kind} {shown(self.limit, self.unit)}" if self.kind else ""

    @property
    def is_met(self) -> bool | None:
        """Whether the requirement is met; None without one."""
        if not self.kind:
            return None
        return self.value <= self.limit if self.kind == MOST else self.value >= self.limit


class Rows:
    """All rows of a file.

    Parameters
    ----------
    path : path
        It need not exist; it is written anew whenever rows are put into it.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        found = json.loads(path.read_text()) if path.exists() else []
        self._rows = {row.key: row for row in (Row(**one) for one in found)}

    def put(self, rows: Iterable[Row], stage: str = "") -> None:
        """Keep rows in place of those with their names. stage : its other rows of as many points are removed"""
        new = list(rows)
        sizes = {row.points for row in new}
        for row in list(self._rows.values()):
            if stage and row.name.split(".")[0] == stage and row.points in sizes:
                del self._rows[row.key]
        self._rows |= {row.key: row for row in new}
        self._path.parent.mkdir(parents=True, exist_ok=True)
        text = json.dumps([row._asdict() for row in self._rows.values()], indent=1)
        self._path.with_suffix(".part").write_text(text)
        self._path.with_suffix(".part").replace(self._path)

    def find(self, name: str) -> Row | None:
        """The row with a name, of the largest scan; None if there is none."""
        return max((row for row in self._rows.values() if row.name == name), key=lambda row: row.points, default=None)

    def under(self, prefix: str) -> list[Row]:
        """The rows whose names begin so, of the largest scan that has one."""
        rows = [row for row in self._rows.values() if row.name.startswith(prefix)]
        most = max((row.points for row in rows), default=0)
        return [row for row in rows if row.points == most]

    def __iter__(self) -> Iterator[Row]:
        return iter(self._rows.values())


def shown(value: float, unit: str) -> str:
    """A figure with its unit."""
    scale, name = UNITS.get(unit, (1, unit))
    number = value / scale
    text = f"{number:,.0f}" if number == int(number) or abs(number) >= 1000 else f"{number:,.3g}"
    return f"{text} {name}".rstrip()


def table_of(title: str, rows: Iterable[Row]) -> Table:
    """Rows, with their requirements."""
    table = Table(title=title)
    for name in ("row", "points", "what", "measured", "asked", ""):
        table.add_column(name, justify="right" if name in ("points", "measured", "asked") else "left")
    for row in rows:
        verdict = {True: "met", False: "NOT met", None: ""}[row.is_met]
        table.add_row(row.name, f"{row.points:,}", row.what, shown(row.value, row.unit), row.asked, verdict)
    return table
