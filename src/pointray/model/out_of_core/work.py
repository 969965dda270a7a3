"""Work on a cloud in parts: stages that follow each other, and what each has found, on disk.

What is done is not done again, so that an interrupted run goes on. Parts of a stage are done one after the other here,
or at once by workers.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any, TypeVar

import numpy as np

from ...base.disk_columns import Column, Columns, look_again
from ...base.executor import LocalTasks, TaskExecutor
from ...base.memory import give_back
from ...base.progress import Progress, part_of, tell
from ...cloud.sampled_statistics import SampledStatistics
from ...cloud.statistics import CloudStatistics, sample_of
from .arrange import TILE
from .local import Local, local_of, points_of

Facts = dict[str, Any]
Result = TypeVar("Result")


class Work:
    """Columns of a cloud in parts, and stages for each part.

    It can be sent to workers, which do parts of a stage with it, and tell nobody of their progress.

    Parameters
    ----------
    columns : Columns
    total : int
        Points of the cloud.
    size : int
        Points of a part, a power of two, `TILE` or more.
    progress : callable, optional
        Called with the share done.
    tasks : TaskExecutor, optional
        Workers who see the columns. What is done for parts is sent to them, so it is a function of a module, or a
        method, with small arguments. None: this process.

    Attributes
    ----------
    is_sent : bool
        Whether this is a worker's, or another machine's.
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

    def stretch(self, part: int) -> slice:
        """The rows of a part."""
        return slice(part * self.size, min((part + 1) * self.size, self._total))

    def watch(self, span: tuple[float, float]) -> Progress | None:
        """The progress of a share of the time."""
        return part_of(self._progress, *span)

    def room(self, name: str, dtype: Any, width: int = 0) -> Column:
        """A column for all points, as it is if there is one; ValueError if there was one, which is lost."""
        there, made = self.columns.find(name), f"made-{name}"
        if there is not None:
            return there
        if self.columns.get(made) is not None:
            raise ValueError(f"{self.columns.folder}: {name} is missing: remove the folder to begin anew")
        column = self.columns.make(name, dtype, width, self._total)
        self.columns.put(made, {})
        return column

    def local(self, part: int) -> Local:
        """The points of a part with its margin, which is looked for once."""
        tiles, name = np.arange(part * self.size, self.stretch(part).stop, TILE) // TILE, f"margin-{part:04d}"
        known = self.columns.get(name)
        if known is not None:
            return points_of(np.array(known["tiles"], np.int64), tiles, self._total)
        local = local_of(self.columns, tiles, self._total)
        self.columns.put(name, {"tiles": local.tiles.tolist()})
        return local

    def surveyed(self, stage: str, look: Callable[[Local, CloudStatistics], Any]) -> CloudStatistics:
        """What a stage asks of the whole cloud, found by doing it for the sample."""
        known = self.columns.get(f"usual-{stage}")
        if known is None:
            stretches = sample_of(self._total)
            tiles = np.concatenate([np.arange(one.start, one.stop, TILE) // TILE for one in stretches])
            local = local_of(self.columns, tiles, self._total)
            statistics = SampledStatistics(local.own)
            look(local, statistics)
            known = statistics.known
            self.columns.put(f"usual-{stage}", known)
        return CloudStatistics(None, known, is_complete=True)

    def all(self, do: Callable[[int], Result], span: tuple[float, float], name: str = "signs") -> list[Result]:
        """Do something for each part, whether or not it is done; what each gives. name : what the dashboard shows"""
        results = dict(self._share(name, partial(_do, self, do), range(self.parts), span))
        return [results[part] for part in range(self.parts)]

    def each(self, stage: str, do: Callable[[int], Facts | None], span: tuple[float, float]) -> list[Facts]:
        """Do a stage for each part, unless it is done; what each says."""
        known = {part: self.columns.get(_mark(stage, part)) for part in range(self.parts)}
        todo = [part for part, said in known.items() if said is None]
        known.update(self._share(stage, partial(_do_once, self, stage, do), todo, span))
        return [known[part] or {} for part in range(self.parts)]

    def _share(
        self, name: str, do: Callable[[int], Result], todo: Sequence[int], span: tuple[float, float]
    ) -> Iterator[tuple[int, Result]]:
        """Do something for some parts, by the executor; yields each with what it gives."""
        say, done = self.watch(span), self.parts - len(todo)

        def tick() -> None:
            tell(say, done / self.parts)

        for one in self._tasks.share(name, do, todo, tick):
            done += 1
            tell(say, done / self.parts)
            yield one
        self._tasks.refresh(self.columns.folder)


def _mark(stage: str, part: int) -> str:
    """The facts that say that a stage is done for a part."""
    return f"{stage}-{part:04d}"


def _do(work: Work, do: Callable[[int], Result], part: int) -> Result:
    """Do something for a part; what it has written is on the disk then, for all machines."""
    if work.is_sent:
        look_again(work.columns.folder)
    result = do(part)
    work.columns.sync()
    give_back()
    return result


def _do_once(work: Work, stage: str, do: Callable[[int], Facts | None], part: int) -> Facts:
    """Do a stage for a part, and mark it as done."""
    said = _do(work, do, part) or {}
    work.columns.put(_mark(stage, part), said)
    return said
