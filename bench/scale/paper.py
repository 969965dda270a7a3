"""Stage `paper` of `scale.py`: extrapolate the measured rows to a billion points on ten machines."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

from rich.table import Table

from bench.scale.rows import Row, Rows, shown

POINTS, MACHINES = 1_000_000_000, 10
NETWORK = 125_000_000.0  # bytes a second of each machine: a gigabit, assumed
SIZE = 1920 * 1080  # pixels of a frame
STAGES = "make", "prepare", "view", "same", "cluster", "faults"  # in the order of the table


class Line(NamedTuple):
    """A line of the table. value : None if a row is missing; how : the arithmetic, with the keys of rows"""

    what: str
    value: float | None
    unit: str
    how: str


@dataclass
class Sheet:
    """Rows, and those used by the current line."""

    rows: Rows
    used: list[Row] = field(default_factory=list)

    def take(self, name: str) -> float:
        """The value of a row. LookupError if it has not been measured."""
        return self._use(name).value

    def each(self, name: str) -> float:
        """The value of a row for each point of its scan."""
        row = self._use(name)
        return row.value / row.points

    def _use(self, name: str) -> Row:
        row = self.rows.find(name)
        if row is None:
            raise LookupError(name)
        self.used.append(row)
        return row

    def line(self, what: str, unit: str, formula: str, count: Callable[[], float]) -> Line:
        """A line; `formula` names rows as {0}, {1}, in the order in which they are used."""
        self.used = []
        try:
            value = count()
        except LookupError as error:
            return Line(what, None, unit, f"needs the row {error.args[0]}")
        names = [f"[{row.key}: {shown(row.value, row.unit)}]" for row in self.used]
        return Line(what, value, unit, formula.format(*names))


def lines(rows: Rows) -> Iterator[Line]:
    """All lines."""
    sheet = Sheet(rows)
    yield from _of_prepare(sheet)
    yield from _of_disk_and_memory(sheet)
    yield from _of_pictures(sheet)


class Group(NamedTuple):
    """Stages of `prepare` that are printed in one line.

    name : the stage, or "levels" for those of all levels
    kind : SHARED, ALONE or SAMPLE
    """

    name: str
    kind: str


SHARED, ALONE, SAMPLE = "part by part", "at once", "by a sample"


def _group_of(row: Row) -> Group:
    """A sample is as large for all scans, all else grows with the points."""
    stage = row.name.split(".")[2]
    kind = SHARED if "one by one" in row.what else SAMPLE if "usual" in stage else ALONE
    return Group(
        "levels" if stage.removeprefix("surface-").removeprefix("loose-").startswith("level-") else stage, kind
    )


def _of_prepare(sheet: Sheet) -> Iterator[Line]:
    """Stages that go part by part are shared out, all else is done by one machine."""
    groups: dict[Group, list[Row]] = {}
    for row in sheet.rows.under("prepare.stage."):
        if row.name.endswith(".time"):
            groups.setdefault(_group_of(row), []).append(row)
    totals = dict.fromkeys((ALONE, SAMPLE, SHARED), 0.0)
    for group, rows in groups.items():
        line = _line_of(sheet, group, rows)
        totals[group.kind] += line.value or 0.0
        yield line
    if groups:
        yield Line("prepare, by one machine", totals[ALONE] + totals[SAMPLE], "s", "the lines of what is done at once")
        yield Line("prepare, shared out", totals[SHARED], "s", "the lines of what goes part by part")
        yield Line("prepare, in all", sum(totals.values()), "s", "the sum of both")


def _line_of(sheet: Sheet, group: Group, rows: list[Row]) -> Line:
    """What stages take. Of several rows the first and how many there are is named, and their sum."""
    seconds, points = sum(row.value for row in rows), rows[0].points
    names = f"{rows[0].key}: " if len(rows) == 1 else f"{rows[0].key} and {len(rows) - 1} more like it: "
    how, value = f"[{names}{shown(seconds, 's')}]", seconds
    if group.kind != SAMPLE:
        how, value = f"{how} / its points x 1e9", seconds / points * POINTS
    if group.kind == SHARED:
        name = "cluster.prepare.throughput"
        row = sheet.rows.find(name)
        if row is None:
            return Line(f"prepare, {group.name}", None, "s", f"needs the row {name}")
        how, value = f"{how} / {MACHINES} machines / [{row.key}: {shown(row.value, '')}]", value / MACHINES / row.value
    return Line(f"prepare, {group.name}, {group.kind}", value, "s", how)


def _of_disk_and_memory(sheet: Sheet) -> Iterator[Line]:
    def grown(name: str) -> float:
        return sheet.each(name) * POINTS

    yield sheet.line("disk of the scan", "bytes", "{0} / its points x 1e9", lambda: grown("make.disk"))
    yield sheet.line("disk of the model", "bytes", "{0} / its points x 1e9", lambda: grown("prepare.disk"))
    yield sheet.line("most of the disk", "bytes", "{0} / its points x 1e9", lambda: grown("prepare.work"))
    yield sheet.line("memory of a machine that prepares", "bytes", "{0}", lambda: sheet.take("prepare.peak"))
    yield sheet.line(
        "the model in the memory of each machine",
        "bytes",
        f"{{0}} / its points x 1e9 / {MACHINES} machines",
        lambda: grown("prepare.disk") / MACHINES,
    )


def _of_pictures(sheet: Sheet) -> Iterator[Line]:
    workers = 2  # of the rows
    yield sheet.line(
        "frames of a film, 640 x 480",
        "frames/s",
        f"24 frames / {{0}} x {MACHINES} machines / {workers} workers",
        lambda: 24 / sheet.take("cluster.film.many") * MACHINES / workers,
    )
    yield sheet.line(
        "what all of these send",
        "bytes/s",
        f"{{0}} x 24 frames / {{1}} x {MACHINES} machines / {workers} workers",
        lambda: sheet.take("cluster.film.sent") * 24 / sheet.take("cluster.film.many") * MACHINES / workers,
    )
    for name, what in (("lit", "a lit frame"), ("paths", "a path-traced frame, 2 samples")):
        spp = 1 if name == "lit" else 2
        yield sheet.line(
            f"{what}, 1920 x 1080, of parts on all machines: sent",
            "bytes",
            f"{{0}} x 1920 x 1080 x {spp} rays",
            lambda name=name, spp=spp: sheet.take(f"cluster.spread.{name}.sent.ray") * SIZE * spp,
        )
        yield sheet.line(
            f"{what}: at least, by the network",
            "s",
            f"{{0}} x 1920 x 1080 x {spp} rays / {MACHINES} machines / 125 MB/s, a gigabit",
            lambda name=name, spp=spp: sheet.take(f"cluster.spread.{name}.sent.ray") * SIZE * spp / MACHINES / NETWORK,
        )


def table(rows: Rows) -> Table:
    """All lines as a table."""
    found = Table(title=f"{POINTS:,} points on {MACHINES} machines, on paper")
    for name in ("what", "value", "how"):
        found.add_column(name, justify="right" if name == "value" else "left")
    for line in lines(rows):
        found.add_row(line.what, "-" if line.value is None else shown(line.value, line.unit), line.how)
    return found


def markdown(rows: Rows) -> str:
    """The tables of docs/scale.md: requirements, measurements, and the extrapolation."""
    measured = [
        [row.what, f"`{row.name}`", f"{row.points:,}", shown(row.value, row.unit), row.asked]
        for row in sorted(rows, key=lambda row: (STAGES.index(row.name.split(".")[0]), -row.points))
        if row.kind
    ]
    extrapolated = [
        [line.what, "-" if line.value is None else shown(line.value, line.unit), line.how.replace(" @ ", " at ")]
        for line in lines(rows)
    ]
    tables = (
        (["what", "row", "points", "measured", "asked"], measured),
        (["a billion points on ten machines", "", "how"], extrapolated),
    )
    return "\n\n".join(_markdown_of(head, cells) for head, cells in tables)


def _markdown_of(head: list[str], cells: list[list[str]]) -> str:
    rules = ["---:" if name in ("points", "measured", "asked", "") else "---" for name in head]
    return "\n".join(f"| {' | '.join(row)} |" for row in (head, rules, *cells))
