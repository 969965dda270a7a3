"""Sources of the baked light of `render`, `animate` and `view`: a file, or a bake before the first image."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from ..base.warning_log import warn
from .waiting import Progress, in_background

# Notes, printed if there is no file.
KEEP = "to reuse it, write it to a file with `pointray bake` and use --bake"
FIRST = f"baking light first ({KEEP})"
LOOK = "baking the studio's light; use --light headlight for a headlight instead"
ONCE = f"baking light first, once for all frames ({KEEP})"


@dataclass(frozen=True)
class LightSource:
    """Where the baked light of a scan comes from: a file, or a bake with these settings.

    Attributes
    ----------
    settings : BakeSettings
        Used if there is no file.
    file : Path or None
        Light written by `pointray bake`.
    quick : bool
        Whether the light is baked by default, without a request of the user, and therefore only roughly.
    """

    settings: Any
    file: Path | None = None
    quick: bool = False

    @property
    def inputs(self) -> dict[str, Any]:
        """All that the light depends on besides the scene, as JSON values: file, or settings of the bake.

        If it has changed, all frames of an interrupted animation are rendered again. The number of threads is left out.
        """
        if self.file is not None:
            facts = self.file.stat()
            return {"light": [str(self.file.resolve()), facts.st_size, facts.st_mtime_ns]}
        return {"bake": {name: value for name, value in asdict(self.settings).items() if name != "threads"}}

    def make(self, scene: Any, show: Any, client: Any = None) -> Any:
        """Read or bake the light of a scene, as `Baked`; raise ValueError if the file's light does not fit the scene.

        show : called with the name of a stage and its completed fraction
        client : Dask client whose workers trace the rays of a bake; None: this process
        """
        import pointray as pr

        from ..scenefile.light import load_light

        if self.file is not None:
            show("reading light", 0.0)
            return load_light(self.file, scene)
        show("baking light", 0.0)
        return pr.bake(scene, self.settings, show, client)

    def light(self, scene: Any, progress: Progress, note: str = FIRST) -> None:
        """Read or bake the light of a scene and set `scene.baked`. note : printed if the light is baked on request"""
        if self.file is None:
            warn(LOOK if self.quick else note, stacklevel=2)
        scene.baked = in_background(lambda: self.make(scene, progress.show))
        if scene.baked.coarser:
            warn(f"not enough memory for the full resolution of the light: {scene.baked.coarser}", stacklevel=2)


def light_source(settings: Any, file: Path | None, quick: bool = False) -> LightSource | None:
    """Return where the baked light for images with these settings comes from; None if they do not show baked light.

    file : value of --bake, or None; raise OSError if it is missing
    quick : whether light is baked by default, not on request; it is then baked roughly, in one to two seconds
    """
    from ..auto_view.default_scene import quick_bake
    from ..baking.settings import BakeSettings
    from ..base.atomic_write import check_regular

    if settings.integrator != "baked":
        return None
    baking = quick_bake(settings) if quick else BakeSettings(seed=settings.seed, threads=settings.threads)
    return LightSource(baking, file and check_regular(file), quick)
