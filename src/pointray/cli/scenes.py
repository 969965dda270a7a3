"""Scene files on the command line: options change what the file says, where they can."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from .options import background_of, numbers, size_of, use_threads
from .outputs import write_picture
from .waiting import Progress, in_background

VECTORS = ("eye", "target", "up")
CAMERA = (*VECTORS, "fov", "size", "projection", "aperture", "focus")
SETTINGS = ("integrator", "spp", "max_depth", "time_limit", "noise", "filter", "seed", "threads")
LOOK = ("background", "exposure")


def is_scene(file: Path) -> bool:
    """Whether it is called like a scene file."""
    return file.suffix.lower() == ".toml"


class SceneStage:
    """A scene file, and the options that were given with it. Raises what is wrong with either at once."""

    def __init__(self, file: Path, options: dict[str, Any]) -> None:
        unfit = [name for name in options if name not in ("file", "output", *CAMERA, *SETTINGS, *LOOK)]
        if unfit:
            raise ValueError(f"--{unfit[0].replace('_', '-')} is not for a scene file, which says it itself: {file}")
        texts: dict[str, Any] = {name: numbers(options[name], f"--{name}") for name in VECTORS if name in options}
        texts |= {"size": size_of(options["size"])} if "size" in options else {}
        texts |= {"background": background_of(options["background"])} if "background" in options else {}
        plain = {name: getattr(value, "value", value) for name, value in options.items()} | texts
        from ..scenefile import Plan

        self.plan = plan = Plan(file)
        plan.change(
            {name: plain[name] for name in CAMERA if name in plain},
            {name: plain[name] for name in SETTINGS if name in plain},
            {name: plain[name] for name in LOOK if name in plain},
        )
        use_threads(plan.settings.threads)


def render_scene(file: Path, output: Path, options: dict[str, Any]) -> str:
    """Render what a scene file describes; returns a line that says what was done."""
    plan = SceneStage(file, options).plan
    with Progress() as progress:
        made = in_background(lambda: plan.build(progress.show))
        what = write_picture(output, made[:3], (made.exposure, made.curve, None), progress)
    width, height = made.camera.size
    return f"{output}: {width}x{height}{what}"
