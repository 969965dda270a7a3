"""The scene that all browsers show; it may still be loading from a file, or be built again."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from ..auto_view.first_view import Scan, ViewChoice
from ..base.arguments import check_direction
from ..base.choices import AS_SPHERES, AUTO
from ..base.memory import give_back
from ..engine.jit import BACKLOG
from ..model.model import Model
from ..rendering.camera import Camera
from ..rendering.settings import Settings
from ..scene.scene import Scene
from .sketch import Sketch
from .time_left import TimeLeft

log = logging.getLogger("pointray.view")


@dataclass(frozen=True)
class Build:
    """How models are built: the parameters of `Model` in the panel.

    measured : whether noise is smoothed away as it is measured; noise : else so much of it, in the median radius
    scatter, scatter_size : how scattered points are drawn
    """

    surface: str
    samples: int
    radius_scale: float = 1.0
    measured: bool = True
    noise: float = 0.0
    scatter: str = AS_SPHERES
    scatter_size: float = 1.0


def build_of(model: Model) -> Build:
    """How a model was built; its noise, where that was measured, is the median."""
    size, found = model.spacing or 1.0, model.tree.noise
    build = Build(model.surface, model.settings.samples, scatter=model.drawing.scatter, scatter_size=model.drawing.size)
    if isinstance(model.smooth, str):
        noise = float(np.median(found)) / size if found.size else 0.0
        return replace(build, noise=round(noise, 2))
    return replace(build, measured=False, noise=round(model.smooth / size, 2))


@dataclass(frozen=True)
class Progress:
    """The work in progress. share, seconds (left) : None if unknown; stage : empty if there is no work."""

    stage: str = ""
    share: float | None = None
    seconds: float | None = None


class Loader(Protocol):
    """Loads a scene: calls `SharedScene.show` whenever there is more to see, and `SharedScene.say` with its stage.

    It first calls `SharedScene.outline` if there are points and no kernels yet to trace them.
    """

    def __call__(self, shared: SharedScene) -> None: ...


class SharedScene:
    """The scene, and the listeners that are notified when it changes.

    Attributes
    ----------
    title : str
    source : str
        The file, as `pointray render` takes it; empty if there is none, or several.
    up : (3,) tuple
    home : Camera or None
        Where a browser begins; None: a view of everything.
    settings, exposes, exposure, curve
        The initial values.
    sketch : Sketch or None
        What is shown while there is no scene.
    look : str
        One of `staging.LOOKS` if that is the light of the scene; empty: it has lights of its own, or none.
    contact_shadow : bool
        Whether browsers show contact shadows at first.
    is_coarse : bool
        Whether the scene is a coarse version, until all of it is there.
    problem : str
        Why there is nothing to see, or only a part.
    failures : int
        How many problems there have been: the same one again counts as another.
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
        self._scan: tuple[Any, Scan] | None = None  # the last scan of the scene, and what it was made for
        self.problem, self.failures = "", 0
        self.sketch: Sketch | None = None
        self.look, self.contact_shadow, self.is_coarse = "", True, False
        self._building, self._compiling, self._time_left = Progress(), Progress(), TimeLeft()
        self._scene, self._revision = scene, 0
        self._wanted: Build | None = None  # the build that the user wants; None: models as they came
        self._built: tuple[Build, dict[Model, Model]] | None = None  # the last build, and which model replaces which
        self._cached_scene: tuple[Any, Scene] | None = (
            None  # the last scene with these models, and what it was made for
        )
        self._listeners: list[Callable[[], None]] = []
        self._lock, self._builds = threading.Lock(), threading.Lock()
        self._next: threading.Thread | None = None  # waits to build what is wanted when it starts

    @property
    def scene(self) -> Scene | None:
        """The scene so far, in which rebuilt models replace the original ones."""
        scene, built = self._scene, self._built
        if scene is None or built is None:
            return scene
        key, cached = (scene, scene._version, built), self._cached_scene
        if cached is None or cached[0] != key:
            cached = self._cached_scene = key, scene.exchange(built[1])
        return cached[1]

    @property
    def progress(self) -> Progress:
        """The work in progress; of two tasks the one that takes longer."""
        return self._compiling if self._compiling.stage else self._building

    @property
    def is_building(self) -> bool:
        """Whether models are being built."""
        return bool(self._building.stage)

    @property
    def version(self) -> tuple[int, int]:
        """A value that differs whenever the scene is another one, or has changed."""
        return self._revision, 0 if self._scene is None else self._scene._version

    def subscribe(self, listener: Callable[[], None]) -> Callable[[], None]:
        """Call a listener, from any thread, whenever anything changes; returns a function that ends this."""
        with self._lock:
            self._listeners.append(listener)

        def leave() -> None:
            with self._lock:
                if listener in self._listeners:
                    self._listeners.remove(listener)

        return leave

    def load(self, loader: Loader) -> threading.Thread:
        """Let a loader load the scene, in the background."""

        def work() -> None:
            loader(self)
            self._rebuild()

        return self._start(work)

    def scan(self, view: str) -> Scan:
        """The scan of the scene for one of its views, see `ViewChoice`; ValueError if there is no scene."""
        seen, key = self.scene or (None if self.sketch is None else self.sketch.points), (self.version, self.up, view)
        if seen is None:
            raise ValueError("there is nothing to see yet")
        if self._scan is None or self._scan[0] != key:
            self._scan = key, Scan(seen, ViewChoice(self.up, view))
        return self._scan[1]

    def show_sketch(self, sketch: Sketch, up: tuple[float, float, float]) -> None:
        """Show a sketch until there is a scene."""
        self.sketch, self.up = sketch, up
        self._revision += 1
        self.notify()

    def show(self, scene: Scene, home: Camera | None = None, coarse: bool = False) -> None:
        """Show a scene from now on; `home` is where a browser begins. coarse : whether there is more to come"""
        self.is_coarse = coarse  # first: what is seen with the new scene is not baked in vain
        self._scene, self._built, self.sketch = scene, None, None
        if home is not None:  # the page opens in perspective, without a lens
            self.home = replace(home, projection="perspective", aperture=0.0, focus=None)
        self._revision += 1
        self.notify()

    @property
    def build(self) -> Build | None:
        """How the shown models are built; the first one's build if there are several."""
        if self._built is not None:
            return self._built[0]
        models = [] if self._scene is None else self._scene.models
        return build_of(models[0]) if models else None

    def rebuild(self, **changes: Any) -> threading.Thread:
        """Build all models again, with changes to the last wanted build; the old ones are shown until it is done.

        Whoever tells the noise does not want it measured.
        """
        if "noise" in changes:
            changes.setdefault("measured", False)
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
                    made = {model: self._rebuild_model(model, build, k, len(models)) for k, model in enumerate(models)}
                except Exception:
                    self._wanted = None
                    raise
                with self._lock:
                    if scene is not self._scene or build is not self._wanted:
                        continue
                    if build.measured:
                        build = replace(build, noise=build_of(made[models[0]]).noise)
                    self._wanted, self._built = build, (build, made)
                    self._revision += 1
                self.notify()

    def _rebuild_model(self, model: Model, build: Build, number: int, count: int) -> Model:
        def report(stage: str, share: float) -> None:
            self.report(f"building: {stage}", (number + share) / count)

        options: dict[str, Any] = {
            "surface": build.surface,
            "samples": build.samples,
            "radius_scale": build.radius_scale,
            "scatter": build.scatter,
            "scatter_size": build.scatter_size,
        }
        options["refine"] = model.settings.refine
        smooth: str | float = AUTO if build.measured else build.noise * model.spacing
        first = build_of(self._scene.models[0]) if self._scene else build
        if (build.measured, build.noise) == (first.measured, first.noise):  # what the command asked for, unrounded
            smooth = model.smooth
        return model.remade(smooth, **options, progress=report)

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
        give_back()
        self.report("", None)

    def _fail(self, why: str) -> None:
        self.failures += 1  # first: a reader between the two lines sees no problem yet
        self.problem = why

    def report(self, stage: str, share: float | None) -> None:
        """Report the current stage, and the share done."""
        self._building = Progress(stage, share, self._time_left(stage, share))
        self.notify()

    def update_compile_progress(self) -> None:
        """Report the progress of compiling kernels; called several times a second."""
        state, before = BACKLOG.state, self._compiling
        self._compiling = Progress()
        if state is not None:
            stage = f"compiling for this processor: kernel {state.number} of {state.total}"
            self._compiling = Progress(stage, state.share, state.seconds)
        if self._compiling != before:
            self.notify()

    def notify(self) -> None:
        """Notify all listeners of a change."""
        with self._lock:
            listeners = list(self._listeners)
        for listener in listeners:
            try:
                listener()
            except Exception:  # of one browser; the others are notified anyway
                log.exception("while telling a browser")
