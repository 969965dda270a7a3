"""The commands that show a scan or a scene: pictures, films, and the page in the browser."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ...base.choices import AUTO, MUTED
from ..cluster import ClusterOption, SpreadOption, WorkersOption, working_on
from ..options import (
    SCANS,
    TOGETHER,
    ApertureOption,
    AzimuthOption,
    BackfacesOption,
    BackgroundOption,
    BakeOption,
    CacheOption,
    ColorByOption,
    ColorOption,
    ContactShadowOption,
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
    Scatter,
    ScatterOption,
    ScatterSizeOption,
    SeedOption,
    Side,
    SizeOption,
    SmoothOption,
    SppOption,
    SubjectArgument,
    SurfaceOption,
    TargetOption,
    ThreadsOption,
    TimeLimitOption,
    UpOption,
    ViewOption,
    ZoomOption,
    bytes_of,
    exposure_of,
    given,
    use_threads,
)
from ..read_options import Reading, with_reading
from ..scan_files import scan_of
from ..scan_lights import picture_options
from ..waiting import Progress


@with_reading
def render(
    context: typer.Context,
    files: SubjectArgument,
    reading: Reading,
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
    integrator: IntegratorOption = None,
    bake: BakeOption = None,
    spp: SppOption = 4,
    max_depth: MaxDepthOption = 4,
    time_limit: TimeLimitOption = None,
    noise: NoiseOption = None,
    denoise: DenoiseOption = False,
    filter: FilterOption = Filter["blackman-harris"],
    seed: SeedOption = 0,
    threads: ThreadsOption = None,
    cluster: ClusterOption = None,
    workers: WorkersOption = None,
    spread: SpreadOption = False,
    cache: CacheOption = True,
    levels: LevelsOption = True,
    surface: SurfaceOption = None,
    samples: SamplesOption = 4,
    radius_scale: RadiusScaleOption = 1.0,
    smooth: SmoothOption = AUTO,
    scatter: ScatterOption = Scatter["auto"],
    scatter_size: ScatterSizeOption = 1.0,
    normals: NormalsOption = Normals["auto"],
    backfaces: BackfacesOption = None,
    contact_shadow: ContactShadowOption = True,
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
    from ..outputs import Shown, check_fits, check_output, is_layered, write_picture
    from ..scan_scene import staged
    from ..scene_file import render_scene, scene_of

    options = picture_options(context)
    stops = exposure_of(exposure, options["integrator"].value)
    check_output(output, exposure != AUTO and stops != 0, legend)
    scene_file = scene_of(files)
    if scene_file is not None:
        with working_on(cluster, workers, spread) as client:
            print(render_scene(scene_file, output, given(context), client))
        return
    if legend and color_by is None:
        raise ValueError("--legend is for --color-by, which is not given")
    scan_view, settings, scan_scene = staged(scan_of(files, reading, cache), options, is_layered(output))
    check_fits(output, scan_view.size, settings, legend)
    with working_on(cluster, workers, spread) as client, Progress(settings, scan_scene.bakes) as progress:
        scene, model, scan = scan_scene.build(progress)
        scan_scene.light(progress)
        camera = scan_view.camera(scan)
        settings = scan_scene.shown_with(settings, camera)
        shadow = scan_scene.shadow(settings)
        shown = Shown(stops, AUTO, scan_scene.legend if legend else None, scan_scene.backdrop, shadow)
        ending = write_picture(output, (scene, camera, settings), shown, progress, client)
        scan_scene.keep(progress)
    print(f"{output}: {camera.size[0]}x{camera.size[1]}, {len(model.points):,} points{ending}")
    if scan_view.framed and scan.found:
        print(scan.found)


@with_reading
def animate(
    context: typer.Context,
    files: SubjectArgument,
    reading: Reading,
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
    integrator: IntegratorOption = None,
    bake: BakeOption = None,
    spp: SppOption = 4,
    max_depth: MaxDepthOption = 4,
    time_limit: TimeLimitOption = None,
    noise: NoiseOption = None,
    denoise: DenoiseOption = False,
    filter: FilterOption = Filter["blackman-harris"],
    seed: SeedOption = 0,
    threads: ThreadsOption = None,
    cluster: ClusterOption = None,
    workers: WorkersOption = None,
    spread: SpreadOption = False,
    cache: CacheOption = True,
    levels: LevelsOption = True,
    surface: SurfaceOption = None,
    samples: SamplesOption = 4,
    radius_scale: RadiusScaleOption = 1.0,
    smooth: SmoothOption = AUTO,
    scatter: ScatterOption = Scatter["auto"],
    scatter_size: ScatterSizeOption = 1.0,
    normals: NormalsOption = Normals["auto"],
    backfaces: BackfacesOption = None,
    contact_shadow: ContactShadowOption = True,
    background: BackgroundOption = AUTO,
    light: LightOption = None,
    fill: FillOption = None,
    exposure: ExposureOption = AUTO,
    material: MaterialOption = Look["own"],
    color: ColorOption = None,
    ground: GroundOption = False,
    color_by: ColorByOption = None,
) -> None:
    """A film of a scan or a scene file, on a turntable or along keys; an interrupted one goes on when started again.

    Only the camera moves: baked light is baked, or read, once for all frames.
    """
    from ..animate import CameraPath, film_output, scan_source
    from ..animate import animate as work
    from ..scan_scene import staged
    from ..scene_file import animate_scene, scene_of

    options = picture_options(context)
    checked_output = film_output(output, background)
    scene_file = scene_of(files)
    if scene_file is not None:
        with working_on(cluster, workers, spread) as client:
            print(animate_scene(scene_file, checked_output, given(context), fps, client))
        return
    scan_view, settings, scan_scene = staged(scan_of(files, reading, cache), options)
    camera_path = CameraPath(scan_view, fps, context.params)
    source = scan_source(scan_scene, scan_view, settings, exposure_of(exposure, options["integrator"].value))
    with working_on(cluster, workers, spread) as client:
        print(work(checked_output, camera_path, source, client))


@with_reading
def view(
    context: typer.Context,
    files: Annotated[
        list[Path],
        typer.Argument(
            help=f"A scan, {SCANS}. {TOGETHER} Saved models, .pointray, are shown beside it, each by itself. Or, "
            "alone, a scene: .toml."
        ),
    ],
    reading: Reading,
    host: Annotated[str, typer.Option(help="The address to listen on; another than 127.0.0.1 is seen by others.")] = (
        "127.0.0.1"
    ),
    port: Annotated[int, typer.Option(min=0, max=65535, help="0: 8080, or the next one that is free.")] = 0,
    open_browser: Annotated[bool, typer.Option("--open/--no-open", help="Open the browser.")] = True,
    up: UpOption = AUTO,
    integrator: IntegratorOption = None,
    bake: BakeOption = None,
    levels: LevelsOption = True,
    surface: SurfaceOption = None,
    samples: SamplesOption = 4,
    radius_scale: RadiusScaleOption = 1.0,
    smooth: SmoothOption = AUTO,
    scatter: ScatterOption = Scatter["auto"],
    scatter_size: ScatterSizeOption = 1.0,
    normals: NormalsOption = Normals["auto"],
    backfaces: BackfacesOption = None,
    contact_shadow: ContactShadowOption = True,
    background: BackgroundOption = AUTO,
    light: LightOption = None,
    fill: FillOption = None,
    ground: GroundOption = False,
    threads: ThreadsOption = None,
    cache: CacheOption = True,
    memory: Annotated[
        str | None,
        typer.Option(help="Of a model in parts: so much of it stays open, like 1GiB [half of what is available]."),
    ] = None,
) -> None:
    """Show a scan in the browser, at once: turn it with the mouse, change light and material, save pictures."""
    from ...auto_view.studio import with_contact
    from ...rendering.settings import Settings
    from ..scan_surface import surface_of
    from ..serve import serve, shared_scene_of

    use_threads(threads)
    options = picture_options(context)
    shown = MUTED if backfaces is None else backfaces.value
    options["settings"] = with_contact(Settings(integrator=options["integrator"].value, levels=levels, backfaces=shown))
    surface_options = {"surface": surface and surface.value, "samples": samples, "radius_scale": radius_scale}
    surface_options |= {"smooth": smooth, "scatter": scatter.value, "scatter_size": scatter_size}
    surface_options = surface_of(surface_options)
    options["normals"] = normals.value
    options["memory"] = None if memory is None else bytes_of(memory)
    shared, loader = shared_scene_of(files, reading, given(context), options, surface_options, cache)
    serve(shared, loader, host, port, open_browser)
