"""Progress bars on the terminal, and work that Ctrl-C can interrupt."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

T = TypeVar("T")
POLL = 0.2  # seconds between checks of the compilation


class Progress:
    """Progress bars on the terminal with the time left: one for the current stage of work, one for compiling kernels.

    Used as a context. If standard error is not a terminal, nothing is drawn.

    Parameters
    ----------
    settings : Settings, optional
        Settings of images to render; their kernels are compiled in the meantime.
    bakes : bool
        Whether light will be baked; its kernels are compiled too.
    """

    def __init__(self, settings: Any = None, bakes: bool = False) -> None:
        self._settings, self._bakes = settings, bakes

    def __enter__(self) -> Progress:
        from rich.console import Console
        from rich.progress import BarColumn, Progress as Bars, TextColumn, TimeRemainingColumn

        console = Console(stderr=True)
        columns = TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn()
        self._bars = Bars(*columns, console=console, transient=True, disable=not console.is_terminal)
        self._task, self._stage = self._bars.add_task("", total=1.0), ""
        self._bars.start()
        self._watch = CompilationWatch(self._bars)
        if self._settings is not None or self._bakes:
            from ..rendering.warmup import warm_up

            warm_up(self._settings, clicks=self._settings is not None, bakes=self._bakes)
        return self

    def __exit__(self, *error: object) -> None:
        self._watch.end()
        self._bars.stop()

    def show(self, stage: str, share: float) -> None:
        """Show the name of the current stage of work and its completed fraction, 0 to 1."""
        if stage != self._stage:  # the remaining time is estimated for each stage
            self._stage = stage
            self._bars.reset(self._task, total=1.0, description=stage)
        self._bars.update(self._task, completed=share)


class CompilationWatch:
    """A progress bar that is visible while kernels are compiled.

    If nothing is drawn, because standard error is not a terminal, one line is printed when compilation begins.

    bars : `rich.progress.Progress` to which the bar is added
    """

    def __init__(self, bars: Any) -> None:
        self._bars, self._task, self._ended = bars, bars.add_task("", total=1.0, visible=False), threading.Event()
        self._announced = not bars.disable
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def end(self) -> None:
        """Stop watching the compilation, and wait for the thread that updates the bar."""
        self._ended.set()
        self._thread.join()

    def _run(self) -> None:
        from ..engine.jit import BACKLOG

        while not self._ended.wait(POLL):
            state = BACKLOG.state
            if state is None:
                self._bars.update(self._task, visible=False)
                continue
            often = _how_often()
            if not self._announced:
                self._announced = True
                text = f"Compiling {state.total} kernels {often}, about {state.seconds:.0f} s)"
                self._bars.console.print(text, style="dim")
            text = f"Compiling kernel {state.number} of {state.total} {often})"
            self._bars.update(self._task, description=text, completed=state.share, visible=True)


def _how_often() -> str:
    """Return how often kernels are compiled, as part of a message: "for this CPU (first run only" or "(each time: ...".

    The caller adds the time and closes the parenthesis.
    """
    from ..engine.jit.disk_cache import cache_folder

    if cache_folder() is None:
        return "(each time: the cache folder POINTRAY_CACHE is not writable"
    return "for this CPU (first run only"


def in_background(work: Callable[[], T]) -> T:
    """Run a function in a thread, wait for it, and return its result or raise its error.

    The compiler and SciPy do not react to Ctrl-C; the main thread, which waits, does.
    """
    results: list[T] = []
    errors: list[BaseException] = []
    # Held until the work is done. Why a plain lock: `engine/jit/c_threads.py`.
    working = threading.Lock()
    working.acquire()

    def body() -> None:
        try:
            results.append(work())
        except BaseException as error:
            errors.append(error)
        working.release()

    from ..engine.jit.c_threads import start

    is_alive = start(body)
    try:
        while is_alive() and not working.acquire(timeout=0.1):
            pass
    except KeyboardInterrupt:
        working.acquire(timeout=0.2)  # lets an image that is being written be finished
        raise
    if errors:
        raise errors[0]
    if not results:
        raise MemoryError("cannot start a thread")
    return results[0]


class WriteError(Exception):
    """Error for a result that could not be written although the input was good, which matters for the exit status."""


@contextmanager
def writing(output: Path) -> Iterator[None]:
    """Turn an OSError raised in this context, such as that of a full disk, into a WriteError: the input is not bad."""
    try:
        yield
    except OSError as error:
        raise WriteError(f"{output}: {error.strerror or error}") from error
