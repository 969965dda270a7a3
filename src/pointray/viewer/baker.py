"""Bakes the light of the scene that a browser shows, in its own thread: a rough solution first, then a fine one.

| stage | when                                                | patches             | links |
|-------|-----------------------------------------------------|---------------------|-------|
| rough | immediately when models or planes change;           | 8,192               | 32    |
|       | whenever lights, materials or colours change        |                     |       |
| fine  | after the rough light, while nothing changes        | defaults of `bake`  | 48    |
|       | and no models are being built                       |                     |       |

Until there is rough light, the painter shows direct light. Baked light of a scene that has changed is not shown, with
one exception: if only levels of detail were added, images leave them out until they have light.
Baking uses all processors at a lower priority than drawing (`thread_priority`); where threads have no priority of their
own, it uses half of them.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable

from ..baking.baked import Baked, bake
from ..baking.settings import BakeSettings
from ..base.warning_log import collect_warnings
from ..engine.jit import thread_count
from ..rendering.settings import Settings
from ..rendering.warmup import wait_until_warm, warm_up
from ..scene.scene import Scene
from .thread_priority import FINE_LIGHT, HAS_THREAD_NICENESS, ROUGH_LIGHT, run_niced
from .time_left import TimeLeft

log = logging.getLogger("pointray.view")

ROUGH = (8192, 32)  # patches and links
SHOWN = Settings("baked")  # for compiling the kernels that show baked light
STAGE, FINE_STAGE = "baking light", "baking finer light"


class _SupersededError(Exception):
    """Raised in the baker's thread to abandon a bake: the models have changed, or the browser has disconnected."""


class Baker:
    """Bakes global illumination of the scene that one browser shows, in its own thread: a rough, then a fine solution.

    A new request replaces the last one. A change of lights or materials only recomputes light from the last bake.

    Parameters
    ----------
    ready : callable
        Called without arguments from the baker's thread when there is new light, so that the image is drawn again.
    report : callable
        Called with stage, fraction done and seconds left (or None) while baking, and with an empty stage at the end.
    """

    def __init__(self, ready: Callable[[], None], report: Callable[[str, float | None, float | None], None]) -> None:
        self._ready, self._report = ready, report
        self._changed = threading.Condition()
        self._wanted: Scene | None = None
        self._refines = False  # whether fine light is requested
        self.is_baking = False  # whether finer light is to be expected
        self._light: tuple[Scene, Baked] | None = None  # the newest light and its scene
        self._rough: Baked | None = None
        self._fine: Baked | None = None
        self._baked: Scene | None = None  # the scene of the newest light
        self._thread: threading.Thread | None = None
        self._open = True
        self._time_left = TimeLeft()

    def light_for(self, scene: Scene, fine: bool = True) -> Baked | None:
        """Return the newest light if it was baked for a scene, else None.

        It may lack levels of detail that were added to models meanwhile (`Baked.lacks_levels`). If the arguments differ
        from those of the last call, a bake for them is requested in place of earlier requests.

        fine : whether the fine bake may follow the rough one; False while models are built, which needs the CPU
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
        """Return the light of the last fine bake, the second one, if it fits a scene; else None. Requests nothing."""
        fine = self._fine
        return fine if fine is not None and fine.fits(scene) else None

    @property
    def has_ended(self) -> bool:
        """Whether `close` was called and the baking thread has ended."""
        return not self._open and (self._thread is None or not self._thread.is_alive())

    def close(self) -> None:
        """Request the end of the baking thread, which abandons a bake at its next progress report."""
        with self._changed:
            self._open = False
            self._changed.notify_all()

    def _run(self) -> None:
        warm_up(SHOWN, bakes=True)  # compiles in the background if needed, while images are drawn
        done: tuple[Scene | None, bool] = None, False
        while (wanted := self._next(done)) is not None:
            try:
                with collect_warnings():  # hides the warning that a scene has no light: the image shows it
                    self._bake(*wanted)
            except _SupersededError:
                pass
            except Exception:  # images keep the light that exists
                log.exception("error while baking light")
            self._report("", None, None)
            done = wanted
            self._finish(wanted)
        with self._changed:
            self._wanted = self._baked = self._light = self._rough = self._fine = None

    def _finish(self, done: tuple[Scene, bool]) -> None:
        """Have the image drawn again if a bake has ended without fine light, though fine light was requested.

        While fine light was expected, images were refined with few samples only.

        done : the finished request: a scene, and whether fine light was requested
        """
        with self._changed:
            ended = self.is_baking and (self._wanted, self._refines) == done
            if ended:
                self.is_baking = False
        if ended and done[1]:
            self._ready()

    def _next(self, done: tuple[Scene | None, bool]) -> tuple[Scene, bool] | None:
        """Wait for a request that differs from the last one; return None after `close`.

        A request, also the returned one, is a scene and whether fine light is wanted, not only rough light.

        done : the last request; its scene is None before the first one
        """
        with self._changed:
            self._changed.wait_for(lambda: not self._open or (self._wanted, self._refines) != done)
            return (self._wanted, self._refines) if self._open and self._wanted is not None else None

    def _bake(self, scene: Scene, refines: bool) -> None:
        """Bake and publish rough light, with few patches, for a scene that has no light yet.

        refines : whether to bake fine light, too, with the patches that `bake` chooses
        """
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
        """Return rough light of a scene, with few patches, which is shown until fine light is baked.

        It is computed from the last rough bake if only lights, materials or colours have changed. Otherwise it is
        baked, and the fine light of the old models is discarded.
        """
        light = _relit(self._rough, scene)
        if light is None:
            self._fine, (patches, links) = None, ROUGH
            settings = BakeSettings(patches=patches, links=links, noise=1.0, threads=_threads())
            light = bake(_without_light(scene), settings, self._report_rough_progress)
        return light

    def _publish(self, scene: Scene | None, light: Baked | None, rough: bool = True) -> None:
        """Set the light that images of a scene use, and have the image drawn again. Neither may be None.

        rough : whether `light` is the first, rough solution; False for the fine one
        """
        assert scene is not None and light is not None
        with self._changed:
            self._light, self._baked = (scene, light), scene
            self._rough = light if rough else self._rough
            self.is_baking = self.is_baking and rough
        self._ready()

    def _check(self) -> None:
        """Raise _SupersededError after `close`; called from progress reports, to abandon a bake."""
        if not self._open:
            raise _SupersededError

    def _report_rough_progress(self, stage: str, share: float) -> None:
        """Pass on the progress of the first, rough bake, and abandon it after `close`.

        share : fraction done; stage : ignored
        """
        self._check()
        self._report(STAGE, share, self._time_left(STAGE, share))

    def _report_progress(self, stage: str, share: float) -> None:
        """Pass on the progress of the second, fine bake; relight images meanwhile if lights or materials change.

        Raise _SupersededError, which abandons the bake, if models changed or after `close`.

        share : fraction done; stage : ignored
        """
        self._check()
        wanted = self._wanted
        if wanted is not None and wanted is not self._baked:
            light = _relit(self._rough, wanted)
            if light is None:
                raise _SupersededError
            self._publish(wanted, light)
        self._report(FINE_STAGE, share, self._time_left(FINE_STAGE, share))


def _relit(baked: Baked | None, scene: Scene | None) -> Baked | None:
    """Return baked light recomputed for the lights, materials and colours of a scene, reusing its light transport.

    None if models, planes or clip planes differ from those of the bake, or if an argument is None.
    """
    return None if baked is None or scene is None else baked.relit(_without_light(scene))


def _without_light(scene: Scene) -> Scene:
    """Return a copy of a scene without baked light. Light refers to the scene of its bake, so this avoids a cycle."""
    copy = scene.copy()
    copy.baked = None
    return copy


def _threads() -> int:
    """Return the number of threads that bake: all, or half of them where threads cannot get a lower priority."""
    return thread_count() if HAS_THREAD_NICENESS else max(1, thread_count() // 2)
