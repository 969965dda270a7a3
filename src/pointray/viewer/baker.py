"""Bakes the light of the scene that a browser shows, in its own thread: roughly at first, then better.

| stage  | when                                              | patches       | links |
|--------|---------------------------------------------------|---------------|-------|
| rough  | as soon as the scene has other models or planes;  | 8,192         | 32    |
|        | whenever lights, materials or colours change      |               |       |
| fine   | when the rough light is there and nothing changes | as `bake` has | 48    |

Until there is rough light, pictures have none: the painter shows direct light instead. Light of a scene that has
changed meanwhile is not shown.
"""

from __future__ import annotations

import logging
import threading
import warnings
from collections.abc import Callable

from ..baking.baked import Baked, bake
from ..baking.settings import BakeSettings
from ..jit import thread_count
from ..scene.scene import Scene
from .time_left import TimeLeft

log = logging.getLogger("pointray.view")

ROUGH = (8192, 32)  # patches and links
STAGE = "baking light"


class _SupersededError(Exception):
    """The scene has changed: what is being baked is no longer wanted."""


class Baker:
    """Bakes the newest scene that is asked for.

    Parameters
    ----------
    ready : callable
        Called, from the baker's thread, when there is new light.
    say : callable
        Takes the stage, the share done and the seconds left (or None), while fine light is baked; empty at its end.
    """

    def __init__(self, ready: Callable[[], None], say: Callable[[str, float | None, float | None], None]) -> None:
        self._ready, self._say = ready, say
        self._changed = threading.Condition()
        self._wanted: Scene | None = None
        self._light: tuple[Scene, Baked] | None = None  # the newest light, and the scene that it is for
        self._rough: Baked | None = None
        self._fine: Baked | None = None
        self._baked: Scene | None = None  # the scene of the newest light
        self._thread: threading.Thread | None = None
        self._open = True
        self._time_left = TimeLeft()

    def light_for(self, scene: Scene) -> Baked | None:
        """The light of a scene, if it is baked; else it will be, unless another scene is asked for."""
        with self._changed:
            light = self._light
            if self._wanted is not scene and self._open:
                self._wanted = scene
                self._changed.notify_all()
                if self._thread is None:
                    self._thread = threading.Thread(target=self._run, name="pointray-baker", daemon=True)
                    self._thread.start()
        return light[1] if light is not None and light[0] is scene else None

    def close(self) -> None:
        """Stop baking."""
        with self._changed:
            self._open = False
            self._changed.notify_all()

    def _run(self) -> None:
        done: Scene | None = None
        while (scene := self._next(done)) is not None:
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")  # of a scene without light: it is seen
                    self._bake(scene)
            except _SupersededError:
                pass
            except Exception:  # pictures go on with direct light
                log.exception("while baking light")
            self._say("", None, None)
            done = scene

    def _next(self, done: Scene | None) -> Scene | None:
        """Wait for another scene; None at the end."""
        with self._changed:
            self._changed.wait_for(lambda: not self._open or self._wanted is not done)
            return self._wanted if self._open else None

    def _bake(self, scene: Scene) -> None:
        """Bake rough light, then fine light."""
        threads = max(1, thread_count() // 2)  # pictures need the others
        rough, fine = _relit(self._rough, scene), self._fine
        if rough is None:
            fine = self._fine = None
            patches, links = ROUGH
            rough = bake(scene, BakeSettings(patches=patches, links=links, noise=1.0, threads=threads), self._check)
        self._give(scene, rough)
        if fine is None:
            self._fine = bake(scene, BakeSettings(threads=threads), self._tell)
        if self._wanted is self._baked:
            self._fine = _relit(self._fine, self._baked)
            self._give(self._baked, self._fine, rough=False)

    def _give(self, scene: Scene | None, light: Baked | None, rough: bool = True) -> None:
        """Make light known."""
        assert scene is not None and light is not None
        with self._changed:
            self._light, self._baked = (scene, light), scene
            self._rough = light if rough else self._rough
        self._ready()

    def _check(self, share: float) -> None:
        """Stop if there is nobody left."""
        if not self._open:
            raise _SupersededError

    def _tell(self, share: float) -> None:
        """Tell how far fine light is; meanwhile rough light follows the lights. Stop if models have changed."""
        self._check(share)
        wanted = self._wanted
        if wanted is not None and wanted is not self._baked:
            light = _relit(self._rough, wanted)
            if light is None:
                raise _SupersededError
            self._give(wanted, light)
        self._say(STAGE, share, self._time_left(STAGE, share))


def _relit(baked: Baked | None, scene: Scene | None) -> Baked | None:
    """The light of a scene, from that of another one with the same models and planes; None if they differ."""
    return None if baked is None or scene is None else baked.relit(scene)
