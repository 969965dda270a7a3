"""The commands about the files of scans: `bake`, `prepare`, `info`, and `convert` between formats."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ...base.choices import AUTO
from ..cluster import ClusterOption, WorkersOption, working_on
from ..options import (
    SCANS,
    TOGETHER,
    AlbedoScaleOption,
    BakeNoiseOption,
    ColorByOption,
    ColorOption,
    FillOption,
    GroundOption,
    LightOption,
    LinksOption,
    Look,
    MaterialOption,
    Normals,
    NormalsOption,
    PatchesOption,
    PerhapsPointsArgument,
    PointsArgument,
    RadiusScaleOption,
    SamplesOption,
    Scatter,
    ScatterOption,
    ScatterSizeOption,
    SeedOption,
    SmoothOption,
    SubjectArgument,
    SurfaceOption,
    ThreadsOption,
    UpOption,
    bytes_of,
    given,
    numbers,
    use_threads,
)
from ..read_options import Reading, with_reading
from ..scan_files import check_not_input, scan_of

SEPARATORS = ("/", "\\")  # at the end of a folder's name


@with_reading
def bake(
    context: typer.Context,
    files: SubjectArgument,
    reading: Reading,
    output: Annotated[
        Path,
        typer.Option(
            "--output",
            "-o",
            help="The result: .ply, the points with the attributes ao (the share of the sky that each sees) and "
            "irradiance_r, _g, _b (the light that arrives, where normals point); or .bake, the light for --bake.",
        ),
    ],
    colors: Annotated[
        bool,
        typer.Option("--colors", help="Give a .ply colours that hold the light: its own, or white, times it, exposed."),
    ] = False,
    noise: BakeNoiseOption = 0.03,
    links: LinksOption = 48,
    patches: PatchesOption = None,
    albedo_scale: AlbedoScaleOption = 1.0,
    seed: SeedOption = 0,
    threads: ThreadsOption = None,
    cluster: ClusterOption = None,
    workers: WorkersOption = None,
    up: UpOption = AUTO,
    surface: SurfaceOption = None,
    samples: SamplesOption = 4,
    radius_scale: RadiusScaleOption = 1.0,
    smooth: SmoothOption = AUTO,
    scatter: ScatterOption = Scatter["auto"],
    scatter_size: ScatterSizeOption = 1.0,
    normals: NormalsOption = Normals["auto"],
    light: LightOption = None,
    fill: FillOption = None,
    material: MaterialOption = Look["own"],
    color: ColorOption = None,
    ground: GroundOption = False,
    color_by: ColorByOption = None,
    force: Annotated[bool, typer.Option("--force", help="The result may be the input itself: overwrite it.")] = False,
) -> None:
    """Bake light into a scan or a scene: all that arrives at each point, after all bounces.

    Without --light there are a sun that stands still, at the upper left of the view that render finds, and the sky of
    the studio. Light that goes with the camera is not baked.
    """
    from ..bake import BAKING, BakeOutput, bake_scan, bake_scene, check_output, scan_to_bake
    from ..scene_file import WORKERS, DescribedScene, scene_of

    wanted, file = BakeOutput(output, colors), scene_of(files)
    check_output(wanted)
    use_threads(threads)
    if file is None:
        scan = scan_of(files, reading)
        check_not_input(scan.files, output, force)
        baking = scan_to_bake(scan, context.params)
        with working_on(cluster, workers) as client:
            print(bake_scan(*baking, wanted, client))
        return
    check_not_input(files, output, force)
    typed = given(context)
    settings = {name: typed.pop(name) for name in BAKING if name in typed}
    described = DescribedScene(file, typed, ("colors", "force", *WORKERS), pictures=False)
    with working_on(cluster, workers) as client:
        print(bake_scene(described, settings, wanted, client))


@with_reading
def prepare(
    files: PointsArgument,
    reading: Reading,
    output: Annotated[
        str,
        typer.Option(
            "--output",
            "-o",
            metavar="PATH",
            help="The result: .ply; .pointray: the model, ready; or a folder, .pointray/: the model in parts.",
        ),
    ],
    tolerance: Annotated[
        str | None,
        typer.Option(help="Leave out what the surface can spare: it stays within 0.5 (units), or 0.05% (diagonal)."),
    ] = None,
    count: Annotated[int | None, typer.Option(help="Leave so many points.")] = None,
    drop_duplicates: Annotated[bool, typer.Option("--drop-duplicates", help="Of equal positions keep one.")] = False,
    drop_outliers: Annotated[bool, typer.Option("--drop-outliers", help="Drop what lies far from the rest.")] = False,
    smooth: Annotated[
        str | None,
        typer.Option(
            help="Move noisy points onto the surface: auto: as measured, which --tolerance and --count do anyway; "
            "else the noise's deviation (units)."
        ),
    ] = None,
    normals: NormalsOption = Normals["auto"],
    estimate_normals: Annotated[bool, typer.Option("--estimate-normals", help="The same as --normals fit.")] = False,
    viewpoint: Annotated[
        str | None, typer.Option(help="The scanner, x,y,z: for normals and --drop-strays, in place of the file's.")
    ] = None,
    trajectory: Annotated[
        Path | None,
        typer.Option(help="Of a moving scanner: time,x,y,z, or a cloud with gps_time; normals are turned to it."),
    ] = None,
    levels: Annotated[
        bool, typer.Option("--levels/--no-levels", help="Of a .pointray: levels of detail too, a third more bytes.")
    ] = True,
    scatter: ScatterOption = Scatter["auto"],
    scatter_size: ScatterSizeOption = 1.0,
    part_points: Annotated[
        int | None,
        typer.Option(help="Of a model in parts: the points of a part, rounded down to a power of two [4194304]."),
    ] = None,
    memory: Annotated[
        str | None,
        typer.Option(
            help="Of a model in parts: make it part by part if it does not fit into so much memory of each machine, "
            "like 4GiB; an interrupted run goes on [what is available]."
        ),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="The result may be the input itself: overwrite it.")] = False,
    threads: ThreadsOption = None,
    cluster: ClusterOption = None,
    workers: WorkersOption = None,
) -> None:
    """Make a scan smaller, cleaner, or give it normals; radii are kept as the attribute 'radius', which render uses."""
    from ..prepare import prepare as work

    if estimate_normals and normals == "file":
        raise ValueError("--estimate-normals and --normals file exclude each other")
    estimate_normals = estimate_normals or normals == "fit"
    if viewpoint is not None and not (estimate_normals or reading.drop_strays):
        raise ValueError("--viewpoint is for --estimate-normals, --normals fit or --drop-strays: none is given")
    if trajectory is not None and not estimate_normals:
        raise ValueError("--trajectory is for --estimate-normals or --normals fit, which is not given")
    if trajectory is not None and viewpoint is not None:
        raise ValueError("--viewpoint and --trajectory exclude each other")
    use_threads(threads)
    options = {
        "tolerance": tolerance,
        "count": count,
        "drop_duplicates": drop_duplicates,
        "drop_outliers": drop_outliers,
        "smooth": smooth,
        "normals": normals.value,
        "estimate_normals": estimate_normals,
        "viewpoint": None if viewpoint is None else numbers(viewpoint, "--viewpoint"),
        "trajectory": trajectory,
        "levels": levels,
        "scatter": scatter.value,
        "scatter_size": scatter_size,
        "in_parts": output.endswith(SEPARATORS) or part_points is not None or memory is not None,
        "part_points": part_points,
        "memory": None if memory is None else bytes_of(memory),
        "force": force,
        "cluster": cluster,
        "workers": workers,
    }
    print(work(files, reading, Path(output), options))


@with_reading
def info(
    reading: Reading,
    files: PerhapsPointsArgument = None,
    deep: Annotated[
        bool, typer.Option("--deep", help="Look at the neighbours of all points: 10 million take a minute and 7 GB.")
    ] = False,
    json: Annotated[
        bool, typer.Option("--json", help="As JSON: null is what only --deep finds of so many points.")
    ] = False,
    verify: Annotated[
        bool, typer.Option("--verify", help="Of a model in parts: compare the SHA-256 of all files with the index.")
    ] = False,
    system: Annotated[
        bool, typer.Option("--system", help="In place of a scan: this installation, and which kernels it uses.")
    ] = False,
) -> None:
    """What is in a scan or a saved model, and what is missing; of large ones a sample tells the spacing."""
    from ..facts import describe_all
    from ..tables import show_table

    if system:
        if files or deep or verify:
            raise ValueError("--system stands alone, or with --json")
        from ..system import describe_system

        show_table(describe_system(), json)
        return
    if not files:
        raise ValueError("Missing argument 'FILES...'.")
    scan = scan_of(files, reading)
    scan.check()
    if verify:
        scan.verify()
    show_table(describe_all(scan, deep), json)


@with_reading
def convert(
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="IN", help=f"A scan, {SCANS}. {TOGETHER} Or, alone, a saved model, .pointray: its points."
        ),
    ],
    output: Annotated[Path, typer.Argument(metavar="OUT", help="The result, in the format that its extension names.")],
    reading: Reading,
    force: Annotated[bool, typer.Option("--force", help="The result may be an input itself: overwrite it.")] = False,
) -> None:
    """Write a scan in another format, with all that this can hold, and tell what it cannot."""
    from ..convert import convert as work

    print(work(files, reading, output, force))
