"""Work on a cloud in parts: stages that follow each other, and what each has found, on disk.

What is done is not done again, so that an interrupted run goes on.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np

from ..memory import give_back
from ..points.usual import Usual, sample_of
from ..progress import Progress, part_of, tell
from .arrange import TILE
from .columns import Column, Columns
from .local import Local, local_of

Facts = dict[str, Any]
Result = TypeVar("Result")


class Work:
    """Columns of a cloud in parts, and stages for each part.

    Parameters
    ----------
    columns : Columns
    total : int
        Points of the cloud.
    size : int
        Points of a part, a power of two, `TILE` or more.
    progress : callable, optional
        Called with the share done.
    """

    def __init__(self, columns: Columns, total: int, size: int, progress: Progress | None = None) -> None:
        self.columns, self.size, self.parts = columns, size, -(-total // size)
        self._total, self._progress = total, progress

    def stretch(self, part: int) -> slice:
        """The rows of a part."""
        return slice(part * self.size, min((part + 1) * self.size, self._total))

    def watch(self, span: tuple[float, float]) -> Progress | None:
        """The progress of a share of the time."""
        return part_of(self._progress, *span)

    def room(self, name: str, dtype: Any, width: int = 0) -> Column:
        """A column for all points, as it is if there is one."""
        return self.columns.find(name) or self.columns.make(name, dtype, width, self._total)

    def local(self, part: int) -> Local:
        tiles = np.arange(part * self.size, min((part + 1) * self.size, self._total), TILE) // TILE
        return local_of(self.columns, tiles, self._total)

    def surveyed(self, stage: str, look: Callable[[Local, Usual], Any]) -> Usual:
        """What a stage asks of the whole cloud, found by doing it for the sample."""
        known = self.columns.get(f"usual-{stage}")
        if known is None:
            stretches = sample_of(self._total)
            tiles = np.concatenate([np.arange(one.start, one.stop, TILE) // TILE for one in stretches])
            local = local_of(self.columns, tiles, self._total)
            usual = Usual(local.own)
            look(local, usual)
            known = usual.known
            self.columns.put(f"usual-{stage}", known)
        return Usual(None, known, is_told=True)

    def all(self, do: Callable[[int], Result], span: tuple[float, float]) -> list[Result]:
        """Do something for each part, whether or not it is done; what each gives."""
        results = []
        for part in range(self.parts):
            results.append(do(part))
            tell(self.watch(span), (part + 1) / self.parts)
        return results

    def each(self, stage: str, do: Callable[[int], Facts | None], span: tuple[float, float]) -> list[Facts]:
        """Do a stage for each part, unless it is done; what each says."""
        facts: list[Facts] = []
        for part in range(self.parts):
            name = f"{stage}-{part:04d}"
            said = self.columns.get(name)
            if said is None:
                said = do(part) or {}
                give_back()
                self.columns.put(name, said)
            facts.append(said)
            tell(self.watch(span), (part + 1) / self.parts)
        return facts
