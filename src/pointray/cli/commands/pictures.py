"""The commands that show a scan or a scene: `render`, `animate` and `view`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ...base.choices import AUTO, MUTED
from ..cluster import working_on
from ..declare import FILM, INPUT, OUTPUT, PAGE, single, with_options
from ..options import SCANS, SUBJECT, bytes_of, exposure_of, given, location, use_threads
from ..picture_options import OF_SURFACE, OF_WORKERS, PictureOptions
from ..read_options import Reading
from ..scan_files import scan_of
from ..waiting import Progress

IMAGE = "Image (.png or .jpg), or all its layers (.exr or .npz)."
FILM_OUTPUT = "Film (.mp4), or numbered images: a folder, or a name like %04d.png."
KEYS = "Fly along keys: .toml or .json, a list `keys` of time, eye, target, and optionally up and fov."
BESIDE = f"{SCANS} Saved models (.pointray) are shown beside them. Or a single scene file (.toml)."
MEMORY = "Memory for open parts of models in parts, such as 1GiB. Default: half of the available memory."


@with_options(
    "pointray render scan.ply -o scan.png",
    "pointray render scan.ply -o front.png --view front --size 1600x1200 --light sun:1,1,-2",
)
def render(
    context: typer.Context,
    files: Annotated[list[Path], typer.Argument(help=SUBJECT, parser=location)],
    reading: Reading,
    options: PictureOptions,
    output: Annotated[Path, single(OUTPUT, "FILE", IMAGE, "--output", "-o")],
) -> None:
    """Render a scan or a scene file to an image.

    Up direction, camera, light and exposure are chosen automatically; the command prints its choices.
    """
    from ..outputs import Shown, check_fits, check_output, is_layered, write_picture
    from ..scan_scene import staged
    from ..scene_file import render_scene, scene_of

    stops = exposure_of(options.exposure, options.shown)
    check_output(output, options.exposure != AUTO and stops != 0, options.legend)
    scene_file = scene_of(files)
    if scene_file is not None:
        with working_on(**options.of(OF_WORKERS)) as client:
            print(render_scene(scene_file, output, options.parsed(given(context)), client))
        return
    if options.legend and options.color_by is None:
        raise ValueError("--legend requires --color-by")
    scan_view, settings, scan_scene = staged(scan_of(files, reading, options.cache), options, is_layered(output))
    check_fits(output, scan_view.size, settings, options.legend)
    with working_on(**options.of(OF_WORKERS)) as client, Progress(settings, scan_scene.bakes) as progress:
        scene, model, scan = scan_scene.build(progress)
        scan_scene.light(progress)
        camera = scan_view.camera(scan)
        settings = scan_scene.shown_with(settings, camera)
        shadow = scan_scene.shadow(settings)
        shown = Shown(stops, AUTO, scan_scene.legend if options.legend else None, scan_scene.backdrop, shadow)
        ending = write_picture(output, (scene, camera, settings), shown, progress, client)
        scan_scene.keep(progress)
    print(f"{output}: {camera.size[0]}x{camera.size[1]}, {len(model.points):,} points{ending}")
    if scan_view.framed and scan.found:
        print(scan.found)


@with_options(
    "pointray animate scan.ply -o turntable.mp4", "pointray animate scan.ply -o flight.mp4 --keys keys.toml --fps 30"
)
def animate(
    context: typer.Context,
    files: Annotated[list[Path], typer.Argument(help=SUBJECT, parser=location)],
    reading: Reading,
    options: PictureOptions,
    output: Annotated[Path, single(OUTPUT, "PATH", FILM_OUTPUT, "--output", "-o")],
    seconds: Annotated[float | None, single(FILM, "SECONDS", "Duration of the turntable. Default: 6.")] = None,
    fps: Annotated[float, single(FILM, "COUNT", "Frames per second.")] = 24.0,
    turns: Annotated[
        float | None, single(FILM, "COUNT", "Revolutions, negative for clockwise ones. Default: 1.")
    ] = None,
    keys: Annotated[Path | None, single(FILM, "FILE", KEYS)] = None,
) -> None:
    """Make a film of a scan or a scene file, on a turntable or along keys.

    Only the camera moves: light is baked, or read, once for all frames. An interrupted film continues when the same
    command is run again.
    """
    from ..animate import CameraPath, animate as work, film_output, scan_source
    from ..scan_scene import staged
    from ..scene_file import animate_scene, scene_of

    checked_output = film_output(output, options.background)
    scene_file = scene_of(files)
    if scene_file is not None:
        with working_on(**options.of(OF_WORKERS)) as client:
            print(animate_scene(scene_file, checked_output, options.parsed(given(context)), fps, client))
        return
    scan_view, settings, scan_scene = staged(scan_of(files, reading, options.cache), options)
    camera_path = CameraPath(scan_view, fps, context.params)
    source = scan_source(scan_scene, scan_view, settings, exposure_of(options.exposure, options.shown))
    with working_on(**options.of(OF_WORKERS)) as client:
        print(work(checked_output, camera_path, source, client))


@with_options("pointray view scan.laz", "pointray view a.ply b.ply --drop-strays")
def view(
    context: typer.Context,
    files: Annotated[list[Path], typer.Argument(help=BESIDE, parser=location)],
    reading: Reading,
    options: PictureOptions,
    host: Annotated[
        str, single(PAGE, "ADDRESS", "Address to listen on; any but 127.0.0.1 is visible to others.")
    ] = "127.0.0.1",
    port: Annotated[int, single(PAGE, "NUMBER", "Port; 0: 8080, or the next free one.", min=0, max=65535)] = 0,
    open_browser: Annotated[bool, single(PAGE, None, "Open the browser.", "--open/--no-open")] = True,
    memory: Annotated[str | None, single(INPUT, "BYTES", MEMORY)] = None,
) -> None:
    """Show a scan or a scene file in the browser.

    Turn it with the mouse, change light and material, and save images and films.
    """
    from ...auto_view.studio import with_contact
    from ...rendering.settings import Settings
    from ..serve import serve, shared_scene_of

    use_threads(options.threads)
    settings = Settings(options.shown, levels=options.levels, backfaces=options.backfaces or MUTED)
    values = {**vars(options), "settings": with_contact(settings), "quick": options.is_quick}
    values["memory"] = None if memory is None else bytes_of(memory)
    typed = options.parsed(given(context))
    shared, loader = shared_scene_of(files, reading, typed, values, options.of(OF_SURFACE), options.cache)
    serve(shared, loader, host, port, open_browser)
