"""The workers of a client at work on one scene."""

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
from .recipe import Stage, write_recipe
from .scattered_objects import ScatteredObject, check_spreadable, scattered_objects_of
from .worker import JobSpec, do_job

REFRESH = 1.0  # seconds between two looks at who is there
LOST = "the scheduler of Dask is lost"
ALONE = 60.0  # seconds without any worker after which a pool gives up

Ask = Callable[[Any, list[str]], dict[str, str]]


class WorkerPool:
    """The workers of a client, and a scene.

    Parameters
    ----------
    client : distributed.Client
        As `check_client` takes it.
    scene : Scene
        As it is now; later changes of the scene change nothing here.
    ask : callable, optional
        Given the client and some workers, it tells what is wrong with those that must not be used, as `unfit` does.
    spread : bool
        Whether each worker opens only some parts of models in parts: whoever makes jobs sees to that.

    Attributes
    ----------
    workers : dict
        The threads of each, by its address.
    """

    def __init__(self, client: Any, scene: Stage, ask: Ask | None = None, spread: bool = False) -> None:
        self._client, self._objects, self._ask, self.spread = client, scattered_objects_of(client), ask, spread
        scene = scene.copy()
        self._baked = None if spread else scene.baked
        self._models: list[Model] = scene.models
        recipe = write_recipe(scene, self._models)
        self._name = hashlib.sha256(recipe).hexdigest()[:16]
        self._recipe = ScatteredObject("scene", recipe)
        self.workers: dict[str, int] = {}
        self._unfit: set[str] = set()
        self._called, self._seen = -REFRESH, time.monotonic()
        self._refresh_workers()

    def run(self, jobs: deque[Job], tick: Callable[[], None]) -> Iterator[tuple[Job, Any]]:
        """Do jobs; yields each with its result, in the order in which they are ready.

        jobs : the caller may add others between two results
        tick : called ten times a second; an error in it ends all

        Raises
        ------
        RuntimeError
            If the scheduler, or all workers, are lost, or several workers died of the same job.
        """
        work = Dispatch(self, jobs)
        try:
            while not work.is_done:
                self._refresh_workers()
                work.drop_lost()
                work.hand_out()
                tick()
                yield from work.take_in()
        finally:
            work.end()

    def submit(self, job: Job, worker: str) -> Any:
        """Have a worker do a job; returns the future, None if that failed: no worker takes what has to be sent.

        If the worker dies, Dask may have another one do it.
        """
        client = self._client
        try:
            baked, recipe = self._send_baked(), self._recipe.send(client)
            models = [self._objects.of_model(model) for model in self._models]
            sent = [model if isinstance(model, Place) else model.send(client) for model in models]
            things = [self._objects.of(one, one.name, one.value).send(client) for one in job.shared]
        except OSError:  # of Dask, which found no worker in time, or lost the scheduler
            return None
        except AttributeError:
            if self._client.scheduler is None:  # Dask asks it for its methods all the same
                raise RuntimeError(LOST) from None
            raise
        scene = " ".join([self._name, *(_name(one) for one in (baked, *sent))])
        todo = do_job, JobSpec(scene, job.work, job.args, len(things)), recipe, baked, *sent, *things
        key = f"{job.name}-{uuid.uuid4().hex}"
        return client.submit(*todo, key=key, workers=[worker], allow_other_workers=True, pure=False)

    def fetch(self, future: Any) -> Any:
        """Begin to fetch what a future holds; returns the `concurrent.futures.Future` of that."""
        import asyncio

        gathered = self._client.gather(future, asynchronous=True)
        return asyncio.run_coroutine_threadsafe(gathered, self._client.loop.asyncio_loop)

    def unsee(self, place: Place) -> None:
        """From now on the model in a file is sent, as not all workers see it."""
        self._objects.unseen.add(place)

    def _send_baked(self) -> Any:
        """The future of the baked light; None: there is none."""
        if self._baked is None:
            return None
        return self._objects.of(self._baked, "baked light", self._baked.portable()).send(self._client)

    def _refresh_workers(self) -> None:
        """See which workers are there, once a second."""
        now = time.monotonic()
        if now - self._called < REFRESH:
            return
        self._called = now
        if self._client.status != "running":
            raise RuntimeError(LOST)
        with suppress(OSError):  # the connection is lost: its status will tell
            self._call(self._client.nthreads())
        if now - self._seen > ALONE:
            raise RuntimeError(f"all workers of Dask are gone, for {ALONE:.0f} seconds")

    def _call(self, there: dict[str, int]) -> None:
        """Take note of the workers that are there."""
        new = [worker for worker in there if worker not in self.workers and worker not in self._unfit]
        for worker, reason in (self._wrongs_of(new) if new else {}).items():
            self._unfit.add(worker)
            warn(f"it is not used: {reason}", stacklevel=2)
        usable = (worker for worker in there if worker not in self._unfit and is_fit(self._client, worker))
        self.workers = {worker: there[worker] for worker in usable}
        if self.workers:
            self._seen = time.monotonic()

    def _wrongs_of(self, workers: list[str]) -> dict[str, str]:
        """What is wrong with each of some workers that cannot be used."""
        wrongs = unfit(self._client, workers)
        if self._ask is not None:
            wrongs |= self._ask(self._client, [worker for worker in workers if worker not in wrongs])
        return wrongs


def snapshot_and_executor(scene: Stage, client: Any, spread: bool | None = False) -> tuple[Any, WorkerPool]:
    """Return a scene's snapshot as it is now, and the workers of a client for it.

    spread : whether models in parts are spread over the workers; None: if one does not fit into a worker's memory
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


def _name(sent: Any) -> str:
    """What tells a thing that was sent from others."""
    return str(getattr(sent, "key", sent))
