"""Opens parts of large models for the images of one browser, which show coarser levels until then."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress

from ..model.model import Model
from .thread_priority import PARTS, lower_priority

log = logging.getLogger("pointray.view")

REDRAW_INTERVAL = 0.2  # seconds between two images that show newly opened parts


class Fetcher:
    """Opens files of large models (parts and levels of detail) in its own thread, most important for the image first.

    Implements `rendering.lod.Fetch` for one browser. It opens no more than fits into the memory budget of a model, and
    closes what earlier images needed.

    Parameters
    ----------
    redraw : callable
        Called without arguments when more is open than the last image could show.
    fail : callable
        Called with the reason why a file cannot be opened, once for each file.
    """

    def __init__(self, redraw: Callable[[], None], fail: Callable[[str], None]) -> None:
        self._redraw, self._fail = redraw, fail
        self._changed = threading.Condition()
        self._wanted: list[Model] = []
        self._failed: set[Model] = set()
        self._open = True
        self._thread: threading.Thread | None = None
        self._is_new = False  # whether parts were opened since the last redraw
        self._drawn = 0.0

    def want(self, models: list[Model]) -> None:
        """Open the files of these models in their order, within memory budgets, in place of earlier requests."""
        fitting = list(_within_budget([model for model in models if model not in self._failed]))
        for model in reversed(fitting):  # marks them as recently used, the first one last
            if model.source is not None:
                model.source.find()
        with self._changed:
            self._wanted = fitting
            if self._thread is None and self._open and self._next() is not None:
                self._thread = threading.Thread(target=self._run, name="pointray-fetcher", daemon=True)
                self._thread.start()
            self._changed.notify_all()

    def open(self, model: Model) -> bool:
        """Open a model's file now, in this thread; return whether it is open.

        A file that has failed before is not tried again.
        """
        if model in self._failed:
            return False
        try:
            if model.source is not None:
                model.source.open()
        except (OSError, ValueError) as error:
            self._failed.add(model)
            self._fail(str(error))
            return False
        return True

    def close(self) -> None:
        """Stop opening files, and drop references to models, so that their memory is released."""
        with self._changed:
            self._open, self._wanted, self._failed = False, [], set()
            self._changed.notify_all()

    @property
    def has_ended(self) -> bool:
        """Whether the thread has ended after `close`."""
        return self._thread is None or not self._thread.is_alive()

    def _run(self) -> None:
        with suppress(OSError):
            lower_priority(PARTS)
        while True:
            with self._changed:
                model = self._next()
                while self._open and model is None:
                    self._changed.wait()
                    model = self._next()
                if not self._open:
                    return
            assert model is not None
            try:
                self._is_new |= self.open(model)
            except Exception as error:
                log.exception("error while opening a part")
                self._failed.add(model)
                self._fail(f"{type(error).__name__}: {error}")
            with self._changed:
                is_last = self._next() is None
            if self._is_new and (is_last or time.monotonic() - self._drawn > REDRAW_INTERVAL):
                self._is_new, self._drawn = False, time.monotonic()
                self._redraw()

    def _next(self) -> Model | None:
        """Return the first requested model that is not open and has not failed, or None."""
        for model in self._wanted:
            if model not in self._failed and model.source is not None and not model.source.is_open:
                return model
        return None


def _within_budget(models: list[Model]) -> Iterator[Model]:
    """Yield the models on disk that together fit into the memory budgets of their caches, in the given order.

    A level of detail is skipped if a finer one of the same part precedes it and fits.
    """
    left: dict[int, int] = {}
    finest: dict[tuple[int, int], int] = {}  # finest level that fits, by model and part
    for model in models:
        source = model.source
        if source is None:
            continue
        owner, (part, level) = id(source.cache), source.key
        room = left.setdefault(owner, source.cache.room)
        size = 0 if source.is_kept else source.file.nbytes
        if size <= room and level <= finest.get((owner, part), level):
            left[owner], finest[owner, part] = room - size, level
            yield model
