"""Assignment of jobs to workers. Each worker has two jobs: one in progress and one queued.

The jobs of a lost worker are retried elsewhere. When all jobs are assigned, idle workers take over jobs that are queued
elsewhere, and duplicate jobs that take much longer than the median to compute or to send back. The first result is
used; both are identical.
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
JOBS_PER_WORKER = 2  # jobs per worker: one is queued, so that the worker does not wait
SLOW, LEAST_SLOW = 3.0, 2.0  # a job is slow if it takes this multiple of the median, and at least these seconds
SLOW_AT_HOME = 60.0  # the same seconds for a job with a home, as other workers are not prepared for it
ATTEMPTS = 4  # attempts of a job whose workers die, as it may be the cause


def aligned(result: Any) -> Any:
    """Return a received result whose arrays are aligned, as kernels require; those of a message may not be."""
    if isinstance(result, np.ndarray):
        return np.require(result, requirements="A")
    return tuple(map(aligned, result)) if type(result) is tuple else result


@dataclass(eq=False)
class _Assignment:
    """A job on a worker, until its result has been received.

    attempt : number of the attempt, from 1; increases when a worker is lost
    worker : address of the worker; future : Dask's future of the job
    begun : estimated time (`time.monotonic`) at which the worker began the job; once the job is finished, at which
        the transfer of the result began
    result : future of the transfer of the result; None while the job is not finished
    """

    job: Job
    attempt: int
    worker: str
    future: Any
    begun: float
    result: Any = None


class WorkerBackend(Protocol):
    """Interface of the workers to which `Dispatch` assigns jobs. workers : number of threads by address"""

    workers: dict[str, int]

    def submit(self, job: Job, worker: str) -> Any:
        """Submit a job to the worker with an address. Returns its Dask future, or None if it could not be sent."""

    def fetch(self, future: Any) -> Any:
        """Start the transfer of a future's result. Returns a `concurrent.futures.Future`."""

    def mark_unseen(self, place: Place) -> None:
        """Record that a worker does not see a model's file, so that the model itself is sent to workers instead."""


class Dispatch:
    """Assigns jobs to workers, at most two to each, collects their results and repeats jobs of lost or slow workers.

    Parameters
    ----------
    pool : WorkerBackend
        The workers.
    jobs : deque of Job
        Jobs to do. The caller may add more.
    """

    def __init__(self, pool: WorkerBackend, jobs: deque[Job]) -> None:
        self._pool, self._jobs = pool, jobs
        self._retries: deque[tuple[Job, int]] = deque()  # jobs to retry, and the number of the attempt
        self.assignments: list[_Assignment] = []  # in the order of assignment
        self._ready: queue.SimpleQueue[Any] = queue.SimpleQueue()  # waits in C, see `engine.jit.threads.run`
        self._times: deque[float] = deque(maxlen=64)  # duration of the last jobs in seconds

    @property
    def is_done(self) -> bool:
        """Whether no job is waiting or assigned."""
        return not (self._jobs or self._retries or self.assignments)

    def drop_lost(self) -> None:
        """Queue the jobs of workers that are no longer in the pool for another attempt."""
        for assignment in [one for one in self.assignments if one.worker not in self._pool.workers]:
            self._release(assignment)
            self._retry(assignment, assignment.attempt + 1)

    def assign_jobs(self) -> None:
        """Assign jobs until each worker has two: one in progress, and one queued so that it need not wait."""
        for round in range(JOBS_PER_WORKER):
            for worker in self._pool.workers:
                if len(self._assignments_of(worker)) <= round and not self._assign_next(worker):
                    return

    def _assign_next(self, worker: str) -> bool:
        """Assign the next job to a worker, if there is one for it; an idle worker may take one over from another.

        Returns False if jobs cannot be sent.

        worker : address
        """
        retry = next((one for one in self._retries if self._is_for(one[0], worker)), None)
        if retry is not None:
            self._retries.remove(retry)
            return self._submit(*retry, worker)
        job = next((one for one in self._jobs if self._is_for(one, worker)), None)
        if job is not None:
            self._jobs.remove(job)
            return self._submit(job, 1, worker)
        return bool(self._assignments_of(worker)) or self._take_over(worker)

    def _is_for(self, job: Job, worker: str) -> bool:
        """Return whether a job may be assigned to a worker: it prefers this worker, or none that is connected.

        worker : address
        """
        return not job.home or job.home == worker or job.home not in self._pool.workers

    def _take_over(self, worker: str) -> bool:
        """Assign to an idle worker a job that is queued at another worker, or that is slow on all workers that do it.

        A slow transfer of a result counts too, even from this worker: Dask joins transfers, so that it may wait for
        another worker that hangs. Returns False if jobs cannot be sent; True also without such a job.
        """
        for assignment in [one for one in self.assignments if one.worker != worker or one.result is not None]:
            same = self._assignments_for(assignment.job)
            waits = assignment in self._assignments_of(assignment.worker)[1:] and self._is_for(assignment.job, worker)
            if len(same) == 1 and waits:
                self._release(assignment)
            if (len(same) == 1 and waits) or all(map(self._is_slow, same)):
                return self._submit(assignment.job, assignment.attempt, worker)
        return True

    def _is_slow(self, assignment: _Assignment) -> bool:
        spent = time.monotonic() - assignment.begun
        least = SLOW_AT_HOME if assignment.job.home else LEAST_SLOW
        return bool(self._times) and spent > max(SLOW * float(np.median(self._times)), least)

    def collect_results(self) -> Iterator[tuple[Job, Any]]:
        """Wait for results for TICK (0.1) seconds at most, and yield jobs with results that have been received."""
        try:
            futures = [self._ready.get(timeout=TICK)]
        except queue.Empty:
            return
        while not self._ready.empty():
            futures.append(self._ready.get())
        for future in futures:
            assignment = next((one for one in self.assignments if future in (one.future, one.result)), None)
            if assignment is None:  # released
                continue
            if assignment.result is None:
                self._start_transfer(assignment)
            else:
                yield from self._finish_transfer(assignment)

    def _start_transfer(self, assignment: _Assignment) -> None:
        """Start the transfer of the result of a finished job; if the job failed, retry it or raise its error.

        The transfer never ends if the worker hangs, so it is asynchronous.
        """
        now = time.monotonic()
        for waiting in self._assignments_of(assignment.worker)[1:]:
            waiting.begun = now
        if assignment.future.status != "finished":
            self._fail(assignment, assignment.future.exception() if assignment.future.status == "error" else None)
            return
        self._times.append(now - assignment.begun)
        assignment.begun, assignment.result = now, self._pool.fetch(assignment.future)
        assignment.result.add_done_callback(self._ready.put)

    def _finish_transfer(self, assignment: _Assignment) -> Iterator[tuple[Job, Any]]:
        """Yield a job with its received result, and release its duplicates; retry the job if the transfer failed."""
        if assignment.result.cancelled() or assignment.result.exception() is not None:
            self._fail(assignment, None)
            return
        for one in self._assignments_for(assignment.job):
            self._release(one)
        self._retries = deque(other for other in self._retries if other[0] is not assignment.job)
        yield assignment.job, aligned(assignment.result.result())

    def _fail(self, assignment: _Assignment, error: BaseException | None) -> None:
        """Retry a failed job if its worker was lost or does not see a file; otherwise raise its error.

        error : None if the job or its result was lost with its worker
        """
        self._release(assignment)
        if isinstance(error, UnseenFileError):
            if assignment.job.home and error.args[0].index:  # workers hold only some of its parts
                raise ValueError(str(error))
            self._pool.mark_unseen(error.args[0])
            self._retry(assignment, assignment.attempt)
        elif error is None or type(error).__name__ == "KilledWorker":
            self._retry(assignment, assignment.attempt + 1)
        else:
            raise error

    def _retry(self, assignment: _Assignment, attempt: int) -> None:
        """Queue a job for another attempt, unless another worker does it too.

        Raises RuntimeError after 4 attempts whose workers were lost, as the job may be the cause.

        attempt : number of the next attempt
        """
        if self._assignments_for(assignment.job):
            return
        if attempt > ATTEMPTS:
            raise RuntimeError(f"{assignment.job.name}: failed, {ATTEMPTS} Dask workers were lost while running it")
        self._retries.append((assignment.job, attempt))

    def _submit(self, job: Job, attempt: int, worker: str) -> bool:
        """Submit a job to a worker; return whether it was sent. If not, it waits for another attempt.

        attempt : counts from 1; worker : address
        """
        future = self._pool.submit(job, worker)
        if future is None:
            self._retries.appendleft((job, attempt))
            return False
        self.assignments.append(_Assignment(job, attempt, worker, future, time.monotonic()))
        future.add_done_callback(self._ready.put)
        return True

    def _release(self, assignment: _Assignment) -> None:
        """Forget a job on a worker, and release its Dask future, upon which the worker stops it."""
        self.assignments.remove(assignment)
        assignment.future.release()

    def _assignments_of(self, worker: str) -> list[_Assignment]:
        """Return the unfinished jobs of a worker in the order of assignment; the first is in progress.

        worker : address
        """
        return [one for one in self.assignments if one.worker == worker and one.result is None]

    def _assignments_for(self, job: Job) -> list[_Assignment]:
        return [one for one in self.assignments if one.job is job]

    def end(self) -> None:
        """Release the futures of all jobs, upon which workers stop them."""
        for assignment in self.assignments[:]:
            self._release(assignment)
