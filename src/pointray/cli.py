"""The command line. Nothing heavy is imported before it is needed, so that --help answers at once."""

from __future__ import annotations

import os
import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Ray traces point clouds: smooth, lit, shadowed surfaces straight from points.",
)

Surface = StrEnum("Surface", ["paper", "imls", "apss", "disc"])
Integrator = StrEnum("Integrator", ["phong", "normal", "depth", "color", "cost"])


def numbers(text: str, name: str) -> tuple[float, float, float]:
    """`x,y,z`."""
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        raise ValueError(f"{name} must be three numbers like 0,-5,1.5, not {text!r}") from None
    return x, y, z


def size_of(text: str) -> tuple[int, int]:
    """`640x480`."""
    try:
        width, height = (int(part) for part in text.lower().split("x"))
    except ValueError:
        raise ValueError(f"--size must be like 640x480, not {text!r}") from None
    return width, height


def light_of(text: str) -> Any:
    """`sun:dx,dy,dz` (direction of travel) or `point:x,y,z`, either with a strength behind another colon."""
    import pointray as pr

    kind, _, rest = text.partition(":")
    place, _, strength = rest.partition(":")
    try:
        power = float(strength) if strength else 3.0
    except ValueError:
        raise ValueError(f"--light: {strength!r} is no strength") from None
    if kind == "sun":
        return pr.SunLight(numbers(place, "--light"), power)
    if kind == "point":
        return pr.PointLight(numbers(place, "--light"), power)
    raise ValueError(f"--light must be like sun:1,1,-2 or point:0,-3,4:20, not {text!r}")


SizeOption = Annotated[str, typer.Option(help="Width and height in pixels, like 640x480.")]
ThreadsOption = Annotated[int | None, typer.Option(help="Threads; default: POINTRAY_THREADS, else all processors.")]


@app.command()
def render(
    file: Annotated[Path, typer.Argument(help="A scan: .ply.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="The picture: .png or .jpg.")],
    eye: Annotated[str | None, typer.Option(help="Where the camera is, x,y,z; default: it frames the scan.")] = None,
    target: Annotated[str | None, typer.Option(help="What it looks at, x,y,z; default: the scan's middle.")] = None,
    up: Annotated[str, typer.Option(help="Which way is up, x,y,z.")] = "0,0,1",
    fov: Annotated[float, typer.Option(help="Vertical field of view, degrees.")] = 40.0,
    size: SizeOption = "800x600",
    integrator: Annotated[Integrator, typer.Option(help="What is shown.")] = Integrator.phong,
    spp: Annotated[int, typer.Option(help="Samples a pixel.")] = 4,
    seed: Annotated[int, typer.Option(help="Of the samples' places.")] = 0,
    threads: ThreadsOption = None,
    surface: Annotated[Surface | None, typer.Option(help="Which surface; default: apss.")] = None,
    samples: Annotated[int, typer.Option(help="Samples along a ray in the diameter of a support.")] = 4,
    radius_scale: Annotated[float, typer.Option(help="All radii times this.")] = 1.0,
    background: Annotated[str, typer.Option(help="Linear r,g,b, or none: transparent.")] = "0.85,0.87,0.9",
    light: Annotated[
        list[str] | None,
        typer.Option(help="sun:dx,dy,dz or point:x,y,z, and :strength; can be repeated. Default: a headlight."),
    ] = None,
    exposure: Annotated[float, typer.Option(help="Stops.")] = 0.0,
) -> None:
    """Render a scan to a picture; camera and light place themselves."""
    from .image.write import check_image_path
    from .points.files import check_readable

    check_image_path(output)
    check_readable(file)
    import pointray as pr

    camera_at: dict[str, Any] = {"fov": fov, "size": size_of(size), "up": numbers(up, "--up")}
    settings = pr.Settings(integrator.value, spp=spp, seed=seed, threads=threads)
    scene = pr.Scene()
    for text in light or []:
        scene.add_light(light_of(text))
    scene.background = None if background == "none" else numbers(background, "--background")
    with Progress() as progress:
        points = progress.stage("reading", lambda: pr.read(file))
        model = pr.Model(
            points,
            surface=surface and surface.value,
            samples=samples,
            radius_scale=radius_scale,
            progress=progress.show,
        )
        scene.add(model)
        if eye is None:
            camera = pr.Camera.frame(model.bounds, **camera_at)
        else:
            middle = model.bounds.mean(axis=0) if target is None else numbers(target, "--target")
            camera = pr.Camera.look_at(numbers(eye, "--eye"), middle, **camera_at)
        image = pr.render(scene, camera, settings, lambda share: progress.show("rendering", share))
    pr.write_image(output, image, exposure=exposure)
    print(f"{output}: {camera.size[0]}x{camera.size[1]}, {len(points):,} points")


@app.command()
def info(
    file: Annotated[Path, typer.Argument(help="A scan: .ply.")],
    json: Annotated[bool, typer.Option("--json", help="As JSON.")] = False,
) -> None:
    """What is in a scan, and what is missing."""
    from .points.files import check_readable
    from .report import describe, show_table

    check_readable(file)
    import pointray as pr

    facts = describe(pr.read(file))
    show_table({"file": str(file), **facts}, json)


@app.command()
def demo(
    output: Annotated[Path, typer.Option("--output", "-o", help="The picture.")] = Path("demo.png"),
    points: Annotated[int, typer.Option(help="Points of the statue, from 1000 on.")] = 1_000_000,
    size: SizeOption = "512x512",
    frames: Annotated[int, typer.Option(help="Frames that are timed.")] = 10,
    threads: ThreadsOption = None,
    json: Annotated[bool, typer.Option("--json", help="The table as JSON.")] = False,
) -> None:
    """Ray trace the embedded statue, on a ground plane, with a hard shadow; write the picture and print the times."""
    from .image.write import check_image_path

    check_image_path(output)
    if points < 1000 or frames < 1:
        raise ValueError("--points must be at least 1000, --frames at least 1")
    from .demonstration import run_demo
    from .report import show_table

    with Progress() as progress:
        facts = run_demo(output, points, size_of(size), frames, threads, progress.show)
    show_table(facts, json)


class Progress:
    """A bar on the terminal, for what takes a moment, and a word when kernels are compiled."""

    def __enter__(self) -> Progress:
        from rich.console import Console
        from rich.progress import BarColumn, TextColumn
        from rich.progress import Progress as Bars

        from .jit import on_first_compilation

        console = Console(stderr=True)
        self._bars = Bars(
            TextColumn("{task.description}"),
            BarColumn(),
            console=console,
            transient=True,
            disable=not console.is_terminal,
        )
        self._task = self._bars.add_task("", total=1.0)
        self._bars.start()
        on_first_compilation(
            lambda: console.print("compiling kernels for this processor: once, some 30 seconds", style="dim")
        )
        return self

    def __exit__(self, *error: object) -> None:
        self._bars.stop()

    def show(self, stage: str, share: float) -> None:
        """Where it is."""
        self._bars.update(self._task, description=stage, completed=share)

    def stage(self, name: str, call: Any) -> Any:
        """Do one stage that cannot tell how far it is."""
        self.show(name, 0.0)
        return call()


@app.callback(invoke_without_command=True)
def _main(version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False) -> None:
    if version:
        from . import __version__

        print(__version__)
        raise typer.Exit()


def _note(message: Any, *rest: Any) -> None:
    """A warning of the library as one line."""
    print(f"pointray: note: {' '.join(str(message).split())}", file=sys.stderr)


def main() -> None:
    """Exit status 0, 1 (failed), 2 (bad input), 130 (interrupted)."""
    import warnings

    warnings.showwarning = _note  # type: ignore[assignment]
    warnings.simplefilter("default", UserWarning)
    status = 0
    try:
        app(standalone_mode=False)
    except KeyboardInterrupt:
        status = 130
    except (OSError, ValueError) as error:
        print(f"pointray: {one_line(error)}", file=sys.stderr)
        status = 2
    except Exception as error:
        status = 130 if type(error).__name__ == "Abort" else getattr(error, "exit_code", 1)
        show = getattr(error, "show", None)
        if status != 130:
            show() if show else print(f"pointray: {type(error).__name__}: {one_line(error)}", file=sys.stderr)
    sys.stdout.flush()
    sys.stderr.flush()
    # A thread may still be inside of the compiler, which nothing interrupts: do not wait for it.
    os._exit(status)


def one_line(error: BaseException) -> str:
    """An error's message; of the system's errors the file and the reason."""
    if isinstance(error, OSError) and error.strerror:
        where = f"{error.filename}: " if error.filename else ""
        return f"{where}{error.strerror}"
    return " ".join(str(error).split())


if __name__ == "__main__":
    main()
