"""Stages `cluster` and `faults` of `scale.py`: Dask workers compared with one process, and killed workers."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from distributed import Client, LocalCluster
from distributed.comm.tcp import TCP

import pointray as pr
from bench.scale.pictures import lit
from bench.scale.prepare import Options, asked, command_of, prepared
from bench.scale.rows import LEAST, MOST, Row
from bench.scale.watch import UNFINISHED, watched

THROUGHPUT = 0.85  # asked, of one process
FRAMES, CHUNK = 24, 100_000  # of the film; rays of a chunk
PATHS = {"integrator": "path", "spp": 64, "max_depth": 4}
AFTER = "place-0000.json"  # the mark after which a worker that prepares is killed
PART = 1 << 18  # points of a part, if nothing else is asked for: two workers have room for it in 2 GiB
_SENT = [0]  # bytes, of this process

Pictures = Callable[[Any, Any], Any]  # (client or None, progress or None) -> result


class Task(NamedTuple):
    """A task for one process and for a cluster.

    name : of its rows
    what : it is, for people
    make : gives arrays
    units, unit : how many of what it makes
    rays : of the camera
    """

    name: str
    what: str
    make: Pictures
    units: int
    unit: str
    rays: int


# ------------------------------------------------------------------------------------------------- counted bytes


def count_sent() -> None:
    """Count the bytes that this process sends to others of Dask."""
    write = TCP.write
    if hasattr(write, "counts"):
        return

    async def counted(self: TCP, *words: Any, **named: Any) -> Any:
        sent = await write(self, *words, **named)
        _SENT[0] += sent if isinstance(sent, int) else 0
        return sent

    counted.counts = True  # type: ignore[attr-defined]
    TCP.write = counted


def sent_here() -> int:
    """Bytes that this process has sent."""
    return _SENT[0]


def sent_by_all(client: Any) -> int:
    """Bytes that this process, with the scheduler in it, and all workers have sent."""
    return sent_here() + sum(client.run(sent_here).values())


@contextmanager
def cluster_of(workers: int) -> Iterator[Any]:
    """A client of workers of one thread each, processes of this machine whose messages are counted."""
    options = {"n_workers": workers, "threads_per_worker": 1, "memory_limit": 0}
    quiet = {"dashboard_address": "127.0.0.1:0", "silence_logs": 50}
    with LocalCluster(**options, **quiet) as cluster, Client(cluster, set_as_default=False) as client:
        count_sent()
        client.run(count_sent)
        yield client


# ------------------------------------------------------------------------------------------------------------ tasks


def tasks(options: Options) -> list[Task]:
    """The film, the path-traced picture and the rays."""
    scene = lit(pr.Model.load(prepared(options)))
    cameras, near = options.city.flight(FRAMES, options.size), options.city.near(options.size)
    pixels = int(np.prod(options.size))
    quick, paths = pr.Settings(threads=options.workers), pr.Settings(threads=options.workers, **PATHS)

    def film(client: Any, progress: Any) -> Any:
        return list(pr.animate(scene, cameras, quick, progress, client))

    def path(client: Any, progress: Any) -> Any:
        return [pr.render(scene, near, paths, progress, client=client)]

    return [
        Task("film", f"a film of {FRAMES} frames", film, FRAMES, "frame", FRAMES * pixels),
        Task("path", f"a path-traced picture, {PATHS['spp']} samples", path, 1, "picture", PATHS["spp"] * pixels),
        Task("rays", "the nearest hits of rays in arrays of Dask", partial(_hits, scene, near), pixels, "ray", pixels),
        *spread_tasks(options, scene),
    ]


def _hits(scene: pr.Scene, camera: pr.Camera, client: Any, progress: Any, spread: bool = False) -> list[Any]:
    """How far the rays of a camera go."""
    import dask.array as da

    rays = [
        np.ascontiguousarray(np.broadcast_to(rows, (*camera.size[::-1], 3))).reshape(-1, 3) for rows in camera.rays()
    ]
    if client is None:
        return [scene.intersect(*rays).t]
    with client.as_current():
        chunked = [da.from_array(rows, chunks=(CHUNK, 3)) for rows in rays]
        return [client.compute(scene.intersect(*chunked, spread=spread).t).result()]


def spread_tasks(options: Options, scene: pr.Scene) -> list[Task]:
    """Pictures of parts spread over workers, which exchange rays."""
    near, pixels = options.city.near(options.size), int(np.prod(options.size))
    kinds = {"lit": pr.Settings(), "paths": pr.Settings(**{**PATHS, "spp": 2})}

    def picture(settings: pr.Settings, client: Any, progress: Any) -> Any:
        more = {} if client is None else {"client": client, "spread": True}
        return [pr.render(scene, near, settings, progress, **more)]

    rays = Task(
        "spread.rays",
        "the nearest hits of rays, parts on workers",
        partial(_hits, scene, near, spread=True),
        pixels,
        "ray",
        pixels,
    )
    return [rays] + [
        Task(
            f"spread.{name}",
            f"a picture of parts on workers, {name}",
            partial(picture, settings),
            1,
            "picture",
            settings.spp * pixels,
        )
        for name, settings in kinds.items()
    ]


def apart(one: list[Any], other: list[Any]) -> int:
    """How many numbers differ."""
    return sum(int((a != b).sum() - (np.isnan(a) & np.isnan(b)).sum()) for a, b in zip(one, other, strict=True))


def timed(work: Callable[[], Any], runs: int) -> tuple[float, Any]:
    """Least seconds of several runs, after one that makes all ready, and the result."""
    least, result = np.inf, work()
    for _ in range(runs):
        begun = time.perf_counter()
        result = work()
        least = min(least, time.perf_counter() - begun)
    return float(least), result


# ---------------------------------------------------------------------------------------------------------- cluster


def cluster(options: Options) -> Iterator[Row]:
    """Workers of one thread each, and one process with as many threads."""
    with cluster_of(options.workers) as client:
        for task in tasks(options):
            one, whole = timed(partial(task.make, None, None), options.runs)
            many, found = timed(partial(task.make, client, None), options.runs)
            before = sent_by_all(client)
            task.make(client, None)
            sent = sent_by_all(client) - before
            yield from _rows_of(options, task, (one, many), apart(whole, found), sent)
    yield from _prepared_by_workers(options)


def _rows_of(options: Options, task: Task, seconds: tuple[float, float], differ: int, sent: int) -> Iterator[Row]:
    name, row = f"cluster.{task.name}", options.row
    yield row(f"{name}.one", seconds[0], "s", f"{task.what}, by one process of {options.workers} threads")
    yield row(f"{name}.many", seconds[1], "s", f"the same, by {options.workers} workers of one thread")
    ratio = row(f"{name}.throughput", seconds[0] / seconds[1], "", "of workers, of the process's")
    yield asked(ratio, LEAST, THROUGHPUT) if task.name in ("film", "path") else ratio
    yield asked(row(f"{name}.apart", differ, "", "numbers that differ"), MOST, 0)
    yield row(f"{name}.sent", sent / task.units, f"bytes/{task.unit}", "sent over the network")
    yield row(f"{name}.sent.ray", sent / task.rays, "bytes/ray", f"the same, of {task.rays:,} rays of the camera")


def _prepared_by_workers(options: Options) -> Iterator[Row]:
    spent = {}
    for name, words in (("one", ()), ("many", ("--workers", options.workers))):
        folder = options.there / f"by-{name}.pointray"
        shutil.rmtree(folder, ignore_errors=True)
        spent[name] = watched(command_of(sized(options), folder, *words), folder)
    one, many, row = spent["one"], spent["many"], options.row
    yield row("cluster.prepare.one", one.seconds, "s", "`prepare` by one process")
    yield row("cluster.prepare.many", many.seconds, "s", f"the same, --workers {options.workers}")
    ratio = row("cluster.prepare.throughput", one.seconds / many.seconds, "", "of workers, of the process's")
    yield asked(ratio, LEAST, THROUGHPUT)
    yield row("cluster.prepare.peak", many.resident, "bytes", "resident memory, all processes")
    folders = (options.there / f"by-{name}.pointray" for name in ("one", "many"))
    yield asked(row("cluster.prepare.apart", arrays_apart(*folders), "", "arrays that differ"), MOST, 0)


def sized(options: Options) -> Options:
    """With parts of a size that workers have room for too."""
    return replace(options, part_points=options.part_points or PART)


def arrays_apart(one: Path, other: Path) -> int:
    """How many arrays of two models in parts differ."""
    models = [pr.Model.load(path) for path in (one, other)]
    if len({len(model.parts) for model in models}) > 1:
        return 1
    columns = [[model.points.positions, model.points.normals, model.radii] for model in models]
    pairs = list(zip(*columns, strict=True))
    for a, b in zip(*(model.parts for model in models), strict=True):
        pairs += list(zip(a.tree, b.tree, strict=True))
    return sum(not np.array_equal(a, b, equal_nan=np.asarray(a).dtype.kind == "f") for a, b in pairs if a is not None)


# ----------------------------------------------------------------------------------------------------------- faults


def kill_one(client: Any) -> None:
    """Kill a worker as `kill -9` does."""
    os.kill(next(iter(client.run(os.getpid).values())), signal.SIGKILL)


def await_workers(client: Any, count: int, before: frozenset[str] = frozenset()) -> frozenset[str]:
    """Wait for a number of workers, at least one of them new, and return their addresses."""
    while len(there := frozenset(client.nthreads())) != count or there == before:
        time.sleep(0.1)
    return there


def faults(options: Options) -> Iterator[Row]:
    """A worker is killed in the middle of each: the result is the same."""
    with cluster_of(options.workers) as client:
        for task in tasks(options):
            if task.unit == "ray":  # a graph of Dask's own: what becomes of it is up to Dask
                continue
            there, killed = await_workers(client, options.workers), []

            def report(stage: str, share: float, killed: list[float] = killed) -> None:
                if share > 0.2 and not killed:
                    killed.append(share)
                    kill_one(client)

            whole, found = task.make(None, None), task.make(client, report)
            if killed:
                await_workers(client, options.workers, there)
            yield from _fault_rows(options, task.name, task.what, len(killed), apart(whole, found))
    yield from _killed_while_preparing(options)


def _fault_rows(options: Options, name: str, what: str, killed: int, differ: int) -> Iterator[Row]:
    yield asked(options.row(f"faults.{name}.killed", killed, "", f"workers killed while they made {what}"), LEAST, 1)
    yield asked(options.row(f"faults.{name}.apart", differ, "", "differences from one process"), MOST, 0)


def _killed_while_preparing(options: Options) -> Iterator[Row]:
    folder, killed = options.there / "killed.pointray", 0
    shutil.rmtree(folder, ignore_errors=True)
    with cluster_of(options.workers) as client:
        words = command_of(sized(options), folder, "--cluster", client.scheduler.address)
        with subprocess.Popen([sys.executable, *map(str, words)], stderr=subprocess.PIPE, text=True) as process:
            while process.poll() is None:
                if not killed and any((folder / UNFINISHED / place / AFTER).exists() for place in (".", "surface")):
                    kill_one(client)
                    killed = 1
                time.sleep(0.02)
            complaint = process.stderr.read() if process.stderr else ""
    if process.returncode:
        raise RuntimeError(complaint.strip().splitlines()[-1])
    whole = options.there / "by-one.pointray"
    if not (whole / "index.json").exists():
        watched(command_of(sized(options), whole))
    yield from _fault_rows(options, "prepare", "a model in parts", killed, arrays_apart(whole, folder))
