"""The scene that all browsers show; it may still be loading or being rebuilt."""

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
from ..base.memory import trim_heap
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
    """How models are built: those parameters of `Model` that the panel shows.

    surface : how f is blended: "paper", "imls", "apss" (fitted spheres) or "disc"
    samples : of f along a ray, over the diameter of a support; radius_scale : factor for all radii
    measured : whether the noise of the points is measured and smoothed
    noise : standard deviation of the noise to smooth if it is not measured, in median support radii
    scatter : how points that lie on no surface are drawn: "spheres", "discs", "surface" or "none"
    scatter_size : factor for the radii of these spheres and discs
    """

    surface: str
    samples: int
    radius_scale: float = 1.0
    measured: bool = True
    noise: float = 0.0
    scatter: str = AS_SPHERES
    scatter_size: float = 1.0


def build_of(model: Model) -> Build:
    """Return how a model was built. If its noise was measured, `noise` is the median of the measured values."""
    size, found = model.spacing or 1.0, model.tree.noise
    build = Build(model.surface, model.settings.samples, scatter=model.drawing.scatter, scatter_size=model.drawing.size)
    if isinstance(model.smooth, str):
        noise = float(np.median(found)) / size if found.size else 0.0
        return replace(build, noise=round(noise, 2))
    return replace(build, measured=False, noise=round(model.smooth / size, 2))


@dataclass(frozen=True)
class Progress:
    """Progress of work such as building a model.

    stage : what is done, as a text; empty if there is no work
    share, seconds : fraction done and time left; None if unknown
    """

    stage: str = ""
    share: float | None = None
    seconds: float | None = None


class Loader(Protocol):
    """Callable that loads a scene into the viewer.

    It calls `SharedScene.show` with each version of the scene, such as a coarse one first, and `SharedScene.report`
    with its progress. If kernels are not compiled, it first calls `SharedScene.show_sketch` with some points.
    """

    def __call__(self, shared: SharedScene) -> None: ...


class SharedScene:
    """The scene that all browsers show, perhaps still loading; it notifies listeners when it changes.

    Attributes
    ----------
    title : str
    source : str
        The file as an argument of `pointray render`; empty if there is none, or several.
    up : (3,) tuple
    home : Camera or None
        Initial camera of a browser; None: a view of everything.
    settings, exposes, exposure, curve
        Initial values of the panel: render settings, whether exposure is automatic, exposure (stops), tone curve.
    sketch : Sketch or None
        Points drawn as dots while there is no scene.
    look : str
        "studio" or "headlight" if the scene is lit by this preset; empty if it has lights of its own, or none.
    contact_shadow : bool
        Whether browsers initially show contact shadows.
    is_coarse : bool
        Whether the scene is a coarse version, until all points are loaded.
    problem : str
        Why nothing, or only a part, can be shown.
    failures : int
        Number of problems so far; repetitions count.
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
        self._scan: tuple[Any, Scan] | None = None  # cache of the scan of the scene, and its key
        self.problem, self.failures = "", 0
        self.sketch: Sketch | None = None
        self.look, self.contact_shadow, self.is_coarse = "", True, False
        self._building, self._compiling, self._time_left = Progress(), Progress(), TimeLeft()
        self._scene, self._revision = scene, 0
        self._wanted: Build | None = None  # the build requested by the user; None: models as loaded
        self._built: tuple[Build, dict[Model, Model]] | None = None  # the last build; original -> rebuilt model
        self._cached_scene: tuple[Any, Scene] | None = None  # cache of the scene with rebuilt models, and its key
        self._listeners: list[Callable[[], None]] = []
        self._lock, self._builds = threading.Lock(), threading.Lock()
        self._next: threading.Thread | None = None  # started, but has not read the requested build yet

    @property
    def scene(self) -> Scene | None:
        """The scene to show, with rebuilt models in place of the original ones; None before anything is loaded."""
        scene, built = self._scene, self._built
        if scene is None or built is None:
            return scene
        key, cached = (scene, scene._version, built), self._cached_scene
        if cached is None or cached[0] != key:
            cached = self._cached_scene = key, scene.exchange(built[1])
        return cached[1]

    @property
    def progress(self) -> Progress:
        """Progress of compiling kernels, or else of loading and building."""
        return self._compiling if self._compiling.stage else self._building

    @property
    def is_building(self) -> bool:
        """Whether a scene is being loaded or models are being built."""
        return bool(self._building.stage)

    @property
    def version(self) -> tuple[int, int]:
        """Two counters, one of which changes whenever the scene is replaced, rebuilt or modified."""
        return self._revision, 0 if self._scene is None else self._scene._version

    def subscribe(self, listener: Callable[[], None]) -> Callable[[], None]:
        """Call a listener, from any thread, on each change of the scene, its progress or its problem.

        Returns a function that unsubscribes it.
        """
        with self._lock:
            self._listeners.append(listener)

        def leave() -> None:
            with self._lock:
                if listener in self._listeners:
                    self._listeners.remove(listener)

        return leave

    def load(self, loader: Loader) -> threading.Thread:
        """Load the scene with a loader, in the background. Returns the thread."""

        def work() -> None:
            loader(self)
            self._rebuild()

        return self._start(work)

    def scan(self, view: str) -> Scan:
        """Return the points to frame in a view with their up and view directions (`Scan`); cached.

        view : "auto" or a standard view such as "front"; ValueError if nothing is loaded yet
        """
        seen, key = self.scene or (None if self.sketch is None else self.sketch.points), (self.version, self.up, view)
        if seen is None:
            raise ValueError("no scene loaded yet")
        if self._scan is None or self._scan[0] != key:
            self._scan = key, Scan(seen, ViewChoice(self.up, view))
        return self._scan[1]

    def show_sketch(self, sketch: Sketch, up: tuple[float, float, float]) -> None:
        """Show points as dots until there is a scene. up : their up direction"""
        self.sketch, self.up = sketch, up
        self._revision += 1
        self.notify()

    def show(self, scene: Scene, home: Camera | None = None, coarse: bool = False) -> None:
        """Show a scene. home : initial camera of browsers; coarse : whether a finer version will follow"""
        self.is_coarse = coarse  # set first, so that no browser bakes a coarse scene
        self._scene, self._built, self.sketch = scene, None, None
        if home is not None:  # the page starts in perspective, without depth of field
            self.home = replace(home, projection="perspective", aperture=0.0, focus=None)
        self._revision += 1
        self.notify()

    @property
    def build(self) -> Build | None:
        """How the shown models are built, that of the first one if there are several; None without models."""
        if self._built is not None:
            return self._built[0]
        models = [] if self._scene is None else self._scene.models
        return build_of(models[0]) if models else None

    def rebuild(self, **changes: Any) -> threading.Thread:
        """Rebuild all models in the background; the old ones are shown meanwhile. Returns the thread.

        changes : fields of `Build` to change in the last requested build. A value for `noise` turns off `measured`,
            unless that is given, too.
        """
        if "noise" in changes:
            changes.setdefault("measured", False)
        with self._lock:
            last = self._wanted or self.build
            if last is None:
                raise ValueError("no model to rebuild")
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
        if (build.measured, build.noise) == (first.measured, first.noise):  # the command's value, unrounded
            smooth = model.smooth
        return model.rebuild(smooth, **options, progress=report)

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
        except OSError as error:
            self._fail(f"{error.filename}: {error.strerror}" if error.filename and error.strerror else str(error))
        except ValueError as error:
            self._fail(str(error))
        except Exception as error:
            log.exception("error while building")
            self._fail(f"{type(error).__name__}: {error}")
        trim_heap()
        self.report("", None)

    def _fail(self, why: str) -> None:
        self.failures += 1  # first: a concurrent reader must not see the new problem with the old count
        self.problem = why

    def report(self, stage: str, share: float | None) -> None:
        """Set the progress of loading or building, and notify listeners. share : fraction done; None: unknown

        stage : what is done, as a text; empty if the work has ended
        """
        self._building = Progress(stage, share, self._time_left(stage, share))
        self.notify()

    def update_compile_progress(self) -> None:
        """Read the progress of compiling kernels, and notify listeners if it has changed. Called ten times a second."""
        state, before = BACKLOG.state, self._compiling
        self._compiling = Progress()
        if state is not None:
            stage = f"compiling for this CPU: kernel {state.number} of {state.total}"
            self._compiling = Progress(stage, state.share, state.seconds)
        if self._compiling != before:
            self.notify()

    def notify(self) -> None:
        """Call all listeners: the scene, its progress or its problem has changed."""
        with self._lock:
            listeners = list(self._listeners)
        for listener in listeners:
            try:
                listener()
            except Exception:  # an error of one browser must not affect the others
                log.exception("error while updating a browser")


def shared_of(scene: Scene, up: tuple[float, float, float] | None) -> SharedScene:
    """Return a scene from Python for the viewer. up : None: chosen by the evidence in the points"""
    if up is None:
        up = Scan(scene, ViewChoice()).up if scene.models else (0.0, 0.0, 1.0)
    return SharedScene("pointray", scene, up)
