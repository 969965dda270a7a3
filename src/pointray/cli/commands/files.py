"""The commands about the files of scans: `bake`, `prepare`, `info`, and `convert` between formats."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ...base.choices import AUTO
from ...model.scan_inputs import check_not_input
from ..cluster import working_on
from ..declare import INPUT, LIGHT, OUTPUT, QUALITY, single, with_options
from ..options import POINTS, SUBJECT, given, location, use_threads
from ..picture_options import OF_WORKERS, PictureOptions, names_of
from ..read_options import Reading
from ..scan_files import scan_of

LIT = (
    "Result: a scan (.ply, .las, .laz and all others that `convert` writes), with the attributes ao (visible share of "
    "the sky) and irradiance_r, _g, _b (incoming light on the side of the normals); or .bake, for --bake."
)
ALBEDO = "Factor for the points' colours where light bounces, 0 to 1; photographs contain light already."
PATCHES = "Maximum number of points that exchange light; others interpolate. Default: half of them, 32768 to 1048576."
PREPARED = (
    "Result: a scan (.ply, .las and all others that `convert` writes); .pointray: a saved model; or a folder "
    ".pointray/: a model in parts."
)
TOLERANCE = "Drop points while the surface changes by at most this: 0.5 (units), or 0.05% (of the diagonal)."
SMOOTH = (
    "Move noisy points onto the surface. Noise as a standard deviation; auto: as measured, which --tolerance and "
    "--count imply."
)
SPLATS = "Write Gaussian splats to a .ply, in the layout of INRIA's training, instead of points."
BAKED = (
    "Bake this light into the colours of Gaussian splats: studio, sun:dx,dy,dz, point:x,y,z or sky:r,g,b as for "
    "`pointray bake`. Repeatable. Default: colours without light."
)
TRAJECTORY = "Path of a moving scanner, towards which normals are turned: time,x,y,z, or a cloud with gps_time."
PART_POINTS = "Points per part of a model in parts, rounded down to a power of two. Default: 4194304."
MEMORY = (
    "Make a model in parts part by part if it needs more memory than this on a machine, such as 4GiB; an interrupted "
    "run continues. Default: the available memory."
)
CompressedOption = Annotated[bool, single(OUTPUT, None, "Write PCD as binary_compressed.", "--compressed")]
ForceOption = Annotated[bool, single(OUTPUT, None, "Allow the result to overwrite an input.", "--force")]
JsonOption = Annotated[bool, single(OUTPUT, None, "Print JSON.", "--json")]


@with_options("pointray bake scan.ply -o scan.bake", "pointray bake scan.ply -o lit.ply --colors --light sun:1,1,-2")
def bake(
    context: typer.Context,
    files: Annotated[list[Path], typer.Argument(help=SUBJECT, parser=location)],
    reading: Reading,
    options: PictureOptions,
    output: Annotated[Path, single(OUTPUT, "FILE", LIT, "--output", "-o")],
    colors: Annotated[
        bool, single(OUTPUT, None, "Give the scan colours that contain the light: own colour times light.", "--colors")
    ] = False,
    noise: Annotated[float, single(QUALITY, "SHARE", "Target noise relative to the light.")] = 0.03,
    links: Annotated[int, single(QUALITY, "COUNT", "Rays per patch that gather light; noisy patches get more.")] = 48,
    patches: Annotated[int | None, single(QUALITY, "COUNT", PATCHES)] = None,
    albedo_scale: Annotated[float, single(LIGHT, "FACTOR", ALBEDO)] = 1.0,
    force: ForceOption = False,
) -> None:
    """Bake light into a scan or a scene: the light at each point after all bounces.

    Without --light these are the studio's sky and a sun fixed at the upper left of the automatic view. Light that moves
    with the camera cannot be baked.
    """
    from ..bake import BAKING, BakeOutput, bake_scan, bake_scene, check_output, scan_to_bake
    from ..scene_file import DescribedScene, scene_of

    wanted, file = BakeOutput(output, colors), scene_of(files)
    check_output(wanted)
    use_threads(options.threads)
    if file is None:
        scan = scan_of(files, reading)
        check_not_input(scan.files, output, force)
        baking = scan_to_bake(scan, options, {name: context.params[name] for name in BAKING}, wanted)
        with working_on(**options.of(OF_WORKERS)) as client:
            print(bake_scan(*baking, wanted, client))
        return
    check_not_input(files, output, force)
    typed = given(context)
    settings = {name: typed.pop(name) for name in BAKING if name in typed}
    others = ("colors", "force", *names_of(OF_WORKERS))
    described = DescribedScene(file, options.parsed(typed), others, pictures=False)
    with working_on(**options.of(OF_WORKERS)) as client:
        print(bake_scene(described, settings, wanted, client))


@with_options(
    "pointray prepare scan.las -o scan.pointray",
    "pointray prepare scan.ply -o small.ply --count 500000 --drop-outliers",
)
def prepare(
    context: typer.Context,
    files: Annotated[list[Path], typer.Argument(help=POINTS, parser=location)],
    reading: Reading,
    options: PictureOptions,
    output: Annotated[str, single(OUTPUT, "PATH", PREPARED, "--output", "-o")],
    tolerance: Annotated[str | None, single(QUALITY, "LENGTH", TOLERANCE)] = None,
    count: Annotated[int | None, single(QUALITY, "COUNT", "Keep this many points.")] = None,
    drop_duplicates: Annotated[
        bool, single(INPUT, None, "Keep one of several points at the same position.", "--drop-duplicates")
    ] = False,
    drop_outliers: Annotated[
        bool, single(INPUT, None, "Drop points far away from all others.", "--drop-outliers")
    ] = False,
    smooth: Annotated[str | None, single(INPUT, "SIGMA", SMOOTH)] = None,
    estimate_normals: Annotated[bool, single(INPUT, None, "Same as --normals fit.", "--estimate-normals")] = False,
    viewpoint: Annotated[
        str | None,
        single(INPUT, "X,Y,Z", "Scanner position, for normals and --drop-strays, instead of that in the file."),
    ] = None,
    trajectory: Annotated[Path | None, single(INPUT, "FILE", TRAJECTORY)] = None,
    levels: Annotated[
        bool, single(OUTPUT, None, "Add levels of detail to a .pointray, a third more bytes.", "--levels/--no-levels")
    ] = True,
    part_points: Annotated[int | None, single(OUTPUT, "COUNT", PART_POINTS)] = None,
    memory: Annotated[str | None, single(OUTPUT, "BYTES", MEMORY)] = None,
    force: ForceOption = False,
) -> None:
    """Make a scan smaller or cleaner, or give it normals; or save its model.

    The radii of the points that are kept are stored in the attribute radius, which `pointray render` uses.
    """
    from ..prepare import prepare as work

    if estimate_normals and options.normals == "file":
        raise ValueError("--estimate-normals and --normals file exclude each other")
    use_threads(options.threads)
    taken = {name: getattr(options, name) for name in ("normals", "scatter", "scatter_size", *names_of(OF_WORKERS))}
    print(work(files, reading, output, {**context.params, **taken}))


@with_options("pointray info scan.las", "pointray info scan.ply --deep --json")
def info(
    reading: Reading,
    files: Annotated[list[Path] | None, typer.Argument(help=POINTS, parser=location)] = None,
    deep: Annotated[
        bool, single(QUALITY, None, "Search the neighbours of all points: 1 minute and 7 GB for 10 million.", "--deep")
    ] = False,
    json: Annotated[
        bool, single(OUTPUT, None, "Print JSON; null: needs --deep for this many points.", "--json")
    ] = False,
    verify: Annotated[
        bool, single(INPUT, None, "Compare the SHA-256 of all files of a model in parts with its index.", "--verify")
    ] = False,
    system: Annotated[
        bool, single(OUTPUT, None, "Describe this installation and its kernels instead of a scan.", "--system")
    ] = False,
) -> None:
    """Describe a scan or a saved model, and what is missing or wrong.

    The spacing of large scans is measured on a sample.
    """
    from ..facts import describe_all
    from ..tables import show_table

    if system:
        if files or deep or verify:
            raise ValueError("--system can only be combined with --json")
        from ..system import describe_system, show_system

        facts = describe_system()
        show_table(facts, json) if json else show_system(facts)
        return
    if not files:
        raise ValueError("Missing argument 'FILES...'.")
    scan = scan_of(files, reading)
    scan.check()
    if verify:
        scan.verify()
    show_table(describe_all(scan, deep), json)


@with_options("pointray convert a.e57 b.e57 both.laz --every 2", "pointray convert scan.laz scan.spz --light studio")
def convert(
    files: Annotated[list[Path], typer.Argument(metavar="IN", help=POINTS, parser=location)],
    output: Annotated[Path, typer.Argument(metavar="OUT", help="Result, in the format of its extension.")],
    reading: Reading,
    splats: Annotated[bool, single(OUTPUT, None, SPLATS, "--splats")] = False,
    light: Annotated[list[str] | None, single(LIGHT, "LIGHT", BAKED)] = None,
    up: Annotated[str, single(LIGHT, "AXIS", "Up direction for --light; auto: found from the shape.")] = AUTO,
    compressed: CompressedOption = False,
    force: ForceOption = False,
) -> None:
    """Write a scan in another format; the command prints what that format cannot store.

    .spz, .splat, and .ply with --splats, contain a flat Gaussian splat for each point, for viewers of splats.
    """
    from ..convert import SplatOptions, convert as work

    print(work(files, reading, output, force, SplatOptions(splats, light, up), compressed))
