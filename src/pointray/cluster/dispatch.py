"""Which worker does which job: each has two, one that it does and one that waits there.

A job whose worker has died is done again elsewhere. When all jobs are handed out, workers without any take over those
that wait elsewhere, and those that take much longer than usual, in the work or on the way back: what is ready first
counts, and both give the same.
"""

from __future__ import annotations

import queue
import time
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from ..base.executor import Job
from ..model.model_file import Place
from .worker import UnseenFileError

TICK = 0.1  # seconds between two reports of progress
AT_ONCE = 2  # jobs of a worker: one more than it does, so that it need not wait for the next one
SLOW, LEAST_SLOW = 3.0, 2.0  # a job is slow that takes so many times the median, and so many seconds
SLOW_AT_HOME = 60.0  # seconds, of a job that only one worker is prepared for
ATTEMPTS = 4  # of a job whose workers die: it may be what kills them


@dataclass(eq=False)
class _Flight:
    """A job on a worker, until its result is here.

    begun : when the worker took it up, or began to send the result, as far as is known
    result : the future of what is being sent; None while the worker is at it
    """

    job: Job
    attempt: int
    worker: str
    future: Any
    begun: float
    result: Any = None


class WorkerBackend(Protocol):
    """Those who do jobs, see `worker_pool.WorkerPool`."""

    workers: dict[str, int]

    def submit(self, job: Job, worker: str) -> Any:
        """Have a worker do a job; returns the future, None if that failed."""

    def fetch(self, future: Any) -> Any:
        """Begin to fetch what a future holds; returns the `concurrent.futures.Future` of that."""

    def unsee(self, place: Place) -> None:
        """A worker does not see a file."""


class Dispatch:
    """Jobs, where they are being done, and what is ready."""

    def __init__(self, pool: WorkerBackend, jobs: deque[Job]) -> None:
        self._pool, self._jobs = pool, jobs
        self._again: deque[tuple[Job, int]] = deque()  # jobs of workers that have died, and the number of attempts
        self.flights: list[_Flight] = []  # in the order in which they were handed out
        self._ready: queue.SimpleQueue[Any] = queue.SimpleQueue()  # waits in C: see `engine.jit.threads.run`
        self._times: deque[float] = deque(maxlen=64)  # seconds that jobs took

    @property
    def is_done(self) -> bool:
        """Whether nothing is left to do."""
        return not (self._jobs or self._again or self.flights)

    def drop_lost(self) -> None:
        """Do again what workers did that are gone."""
        for flight in [one for one in self.flights if one.worker not in self._pool.workers]:
            self._drop(flight)
            self._retry(flight, flight.attempt + 1)

    def hand_out(self) -> None:
        """Give each worker as many jobs as it should have."""
        for round in range(AT_ONCE):
            for worker in self._pool.workers:
                if len(self._flights_of(worker)) <= round and not self._give(worker):
                    return

    def _give(self, worker: str) -> bool:
        """Give a worker a job, if there is one for it; returns whether jobs can be sent."""
        again = next((one for one in self._again if self._is_for(one[0], worker)), None)
        if again is not None:
            self._again.remove(again)
            return self._launch(*again, worker)
        job = next((one for one in self._jobs if self._is_for(one, worker)), None)
        if job is not None:
            self._jobs.remove(job)
            return self._launch(job, 1, worker)
        return bool(self._flights_of(worker)) or self._take_over(worker)

    def _is_for(self, job: Job, worker: str) -> bool:
        """Whether a worker may do a job at once."""
        return not job.home or job.home == worker or job.home not in self._pool.workers

    def _take_over(self, worker: str) -> bool:
        """Have an idle worker do what waits at another one, or what another one takes too long for."""
        for flight in [one for one in self.flights if one.worker != worker]:
            alone = len(self._flights_for(flight.job)) == 1
            waits = flight in self._flights_of(flight.worker)[1:] and self._is_for(flight.job, worker)
            if alone and waits:
                self._drop(flight)
            if alone and (waits or self._is_slow(flight)):
                return self._launch(flight.job, flight.attempt, worker)
        return True

    def _is_slow(self, flight: _Flight) -> bool:
        spent = time.monotonic() - flight.begun
        least = SLOW_AT_HOME if flight.job.home else LEAST_SLOW
        return bool(self._times) and spent > max(SLOW * float(np.median(self._times)), least)

    def take_in(self) -> Iterator[tuple[Job, Any]]:
        """Wait a moment for results; yields those that are ready."""
        try:
            futures = [self._ready.get(timeout=TICK)]
        except queue.Empty:
            return
        while not self._ready.empty():
            futures.append(self._ready.get())
        for future in futures:
            flight = next((one for one in self.flights if future in (one.future, one.result)), None)
            if flight is None:  # it is no longer wanted
                continue
            if flight.result is None:
                self._land(flight)
            else:
                yield from self._unload(flight)

    def _land(self, flight: _Flight) -> None:
        """A worker is through with a job: fetch the result, which takes for ever where the worker stands still now."""
        now = time.monotonic()
        for waiting in self._flights_of(flight.worker)[1:]:
            waiting.begun = now
        if flight.future.status != "finished":
            self._fail(flight, flight.future.exception() if flight.future.status == "error" else None)
            return
        self._times.append(now - flight.begun)
        flight.begun, flight.result = now, self._pool.fetch(flight.future)
        flight.result.add_done_callback(self._ready.put)

    def _unload(self, flight: _Flight) -> Iterator[tuple[Job, Any]]:
        """A result is here, or was lost on its way."""
        if flight.result.cancelled() or flight.result.exception() is not None:
            self._fail(flight, None)
            return
        for one in self._flights_for(flight.job):
            self._drop(one)
        self._again = deque(other for other in self._again if other[0] is not flight.job)
        yield flight.job, flight.result.result()

    def _fail(self, flight: _Flight, error: BaseException | None) -> None:
        """A job gave an error; None: it, or its result, was lost with its worker."""
        self._drop(flight)
        if isinstance(error, UnseenFileError):
            if flight.job.home and error.args[0].index:  # a model in parts is not sent to one who holds some of them
                raise ValueError(str(error))
            self._pool.unsee(error.args[0])
            self._retry(flight, flight.attempt)
        elif error is None or type(error).__name__ == "KilledWorker":
            self._retry(flight, flight.attempt + 1)
        else:
            raise error

    def _retry(self, flight: _Flight, attempt: int) -> None:
        """Do a job again, unless it is being done elsewhere too."""
        if self._flights_for(flight.job):
            return
        if attempt > ATTEMPTS:
            raise RuntimeError(f"{flight.job.name}: given up, as {ATTEMPTS} workers of Dask were lost with it")
        self._again.append((flight.job, attempt))

    def _launch(self, job: Job, attempt: int, worker: str) -> bool:
        """Have a worker do a job; returns whether that could be sent."""
        future = self._pool.submit(job, worker)
        if future is None:
            self._again.appendleft((job, attempt))
            return False
        self.flights.append(_Flight(job, attempt, worker, future, time.monotonic()))
        future.add_done_callback(self._ready.put)
        return True

    def _drop(self, flight: _Flight) -> None:
        """Nobody wants this any more: the worker stops."""
        self.flights.remove(flight)
        flight.future.release()

    def _flights_of(self, worker: str) -> list[_Flight]:
        """What a worker has to do: the first is what it is at."""
        return [one for one in self.flights if one.worker == worker and one.result is None]

    def _flights_for(self, job: Job) -> list[_Flight]:
        return [one for one in self.flights if one.job is job]

    def end(self) -> None:
        """Stop all that is still being done."""
        for flight in self.flights[:]:
            self._drop(flight)
