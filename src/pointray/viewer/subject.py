"""What is shown, to all browsers alike: a scene, which may still be on its way from a file, or be built anew."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from ..camera import Camera
from ..data import Points
from ..model import Model
from ..scene import Scene
from ..settings import Settings

log = logging.getLogger("pointray.view")


@dataclass(frozen=True)
class Build:
    """How models are built: the parameters of `Model` that the panel has."""

    surface: str
    samples: int
    radius_scale: float = 1.0


@dataclass(frozen=True)
class Progress:
    """What is going on. share : None where it is not known; an empty stage: nothing is."""

    stage: str = ""
    share: float | None = None


class Given(NamedTuple):
    """What a model is built of: points, their radii, and by how much these were scaled since."""

    points: Points
    radii: NDArray[np.float32]
    scale: float


class Loader(Protocol):
    """Brings a scene: `Subject.show` as often as there is more of it to see, `Subject.say` what it is at."""

    def __call__(self, subject: Subject) -> None: ...


class Subject:
    """The scene, and who wants to know when it changes.

    Attributes
    ----------
    title : str
    source : str
        The file, as `pointray render` takes it; empty: there is none, or several.
    up : (3,) tuple
    home : Camera or None
        Where a browser begins; None: where it sees all.
    settings, exposure, curve
        What it begins with.
    problem : str
        Why there is nothing to see, or not all.
    """

    def __init__(
        self,
        title: str,
        scene: Scene | None = None,
        up: tuple[float, float, float] = (0.0, 0.0, 1.0),
        settings: Settings | None = None,
        source: str = "",
    ) -> None:
        self.title, self.up, self.settings, self.source = title, up, settings or Settings(), source
        self.home: Camera | None = None
        self.exposure, self.curve = 0.0, "srgb"
        self.problem = ""
        self.progress = Progress()
        self._scene, self._shown = scene, 0
        self._given: WeakKeyDictionary[Model, Given] = (
            WeakKeyDictionary()
        )  # what the models that were built here are built of
        self._listeners: list[Callable[[], None]] = []
        self._lock, self._building = threading.Lock(), threading.Lock()

    @property
    def scene(self) -> Scene | None:
        """What there is so far."""
        return self._scene

    @property
    def version(self) -> tuple[int, int]:
        """Another one whenever the scene is, or has changed."""
        return self._shown, 0 if self._scene is None else self._scene._version

    def listen(self, listener: Callable[[], None]) -> Callable[[], None]:
        """Have something called, from any thread, whenever anything changes; returns what ends that."""
        with self._lock:
            self._listeners.append(listener)

        def leave() -> None:
            with self._lock:
                if listener in self._listeners:
                    self._listeners.remove(listener)

        return leave

    def load(self, loader: Loader) -> threading.Thread:
        """Let a loader bring the scene, in the background."""

        def work() -> None:
            loader(self)

        return self._start(work)

    def show(self, scene: Scene, home: Camera | None = None) -> None:
        """This is what is shown from now on, and where a browser begins."""
        self._scene, self.home = scene, home or self.home
        self._shown += 1
        self.tell()

    @property
    def build(self) -> Build | None:
        """How the models that are shown are built; of several, the first."""
        models = [] if self._scene is None else self._scene.models
        if not models:
            return None
        scale = self._given[models[0]].scale if models[0] in self._given else 1.0
        return Build(models[0].surface, models[0].settings.samples, scale)

    def rebuild(self, build: Build) -> threading.Thread:
        """Build all models anew, in the background; what is there is shown until then."""

        def work() -> None:
            with self._building:
                scene = self._scene
                if scene is None or build == self.build:
                    return
                made: dict[Model, Model] = {}
                for k, model in enumerate(scene.models):

                    def say(stage: str, share: float, k: int = k) -> None:
                        self.say(f"building: {stage}", (k + share) / len(scene.models))

                    made[model] = self._rebuilt(model, build, say)
                self.show(scene.exchange(made))

        return self._start(work)

    def _rebuilt(self, model: Model, build: Build, say: Callable[[str, float], None]) -> Model:
        given = self._given.get(model, Given(model.points, model.radii, 1.0))
        built = Model(
            given.points,
            given.radii,
            surface=build.surface,
            samples=build.samples,
            radius_scale=build.radius_scale,
            progress=say,
        )
        self._given[built] = given._replace(scale=build.radius_scale)
        return built

    def _start(self, work: Callable[[], None]) -> threading.Thread:
        thread = threading.Thread(target=self._run, args=(work,), name="pointray-builder", daemon=True)
        thread.start()
        return thread

    def _run(self, work: Callable[[], None]) -> None:
        try:
            work()
        except (OSError, ValueError) as error:
            self.problem = str(error)
        except Exception as error:
            log.exception("while building")
            self.problem = f"{type(error).__name__}: {error}"
        self.say("", None)

    def say(self, stage: str, share: float | None) -> None:
        """What is being done, and how much of it is."""
        self.progress = replace(self.progress, stage=stage, share=share)
        self.tell()

    def tell(self) -> None:
        """Say to all who listen that something has changed."""
        with self._lock:
            listeners = list(self._listeners)
        for listener in listeners:
            listener()
