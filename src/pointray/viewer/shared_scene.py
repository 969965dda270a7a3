"""What is shown, to all browsers alike: a scene, which may still be on its way from a file, or be built anew."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Protocol

from ..jit import BACKLOG
from ..model import Model
from ..rendering.camera import Camera, check_direction
from ..rendering.settings import Settings
from ..scene.scene import Scene
from ..staging.first_view import Scan, ViewChoice
from .sketch import Sketch
from .time_left import TimeLeft

log = logging.getLogger("pointray.view")


@dataclass(frozen=True)
class Build:
    """How models are built: the parameters of `Model` that the panel has."""

    surface: str
    samples: int
    radius_scale: float = 1.0


@dataclass(frozen=True)
class Progress:
    """What is going on. share, seconds (that are left) : None where not known; an empty stage: nothing is going on."""

    stage: str = ""
    share: float | None = None
    seconds: float | None = None


class Loader(Protocol):
    """Brings a scene: `SharedScene.show` as often as there is more of it to see, `SharedScene.say` what it is at.

    Before, `SharedScene.outline` if there are points and no kernels yet to trace them.
    """

    def __call__(self, shared: SharedScene) -> None: ...


class SharedScene:
    """The scene, and who wants to know when it changes.

    Attributes
    ----------
    title : str
    source : str
        The file, as `pointray render` takes it; empty: there is none, or several.
    up : (3,) tuple
    home : Camera or None
        Where a browser begins; None: where it sees all.
    settings, exposes, exposure, curve
        What it begins with.
    sketch : Sketch or None
        What is seen as long as there is no scene.
    problem : str
        Why there is nothing to see, or not all.
    failures : int
        How many problems there have been: the same one again is another.
    """

    def __init__(
        self,
        title: str,
        scene: Scene | None = None,
        up: tuple[float, float, float] = (0.0, 0.0, 1.0),
        settings: Settings | None = None,
        source: str = "",
    ) -> None:
        self.title, self.settings, self.source = title, settings or Settings(), source
        self.up = check_direction(up, "up")
        self.home: Camera | None = None
        self.exposes, self.exposure, self.curve = False, 0.0, "srgb"
        self._scan: tuple[Any, Scan] | None = None  # how the scene was seen last, and what for
        self.problem, self.failures = "", 0
        self.sketch: Sketch | None = None
        self._building, self._compiling, self._time_left = Progress(), Progress(), TimeLeft()
        self._scene, self._shown = scene, 0
        self._wanted: Build | None = None  # how the user wants models to be built; None: as they came
        self._built: tuple[Build, dict[Model, Model]] | None = None  # how they were, and what in the place of what
        self._exchanged: tuple[Any, Scene] | None = None  # what that was made for, and the scene with them
        self._listeners: list[Callable[[], None]] = []
        self._lock, self._builds = threading.Lock(), threading.Lock()
        self._next: threading.Thread | None = None  # waits to build what will be wished for by then

    @property
    def scene(self) -> Scene | None:
        """What there is so far, with models that were built anew in the place of those that came."""
        scene, built = self._scene, self._built
        if scene is None or built is None:
            return scene
        key, exchanged = (scene, scene._version, built), self._exchanged
        if exchanged is None or exchanged[0] != key:
            exchanged = self._exchanged = key, scene.exchange(built[1])
        return exchanged[1]

    @property
    def progress(self) -> Progress:
        """What is going on; of two things what takes longer."""
        return self._compiling if self._compiling.stage else self._building

    @property
    def is_building(self) -> bool:
        """Whether models are built."""
        return bool(self._building.stage)

    @property
    def version(self) -> tuple[int, int]:
        """Another one whenever the scene is, or has changed."""
        return self._shown, 0 if self._scene is None else self._scene._version

    def subscribe(self, listener: Callable[[], None]) -> Callable[[], None]:
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
            self._rebuild()

        return self._start(work)

    def scan(self, view: str) -> Scan:
        """What is known of the scene for a view of it, see `ViewChoice`; ValueError if there is none."""
        seen, key = self.scene or (None if self.sketch is None else self.sketch.points), (self.version, self.up, view)
        if seen is None:
            raise ValueError("there is nothing to see yet")
        if self._scan is None or self._scan[0] != key:
            self._scan = key, Scan(seen, ViewChoice(self.up, view))
        return self._scan[1]

    def outline(self, sketch: Sketch, up: tuple[float, float, float]) -> None:
        """This is seen until there is a scene."""
        self.sketch, self.up = sketch, up
        self._shown += 1
        self.notify()

    def show(self, scene: Scene, home: Camera | None = None) -> None:
        """This is what is shown from now on, and where a browser begins."""
        self._scene, self._built, self.sketch = scene, None, None
        if home is not None:  # the page knows this projection only
            self.home = replace(home, projection="perspective", aperture=0.0, focus=None)
        self._shown += 1
        self.notify()

    @property
    def build(self) -> Build | None:
        """How the models that are shown are built; of several, the first."""
        if self._built is not None:
            return self._built[0]
        models = [] if self._scene is None else self._scene.models
        return Build(models[0].surface, models[0].settings.samples) if models else None

    def rebuild(self, **changes: Any) -> threading.Thread:
        """Build all models anew, with changes to what was wished for last; until it is done the old ones are shown."""
        with self._lock:
            last = self._wanted or self.build
            if last is None:
                raise ValueError("there is no model to build anew")
            self._wanted = replace(last, **changes)
            if self._next is None:
                self._next = self._start(self._rebuild)
            return self._next

    def _rebuild(self) -> None:
        with self._builds:
            with self._lock:
                self._next = None
            while True:
                scene, build = self._scene, self._wanted
                if scene is None or build is None or build == self.build:
                    return
                models = scene.models
                try:
                    made = {model: self._rebuilt(model, build, k, len(models)) for k, model in enumerate(models)}
                except Exception:
                    self._wanted = None
                    raise
                if scene is self._scene and build is self._wanted:
                    self._built = build, made
                    self._shown += 1
                    self.notify()

    def _rebuilt(self, model: Model, build: Build, number: int, count: int) -> Model:
        def say(stage: str, share: float) -> None:
            self.say(f"building: {stage}", (number + share) / count)

        how: dict[str, Any] = {"surface": build.surface, "samples": build.samples, "radius_scale": build.radius_scale}
        how["refine"] = model.settings.refine
        return Model(model.points, model.radii, **how, progress=say)

    def _start(self, work: Callable[[], None]) -> threading.Thread:
        thread = threading.Thread(target=self._run, args=(work,), name="pointray-builder", daemon=True)
        thread.start()
        return thread

    def _run(self, work: Callable[[], None]) -> None:
        if self.problem:
            self.problem = ""
            self.notify()
        try:
            work()
        except (OSError, ValueError) as error:
            self._fail(str(error))
        except Exception as error:
            log.exception("while building")
            self._fail(f"{type(error).__name__}: {error}")
        self.say("", None)

    def _fail(self, why: str) -> None:
        self.failures += 1  # first: who looks between the two sees no problem yet
        self.problem = why

    def say(self, stage: str, share: float | None) -> None:
        """What is being done, and how much of it is."""
        self._building = Progress(stage, share, self._time_left(stage, share))
        self.notify()

    def look_at_compiling(self) -> None:
        """Say how far the compiling of kernels is; several times a second."""
        state, before = BACKLOG.state, self._compiling
        self._compiling = Progress()
        if state is not None:
            stage = f"compiling for this processor: kernel {state.number} of {state.total}"
            self._compiling = Progress(stage, state.share, state.seconds)
        if self._compiling != before:
            self.notify()

    def notify(self) -> None:
        """Say to all who listen that something has changed."""
        with self._lock:
            listeners = list(self._listeners)
        for listener in listeners:
            try:
                listener()
            except Exception:  # of one browser; the others are told all the same
                log.exception("while telling a browser")
