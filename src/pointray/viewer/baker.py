"""Bakes the light of the scene that a browser shows, in its own thread: roughly at first, then better.

| stage  | when                                              | patches       | links |
|--------|---------------------------------------------------|---------------|-------|
| rough  | as soon as the scene has other models or planes;  | 8,192         | 32    |
|        | whenever lights, materials or colours change      |               |       |
| fine   | when the rough light is there, nothing changes    | as `bake` has | 48    |
|        | and no models are being built                     |               |       |

Until there is rough light, pictures have none: the painter shows direct light instead. Light of a scene that has
changed meanwhile is not shown, but for levels of detail that were made later: they are left out until they have light.
All processors bake, and yield to pictures (`niceness`); where they cannot, half of them bake.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable

from ..baking.baked import Baked, bake
from ..baking.settings import BakeSettings
from ..base.warning_log import heard
from ..engine.jit import thread_count
from ..rendering.settings import Settings
from ..rendering.warmup import wait_until_warm, warm_up
from ..scene.scene import Scene
from .thread_priority import FINE_LIGHT, HAS_THREAD_NICENESS, ROUGH_LIGHT, run_niced
from .time_left import TimeLeft

log = logging.getLogger("pointray.view")

ROUGH = (8192, 32)  # patches and links
SHOWN = Settings("baked")  # pictures of the light
STAGE, FINE_STAGE = "baking light", "baking finer light"


class _SupersededError(Exception):
    """The scene has changed: what is being baked is no longer wanted."""


class Baker:
    """Bakes the newest scene that is asked for.

    Parameters
    ----------
    ready : callable
        Called, from the baker's thread, when there is new light.
    say : callable
        Takes the stage, the share done and the seconds left (or None), while light is baked; empty at its end.
    """

    def __init__(self, ready: Callable[[], None], report: Callable[[str, float | None, float | None], None]) -> None:
        self._ready, self._report = ready, report
        self._changed = threading.Condition()
        self._wanted: Scene | None = None
        self._refines = False  # whether it is to have fine light
        self.is_baking = False  # whether finer light comes soon
        self._light: tuple[Scene, Baked] | None = None  # the newest light, and the scene that it is for
        self._rough: Baked | None = None
        self._fine: Baked | None = None
        self._baked: Scene | None = None  # the scene of the newest light
        self._thread: threading.Thread | None = None
        self._open = True
        self._time_left = TimeLeft()

    def light_for(self, scene: Scene, fine: bool = True) -> Baked | None:
        """The light of a scene, if it is baked, perhaps without levels of detail, see `Baked.lacks_levels`.

        Else it will be, unless another scene is asked for. fine : whether fine light may be baked now
        """
        with self._changed:
            light = self._light
            if (self._wanted is not scene or self._refines != fine) and self._open:
                self._wanted, self._refines, self.is_baking = scene, fine, True
                self._changed.notify_all()
                if self._thread is None:
                    self._thread = threading.Thread(target=self._run, name="pointray-baker", daemon=True)
                    self._thread.start()
        if light is None:
            return None
        return light[1] if light[0] is scene or light[1].lacks_levels(scene) else None

    def fine_for(self, scene: Scene) -> Baked | None:
        """The fine light, if it is there and is that of a scene."""
        fine = self._fine
        return fine if fine is not None and fine.fits(scene) else None

    @property
    def has_ended(self) -> bool:
        """Whether nothing is baked any more, after `close`."""
        return not self._open and (self._thread is None or not self._thread.is_alive())

    def close(self) -> None:
        """Stop baking."""
        with self._changed:
            self._open = False
            self._changed.notify_all()

    def _run(self) -> None:
        warm_up(SHOWN, bakes=True)  # beside, where nobody has: pictures go on meanwhile
        done: tuple[Scene | None, bool] = None, False
        while (wanted := self._next(done)) is not None:
            try:
                with heard():  # that a scene is without light: it is seen
                    self._bake(*wanted)
            except _SupersededError:
                pass
            except Exception:  # pictures go on with the light that there is
                log.exception("while baking light")
            self._report("", None, None)
            done = wanted
            self._finish(wanted)
        with self._changed:
            self._wanted = self._baked = self._light = self._rough = self._fine = None

    def _finish(self, done: tuple[Scene, bool]) -> None:
        """Tell whoever waits for finer light that none comes, unless something else is wanted by now."""
        with self._changed:
            ended = self.is_baking and (self._wanted, self._refines) == done
            if ended:
                self.is_baking = False
        if ended and done[1]:
            self._ready()

    def _next(self, done: tuple[Scene | None, bool]) -> tuple[Scene, bool] | None:
        """Wait for another scene, or the wish for its fine light; None at the end."""
        with self._changed:
            self._changed.wait_for(lambda: not self._open or (self._wanted, self._refines) != done)
            return (self._wanted, self._refines) if self._open and self._wanted is not None else None

    def _bake(self, scene: Scene, refines: bool) -> None:
        """Bake rough light, then fine light."""
        if self._baked is not scene:
            rough = run_niced(ROUGH_LIGHT, lambda: self._bake_rough(scene))
            wait_until_warm(SHOWN)
            self._publish(scene, rough)
        if not refines:
            return
        if self._fine is None:
            self._fine = run_niced(
                FINE_LIGHT, lambda: bake(_without_light(scene), BakeSettings(threads=_threads()), self._report_progress)
            )
        fine = self._fine
        if self._wanted is self._baked and self._light is not None and self._light[1] is not fine:
            self._fine = run_niced(FINE_LIGHT, lambda: _relit(fine, self._baked))
            self._publish(self._baked, self._fine, rough=False)

    def _bake_rough(self, scene: Scene) -> Baked:
        """The rough light of a scene; fine light of other models is forgotten."""
        light = _relit(self._rough, scene)
        if light is None:
            self._fine, (patches, links) = None, ROUGH
            settings = BakeSettings(patches=patches, links=links, noise=1.0, threads=_threads())
            light = bake(_without_light(scene), settings, self._report_rough_progress)
        return light

    def _publish(self, scene: Scene | None, light: Baked | None, rough: bool = True) -> None:
        """Make light known."""
        assert scene is not None and light is not None
        with self._changed:
            self._light, self._baked = (scene, light), scene
            self._rough = light if rough else self._rough
            self.is_baking = self.is_baking and rough
        self._ready()

    def _check(self) -> None:
        """Stop if there is nobody left."""
        if not self._open:
            raise _SupersededError

    def _report_rough_progress(self, share: float) -> None:
        """Tell how far rough light is."""
        self._check()
        self._report(STAGE, share, self._time_left(STAGE, share))

    def _report_progress(self, share: float) -> None:
        """Tell how far fine light is; meanwhile rough light follows the lights. Stop if models have changed."""
        self._check()
        wanted = self._wanted
        if wanted is not None and wanted is not self._baked:
            light = _relit(self._rough, wanted)
            if light is None:
                raise _SupersededError
            self._publish(wanted, light)
        self._report(FINE_STAGE, share, self._time_left(FINE_STAGE, share))


def _relit(baked: Baked | None, scene: Scene | None) -> Baked | None:
    """The light of a scene, from that of another one with the same models and planes; None if they differ."""
    return None if baked is None or scene is None else baked.relit(_without_light(scene))


def _without_light(scene: Scene) -> Scene:
    """A copy without light. Light keeps the scene that it is baked for: if that had the light it would be a cycle."""
    copy = scene.copy()
    copy.baked = None
    return copy


def _threads() -> int:
    """How many threads bake."""
    return thread_count() if HAS_THREAD_NICENESS else max(1, thread_count() // 2)
