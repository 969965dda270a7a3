"""Lights, ground and background of scans in the viewer, chosen once for the coarse version and the full model."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from ..auto_view.default_scene import fixed_front, with_visible_backs
from ..auto_view.first_view import Scan, ViewChoice
from ..auto_view.studio import studio, with_direct_light
from ..rendering.settings import Settings
from ..rendering.warmup import has_clicks
from ..scene.scene import Scene
from .shared_scene import SharedScene

Make = Callable[[Any, Any, float | None], list[Any]]


@dataclass
class SceneSetup:
    """Adds lights, ground and background to a scene with its models; returns the up direction. A `set_up_scene`.

    Attributes
    ----------
    settings : Settings
        Of the first images; those of `shared` are changed if light is not baked after all, or back faces are visible.
    choice : ViewChoice
    make_lights : callable
        (middle, up, azimuth of fixed lights or None) -> lights. Default: the studio.
    bakes, quick : bool
        Whether light is baked, and whether without a request.
    chooses_backs : bool
        Whether the settings for back faces are chosen automatically.
    ground : callable, optional
        (bounds, up) -> `Plane`
    background : optional
        See `Scene.background`.
    report : callable, optional
        Called with a line for the user about the automatic choices.
    shared : SharedScene
        To be set before the first call.
    """

    settings: Settings
    choice: ViewChoice = ViewChoice()
    make_lights: Make = lambda middle, up, front: list(studio(up, front))
    bakes: bool = True
    quick: bool = True
    chooses_backs: bool = True
    ground: Callable[[Any, Any], Any] | None = None
    background: Any = None
    report: Callable[[str], None] | None = None
    shared: SharedScene | None = None
    _known: list[Any] = field(default_factory=list)  # up direction, lights, and whether some points are not framed

    def __call__(self, scene: Scene) -> Any:
        if not self._known:
            self._choose(scene)
        up, scene.lights, has_outliers = self._known
        bounds = Scan(scene, self.choice).bounds if has_outliers else scene.bounds
        if self.ground is not None:
            scene.add(self.ground(bounds, up))
        scene.background = self.background
        return up

    def _choose(self, scene: Scene) -> None:
        """Find the up direction and the lights, and change the settings of the shared scene accordingly."""
        assert self.shared is not None
        scan = Scan(scene, self.choice)
        if scan.found and self.report is not None:
            self.report(scan.found)
        front = fixed_front(scan, self.quick) if self.bakes else None
        if self.bakes and front is None:
            self.shared.settings = with_direct_light(self.settings)
        lights = self.make_lights(scan.bounds.mean(axis=0), scan.up, front)
        self._known.extend((scan.up, lights, bool(scan.ignored)))
        unseen = not has_clicks() or any(model.parts for model in scene.models)
        if self.chooses_backs:
            self.shared.settings = with_visible_backs(self.shared.settings, scene, scan.camera(), unseen)
