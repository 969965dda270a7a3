"""The contact shadows of the viewer's pictures: found while a picture is refined, shown with all that follow."""

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
    """The contact shadow of the last scene that was asked for."""

    def __init__(self) -> None:
        self._key: Any = None
        self._lamps: Any = None  # which the key names by their ids: none of these is used again while they are kept
        self._found: ContactShadow | None = None

    def of(
        self,
        scan: Callable[[], Scan] | None,
        seen: tuple[Scene, tuple[int, int]],
        view: ViewSettings,
        may_trace: bool = True,
    ) -> ContactShadow | None:
        """The contact shadow of a scene in the studio before a backdrop; None if there is none, or it is not known yet.

        Parameters
        ----------
        scan : callable, optional
            Returns what was found out about the scene. None: nothing stands.
        seen : (Scene, version)
            The scene with its view settings, and the version of the scene.
        view : ViewSettings
        may_trace : bool
            Whether it may be computed now, which takes about a tenth of a second.
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
    """The contact shadow of a scan that stands and is in memory."""
    if any(model.parts for model in scene.models) or not scan.stands:
        return None
    still = (light.direction for light in scene.lights if isinstance(light, SunLight) and not light.camera)
    return contact_shadow(scene, scan.positions, scan.up, next(still, None))
