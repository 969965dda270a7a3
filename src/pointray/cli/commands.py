"""The commands. Nothing heavy is imported before it is needed, so that --help answers at once."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..choices import AUTO
from .options import (
    SCANS,
    ApertureOption,
    AzimuthOption,
    BackgroundOption,
    ColorByOption,
    ColorOption,
    DenoiseOption,
    ElevationOption,
    ExposureOption,
    EyeOption,
    FillOption,
    Filter,
    FilterOption,
    FocusOption,
    FovOption,
    GroundOption,
    Integrator,
    IntegratorOption,
    LegendOption,
    LevelsOption,
    LightOption,
    Look,
    MaterialOption,
    MaxDepthOption,
    NoiseOption,
    Normals,
    NormalsOption,
    Projection,
    ProjectionOption,
    RadiusScaleOption,
    SamplesOption,
    SeedOption,
    Side,
    SizeOption,
    SppOption,
    SubjectArgument,
    SurfaceOption,
    TargetOption,
    ThreadsOption,
    TimeLimitOption,
    UpOption,
    ViewOption,
    ZoomOption,
    exposure_of,
    given,
    numbers,
    use_threads,
)
from .views import View
from .waiting import Progress, in_background, writing

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Ray traces point clouds: smooth, lit, shadowed surfaces straight from points.",
)


@app.command()
def render(
    context: typer.Context,
    file: SubjectArgument,
    output: Annotated[
        Path, typer.Option("--output", "-o", help="The picture: .png or .jpg; or all its layers: .exr or .npz.")
    ],
    eye: EyeOption = None,
    target: TargetOption = None,
    up: UpOption = AUTO,
    view: ViewOption = Side["auto"],
    azimuth: AzimuthOption = None,
    elevation: ElevationOption = None,
    zoom: ZoomOption = 1.0,
    fov: FovOption = 40.0,
    size: SizeOption = "800x600",
    projection: ProjectionOption = Projection["perspective"],
    aperture: ApertureOption = 0.0,
    focus: FocusOption = None,
    integrator: IntegratorOption = Integrator["phong"],
    spp: SppOption = 4,
    max_depth: MaxDepthOption = 4,
    time_limit: TimeLimitOption = None,
    noise: NoiseOption = None,
    denoise: DenoiseOption = False,
    filter: FilterOption = Filter["blackman-harris"],
    seed: SeedOption = 0,
    threads: ThreadsOption = None,
    levels: LevelsOption = True,
    surface: SurfaceOption = None,
    samples: SamplesOption = 4,
    radius_scale: RadiusScaleOption = 1.0,
    normals: NormalsOption = Normals["auto"],
    background: BackgroundOption = AUTO,
    light: LightOption = None,
    fill: FillOption = None,
    exposure: ExposureOption = AUTO,
    material: MaterialOption = Look["own"],
    color: ColorOption = None,
    ground: GroundOption = False,
    color_by: ColorByOption = None,
    legend: LegendOption = False,
) -> None:
    """Render a scan to a picture, camera and light place themselves; or what a scene file describes."""
    from .outputs import Shown, check_fits, check_output, is_layered, write_picture
    from .scan_scene import staged
    from .scene_file import is_scene, render_scene

    stops = exposure_of(exposure, integrator.value)
    check_output(output, exposure != AUTO and stops != 0, legend)
    if is_scene(file):
        print(render_scene(file, output, given(context)))
        return
    if legend and color_by is None:
        raise ValueError("--legend is for --color-by, which is not given")
    seen, settings, scan_scene = staged(file, context.params, is_layered(output))
    check_fits(output, seen.size, settings, legend)
    with Progress(settings) as progress:
        scene, model, scan = scan_scene.build(progress)
        camera = seen.camera(scan)
        look = Shown(stops, AUTO, scan_scene.legend if legend else None, scan_scene.backdrop)
        what = write_picture(output, (scene, camera, settings), look, progress)
    print(f"{output}: {camera.size[0]}x{camera.size[1]}, {len(model.points):,} points{what}")
    if seen.framed and scan.found:
        print(scan.found)


@app.command()
def animate(
    context: typer.Context,
    file: SubjectArgument,
    output: Annotated[
        Path, typer.Option("--output", "-o", help="The film: .mp4; or pictures: a folder, or a name like %04d.png.")
    ],
    seconds: Annotated[float | None, typer.Option(help="How long the turntable turns; default: 6.")] = None,
    fps: Annotated[float, typer.Option(help="Frames a second.")] = 24.0,
    turns: Annotated[float | None, typer.Option(help="How often it turns, negative: clockwise; default: 1.")] = None,
    keys: Annotated[
        Path | None,
        typer.Option(help="Fly instead: .toml or .json, a list keys of time, eye, target, perhaps up and fov."),
    ] = None,
    eye: EyeOption = None,
    target: TargetOption = None,
    up: UpOption = AUTO,
    view: ViewOption = Side["auto"],
    azimuth: AzimuthOption = None,
    elevation: ElevationOption = None,
    zoom: ZoomOption = 1.0,
    fov: FovOption = 40.0,
    size: SizeOption = "800x600",
    projection: ProjectionOption = Projection["perspective"],
    aperture: ApertureOption = 0.0,
    focus: FocusOption = None,
    integrator: IntegratorOption = Integrator["phong"],
    spp: SppOption = 4,
    max_depth: MaxDepthOption = 4,
    time_limit: TimeLimitOption = None,
    noise: NoiseOption = None,
    denoise: DenoiseOption = False,
    filter: FilterOption = Filter["blackman-harris"],
    seed: SeedOption = 0,
    threads: ThreadsOption = None,
    levels: LevelsOption = True,
    surface: SurfaceOption = None,
    samples: SamplesOption = 4,
    radius_scale: RadiusScaleOption = 1.0,
    normals: NormalsOption = Normals["auto"],
    background: BackgroundOption = AUTO,
    light: LightOption = None,
    fill: FillOption = None,
    exposure: ExposureOption = AUTO,
    material: MaterialOption = Look["own"],
    color: ColorOption = None,
    ground: GroundOption = False,
    color_by: ColorByOption = None,
) -> None:
    """A film of a scan or a scene file, on a turntable or along keys; an interrupted one goes on when started again."""
    from .animate import CameraPath, film_output, scan_source
    from .animate import animate as work
    from .scan_scene import staged
    from .scene_file import animate_scene, is_scene

    goal = film_output(output, background)
    if is_scene(file):
        print(animate_scene(file, goal, given(context), fps))
        return
    seen, settings, scan_scene = staged(file, context.params)
    film = CameraPath(seen, fps, context.params)
    print(work(goal, film, scan_source(scan_scene, seen, settings, exposure_of(exposure, integrator.value))))


@app.command()
def view(
    context: typer.Context,
    files: Annotated[
        list[Path], typer.Argument(help=f"Scans, {SCANS}, and saved models, .pointray, together; or a scene: .toml.")
    ],
    host: Annotated[str, typer.Option(help="The address to listen on; another than 127.0.0.1 is seen by others.")] = (
        "127.0.0.1"
    ),
    port: Annotated[int, typer.Option(min=0, max=65535, help="0: 8080, or the next one that is free.")] = 0,
    open_browser: Annotated[bool, typer.Option("--open/--no-open", help="Open the browser.")] = True,
    up: UpOption = AUTO,
    integrator: IntegratorOption = Integrator["phong"],
    levels: LevelsOption = True,
    surface: SurfaceOption = None,
    samples: SamplesOption = 4,
    radius_scale: RadiusScaleOption = 1.0,
    normals: NormalsOption = Normals["auto"],
    background: BackgroundOption = AUTO,
    light: LightOption = None,
    fill: FillOption = None,
    ground: GroundOption = False,
    threads: ThreadsOption = None,
) -> None:
    """Show a scan in the browser, at once: turn it with the mouse, change light and material, save pictures."""
    from ..arguments import check_positive
    from ..rendering.settings import Settings
    from ..staging.studio import with_contact
    from .serve import serve, shared_scene_of

    use_threads(threads)
    settings = with_contact(Settings(integrator=integrator.value, levels=levels))
    place = {"settings": settings, "up": up, "light": light, "fill": fill, "background": background, "ground": ground}
    look = {"surface": surface and surface.value, "samples": samples, "radius_scale": radius_scale}
    check_positive(radius_scale, "--radius-scale")
    place["normals"] = normals.value
    shared, loader = shared_scene_of(files, given(context), place, look)
    serve(shared, loader, host, port, open_browser)


@app.command()
def prepare(
    file: Annotated[Path, typer.Argument(help=f"A scan, {SCANS}, or a saved model, .pointray: its points.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="The result: .ply, or .pointray: the model, ready.")],
    tolerance: Annotated[
        str | None,
        typer.Option(help="Leave out what the surface can spare: it stays within 0.5 (units), or 0.05% (diagonal)."),
    ] = None,
    count: Annotated[int | None, typer.Option(help="Leave so many points.")] = None,
    drop_duplicates: Annotated[bool, typer.Option("--drop-duplicates", help="Of equal positions keep one.")] = False,
    drop_outliers: Annotated[bool, typer.Option("--drop-outliers", help="Drop what lies far from the rest.")] = False,
    normals: NormalsOption = Normals["auto"],
    estimate_normals: Annotated[bool, typer.Option("--estimate-normals", help="The same as --normals fit.")] = False,
    viewpoint: Annotated[str | None, typer.Option(help="The scanner, x,y,z: normals are turned to it.")] = None,
    levels: Annotated[
        bool, typer.Option("--levels/--no-levels", help="Of a .pointray: levels of detail too, a third more bytes.")
    ] = True,
    force: Annotated[bool, typer.Option("--force", help="The result may be the input itself: overwrite it.")] = False,
    threads: ThreadsOption = None,
) -> None:
    """Make a scan smaller, cleaner, or give it normals; radii are kept as the attribute 'radius', which render uses."""
    from .prepare import prepare as work

    if estimate_normals and normals == "file":
        raise ValueError("--estimate-normals and --normals file exclude each other")
    estimate_normals = estimate_normals or normals == "fit"
    if viewpoint is not None and not estimate_normals:
        raise ValueError("--viewpoint is for --estimate-normals or --normals fit, which is not given")
    use_threads(threads)
    wishes = {
        "tolerance": tolerance,
        "count": count,
        "drop_duplicates": drop_duplicates,
        "drop_outliers": drop_outliers,
        "normals": normals.value,
        "estimate_normals": estimate_normals,
        "viewpoint": None if viewpoint is None else numbers(viewpoint, "--viewpoint"),
        "levels": levels,
        "force": force,
    }
    print(work(file, output, wishes))


@app.command()
def info(
    file: Annotated[Path, typer.Argument(help=f"A scan, {SCANS}, or a saved model, .pointray.")],
    deep: Annotated[
        bool, typer.Option("--deep", help="Look at the neighbours of all points: 10 million take a minute and 7 GB.")
    ] = False,
    json: Annotated[
        bool, typer.Option("--json", help="As JSON: null is what only --deep finds of so many points.")
    ] = False,
) -> None:
    """What is in a scan or a saved model, and what is missing; of large ones a sample tells the spacing."""
    from .prepare import read_scan
    from .report import describe, describe_model, show_table
    from .scan_scene import check_scan

    check_scan(file)
    with Progress() as progress:
        progress.show("reading", 0.0)
        points, model = in_background(lambda: read_scan(file, progress))
        progress.show("looking", 0.0)
        facts = in_background(lambda: describe(points, deep, lambda share: progress.show("looking", share)))
    if model is not None:
        facts |= describe_model(model)
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
    from ..rendering.settings import Settings
    from .demo import run_demo
    from .report import show_table

    with Progress(Settings()) as progress:
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
    from . import benchmark

    if plot is not None:
        benchmark.check_plot(plot)
    count, counts = use_threads(threads), points or [32_000, 1_000_000]
    from ..rendering.settings import Settings

    with Progress(Settings()) as progress:
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
