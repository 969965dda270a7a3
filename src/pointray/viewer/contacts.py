"""Contact shadow of the viewer's images, computed during refinement and reused in later images."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ..auto_view import STUDIO
from ..auto_view.contact import ContactShadow, contact_shadow
from ..auto_view.first_view import Scan
from ..base.choices import EXPOSED
from ..scene.scene import Scene
from ..shade.lights import SunLight
from .view_settings import ViewSettings


class Contacts:
    """Cache of one contact shadow (soft shadow on the ground under a standing object), that of the last scene."""

    def __init__(self) -> None:
        self._key: Any = None
        self._lamps: Any = None  # the key holds their ids, which are not reused while the lights are alive
        self._found: ContactShadow | None = None

    def of(
        self,
        scan: Callable[[], Scan] | None,
        seen: tuple[Scene, tuple[int, int]],
        view: ViewSettings,
        may_trace: bool = True,
    ) -> ContactShadow | None:
        """Return the contact shadow to put under the image of a scene; None if it has none, or not yet.

        Only objects that stand have one, in studio light, before a gradient or (if automatically exposed) one colour.

        Parameters
        ----------
        scan : callable, optional
            Returns the scene's points with their detected up direction. None: no contact shadow.
        seen : (Scene, (int, int))
            The scene with the panel's settings applied, and its version (`SharedScene.version`).
        view : ViewSettings
            The panel's settings.
        may_trace : bool
            Whether a shadow that is not cached may be computed now, which takes about 0.1 s.
        """
        scene, version = seen
        plain = view.around == "gradient" or (view.around == "color" and view.exposes)
        wanted = view.contact_shadow and view.look == STUDIO and view.integrator in EXPOSED
        if scan is None or not wanted or view.ground or not plain:
            return None
        key = version, view.cuts, tuple(map(id, view.lamps))
        if key != self._key and may_trace:
            self._key, self._lamps, self._found = key, view.lamps, _found(scan(), scene)
        return self._found if key == self._key else None


def _found(scan: Scan, scene: Scene) -> ContactShadow | None:
    """Trace the contact shadow of a scan in a scene; None if it stands on no base, or has a model in parts on disk."""
    if any(model.parts for model in scene.models) or not scan.stands:
        return None
    still = (light.direction for light in scene.lights if isinstance(light, SunLight) and not light.camera)
    return contact_shadow(scene, scan.positions, scan.up, next(still, None))
