"""The commands. Nothing heavy is imported before it is needed, so that --help answers at once."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from .options import SAVED, View, ground_under, light_of, numbers, positive, use_threads
from .waiting import Progress, in_background, writing

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Ray traces point clouds: smooth, lit, shadowed surfaces straight from points.",
)

Surface = StrEnum("Surface", ["paper", "imls", "apss", "disc"])
Integrator = StrEnum("Integrator", ["phong", "normal", "depth", "color", "cost"])
Projection = StrEnum("Projection", ["perspective", "orthographic", "panorama"])
Filter = StrEnum("Filter", ["box", "tent", "gaussian", "blackman-harris"])

SizeOption = Annotated[str, typer.Option(help="Width and height in pixels, like 640x480.")]
ThreadsOption = Annotated[int | None, typer.Option(help="Threads; default: POINTRAY_THREADS, else all processors.")]


@app.command()
def render(
    file: Annotated[Path, typer.Argument(help="A scan: .ply, or a model that prepare has saved: .pointray.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="The picture: .png or .jpg.")],
    eye: Annotated[str | None, typer.Option(help="Where the camera is, x,y,z; default: it frames the scan.")] = None,
    target: Annotated[str | None, typer.Option(help="What it looks at, x,y,z; default: the scan's middle.")] = None,
    up: Annotated[str, typer.Option(help="Which way is up, x,y,z.")] = "0,0,1",
    fov: Annotated[float, typer.Option(help="Vertical field of view, degrees.")] = 40.0,
    size: SizeOption = "800x600",
    projection: Annotated[
        Projection, typer.Option(help="Orthographic: as high at the target; panorama: 360 x 180 degrees.")
    ] = Projection.perspective,
    aperture: Annotated[float, typer.Option(help="Diameter of the lens, in the scan's units; 0: all is sharp.")] = 0.0,
    focus: Annotated[float | None, typer.Option(help="How far away it is sharp; default: the target.")] = None,
    integrator: Annotated[Integrator, typer.Option(help="What is shown.")] = Integrator.phong,
    spp: Annotated[int, typer.Option(help="Samples a pixel.")] = 4,
    filter: Annotated[Filter, typer.Option(help="How a pixel is made of its samples.")] = Filter["blackman-harris"],
    seed: Annotated[int, typer.Option(help="Of the samples' places.")] = 0,
    threads: ThreadsOption = None,
    surface: Annotated[Surface | None, typer.Option(help="Which surface; default: apss.")] = None,
    samples: Annotated[int, typer.Option(min=2, max=64, help="Samples along a ray in a support's diameter.")] = 4,
    radius_scale: Annotated[float, typer.Option(help="All radii times this.")] = 1.0,
    background: Annotated[str, typer.Option(help="Linear r,g,b, or none: transparent.")] = "0.85,0.87,0.9",
    light: Annotated[
        list[str] | None,
        typer.Option(
            help="sun:dx,dy,dz (the way it travels) or point:x,y,z, then :strength; repeatable. Default: a headlight."
        ),
    ] = None,
    exposure: Annotated[float, typer.Option(help="Stops.")] = 0.0,
    ground: Annotated[bool, typer.Option("--ground/--no-ground", help="A grey plane under the scan.")] = False,
) -> None:
    """Render a scan to a picture; camera and light place themselves."""
    from ..image.write import check_image_path
    from ..points.files import check_readable, check_regular

    check_image_path(output)
    (check_regular if file.suffix.lower() == SAVED else check_readable)(file)
    import pointray as pr

    from ..picture import render as trace  # pr.render may be the module, by now
    from ..settings import Settings

    view = View(size, fov, up, eye, target, projection.value, aperture, focus)
    settings = Settings(integrator.value, spp=spp, seed=seed, threads=use_threads(threads), filter=filter.value)
    lights = [light_of(text) for text in light or []]
    scene = pr.Scene()
    scene.background = None if background == "none" else numbers(background, "--background")
    options: dict[str, Any] = {"surface": surface and surface.value, "samples": samples}
    options["radius_scale"] = positive(radius_scale, "--radius-scale")
    if not -100 <= exposure <= 100:
        raise ValueError(f"--exposure must lie between -100 and 100 stops, not {exposure}")
    with Progress() as progress:
        model = _load(file, options, progress)
        scene.add(model)
        if ground:
            scene.add(ground_under(model.bounds, view.up))
        for make in lights:
            scene.add_light(make(model.bounds.mean(axis=0)))
        camera = view.camera(model.bounds)
        show = progress.show
        image = in_background(lambda: trace(scene, camera, settings, lambda share: show("rendering", share)))
    with writing(output):
        pr.write_image(output, image, exposure=exposure)
    print(f"{output}: {camera.size[0]}x{camera.size[1]}, {len(model.points):,} points")


def _load(file: Path, options: dict[str, Any], progress: Progress) -> Any:
    """The model of a file: a scan's, or a saved one."""
    import pointray as pr

    from .prepare import radii_in

    progress.show("reading", 0.0)
    if file.suffix.lower() == SAVED:
        if options != {"surface": None, "samples": 4, "radius_scale": 1.0}:
            raise ValueError(f"{file}: --surface, --samples and --radius-scale are part of a saved model")
        return in_background(lambda: pr.Model.load(file))
    points = in_background(lambda: pr.read(file))
    radii = radii_in(points)
    try:
        return in_background(lambda: pr.Model(points, radii, **options, progress=progress.show))
    except ValueError as error:
        raise ValueError(f"{file}: {error}") from error


@app.command()
def prepare(
    file: Annotated[Path, typer.Argument(help="A scan: .ply.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="The result: .ply, or .pointray: the model, ready.")],
    tolerance: Annotated[
        str | None,
        typer.Option(help="Leave out what the surface can spare: it stays within 0.5 (units), or 0.05% (diagonal)."),
    ] = None,
    count: Annotated[int | None, typer.Option(help="Leave so many points.")] = None,
    drop_duplicates: Annotated[bool, typer.Option("--drop-duplicates", help="Of equal positions keep one.")] = False,
    drop_outliers: Annotated[bool, typer.Option("--drop-outliers", help="Drop what lies far from the rest.")] = False,
    estimate_normals: Annotated[bool, typer.Option("--estimate-normals", help="Replaces those there are.")] = False,
    viewpoint: Annotated[str | None, typer.Option(help="The scanner, x,y,z: normals are turned to it.")] = None,
    threads: ThreadsOption = None,
) -> None:
    """Make a scan smaller, cleaner, or give it normals; radii are kept as the attribute 'radius', which render uses."""
    from .prepare import prepare as work

    if viewpoint is not None and not estimate_normals:
        raise ValueError("--viewpoint is for --estimate-normals, which is not given")
    use_threads(threads)
    wishes = {
        "tolerance": tolerance,
        "count": count,
        "drop_duplicates": drop_duplicates,
        "drop_outliers": drop_outliers,
        "estimate_normals": estimate_normals,
        "viewpoint": None if viewpoint is None else numbers(viewpoint, "--viewpoint"),
    }
    print(work(file, output, wishes))


@app.command()
def info(
    file: Annotated[Path, typer.Argument(help="A scan: .ply.")],
    json: Annotated[bool, typer.Option("--json", help="As JSON.")] = False,
) -> None:
    """What is in a scan, and what is missing."""
    from ..points.files import check_readable
    from ..report import describe, show_table

    check_readable(file)
    import pointray as pr

    with Progress() as progress:
        progress.show("reading", 0.0)
        facts = in_background(lambda: describe(pr.read(file)))
    show_table({"file": str(file), **facts}, json)


@app.command()
def demo(
    output: Annotated[Path, typer.Option("--output", "-o", help="The picture.")] = Path("demo.png"),
    points: Annotated[int, typer.Option(min=1000, max=10**8, help="Points of the statue.")] = 1_000_000,
    size: SizeOption = "512x512",
    frames: Annotated[int, typer.Option(min=1, help="Frames that are timed.")] = 10,
    threads: ThreadsOption = None,
    json: Annotated[bool, typer.Option("--json", help="The table as JSON.")] = False,
) -> None:
    """Ray trace the embedded statue, on a ground plane, with a hard shadow; write the picture and print the times."""
    from ..image.write import check_image_path

    check_image_path(output)
    wanted, count = View(size).size, use_threads(threads)
    from ..demonstration import run_demo
    from ..report import show_table

    with Progress() as progress:
        facts = in_background(lambda: run_demo(output, points, wanted, frames, count, progress.show))
    show_table(facts, json)


@app.command()
def bench(
    points: Annotated[
        list[int] | None,
        typer.Option(min=1000, max=10**8, help="Points of the statue; repeatable. Default: 32000 and 1000000."),
    ] = None,
    runs: Annotated[int, typer.Option(min=1, help="Frames that are timed, of each view.")] = 9,
    threads: ThreadsOption = None,
    plot: Annotated[Path | None, typer.Option(help="Draw the table: .png, .svg or .pdf.")] = None,
    json: Annotated[bool, typer.Option("--json", help="The table as JSON.")] = False,
) -> None:
    """The paper's frame rates beside this machine's; --points 24000000 is its stress test (6 minutes, 8 GiB)."""
    from .. import benchmark

    if plot is not None:
        benchmark.check_plot(plot)
    count, counts = use_threads(threads), points or [32_000, 1_000_000]
    with Progress() as progress:
        rows = in_background(lambda: benchmark.measure(counts, runs, count, progress.show))
    benchmark.show_rows(rows, count, json)
    if plot is not None:
        with writing(plot):
            benchmark.plot(plot, rows)


@app.callback(invoke_without_command=True)
def _main(version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False) -> None:
    if version:
        from .. import __version__

        print(__version__)
        raise typer.Exit()
