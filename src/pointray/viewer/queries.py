"""Slower requests of one browser, answered in the background: the point under the mouse, the legend of colours."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from concurrent.futures import Executor, ThreadPoolExecutor
from typing import Generic, NamedTuple, TypeVar

from ..base.arrays import Doubles
from ..scene.scene import Scene
from ..shade.attributes import Attribute
from .outbox import Outbox, legend_of
from .painter import FrameRequest
from .pick import pick, prepare

log = logging.getLogger("pointray.view")

T = TypeVar("T")


class Click(NamedTuple):
    """A click on the view.

    Attributes
    ----------
    request : FrameRequest
        The image shown.
    position : (2,) tuple of float
        0 to 1 from the left and from the top.
    purpose : str
        "target": turn the camera to the point. Otherwise the page is sent a description of the point.
    extend : bool
        Whether to send the distance from the last clicked point, too.
    """

    request: FrameRequest
    position: tuple[float, float]
    purpose: str
    extend: bool


class Newest(Generic[T]):
    """Queue of length one for background work: a newer request replaces one that still waits.

    Parameters
    ----------
    jobs : Executor
        Runs `answer`.
    answer : callable
        Called with a request.
    needed_by : callable, optional
        Returns whether a request needs the answer to the one before it, which then is kept.
    """

    def __init__(
        self, jobs: Executor, answer: Callable[[T], None], needed_by: Callable[[T], bool] = lambda question: False
    ) -> None:
        self._jobs, self._answer, self._needed_by = jobs, answer, needed_by
        self._lock = threading.Lock()
        self._waiting: list[T] = []

    def ask(self, question: T) -> None:
        """Queue a request for `answer`; it is dropped if a newer one that does not need it arrives before it starts."""
        with self._lock:
            waiting = self._waiting
            self._waiting = [*waiting[-1:], question] if self._needed_by(question) else [question]
        if not waiting:  # otherwise the job already submitted takes this one
            self._jobs.submit(self._run)

    def _run(self) -> None:
        with self._lock:
            waiting, self._waiting = self._waiting, []
        for question in waiting:
            self._answer(question)


class Lookups:
    """Answers clicks and requests for legends of one browser in one thread, one after the other.

    Parameters
    ----------
    outbox : Outbox
        Receives the answers to clicks.
    apply : callable
        Returns the scene of a `FrameRequest`; raises ValueError if it cannot be made, which the painter reports.
    show_legend : callable
        Called with a request, the attribute that colours its scene, and the image of the legend.
    """

    def __init__(
        self,
        outbox: Outbox,
        apply: Callable[[FrameRequest], Scene],
        show_legend: Callable[[FrameRequest, Attribute, str], None],
    ) -> None:
        self._outbox, self._apply, self._show_legend = outbox, apply, show_legend
        self._found: Doubles | None = None  # the last point found
        self._state = threading.Lock()  # guards the next two
        self._prepared = self._stopped = False
        self._jobs = ThreadPoolExecutor(1, "pointray-pick")
        self._clicks = Newest(self._jobs, self._find, needed_by=lambda click: click.extend)
        self._legends = Newest(self._jobs, self._draw_legend)

    def click(self, click: Click) -> None:
        """Find the surface point under a click in the background, and send it to the page."""
        self._clicks.ask(click)

    def forget(self) -> None:
        """Forget the last clicked point, so that no distance is measured from it."""
        self._found = None

    def legend(self, request: FrameRequest) -> None:
        """Draw the legend of the attribute that colours a request's scene, in the background, for `show_legend`."""
        self._legends.ask(request)

    def prepare(self, scene: Scene) -> None:
        """Load or compile in the background the kernel that finds clicked points; later calls have no effect.

        This takes seconds, which a click then need not wait.
        """
        with self._state:
            if not self._prepared and not self._stopped:
                self._prepared = True
                self._jobs.submit(self._prepare, scene)

    def stop(self) -> None:
        """Discard waiting requests and accept no more."""
        with self._state:
            self._stopped = True
            self._jobs.shutdown(wait=False, cancel_futures=True)

    def _find(self, click: Click) -> None:
        try:
            found = pick(self._apply(click.request), click.request.camera, *click.position)
        except ValueError:  # the painter reports it
            return
        if found is None:
            return
        if click.purpose == "target":
            self._outbox.send_message(type="target", position=found.position.tolist())
            return
        self._outbox.found(found, self._found if click.extend else None)
        self._found = found.position

    def _draw_legend(self, request: FrameRequest) -> None:
        try:
            shown = self._apply(request).shown_attributes[0]
            image = legend_of(shown)
        except ValueError:  # the painter reports it
            return
        self._show_legend(request, shown, image)

    def _prepare(self, scene: Scene) -> None:
        try:
            prepare(scene)
        except Exception:
            log.exception("error while preparing for clicks")
