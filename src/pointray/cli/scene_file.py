"""Scene files on the command line: options change what the file says, where they can."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .options import background_of, exposure_of, numbers, size_of, up_axis, use_threads
from .outputs import Shown, check_fits, write_picture
from .views import SceneView
from .waiting import Progress, in_background

if TYPE_CHECKING:
    from .animate import FilmOutput, FilmSource

VECTORS = ("eye", "target")
CAMERA = (*VECTORS, "up", "fov", "size", "projection", "aperture", "focus")
SETTINGS = ("integrator", "spp", "max_depth", "time_limit", "noise", "denoise", "filter", "seed", "threads", "levels")
LOOK = ("background", "exposure")
FILM = ("seconds", "fps", "turns", "keys")  # options that are about the film, not about what it shows


def is_scene(file: Path) -> bool:
    """Whether it is called like a scene file."""
    return file.suffix.lower() == ".toml"


class DescribedScene:
    """A scene file, and the options that were given with it. Raises what is wrong with either at once.

    Parameters
    ----------
    options : dict
        Those that the user has typed.
    film : sequence of str
        Names of options that are about neither the scene nor the picture.
    """

    def __init__(self, file: Path, options: dict[str, Any], film: Sequence[str] = ()) -> None:
        unfit = [name for name in options if name not in ("file", "output", *CAMERA, *SETTINGS, *LOOK, *film)]
        if unfit:
            raise ValueError(f"--{unfit[0].replace('_', '-')} is not for a scene file, which says it itself: {file}")
        texts: dict[str, Any] = {name: numbers(options[name], f"--{name}") for name in VECTORS if name in options}
        texts |= {"size": size_of(options["size"])} if "size" in options else {}
        texts |= {"background": background_of(options["background"])} if "background" in options else {}
        if "up" in options:
            texts["up"] = up_axis(options["up"])
            if texts["up"] is None:
                raise ValueError("--up auto is for a scan: a scene file says which way is up")
        if "exposure" in options:
            texts["exposure"] = exposure_of(options["exposure"])
            if isinstance(texts["exposure"], str):
                raise ValueError("--exposure auto is for a scan: a scene file says how bright its light is")
        plain = {name: getattr(value, "value", value) for name, value in options.items()} | texts
        from ..image.denoise import check_denoise
        from ..scenefile import Plan

        self.plan = plan = Plan(file)
        plan.change(
            {name: plain[name] for name in CAMERA if name in plain},
            {name: plain[name] for name in SETTINGS if name in plain},
            {name: plain[name] for name in LOOK if name in plain},
        )
        if plan.settings.denoised:
            check_denoise()
        use_threads(plan.settings.threads)

    @property
    def settings(self) -> dict[str, Any]:
        """What the scene depends on, as JSON takes it."""
        facts = [(path, path.stat()) for path in self.plan.files]
        files = [(str(path.resolve()), fact.st_size, fact.st_mtime_ns) for path, fact in facts]
        return {"scene": files, "background": self.plan.background}

    def source(self) -> FilmSource:
        """What a film of it shows."""
        from .animate import FilmSource

        def build(progress: Progress) -> tuple[Any, Any]:
            made = in_background(lambda: plan.build(progress.show))
            return made.scene, made.camera

        plan = self.plan
        return FilmSource(build, plan.settings, plan.exposure, plan.curve, self.settings)


def render_scene(file: Path, output: Path, options: dict[str, Any]) -> str:
    """Render what a scene file describes; returns a line that says what was done."""
    plan = DescribedScene(file, options).plan
    check_fits(output, SceneView(plan.camera).size, plan.settings)
    with Progress(plan.settings) as progress:
        made = in_background(lambda: plan.build(progress.show))
        what = write_picture(output, made[:3], Shown(made.exposure, made.curve), progress)
    width, height = made.camera.size
    return f"{output}: {width}x{height}{what}"


def animate_scene(file: Path, goal: FilmOutput, options: dict[str, Any], fps: float) -> str:
    """A film of what a scene file describes; returns a line that says what was done."""
    from .animate import TRANSPARENT, CameraPath, animate

    described = DescribedScene(file, options, FILM)
    if goal.mp4 and described.plan.background is None:
        raise described.plan.error("background", f"{TRANSPARENT}; or say --background")
    wishes = {name: options.get(name) for name in ("seconds", "turns", "keys", "eye", "target")}
    return animate(goal, CameraPath(SceneView(described.plan.camera), fps, wishes), described.source())
