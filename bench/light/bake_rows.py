"""The rows of the table of `bake.py`: measurement, target, and whether it is met."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

MILLION = 1_000_000
FEW = 200_000  # points, at most, of scenes that are compared with formulas
WIDTHS = 70, 52, 32


@dataclass(frozen=True)
class Options:
    """Settings of the measurements.

    points : of the statue; other scenes have as many or fewer
    seeds : bakes of the same scene; the worst one counts
    quick : small pictures, few samples
    models, references : folders of real scans, and of path-traced pictures that are kept
    pictures : folder for pictures of the errors, or None
    """

    points: int
    seeds: int
    quick: bool
    models: Path
    references: Path
    pictures: Path | None

    @property
    def few(self) -> int:
        """Points of scenes that are compared with formulas."""
        return min(self.points, FEW)

    @property
    def chances(self) -> list[int]:
        """Seeds far from each other: a bake with the seed n uses those up to n + 3."""
        return [1000 * k for k in range(self.seeds)]

    def scaled(self, seconds: float) -> float:
        """The target for this number of points, given that for a million."""
        return seconds * self.points / MILLION


class Row(NamedTuple):
    """One row of the table. ok : None where nothing is demanded, or nothing was measured"""

    test: str
    measured: str
    demanded: str = ""
    ok: bool | None = None


def at_most(test: str, value: float, limit: float, form: str = "{:.2%}", note: str = "", aim: str = "") -> Row:
    """A figure that is to be small. note : after the figure; aim : after the demand"""
    return Row(test, form.format(value) + note, "at most " + form.format(limit) + aim, bool(value <= limit))


def at_least(test: str, value: float, limit: float, form: str = "{:.2f}", note: str = "", aim: str = "") -> Row:
    """A figure that is to be large."""
    return Row(test, form.format(value) + note, "at least " + form.format(limit) + aim, bool(value >= limit))


def plain_row(test: str, measured: str) -> Row:
    """A figure without a target, or the reason why it is missing."""
    return Row(test, measured)


def show_head() -> None:
    """Print the titles of the columns."""
    _show(("test", "measured", "demanded"), "")


def show(rows: Iterable[Row]) -> None:
    """Print rows."""
    for row in rows:
        _show(row[:3], {True: "ok", False: "SHORT", None: ""}[row.ok])


def _show(cells: tuple[str, str, str], end: str) -> None:
    print("  ".join(cell.ljust(width) for cell, width in zip(cells, WIDTHS, strict=True)) + "  " + end, flush=True)
