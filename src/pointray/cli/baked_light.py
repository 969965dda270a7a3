"""Where the pictures of `render`, `animate` and `view` get baked light from: a file, or they have it baked first."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from ..base.warning_log import warn
from .waiting import Progress, in_background

# Of light that nobody asked for: a picture comes a second or two later than without, see docs/decisions.
QUICK_PATCHES, QUICK_LINKS, QUICK_NOISE = 16384, 16, 1.0

# What is said when there is no file.
KEEP = "pointray bake keeps it in a file, for --bake"
FIRST = f"light is baked first ({KEEP})"
LOOK = "a studio lights the scan, and its light is baked; --light headlight takes a headlight instead"
ONCE = f"light is baked first, once for all frames: only the camera moves ({KEEP})"


@dataclass(frozen=True)
class LightSource:
    """Baked light of a scan.

    Attributes
    ----------
    settings : BakeSettings
        How it is baked, without a file.
    file : Path or None
    quick : bool
        Whether it is baked although nobody asked for it.
    """

    settings: Any
    file: Path | None = None
    quick: bool = False

    @property
    def inputs(self) -> dict[str, Any]:
        """What the light depends on besides the scene, as values of JSON; the number of threads is not part of it."""
        if self.file is not None:
            facts = self.file.stat()
            return {"light": [str(self.file.resolve()), facts.st_size, facts.st_mtime_ns]}
        return {"bake": {name: value for name, value in asdict(self.settings).items() if name != "threads"}}

    def make(self, scene: Any, show: Any, client: Any = None) -> Any:
        """The light of a scene; ValueError if that of the file does not fit.

        show : takes a stage and the share done
        client : whose workers send the rays of a bake; None: this process
        """
        import pointray as pr

        from ..scenefile.light import load_light

        if self.file is not None:
            show("reading light", 0.0)
            return load_light(self.file, scene)
        show("baking light", 0.0)
        return pr.bake(scene, self.settings, partial(show, "baking light"), client)

    def light(self, scene: Any, progress: Progress, told: str = FIRST) -> None:
        """Give a scene its light. told : what is said if it is baked"""
        if self.file is None:
            warn(LOOK if self.quick else told, stacklevel=2)
        scene.baked = in_background(lambda: self.make(scene, progress.show))
        if scene.baked.coarser:
            warn(f"the light does not fit into memory as it is: {scene.baked.coarser}", stacklevel=2)


def light_source(settings: Any, file: Path | None, quick: bool = False) -> LightSource | None:
    """Where pictures with these settings get baked light from; None if they show none. The file must be there."""
    from ..baking.settings import BakeSettings
    from ..base.atomic_write import check_regular

    if settings.integrator != "baked":
        return None
    baking = BakeSettings(seed=settings.seed, threads=settings.threads)
    if quick:
        baking = replace(baking, patches=QUICK_PATCHES, links=QUICK_LINKS, noise=QUICK_NOISE)
    return LightSource(baking, file and check_regular(file), quick)
