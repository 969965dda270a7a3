"""Exchange of rays with the workers of a cluster that each hold some of the models, for several pieces at once."""

from __future__ import annotations

import threading
from collections import OrderedDict, deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...base.arrays import Rows
from ...base.executor import Executor, Job
from ...engine.kernels.records import World
from ...scene.ownership import Shares, boxes_of
from ...scene.world import Snapshot
from ...surface.trace.cast import Pace
from ..camera import Camera
from ..lod import at_distance
from ..pieces import Piece
from .route import route
from .wave import Answer, KernelArguments, Question, Waves, answer_query, passes_of, pieces_of

PIECES = 3  # pieces in progress: some are shaded while the rays of others are on the way
MOST_RAYS = 1 << 16  # rays a message: 4 MiB
WORLDS = 4  # worlds cached by the holders in a process


@dataclass(frozen=True)
class View:
    """Camera and number of samples a pixel, from which workers select levels of detail. samples : None: no levels"""

    camera: Camera
    samples: int | None


@dataclass(frozen=True)
class Traffic:
    """Statistics of rays sent to the workers that hold the models.

    Attributes
    ----------
    waves : int
        Queries: sets of rays that a piece of an image needs intersected before its samples continue.
    asked : int
        Rays in these queries.
    rays : int
        Rays sent: a ray that may hit parts on several workers is sent to each.
    sent, received : int
        Bytes of rays, and of answers.
    """

    waves: int = 0
    asked: int = 0
    rays: int = 0
    sent: int = 0
    received: int = 0

    def plus(self, **more: int) -> Traffic:
        """Return new statistics with numbers added. more : the number to add to each field, by name"""
        return replace(self, **{name: getattr(self, name) + number for name, number in more.items()})

    def since(self, before: Traffic) -> Traffic:
        """Return the difference of these statistics to earlier ones."""
        return self.plus(**{name: -number for name, number in vars(before).items()})


class _Meter:
    """Holder of the statistics of all rays that this process has sent to workers."""

    traffic = Traffic()


def traffic() -> Traffic:
    """Return the statistics of all rays that this process has sent to workers so far."""
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
    """Add samples to a whole image, with rays sent to the workers that hold the models.

    executor : workers of the same scene
    scene : with the lights that follow the camera fixed in the world, and no parts on disk opened
    view : camera and samples a pixel, from which workers select levels of detail
    picture : the rendering kernel and its arguments, among them the image, where the result is stored
    samples : range of sample indices
    """
    RayExchange(executor, scene, view, progress).add(picture, samples)


class RayExchange:
    """Rendering of an image whose models are held by workers: pieces in progress, and the rays sent for them.

    While the rays of some pieces are with the workers, which return hits, this process shades others.
    """

    def __init__(
        self, executor: Executor, scene: Snapshot, view: View, progress: Callable[[float], None] | None = None
    ) -> None:
        self._executor, self._view, self._progress = executor, view, progress
        self._shares = Shares(scene, executor.workers)
        self._boxes = boxes_of(scene, self._shares.rows)
        self._jobs = deque[Job]()
        self._asked: dict[Job, tuple[_Piece, Rows]] = {}
        self._waiting: dict[_Piece, int] = {}  # pieces in progress: number of missing answers
        self._done, self._total = 0, 1
        self._waves = 0

    def add(self, picture: KernelArguments, samples: tuple[int, int]) -> None:
        """Add samples to a whole image, and return when all its pieces are finished.

        picture : the rendering kernel and its arguments, among them the image, where the result is stored
        samples : range of sample indices
        """
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
        """Start pieces of the image until enough are in progress. pending : pieces not yet started"""
        while len(self._waiting) < PIECES:
            piece = next(pending, None)
            if piece is None:
                return
            self._continue(piece)

    def _continue(self, piece: _Piece) -> None:
        """Run the samples of a piece until they need hits of rays, which are sent to workers, or are finished."""
        while (question := piece.ask(self._tick)) is not None:
            sent = self._send(piece, question)
            if sent > 0:
                self._waiting[piece] = sent
                return
        self._done += 1

    def _send(self, piece: _Piece, question: Question) -> int:
        """Send the rays of a piece to the workers with parts that they may hit; return the number of messages."""
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
        """Store the hits that a worker returned for a job; after the last ones that a piece needs, continue it."""
        piece, rows = self._asked.pop(job)
        _count(received=given.nbytes)
        piece.take(rows, given)
        self._waiting[piece] -= 1
        if self._waiting[piece] == 0:
            del self._waiting[piece]
            self._continue(piece)


class _Piece:
    """Computation of the samples of a piece of an image, pass by pass; a pass is a range of sample indices."""

    def __init__(self, picture: KernelArguments, piece: Piece, samples: tuple[int, int]) -> None:
        self._passes = (Waves(picture, piece, some) for some in passes_of(samples))
        self._now: Waves | None = None  # allocated when the piece is started

    def ask(self, progress: Any) -> Question | None:
        """Return the next rays to send to workers; None if all samples are finished.

        All answers to the previous rays must have been passed to `take`.
        """
        while True:
            question = None if self._now is None else self._now.ask(progress)
            if question is None:
                self._now = next(self._passes, None)
            if question is not None or self._now is None:
                return question

    def take(self, rows: NDArray[np.int64], given: Answer) -> None:
        """Store the hits that a worker returned for some of the rays. rows : of these rays in the query, ascending"""
        assert self._now is not None
        self._now.take(rows, given)


_WORLDS: OrderedDict[tuple[Any, ...], tuple[Snapshot, World]] = OrderedDict()  # of holders in this process
_LOCK = threading.Lock()


def answer_here(scene: Snapshot, view: View, rows: Rows, question: Question, threads: int, check: Any) -> Answer:
    """Intersect rays from the client on a worker, and return their hits with the models that the worker holds.

    view : camera and samples a pixel, which select levels of detail; question : the rays
    rows : rows of the instances whose models the worker holds
    check : progress callback, which raises an exception to cancel
    """
    return answer_query(world_of(scene, view, rows), question, Pace(threads, check))


def world_of(scene: Snapshot, view: View, rows: Rows) -> World:
    """Return the world with the models that a worker holds opened, from a cache of the last few.

    view : camera and samples a pixel, which select levels of detail
    rows : rows of the instances whose models the worker holds
    """
    key = id(scene), view, rows.tobytes()  # the cache keeps the scene alive, so that its id stays unique
    with _LOCK:
        if key not in _WORLDS:
            made = held_world(scene, view, rows)
            while len(_WORLDS) >= WORLDS:
                _WORLDS.popitem(last=False)
            _WORLDS[key] = scene, made
        _WORLDS.move_to_end(key)
        return _WORLDS[key][1]


def held_world(scene: Snapshot, view: View, rows: Rows) -> World:
    """Return a world in which rays hit the parts on disk of given instances, and models that are not on disk.

    It has no planes, which the sender of the rays intersects itself.

    view : camera and samples a pixel, which select levels of detail; rows : rows of the given instances
    """
    if view.samples is None:
        world = scene.opened(rows).world
    else:
        world, _ = at_distance(scene, view.camera, view.samples, held=rows)
    return world._replace(planes=np.zeros(0))
