"""Waiting for the work: a bar on the terminal, and Ctrl-C at any moment."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar

T = TypeVar("T")


class Progress:
    """A bar on the terminal, for what takes a moment, and a word when kernels are compiled."""

    def __enter__(self) -> Progress:
        from rich.console import Console
        from rich.progress import BarColumn, TextColumn
        from rich.progress import Progress as Bars

        from ..jit import cache_folder, on_first_compilation

        console = Console(stderr=True)
        columns = TextColumn("{task.description}"), BarColumn()
        self._bars = Bars(*columns, console=console, transient=True, disable=not console.is_terminal)
        self._task = self._bars.add_task("", total=1.0)
        self._bars.start()
        word = "compiling kernels for this processor: once, some 30 seconds"
        if cache_folder() is None:
            word = "compiling kernels, some 30 seconds: each time, the cache folder (POINTRAY_CACHE) cannot be written"
        on_first_compilation(lambda: console.print(word, style="dim"))
        return self

    def __exit__(self, *error: object) -> None:
        from ..jit import on_first_compilation

        on_first_compilation(None)
        self._bars.stop()

    def show(self, stage: str, share: float) -> None:
        """Where it is."""
        self._bars.update(self._task, description=stage, completed=share)


def in_background(work: Callable[[], T]) -> T:
    """Do it in a thread and wait: the compiler and SciPy do not listen to Ctrl-C, the main thread does."""
    results: list[T] = []
    errors: list[BaseException] = []
    ended = threading.Event()  # an interrupted Thread.join takes the thread for dead (Python 3.11)

    def body() -> None:
        try:
            results.append(work())
        except BaseException as error:
            errors.append(error)
        ended.set()

    threading.Thread(target=body, daemon=True).start()
    try:
        while not ended.wait(0.1):
            pass
    except KeyboardInterrupt:
        ended.wait(0.2)  # a picture that is just being written gets finished
        raise
    if errors:
        raise errors[0]
    return results[0]


class WriteError(Exception):
    """The input was good, and yet it did not work."""


@contextmanager
def writing(output: Path) -> Iterator[None]:
    """Errors of the system, in here, are no bad input: the disk is full, say."""
    try:
        yield
    except OSError as error:
        raise WriteError(f"{output}: {error.strerror or error}") from error
