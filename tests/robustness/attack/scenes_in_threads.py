"""Threads trace a scene while another one changes, copies and pickles it, and drops models that only it held.

Each result must be that of a state which the scene has been in, to the last bit.
"""

from __future__ import annotations

import copy
import gc
import pickle
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import pointray as pr
from attack import Attack, WrongError
from attack.mutate import Rng, pick

SPAN = 0.35  # seconds that an input takes
SLOTS = 2  # slots, each of which may hold a model
SIZE = (12, 12)
SHIFT = np.array([[1.0, 0, 0, 0.3], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])


class State(NamedTuple):
    """What the scene holds.

    Attributes
    ----------
    there : tuple of bool
        Whether each slot has its model.
    moved : bool
        Whether the fixed model is at its second position.
    lit : bool
        Whether there is a light.
    cut : bool
        Whether a clip plane cuts the scene.
    """

    there: tuple[bool, ...]
    moved: bool
    lit: bool
    cut: bool


class Stage:
    """A scene that can be changed from one state to another.

    The models of the slots are loaded from files each time, so that only the scene holds them.
    """

    def __init__(self, files: list[Path], fixed: pr.Model) -> None:
        self.scene, self._files = pr.Scene(), files
        self._fixed = self.scene.add(fixed)
        self._numbers: dict[int, int] = {}
        self.state = State((False,) * SLOTS, False, False, False)

    def change_to(self, state: State) -> None:
        """Make one change after another; the scene is in a valid state after each."""
        for slot, there in enumerate(state.there):
            if there and slot not in self._numbers:
                self._numbers[slot] = self.scene.add(pr.Model.load(self._files[slot]))
            if not there and slot in self._numbers:
                self.scene.remove(self._numbers.pop(slot))
                gc.collect(0)
        if state.moved != self.state.moved:
            self.scene.update(self._fixed, SHIFT if state.moved else np.eye(4))
        if state.lit != self.state.lit:
            self.scene.lights = [pr.SunLight((1, 1, -1), 3.0)] if state.lit else []
        if state.cut != self.state.cut:
            self.scene.clips = [((0, 0, 0.2), (0, 0, 1))] if state.cut else ()
        self.state = state


def all_states() -> list[State]:
    flags = [bool(k & 1) for k in range(2)]
    return [
        State((a, b), moved, lit, cut)
        for a in flags
        for b in flags
        for moved in flags
        for lit in flags
        for cut in flags
    ]


def neighbour(rng: Rng, state: State) -> State:
    """A state that differs in one thing."""
    k = int(rng.integers(SLOTS + 3))
    if k < SLOTS:
        return state._replace(there=tuple(there != (slot == k) for slot, there in enumerate(state.there)))
    name = ("moved", "lit", "cut")[k - SLOTS]
    return state._replace(**{name: not getattr(state, name)})


class Views:
    """The queries of a scene: closest hits, any hits, and a picture, each as bytes."""

    def __init__(self) -> None:
        self._camera = pr.Camera.look_at((0.4, -6, 1), (0.4, 0, 0), fov=40, size=SIZE)
        self._rays = self._camera.rays()

    def intersect(self, scene: pr.Scene) -> bytes:
        hits = scene.intersect(*self._rays)
        return hits.t.tobytes() + hits.point.tobytes()

    def occluded(self, scene: pr.Scene) -> bytes:
        return scene.occluded(*self._rays).tobytes()

    def single(self, scene: pr.Scene) -> bytes:
        return scene.intersect(self._rays[0][5, 6], self._rays[1][5, 6]).t.tobytes()

    def render(self, scene: pr.Scene) -> bytes:
        return pr.render(scene, self._camera, pr.Settings("phong")).tobytes()


QUESTIONS = ("intersect", "occluded", "single", "render")


def copied(rng: Rng, scene: pr.Scene) -> tuple[str, pr.Scene]:
    """A copy by a random method, and the method's name."""
    copiers: dict[str, Callable[[Any], Any]] = {
        "copy": copy.copy,
        "deepcopy": copy.deepcopy,
        "pickle": lambda scene: pickle.loads(pickle.dumps(scene)),
        "Scene.copy": lambda scene: scene.copy(),
    }
    name = pick(rng, list(copiers))
    return name, copiers[name](scene)


def begin(folder: Path) -> Attack:
    """Scenes that change while they are traced."""
    rng = np.random.default_rng(2)
    rows = rng.normal(size=(400, 3))
    rows /= np.linalg.norm(rows, axis=1, keepdims=True)
    files = []
    for slot, center in enumerate(([1.3, 0.0, 0.6], [-0.9, -0.5, -0.3])):
        files.append(folder / f"{slot}.pointray")
        pr.Model(pr.Points(0.6 * rows + center, rows)).save(files[-1])
    fixed, views, states = pr.Model(pr.Points(rows, rows)), Views(), all_states()
    answers: dict[str, dict[bytes, set[State]]] = {name: {} for name in QUESTIONS}
    for state in states:
        stage = Stage(files, fixed)
        stage.change_to(state)
        for name in QUESTIONS:
            answers[name].setdefault(getattr(views, name)(stage.scene), set()).add(state)

    def attack(rng: Rng, index: int) -> bool:
        stage, errors = Stage(files, fixed), []
        stage.change_to(pick(rng, states))
        end, stop = time.monotonic() + SPAN, threading.Event()
        sets = float(rng.random())

        def ask(seed: int) -> None:
            mine = np.random.default_rng(seed)
            while not stop.is_set():
                name = pick(mine, QUESTIONS)
                if getattr(views, name)(stage.scene) not in answers[name]:
                    raise WrongError(f"{name}: the result is that of no state of the scene")

        def change(seed: int) -> None:
            mine = np.random.default_rng(seed)
            while not stop.is_set():
                stage.change_to(neighbour(mine, stage.state))
                time.sleep(sets * 0.004)

        def replicate(seed: int) -> None:
            mine = np.random.default_rng(seed)
            while not stop.is_set():
                method, twin = copied(mine, stage.scene)
                name = pick(mine, QUESTIONS)
                if getattr(views, name)(twin) not in answers[name]:
                    raise WrongError(f"{name} of a {method}: the result is that of no state of the scene")

        def guarded(work: Callable[[int], None], seed: int) -> None:
            try:
                work(seed)
            except Exception as error:
                errors.append(error)
                stop.set()

        works = [ask] * int(rng.integers(1, 4)) + [change] + [replicate] * int(rng.integers(0, 2))
        threads = [threading.Thread(target=guarded, args=(work, int(rng.integers(2**31)))) for work in works]
        for thread in threads:
            thread.start()
        while time.monotonic() < end and not stop.is_set():
            time.sleep(0.02)
        stop.set()
        for thread in threads:
            thread.join()
        if errors:
            raise errors[0]
        check_copies(rng, stage, views)
        return True

    return attack


def check_copies(rng: Rng, stage: Stage, views: Views) -> None:
    """Check that copies can be traced after the original is gone, and do not change with it."""
    want = {name: getattr(views, name)(stage.scene) for name in QUESTIONS}
    method, twin = copied(rng, stage.scene)
    stage.change_to(neighbour(rng, neighbour(rng, stage.state)))
    stage.scene = pr.Scene()
    gc.collect()
    for name, right in want.items():
        if getattr(views, name)(twin) != right:
            raise WrongError(f"{name} of a {method} has changed with the original")
