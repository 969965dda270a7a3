"""A picture by the workers of a cluster who each hold some of the models: several pieces at once, wave after wave."""

from __future__ import annotations

import threading
from collections import OrderedDict, deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...base.executor import Executor, Job
from ...engine.kernels.records import World
from ...scene.ownership import Rows, Shares, boxes_of
from ...scene.world import Snapshot
from ...surface.trace.cast import Pace
from ..camera import Camera
from ..lod import at_distance
from ..pieces import Piece
from .route import route
from .wave import Answer, KernelArguments, Question, Waves, answer_question, passes_of, pieces_of

PIECES = 3  # in the works at once: while the rays of some travel, others go on here
MOST_RAYS = 1 << 16  # of a message: 4 MiB
WORLDS = 4  # that the holders in a process keep


@dataclass(frozen=True)
class View:
    """What levels of detail depend on. samples : of a pixel; None: there are no levels"""

    camera: Camera
    samples: int | None


@dataclass(frozen=True)
class Traffic:
    """What has travelled.

    Attributes
    ----------
    waves : int
        Questions of pieces.
    asked : int
        Rays in them.
    rays : int
        Rays that were sent: a ray that may meet what several hold goes to each of them.
    sent, received : int
        Bytes of rays, and of answers.
    """

    waves: int = 0
    asked: int = 0
    rays: int = 0
    sent: int = 0
    received: int = 0

    def plus(self, **more: int) -> Traffic:
        """The sum with some numbers."""
        return replace(self, **{name: getattr(self, name) + number for name, number in more.items()})

    def since(self, before: Traffic) -> Traffic:
        """What was added since it was like that."""
        return self.plus(**{name: -number for name, number in vars(before).items()})


class _Meter:
    """Counts what travels."""

    traffic = Traffic()


def traffic() -> Traffic:
    """All that has travelled for pictures of this process so far."""
    return _Meter.traffic


def _count(**more: int) -> None:
    _Meter.traffic = _Meter.traffic.plus(**more)


def add_by_waves(
    executor: Executor,
    scene: Snapshot,
    view: View,
    picture: KernelArguments,
    samples: tuple[int, int],
    progress: Callable[[float], None] | None,
) -> None:
    """Add samples to all of a picture.

    executor : of the same scene; scene : as the camera sees it, with nothing opened
    samples : the number of the first one, and of the one after the last
    """
    RayExchange(executor, scene, view, progress).add(picture, samples)


class RayExchange:
    """Pieces of a picture in the works, and their questions on the way."""

    def __init__(
        self, executor: Executor, scene: Snapshot, view: View, progress: Callable[[float], None] | None = None
    ) -> None:
        self._executor, self._view, self._progress = executor, view, progress
        self._shares = Shares(scene, executor.workers)
        self._boxes = boxes_of(scene, self._shares.rows)
        self._jobs = deque[Job]()
        self._asked: dict[Job, tuple[_Piece, Rows]] = {}
        self._waiting: dict[_Piece, int] = {}  # pieces in the works, and how many answers each waits for
        self._done, self._total = 0, 1
        self._waves = 0

    def add(self, picture: KernelArguments, samples: tuple[int, int]) -> None:
        """Add samples to all of a picture."""
        size = picture.image.shape[1], picture.image.shape[0]
        pieces = [_Piece(picture, piece, samples) for piece in pieces_of(size, samples)]
        self._total = len(pieces)
        pending = iter(pieces)
        self._begin(pending)
        for job, given in self._executor.run(self._jobs, self._tick):
            self._take(job, given)
            self._begin(pending)

    def _tick(self, share: float = 0.0) -> None:
        if self._progress is not None:
            self._progress(self._done / self._total)

    def _begin(self, pending: Iterator[_Piece]) -> None:
        """Begin pieces until enough of them are in the works."""
        while len(self._waiting) < PIECES:
            piece = next(pending, None)
            if piece is None:
                return
            self._go_on(piece)

    def _go_on(self, piece: _Piece) -> None:
        """Have a piece ask; if nobody has to be asked, go on until it is done."""
        while (question := piece.ask(self._tick)) is not None:
            sent = self._send(piece, question)
            if sent > 0:
                self._waiting[piece] = sent
                return
        self._done += 1

    def _send(self, piece: _Piece, question: Question) -> int:
        """Send a question to those who hold what its rays may meet; returns in how many messages."""
        self._shares.pass_on(self._executor.workers)
        shares, sent = self._shares, 0
        meets = route(question.rays, self._boxes, shares.owners, len(shares.holders), None)
        self._waves += 1
        _count(waves=1, asked=len(question.rays))
        for k, holder in enumerate(shares.holders):
            reached = np.flatnonzero(meets[:, k])
            for begin in range(0, len(reached), MOST_RAYS):
                rows = reached[begin : begin + MOST_RAYS]
                part = question.of(rows)
                job = Job(f"wave {self._waves}", answer_here, (self._view, shares.of(holder), part), home=holder)
                self._asked[job] = piece, rows
                self._jobs.append(job)
                _count(rays=len(rows), sent=part.nbytes)
                sent += 1
        return sent

    def _take(self, job: Job, given: Answer) -> None:
        """Take an answer; when it is the last one to a question, the piece goes on."""
        piece, rows = self._asked.pop(job)
        _count(received=given.nbytes)
        piece.take(rows, given)
        self._waiting[piece] -= 1
        if self._waiting[piece] == 0:
            del self._waiting[piece]
            self._go_on(piece)


class _Piece:
    """The samples of a piece of a picture, some of them after the others."""

    def __init__(self, picture: KernelArguments, piece: Piece, samples: tuple[int, int]) -> None:
        self._passes = (Waves(picture, piece, some) for some in passes_of(samples))
        self._now: Waves | None = None  # nothing takes memory before the piece is begun

    def ask(self, progress: Any) -> Question | None:
        """See `Waves.ask`; None: all samples are there."""
        while True:
            question = None if self._now is None else self._now.ask(progress)
            if question is None:
                self._now = next(self._passes, None)
            if question is not None or self._now is None:
                return question

    def take(self, rows: NDArray[np.int64], given: Answer) -> None:
        """See `Waves.take`."""
        assert self._now is not None
        self._now.take(rows, given)


_WORLDS: OrderedDict[tuple[Any, ...], tuple[Snapshot, World]] = OrderedDict()  # of holders in this process
_LOCK = threading.Lock()


def answer_here(scene: Snapshot, view: View, rows: Rows, question: Question, threads: int, check: Any) -> Answer:
    """Answer a question on a worker. rows : of the instances that it holds"""
    return answer_question(world_of(scene, view, rows), question, Pace(threads, check))


def world_of(scene: Snapshot, view: View, rows: Rows) -> World:
    """What rays meet in what somebody holds, which is opened; it is kept."""
    key = id(scene), view, rows.tobytes()  # the scene is kept too, so that no other one gets its id
    with _LOCK:
        if key not in _WORLDS:
            made = held_world(scene, view, rows)
            while len(_WORLDS) >= WORLDS:
                _WORLDS.popitem(last=False)
            _WORLDS[key] = scene, made
        _WORLDS.move_to_end(key)
        return _WORLDS[key][1]


def held_world(scene: Snapshot, view: View, rows: Rows) -> World:
    """What rays meet in some instances that lie on disk, and in all that does not; planes are left out."""
    if view.samples is None:
        world = scene.opened(rows).world
    else:
        world, _ = at_distance(scene, view.camera, view.samples, held=rows)
    return world._replace(planes=np.zeros(0))
