"""Scene files on the command line; some options replace values of the file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..base.warning_log import warn
from .baked_light import FIRST, ONCE
from .options import background_of, exposure_of, use_threads
from .outputs import Shown, check_fits, write_picture
from .picture_options import IN_CAMERA, IN_ROOT, IN_SETTINGS, OF_WORKERS, TABLES, names_of
from .views import SceneView
from .waiting import Progress, in_background

if TYPE_CHECKING:
    from ..io.remote.remote_file import Location
    from .animate import FilmOutput, FilmSource

FILM = ("seconds", "fps", "turns", "keys")  # options of the film, not of its contents


def is_scene(file: Location) -> bool:
    """Return whether a file is a scene file, by its extension .toml."""
    return file.suffix.lower() == ".toml"


def scene_of(files: Sequence[Location]) -> Path | None:
    """Return the scene file among the files given to a command; None if they are scans or models.

    Raise ValueError if there are other files beside a scene file, or if it is given as a URL.
    """
    found = next(filter(is_scene, files), None)
    if found is not None and len(files) > 1:
        raise ValueError(f"{found}: a scene file cannot be combined with other files")
    if found is not None and not isinstance(found, Path):
        raise ValueError(f"{found}: a scene file must be on this computer, because it names other files: download it")
    return found


class DescribedScene:
    """A checked scene file, some of whose values are replaced by options of the command.

    Raises ValueError or OSError if the file or an option is invalid.

    Parameters
    ----------
    options : dict
        Options that the user typed, parsed, by name.
    others : sequence of str
        Names of options that are allowed, but are not for the scene file.
    pictures : bool
        Whether options of images, such as --size, are allowed.

    Attributes
    ----------
    plan : Plan
        The checked file with the replaced values, from which the scene is built.
    """

    def __init__(self, file: Path, options: dict[str, Any], others: Sequence[str] = (), pictures: bool = True) -> None:
        known = names_of(*TABLES) if pictures else ()
        unfit = [name for name in options if name not in ("files", "output", *known, *others)]
        if unfit:
            raise ValueError(f"--{unfit[0].replace('_', '-')} is not for a scene file, which defines it itself: {file}")
        values = dict(options)
        if values.get("up", ()) is None:
            raise ValueError("--up auto is for scans: a scene file defines the up direction")
        if "background" in options:
            values["background"] = background_of(options["background"])
        if "exposure" in options:
            values["exposure"] = exposure_of(options["exposure"])
            if isinstance(values["exposure"], str):
                raise ValueError("--exposure auto is for scans: a scene file defines its exposure")
        light: Path | None = options.get("bake")
        values |= {"integrator": "baked"} if light is not None else {}
        from ..base.atomic_write import check_regular
        from ..image.denoise import check_denoise
        from ..scenefile import Plan
        from ..scenefile.light import BakePlan

        self.plan = plan = Plan(file)
        if light is not None:
            plan.bake = BakePlan(plan.bake.settings, check_regular(light))
        tables = (names_of(table) for table in (IN_CAMERA, IN_SETTINGS, IN_ROOT))
        plan.change(*({name: values[name] for name in names if name in values} for names in tables))
        if plan.settings.denoised:
            check_denoise()
        use_threads(plan.settings.threads)

    @property
    def bakes(self) -> bool:
        """Whether light must be baked: images show baked light, and there is no file of it."""
        return self.plan.is_baked and self.plan.bake.found is None

    @property
    def inputs(self) -> dict[str, Any]:
        """All that the scene depends on, as JSON values: paths, sizes and times of all files, and the background.

        If it has changed, all frames of an interrupted animation are rendered again.
        """
        facts = [(path, path.stat()) for path in self.plan.files]
        files = [(str(path.resolve()), fact.st_size, fact.st_mtime_ns) for path, fact in facts]
        return {"scene": files, "background": self.plan.background}

    def build(self, progress: Progress, note: str = FIRST) -> Any:
        """Build the scene and return a `SceneFile`: scene, camera, settings, exposure and tone curve.

        The scene has baked light if images show it. note : message printed if the light must be baked
        """
        if self.bakes:
            warn(note, stacklevel=2)
        return in_background(lambda: self.plan.build(progress.show))

    def source(self) -> FilmSource:
        """Return what an animation of this scene needs: the function that builds the scene, settings and exposure."""
        from .animate import FilmSource

        def build(progress: Progress) -> tuple[Any, Any, Any]:
            return self.build(progress, ONCE)[:3]

        plan = self.plan
        return FilmSource(build, plan.settings, plan.exposure, plan.curve, self.inputs, bakes=self.bakes)


def render_scene(file: Path, output: Path, options: dict[str, Any], client: Any = None) -> str:
    """Render a scene file to an image; return the line that the command prints.

    options : those that the user typed, by name; they replace values of the file
    client : Dask client whose workers render; None: this process
    """
    described = DescribedScene(file, options, names_of(OF_WORKERS))
    plan = described.plan
    check_fits(output, SceneView(plan.camera).size, plan.settings)
    with Progress(plan.settings, described.bakes) as progress:
        made = described.build(progress)
        ending = write_picture(output, made[:3], Shown(made.exposure, made.curve), progress, client)
    width, height = made.camera.size
    return f"{output}: {width}x{height}{ending}"


def animate_scene(file: Path, output: FilmOutput, options: dict[str, Any], fps: float, client: Any = None) -> str:
    """Make an animation of a scene file; return the line that the command prints.

    options : those that the user typed, by name; they replace values of the file; fps : frames per second
    client : Dask client whose workers render; None: this process
    """
    from .animate import TRANSPARENT, CameraPath, animate

    described = DescribedScene(file, options, (*FILM, *names_of(OF_WORKERS)))
    if output.mp4 and described.plan.background is None:
        raise described.plan.error("background", f"{TRANSPARENT}, or set --background")
    film_options = {name: options.get(name) for name in ("seconds", "turns", "keys", "eye", "target")}
    camera_path = CameraPath(SceneView(described.plan.camera), fps, film_options)
    return animate(output, camera_path, described.source(), client)
