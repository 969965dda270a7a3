"""A child of `prepare.py`: build a model with levels from one file, and time every stage.

    python -m bench.preparation.stages FILE [--without-normals] [--noise DISTANCE]

Prints JSON: seconds, processor seconds and peak memory of each stage. A stage is a few functions of the package; the
clock replaces them by their names wherever they were imported. Own seconds are those in which no other stage runs.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import threading
import time
import warnings
from collections.abc import Callable
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

import pointray as pr

# The functions of each stage, inner ones of others too. Names that the package lacks are passed over.
STAGES = {
    "sort and distinct": ("distinct", "kd_order", "compute_kd_ordering"),
    "neighbours": ("NeighborTree.__init__", "NeighborTree.query"),
    "noise and layers": ("merge_for_model", "measure_ranges"),
    "fits": ("fit_normals", "fit_surface"),
    "orientation": ("orient", "orient_thin_sheets", "orient_unknown"),
    "normals": ("place",),
    "radii": ("make_splats",),
    "tree": ("build_tree",),
}
WARM = 20_000  # points of the small cloud that compiles the kernels
CLEAR = Path("/proc/self/clear_refs")

Work = TypeVar("Work", bound=Callable[..., Any])


@dataclass
class Spent:
    """Resource usage of a stage.

    own : seconds without the stages inside
    peak : bytes of the process; 0 for a stage inside another one
    """

    seconds: float = 0.0
    own: float = 0.0
    processor: float = 0.0
    peak: int = 0


@dataclass
class Clock:
    """Stages as they run, one inside the other."""

    spent: dict[str, Spent] = field(default_factory=dict)
    _open: list[tuple[str, list[float]]] = field(default_factory=list)  # name, seconds of the stages inside

    @contextmanager
    def stage(self, name: str) -> Any:
        """Count what happens inside. A stage inside itself counts once."""
        if threading.current_thread() is not threading.main_thread() or any(name == there for there, _ in self._open):
            yield
            return
        outermost = not self._open
        if outermost:
            reset_peak()
        inside = [0.0]
        self._open.append((name, inside))
        wall, processor = time.perf_counter(), time.process_time()
        try:
            yield
        finally:
            wall, processor = time.perf_counter() - wall, time.process_time() - processor
            self._open.pop()
            if self._open:
                self._open[-1][1][0] += wall
            spent = self.spent.setdefault(name, Spent())
            spent.seconds, spent.processor = spent.seconds + wall, spent.processor + processor
            spent.own += wall - inside[0]
            if outermost:
                spent.peak = max(spent.peak, peak())

    def apart(self, work: Callable[..., Any], *words: Any) -> Any:
        """Do work whose stages count as outermost ones, so that each has a peak of its own."""
        around, self._open = self._open, []
        try:
            return work(*words)
        finally:
            self._open = around

    def around(self, name: str, work: Work) -> Work:
        """The function with this clock around it."""

        def timed(*words: Any, **named: Any) -> Any:
            with self.stage(name):
                return work(*words, **named)

        return timed  # type: ignore[return-value]


def reset_peak() -> None:
    """The most memory is that of now; else it is that of the parent (Linux)."""
    with suppress(OSError):
        CLEAR.write_text("5")


def peak() -> int:
    """Peak bytes of memory since `reset_peak`; 0 where the system does not report it."""
    with suppress(OSError):
        lines = Path("/proc/self/status").read_text().splitlines()
        return 1024 * next(int(line.split()[1]) for line in lines if line.startswith("VmHWM"))
    return 0


def watch(clock: Clock) -> None:
    """Put the clock around every function of `STAGES`, under every name by which a module of the package knows it."""
    modules = [module for name, module in list(sys.modules.items()) if name.startswith("pointray")]
    for stage, names in STAGES.items():
        for name in names:
            owner, _, method = name.partition(".")
            found = {id(vars(module)[owner]): vars(module)[owner] for module in modules if owner in vars(module)}
            for thing in found.values():
                if method and hasattr(thing, method):
                    setattr(thing, method, clock.around(stage, getattr(thing, method)))
                elif not method and callable(thing):
                    timed = clock.around(stage, thing)
                    for module in modules:
                        if vars(module).get(owner) is thing:
                            setattr(module, owner, timed)


def cloud_of(points: pr.Points, normals: bool, noise: float) -> pr.Points:
    """The points, perhaps moved in all directions by a Gaussian, perhaps without normals."""
    if noise:
        away = np.random.default_rng(1).normal(scale=noise, size=points.positions.shape)
        points = points.changed(positions=points.positions + away.astype(np.float32))
    return points if normals else points.with_normals(None)


def warm_up(points: pr.Points, normals: bool, noise: float) -> None:
    """Compile or load the kernels with a part of the points that is as dense as the whole, and with a thin sample."""
    part = np.sort(np.argsort(points.positions[:, 0])[:WARM])
    thin = np.arange(0, len(points), max(len(points) // WARM, 1))
    for rows, distance in ((part, noise), (thin, noise * math.sqrt(len(points) / len(thin)))):
        pr.Model(cloud_of(points.select(rows), normals, distance)).make_levels()


def measure(file: Path, normals: bool, noise: float) -> dict[str, Any]:
    """Return the resource usage of each stage, and the number of points."""
    warm_up(pr.read(file), normals, noise)
    clock = Clock()
    reset_peak()
    with clock.stage("read"):
        points = pr.read(file)
    points = cloud_of(points, normals, noise)
    watch(clock)
    with clock.stage("whole model"):
        model = clock.apart(pr.Model, points)
    clock.spent["whole model"].peak = max(spent.peak for spent in clock.spent.values())
    with clock.stage("levels"):
        model.make_levels()
    clock.spent["whole model"].own = 0.0
    return {"points": len(points), "stages": {name: asdict(spent) for name, spent in clock.spent.items()}}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", type=Path)
    parser.add_argument("--without-normals", action="store_true")
    parser.add_argument("--noise", type=float, default=0.0, help="standard deviation, in the points' unit")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    print(json.dumps(measure(options.file, not options.without_normals, options.noise)))


if __name__ == "__main__":
    main()
