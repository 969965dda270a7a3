"""Work on a cloud in parts: consecutive stages, and their results on disk.

Finished work is not repeated, so an interrupted run can be resumed. The parts of a stage are processed one after the
other in this process, or concurrently by workers.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from ...base.disk_columns import Column, Columns, refresh_listing
from ...base.executor import LocalTasks, TaskExecutor
from ...base.memory import trim_heap
from ...base.progress import Progress, part_of, report_progress
from ...cloud.sampled_statistics import SampledStatistics
from ...cloud.statistics import CloudStatistics, sample_of
from .arrange import TILE
from .local import Local, local_of, points_of

Facts = dict[str, Any]
Span = tuple[float, float]  # begin and end of a stage, as fractions of all work
Result = TypeVar("Result")


class Work:
    """Columns of a cloud in parts, and stages for each part.

    Can be sent to workers, which process parts of a stage with it and report no progress.

    Parameters
    ----------
    columns : Columns
    total : int
        Number of points of the cloud.
    size : int
        Points of a part, a power of two, at least `TILE`.
    progress : callable, optional
        Called with the fraction done.
    tasks : TaskExecutor, optional
        Workers that see the columns. Functions applied to parts are sent to them: module-level functions, or methods,
        with small arguments. None: this process.

    Attributes
    ----------
    is_sent : bool
        Whether this is a copy in a worker.
    """

    def __init__(
        self,
        columns: Columns,
        total: int,
        size: int,
        progress: Progress | None = None,
        tasks: TaskExecutor | None = None,
    ) -> None:
        self.is_sent = False
        self.columns, self.size, self.parts = columns, size, -(-total // size)
        self._total, self._progress = total, progress
        self._tasks = LocalTasks() if tasks is None else tasks

    def __reduce__(self) -> tuple[Any, ...]:
        return Work, (self.columns, self._total, self.size), {"is_sent": True}

    def part_rows(self, part: int) -> slice:
        """Return the rows of a part."""
        return slice(part * self.size, min((part + 1) * self.size, self._total))

    def watch(self, span: tuple[float, float]) -> Progress | None:
        """Return the progress callback of a span of the time."""
        return part_of(self._progress, *span)

    def make_column(self, name: str, dtype: Any, width: int = 0) -> Column:
        """Return a column for all points, created if missing; raise a ValueError if it existed and was lost."""
        there, made = self.columns.find(name), f"made-{name}"
        if there is not None:
            return there
        if self.columns.get(made) is not None:
            raise ValueError(f"{self.columns.folder}: {name} is missing: remove the folder to start over")
        column = self.columns.make(name, dtype, width, self._total)
        self.columns.put(made, {})
        return column

    def read(self, name: str, part: int) -> NDArray[Any]:
        """Return the rows of a part in a column."""
        return self.columns[name][self.part_rows(part)]

    def write(self, name: str, part: int, values: NDArray[Any]) -> None:
        """Write the rows of a part to a column."""
        self.columns[name].write(self.part_rows(part).start, values)

    def local(self, part: int) -> Local:
        """Return the points of a part with its margin, which is computed once."""
        tiles, name = np.arange(part * self.size, self.part_rows(part).stop, TILE) // TILE, f"margin-{part:04d}"
        known = self.columns.get_or_put(
            name, lambda: {"tiles": local_of(self.columns, tiles, self._total).tiles.tolist()}
        )
        return points_of(np.array(known["tiles"], np.int64), tiles, self._total)

    def statistics_for(self, stage: str, compute: Callable[[Local, CloudStatistics], Any]) -> CloudStatistics:
        """Return the statistics that a stage needs of the whole cloud, computed on the sample and cached."""

        def on_sample() -> dict[str, float]:
            tiles = np.concatenate([np.arange(one.start, one.stop, TILE) // TILE for one in sample_of(self._total)])
            local = local_of(self.columns, tiles, self._total)
            statistics = SampledStatistics(local.own)
            compute(local, statistics)
            return statistics.known

        known = self.columns.get_or_put(f"usual-{stage}", on_sample)
        return CloudStatistics(None, known, is_complete=True)

    def all(self, do: Callable[[int], Result], span: tuple[float, float], name: str = "signs") -> list[Result]:
        """Call a function for each part; return the results. name : for the dashboard"""
        results = dict(self._share(name, partial(_do, self, do), range(self.parts), span))
        return [results[part] for part in range(self.parts)]

    def each(self, stage: str, do: Callable[[int], Facts | None], span: tuple[float, float]) -> list[Facts]:
        """Run a stage for each part where it is not done yet; return the facts of all parts."""
        known = {part: self.columns.get(_mark(stage, part)) for part in range(self.parts)}
        todo = [part for part, facts in known.items() if facts is None]
        known.update(self._share(stage, partial(_do_once, self, stage, do), todo, span))
        return [known[part] or {} for part in range(self.parts)]

    def _share(
        self, name: str, do: Callable[[int], Result], todo: Sequence[int], span: tuple[float, float]
    ) -> Iterator[tuple[int, Result]]:
        """Call a function for some parts, by the executor; yield each part with its result."""
        report, done = self.watch(span), self.parts - len(todo)

        def tick() -> None:
            report_progress(report, done / self.parts)

        for one in self._tasks.share(name, do, todo, tick):
            done += 1
            report_progress(report, done / self.parts)
            yield one
        self._tasks.refresh(self.columns.folder)


def within(span: Span, begin: float, end: float) -> Span:
    """Return the part of a span between two fractions of it."""
    length = span[1] - span[0]
    return span[0] + begin * length, span[0] + end * length


def _mark(stage: str, part: int) -> str:
    """Return the name of the facts that mark a stage of a part as done."""
    return f"{stage}-{part:04d}"


def _do(work: Work, do: Callable[[int], Result], part: int) -> Result:
    """Call a function for a part, then flush its columns to the disk, for all machines."""
    if work.is_sent:
        refresh_listing(work.columns.folder)
    result = do(part)
    work.columns.sync()
    trim_heap()
    return result


def _do_once(work: Work, stage: str, do: Callable[[int], Facts | None], part: int) -> Facts:
    """Run a stage for a part, and mark it as done."""
    facts = _do(work, do, part) or {}
    work.columns.put(_mark(stage, part), facts)
    return facts
