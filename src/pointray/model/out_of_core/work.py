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
    """A cloud on disk that is processed part by part, and the progress of this work.

    Finished stages of a part are recorded on disk and not repeated, so an interrupted run can be resumed. A copy can be
    sent to workers, which process parts with it and report no progress.

    Parameters
    ----------
    columns : Columns
    total : int
        Number of points of the cloud.
    size : int
        Points of a part, a power of two, at least `TILE` (4,096).
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
        """Return the rows of a part in the columns, which hold the parts one after the other."""
        return slice(part * self.size, min((part + 1) * self.size, self._total))

    def watch(self, span: tuple[float, float]) -> Progress | None:
        """Return a callback for the progress of one stage; None if no progress is reported.

        span : begin and end of the stage, as fractions of all work
        """
        return part_of(self._progress, *span)

    def make_column(self, name: str, dtype: Any, width: int = 0) -> Column:
        """Return a column on disk with a row for each point; create it if it is missing.

        width : numbers in a row, 0 for an array with one axis

        Raises
        ------
        ValueError
            If the column was created before and has been lost.
        """
        there, made = self.columns.find(name), f"made-{name}"
        if there is not None:
            return there
        if self.columns.get(made) is not None:
            raise ValueError(f"{self.columns.folder}: {name} is missing: remove the folder to start over")
        column = self.columns.make(name, dtype, width, self._total)
        self.columns.put(made, {})
        return column

    def read(self, name: str, part: int) -> NDArray[Any]:
        """Return the rows of a part from the column on disk with this name."""
        return self.columns[name][self.part_rows(part)]

    def write(self, name: str, part: int, values: NDArray[Any]) -> None:
        """Write the rows of a part to the column on disk with this name."""
        self.columns[name].write(self.part_rows(part).start, values)

    def local(self, part: int) -> Local:
        """Return the rows of a part's points and of its margin, the surrounding points that its surface depends on.

        The margin is found once and stored.
        """
        tiles, name = np.arange(part * self.size, self.part_rows(part).stop, TILE) // TILE, f"margin-{part:04d}"
        known = self.columns.get_or_put(
            name, lambda: {"tiles": local_of(self.columns, tiles, self._total).tiles.tolist()}
        )
        return points_of(np.array(known["tiles"], np.int64), tiles, self._total)

    def statistics_for(self, stage: str, compute: Callable[[Local, CloudStatistics], Any]) -> CloudStatistics:
        """Return the statistics of the whole cloud that a stage needs, computed from a sample once and stored.

        compute : runs the stage on the rows of the sample; the statistics it asks for are kept
        """

        def on_sample() -> dict[str, float]:
            tiles = np.concatenate([np.arange(one.start, one.stop, TILE) // TILE for one in sample_of(self._total)])
            local = local_of(self.columns, tiles, self._total)
            statistics = SampledStatistics(local.own)
            compute(local, statistics)
            return statistics.known

        known = self.columns.get_or_put(f"usual-{stage}", on_sample)
        return CloudStatistics(None, known, is_complete=True)

    def all(self, do: Callable[[int], Result], span: tuple[float, float], name: str = "signs") -> list[Result]:
        """Call a function with the number of each part; return its results in the order of the parts.

        No result is stored, so a resumed run calls the function again for all parts.

        do : called here or in workers; name : label in the dashboard of the workers
        span : begin and end of this step, as fractions of all work
        """
        results = dict(self._share(name, partial(_do, self, do), range(self.parts), span))
        return [results[part] for part in range(self.parts)]

    def each(self, stage: str, do: Callable[[int], Facts | None], span: tuple[float, float]) -> list[Facts]:
        """Call a function for each part in which a stage is not yet done; return its results for all parts.

        stage : name under which the results are stored
        do : called with the number of a part, here or in workers; returns a few facts, which are stored as JSON and
            mark the stage as done for this part
        span : begin and end of the stage, as fractions of all work
        """
        known = {part: self.columns.get(_mark(stage, part)) for part in range(self.parts)}
        todo = [part for part, facts in known.items() if facts is None]
        known.update(self._share(stage, partial(_do_once, self, stage, do), todo, span))
        return [known[part] or {} for part in range(self.parts)]

    def _share(
        self, name: str, do: Callable[[int], Result], todo: Sequence[int], span: tuple[float, float]
    ) -> Iterator[tuple[int, Result]]:
        """Call a function with the numbers of some parts, here or in the workers; yield each number with its result.

        name : label in the dashboard of the workers; todo : numbers of the parts
        span : begin and end of this step, as fractions of all work
        """
        report, done = self.watch(span), self.parts - len(todo)

        def tick() -> None:
            report_progress(report, done / self.parts)

        for one in self._tasks.share(name, do, todo, tick):
            done += 1
            report_progress(report, done / self.parts)
            yield one
        self._tasks.refresh(self.columns.folder)


def within(span: Span, begin: float, end: float) -> Span:
    """Return a part of a span of progress. begin, end : of the part, as fractions of the span"""
    length = span[1] - span[0]
    return span[0] + begin * length, span[0] + end * length


def _mark(stage: str, part: int) -> str:
    """Return the name under which the facts of a stage of a part are stored, which marks it as done."""
    return f"{stage}-{part:04d}"


def _do(work: Work, do: Callable[[int], Result], part: int) -> Result:
    """Call a function with the number of a part; return its result. Columns are flushed to disk, for other machines."""
    if work.is_sent:
        refresh_listing(work.columns.folder)
    result = do(part)
    work.columns.sync()
    trim_heap()
    return result


def _do_once(work: Work, stage: str, do: Callable[[int], Facts | None], part: int) -> Facts:
    """Run a stage for a part and store the facts it returns, which marks it as done."""
    facts = _do(work, do, part) or {}
    work.columns.put(_mark(stage, part), facts)
    return facts
