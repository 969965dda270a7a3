"""Executor of jobs on a scene by the workers of a client."""

from __future__ import annotations

import hashlib
import time
import uuid
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Any

from ..base.executor import Job
from ..base.warning_log import warn
from ..model.model import Model
from ..model.model_file import Place
from .client import check_client, is_fit, memory_of, unfit
from .dispatch import Dispatch
from .recipe import SceneLike, write_recipe
from .scattered_objects import ScatteredObject, check_spreadable, scattered_objects_of
from .worker import JobSpec, do_job

REFRESH = 1.0  # seconds between two updates of the list of workers
LOST = "connection to the Dask scheduler lost"
NO_WORKERS_TIMEOUT = 60.0  # timeout in seconds without any worker

WorkerCheck = Callable[[Any, list[str]], dict[str, str]]


class WorkerPool:
    """The workers of a Dask client as an executor of jobs on one scene (`base.executor.Executor`).

    Parameters
    ----------
    client : distributed.Client
        One with workers, as checked by `check_client`.
    scene : Scene
        It is copied.
    ask : callable, optional
        Called with the client and addresses of workers, returns the reason for each one that must not be used.
    spread : bool
        Whether each worker opens only some parts of models in parts. Jobs must provide for that.

    Attributes
    ----------
    workers : dict
        Number of threads of each worker, by its address.
    """

    def __init__(self, client: Any, scene: SceneLike, ask: WorkerCheck | None = None, spread: bool = False) -> None:
        self._client, self._objects, self._ask, self.spread = client, scattered_objects_of(client), ask, spread
        scene = scene.copy()
        self._baked = None if spread else scene.baked
        self._models: list[Model] = scene.models
        recipe = write_recipe(scene, self._models)
        self._unique_name = hashlib.sha256(recipe).hexdigest()[:16]
        self._recipe = ScatteredObject("scene", recipe)
        self.workers: dict[str, int] = {}
        self._unfit: set[str] = set()
        self._refreshed, self._had_workers = -REFRESH, time.monotonic()
        self._refresh_workers()

    def run(self, jobs: deque[Job], tick: Callable[[], None]) -> Iterator[tuple[Job, Any]]:
        """Do jobs on the workers; yield each with its result, in the order of completion.

        jobs : the caller may add jobs between two results
        tick : called ten times a second; an exception in it stops all jobs

        Raises
        ------
        RuntimeError
            If the scheduler or all workers are lost, or several workers died while running the same job.
        """
        work = Dispatch(self, jobs)
        try:
            while not work.is_done:
                self._refresh_workers()
                work.drop_lost()
                work.assign_jobs()
                tick()
                yield from work.collect_results()
        finally:
            work.end()

    def submit(self, job: Job, worker: str) -> Any:
        """Submit a job to the worker with an address. Returns its Dask future, or None if its data cannot be sent.

        If the worker dies, Dask may give it to another one.
        """
        client = self._client
        try:
            baked, recipe = self._send_baked(), self._recipe.send(client)
            models = [self._objects.of_model(model) for model in self._models]
            sent = [model if isinstance(model, Place) else model.send(client) for model in models]
            values = [self._objects.of(one, one.name, one.value).send(client) for one in job.shared]
        except OSError:  # from Dask: no worker in time, or the scheduler is lost
            return None
        except AttributeError:
            if self._client.scheduler is None:  # Dask uses it without a check
                raise RuntimeError(LOST) from None
            raise
        scene = " ".join([self._unique_name, *(_unique_name(one) for one in (baked, *sent))])
        todo = do_job, JobSpec(scene, job.work, job.args, len(values)), recipe, baked, *sent, *values
        key = f"{job.name}-{uuid.uuid4().hex}"
        return client.submit(*todo, key=key, workers=[worker], allow_other_workers=True, pure=False)

    def fetch(self, future: Any) -> Any:
        """Start the transfer of a future's result to this process. Returns a `concurrent.futures.Future`."""
        import asyncio

        gathered = self._client.gather(future, asynchronous=True)
        return asyncio.run_coroutine_threadsafe(gathered, self._client.loop.asyncio_loop)

    def mark_unseen(self, place: Place) -> None:
        """Record that a worker does not see a model's file: the model itself is sent to workers from now on."""
        self._objects.unseen.add(place)

    def _send_baked(self) -> Any:
        """Return the Dask future of the scene's baked light, sent if necessary, or None without light."""
        if self._baked is None:
            return None
        return self._objects.of(self._baked, "baked light", self._baked.portable()).send(self._client)

    def _refresh_workers(self) -> None:
        """Update `workers` from the scheduler, at most once a second.

        Raises RuntimeError if the scheduler is lost, or there was no worker for 60 seconds.
        """
        now = time.monotonic()
        if now - self._refreshed < REFRESH:
            return
        self._refreshed = now
        if self._client.status != "running":
            raise RuntimeError(LOST)
        with suppress(OSError):  # connection lost: the next check of its status raises
            self._update_workers(self._client.nthreads())
        if now - self._had_workers > NO_WORKERS_TIMEOUT:
            raise RuntimeError(f"no Dask worker available for {NO_WORKERS_TIMEOUT:.0f} seconds")

    def _update_workers(self, there: dict[str, int]) -> None:
        """Set `workers` to the usable ones of those present; warn of new ones that are not.

        there : number of threads of each present worker, by address
        """
        new = [worker for worker in there if worker not in self.workers and worker not in self._unfit]
        for worker, reason in (self._find_unusable(new) if new else {}).items():
            self._unfit.add(worker)
            warn(f"worker ignored: {reason}", stacklevel=2)
        usable = (worker for worker in there if worker not in self._unfit and is_fit(self._client, worker))
        self.workers = {worker: there[worker] for worker in usable}
        if self.workers:
            self._had_workers = time.monotonic()

    def _find_unusable(self, workers: list[str]) -> dict[str, str]:
        """Return the reason for each worker, by address, that cannot be used, such as another version of pointray."""
        wrongs = unfit(self._client, workers)
        if self._ask is not None:
            wrongs |= self._ask(self._client, [worker for worker in workers if worker not in wrongs])
        return wrongs


def snapshot_and_executor(scene: SceneLike, client: Any, spread: bool | None = False) -> tuple[Any, WorkerPool]:
    """Return a snapshot of a scene, and the workers of a client as an executor of jobs on this state of the scene.

    spread : whether each worker opens only some parts of models in parts; None: only if one exceeds a worker's memory
    """
    check_client(client)
    scene = scene.copy()
    parted = [model for model in scene.models if model.parts]
    if spread is None:
        free = memory_of(client) if parted else 0
        spread = any(model.nbytes > free for model in parted)
    for model in parted if spread else ():
        check_spreadable(model)
    return scene.snapshot(), WorkerPool(client, scene, spread=spread)


def _unique_name(sent: Any) -> str:
    """Return a unique name of what was sent for a model or light: the key of a future, or a file's place as text."""
    return str(getattr(sent, "key", sent))
