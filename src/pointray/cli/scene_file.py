"""Scene files on the command line; some options replace what the file says."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..base.warning_log import warn
from .baked_light import FIRST, ONCE
from .options import background_of, exposure_of, numbers, size_of, up_axis, use_threads
from .outputs import Shown, check_fits, write_picture
from .views import SceneView
from .waiting import Progress, in_background

if TYPE_CHECKING:
    from .animate import FilmOutput, FilmSource

VECTORS = ("eye", "target")
CAMERA = (*VECTORS, "up", "fov", "size", "projection", "aperture", "focus")
SETTINGS = (
    "integrator",
    "spp",
    "max_depth",
    "time_limit",
    "noise",
    "denoise",
    "filter",
    "seed",
    "threads",
    "levels",
    "backfaces",
)
ROOT = ("background", "exposure")
LIGHT = ("bake",)
WORKERS = ("cluster", "workers", "spread")  # who renders
FILM = ("seconds", "fps", "turns", "keys")  # options about the film, not about what it shows


def is_scene(file: Path) -> bool:
    """Whether a file has the extension of scene files."""
    return file.suffix.lower() == ".toml"


def scene_of(files: Sequence[Path]) -> Path | None:
    """The scene file that a command gets, which is alone; None if it gets scans."""
    found = next(filter(is_scene, files), None)
    if found is not None and len(files) > 1:
        raise ValueError(f"{found}: a scene file is taken alone")
    return found


class DescribedScene:
    """A scene file with the options given beside it. A mistake in either raises ValueError or OSError at once.

    Parameters
    ----------
    options : dict
        The options that the user has typed.
    others : sequence of str
        Names of options about neither the scene nor the picture, which are allowed too.
    pictures : bool
        Whether pictures are wanted: options about them are allowed.
    """

    def __init__(self, file: Path, options: dict[str, Any], others: Sequence[str] = (), pictures: bool = True) -> None:
        of_pictures = (*CAMERA, *SETTINGS, *ROOT, *LIGHT) if pictures else ()
        unfit = [name for name in options if name not in ("files", "output", *of_pictures, *others)]
        if unfit:
            raise ValueError(f"--{unfit[0].replace('_', '-')} is not for a scene file, which says it itself: {file}")
        parsed: dict[str, Any] = {name: numbers(options[name], f"--{name}") for name in VECTORS if name in options}
        parsed |= {"size": size_of(options["size"])} if "size" in options else {}
        parsed |= {"background": background_of(options["background"])} if "background" in options else {}
        if "up" in options:
            parsed["up"] = up_axis(options["up"])
            if parsed["up"] is None:
                raise ValueError("--up auto is for a scan: a scene file says which way is up")
        if "exposure" in options:
            parsed["exposure"] = exposure_of(options["exposure"])
            if isinstance(parsed["exposure"], str):
                raise ValueError("--exposure auto is for a scan: a scene file says how bright its light is")
        light: Path | None = options.get("bake")
        parsed |= {"integrator": "baked"} if light is not None else {}
        plain = {name: getattr(value, "value", value) for name, value in options.items()} | parsed
        from ..base.atomic_write import check_regular
        from ..image.denoise import check_denoise
        from ..scenefile import Plan
        from ..scenefile.light import BakePlan

        self.plan = plan = Plan(file)
        if light is not None:
            plan.bake = BakePlan(plan.bake.settings, check_regular(light))
        plan.change(
            {name: plain[name] for name in CAMERA if name in plain},
            {name: plain[name] for name in SETTINGS if name in plain},
            {name: plain[name] for name in ROOT if name in plain},
        )
        if plan.settings.denoised:
            check_denoise()
        use_threads(plan.settings.threads)

    @property
    def bakes(self) -> bool:
        """Whether light is baked before there are pictures: they show it, and no file has it."""
        return self.plan.is_baked and self.plan.bake.found is None

    @property
    def inputs(self) -> dict[str, Any]:
        """What the scene depends on, as values of JSON."""
        facts = [(path, path.stat()) for path in self.plan.files]
        files = [(str(path.resolve()), fact.st_size, fact.st_mtime_ns) for path, fact in facts]
        return {"scene": files, "background": self.plan.background}

    def build(self, progress: Progress, told: str = FIRST) -> Any:
        """The `SceneFile`, with its baked light if pictures show that. told : what is said if it is baked"""
        if self.bakes:
            warn(told, stacklevel=2)
        return in_background(lambda: self.plan.build(progress.show))

    def source(self) -> FilmSource:
        """The source of a film of the scene."""
        from .animate import FilmSource

        def build(progress: Progress) -> tuple[Any, Any, Any]:
            return self.build(progress, ONCE)[:3]

        plan = self.plan
        return FilmSource(build, plan.settings, plan.exposure, plan.curve, self.inputs, bakes=self.bakes)


def render_scene(file: Path, output: Path, options: dict[str, Any], client: Any = None) -> str:
    """Render what a scene file describes; returns a line for the user."""
    described = DescribedScene(file, options, WORKERS)
    plan = described.plan
    check_fits(output, SceneView(plan.camera).size, plan.settings)
    with Progress(plan.settings, described.bakes) as progress:
        made = described.build(progress)
        ending = write_picture(output, made[:3], Shown(made.exposure, made.curve), progress, client)
    width, height = made.camera.size
    return f"{output}: {width}x{height}{ending}"


def animate_scene(file: Path, output: FilmOutput, options: dict[str, Any], fps: float, client: Any = None) -> str:
    """Make a film of what a scene file describes; returns a line for the user."""
    from .animate import TRANSPARENT, CameraPath, animate

    described = DescribedScene(file, options, (*FILM, *WORKERS))
    if output.mp4 and described.plan.background is None:
        raise described.plan.error("background", f"{TRANSPARENT}; or say --background")
    film_options = {name: options.get(name) for name in ("seconds", "turns", "keys", "eye", "target")}
    camera_path = CameraPath(SceneView(described.plan.camera), fps, film_options)
    return animate(output, camera_path, described.source(), client)
