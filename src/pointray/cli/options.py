"""The options that several commands share, and functions that parse their texts; a wrong text raises ValueError."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Callable
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from ..base.choices import (
    AUTO,
    BACKFACES,
    EXPOSED,
    FILTERS,
    INTEGRATORS,
    LIGHTS,
    MATERIALS,
    NORMALS,
    PROJECTIONS,
    SCATTER,
    SURFACES,
    VIEWS,
    listed,
)

SUN = 3.0  # irradiance of a sun without a strength

# mypy accepts enumerations with literal members only; these are made from tables.
Surface = StrEnum("Surface", list(SURFACES))  # type: ignore[misc]
Integrator = StrEnum("Integrator", list(INTEGRATORS))  # type: ignore[misc]
Projection = StrEnum("Projection", list(PROJECTIONS))  # type: ignore[misc]
Side = StrEnum("Side", [AUTO, *VIEWS])  # type: ignore[misc]
Look = StrEnum("Look", list(MATERIALS))  # type: ignore[misc]
Normals = StrEnum("Normals", list(NORMALS))  # type: ignore[misc]
Filter = StrEnum("Filter", list(FILTERS))  # type: ignore[misc]
Backfaces = StrEnum("Backfaces", list(BACKFACES))  # type: ignore[misc]
Scatter = StrEnum("Scatter", [AUTO, *SCATTER])  # type: ignore[misc]

SCANS = "a file of points: .ply, .las, .laz, .e57, .pcd, .xyz and more (docs/formats.md)"
TOGETHER = "Several are one cloud; a folder stands for the scans in it."
SubjectArgument = Annotated[
    list[Path],
    typer.Argument(
        help=f"A scan, {SCANS}. {TOGETHER} Or, alone, a model that prepare has saved: .pointray; or a scene: .toml."
    ),
]
_POINTS = typer.Argument(help=f"A scan, {SCANS}. {TOGETHER} Or, alone, a saved model, .pointray: its points.")
PointsArgument = Annotated[list[Path], _POINTS]
PerhapsPointsArgument = Annotated[list[Path] | None, _POINTS]
EyeOption = Annotated[str | None, typer.Option(help="Where the camera is, x,y,z; default: it frames the scan.")]
TargetOption = Annotated[str | None, typer.Option(help="What it looks at, x,y,z; default: the scan's middle.")]
UpOption = Annotated[
    str, typer.Option(help="Which way is up: z, y, -y, ... or x,y,z; auto: where the scan would stand.")
]
ViewOption = Annotated[Side, typer.Option(help="The side that is seen; auto: what shows the scan best.")]
AzimuthOption = Annotated[float | None, typer.Option(help="Degrees around it: 0 the front, 90 the right side.")]
ElevationOption = Annotated[float | None, typer.Option(help="Degrees above the horizon, -90 to 90.")]
ZoomOption = Annotated[float, typer.Option(help="2: half as far away as the camera that sees all.")]
FovOption = Annotated[float, typer.Option(help="Vertical field of view, degrees.")]
SizeOption = Annotated[str, typer.Option(help="Width and height in pixels, like 640x480.")]
SHOWN = "; ".join(INTEGRATORS.values())
IntegratorOption = Annotated[
    Integrator | None,
    typer.Option(
        help=f"What is shown, in this order: {SHOWN}. Default: baked, quickly, for a scan in the studio's light with "
        "colours of its own, or one; else phong."
    ),
]
SppOption = Annotated[int, typer.Option(help="Samples a pixel; 1 with a limit of time or noise: as many as it takes.")]
ProjectionOption = Annotated[Projection, typer.Option(help=f"How rays begin. {listed(PROJECTIONS)}.")]
ApertureOption = Annotated[float, typer.Option(help="Diameter of the lens, in the scan's units; 0: all is sharp.")]
FocusOption = Annotated[float | None, typer.Option(help="How far away it is sharp; default: the target.")]
MaxDepthOption = Annotated[int, typer.Option(help="Scatterings along a path; for phong: mirrors and panes in a row.")]
TimeLimitOption = Annotated[float | None, typer.Option(help="Seconds after which no more samples are begun.")]
NoiseOption = Annotated[float | None, typer.Option(help="Stop at this standard error, as a share of the mean: 0.02.")]
DenoiseOption = Annotated[bool, typer.Option("--denoise/--no-denoise", help="Take out the noise of path and ao.")]
FilterOption = Annotated[Filter, typer.Option(help=f"How a pixel is made of its samples. {listed(FILTERS)}.")]
SeedOption = Annotated[int, typer.Option(help="Seed of random numbers.")]
ThreadsOption = Annotated[int | None, typer.Option(help="Threads; default: POINTRAY_THREADS, else all processors.")]
LevelsOption = Annotated[
    bool, typer.Option("--levels/--no-levels", help="From afar, show levels of detail instead of all points.")
]
SurfaceOption = Annotated[Surface | None, typer.Option(help="Which surface; default: apss.")]
SamplesOption = Annotated[int, typer.Option(min=2, max=64, help="Samples along a ray in a support's diameter.")]
NormalsOption = Annotated[
    Normals,
    typer.Option(help=f"Which normals. {listed(NORMALS)}."),
]
BackfacesOption = Annotated[
    Backfaces | None,
    typer.Option(
        help=f"How phong and baked show back faces. {listed(BACKFACES)}. Default: muted, or same where more than a "
        "quarter of the visible surface are back faces, as in trees."
    ),
]
ContactShadowOption = Annotated[
    bool,
    typer.Option(
        "--contact-shadow/--no-contact-shadow",
        help="Draw the shadow of an object that stands on an invisible ground, in the studio's light.",
    ),
]
ScatterOption = Annotated[
    Scatter,
    typer.Option(
        help=f"How points are drawn that lie on no surface: leaves, wires. {listed(SCATTER)}; "
        "auto: spheres, or as all others if the file has radii."
    ),
]
ScatterSizeOption = Annotated[
    float, typer.Option(help="The radii of these are multiplied by this; 1: 0.35 of the local spacing.")
]
RadiusScaleOption = Annotated[float, typer.Option(help="All radii of the surface are multiplied by this.")]
SmoothOption = Annotated[
    str,
    typer.Option(help="Noise that is smoothed away: auto: as measured; 0: none; else its standard deviation (units)."),
]
BackgroundOption = Annotated[
    str,
    typer.Option(
        help="auto: a soft gradient, as bright whatever the exposure; r,g,b: linear; none: transparent; sky: the light "
        "all around."
    ),
]
LightOption = Annotated[
    list[str] | None,
    typer.Option(
        help="sun:dx,dy,dz (the way it travels) or point:x,y,z, then :strength, with ,camera at the end it goes with "
        "the camera (x to the right, y up, z to the eye); sky:r,g,b or sky:FILE (.hdr, .exr: all around); repeatable. "
        "A fill light from the sky comes with suns and points, see --fill. Or alone: studio, the default, a key light "
        "with shadows and a sky; headlight, a lamp at the camera. The key light stands still where light is baked, at "
        "the upper left of the view that auto finds; else it goes with the camera."
    ),
]
FillOption = Annotated[
    float | None,
    typer.Option(help="The sky's light beside --light sun and point, as a share of a sun's; 0: none. Default: 0.3."),
]
ExposureOption = Annotated[str, typer.Option(help="Stops; auto: medium, dark scans darker, highlights kept.")]
ColorOption = Annotated[str | None, typer.Option(help="One colour for all of the scan: linear r,g,b, 0 to 1.")]
MaterialOption = Annotated[Look, typer.Option(help=f"What the scan is made of. {listed(MATERIALS)}.")]
GroundOption = Annotated[bool, typer.Option("--ground/--no-ground", help="A grey plane under the scan.")]
ColorByOption = Annotated[
    str | None,
    typer.Option(
        help="height, x, y, z or an attribute of the scan (info lists them), then :colormap and :low,high; default: "
        "the points' own colours."
    ),
]
BakeOption = Annotated[
    Path | None,
    typer.Option(
        help="A file of baked light for --integrator baked, which it implies: pointray bake has written it for this "
        "scan or scene, with the same options. Without, baked light is baked first."
    ),
]
BakeNoiseOption = Annotated[float, typer.Option(help="The noise that is aimed at, as a share of the light.")]
LinksOption = Annotated[
    int, typer.Option(help="Rays of each patch that find where its light comes from; more where there is noise.")
]
PatchesOption = Annotated[
    int | None,
    typer.Option(
        help="At most so many points exchange light, the others get theirs from these; default: half of them, at "
        "least 32768, at most 1048576."
    ),
]
AlbedoScaleOption = Annotated[
    float,
    typer.Option(
        help="Factor for the points' colours where light bounces, 0 to 1: colours of photographs hold light already."
    ),
]
CacheOption = Annotated[
    bool,
    typer.Option(
        "--cache/--no-cache",
        help="Keep the model of a scan that was built, and take it the next time: pointray cache tells of them.",
    ),
]
LegendOption = Annotated[bool, typer.Option("--legend/--no-legend", help="Draw what the colors of --color-by mean.")]

FILL = 0.3  # see `auto_view.studio.fill`


def numbers(text: str, name: str) -> tuple[float, float, float]:
    """Parse `x,y,z`; messages call the option `name`."""
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        raise ValueError(f"{name} must be three numbers like 0,-5,1.5, not {text!r}") from None
    if not all(map(math.isfinite, (x, y, z))):
        raise ValueError(f"{name} must be finite, not {text!r}")
    return x, y, z


def up_axis(text: str) -> tuple[float, float, float] | None:
    """Parse `z`, `-y`, ..., or `x,y,z`; None for `auto`."""
    from ..auto_view.first_view import up_of

    try:
        return up_of(numbers(text, "--up") if "," in text else text)
    except ValueError as error:
        raise ValueError(f"--{str(error).removeprefix('--')}") from None


def exposure_of(text: str, integrator: str = "phong") -> float | str:
    """Parse a number of stops, or "auto"; auto is 0 stops if the integrator's pictures show no light."""
    if text == AUTO:
        return AUTO if integrator in EXPOSED else 0.0
    try:
        value = float(text)
    except ValueError:
        raise ValueError(f"--exposure must be a number of stops, or auto, not {text!r}") from None
    if not -100 <= value <= 100:
        raise ValueError(f"--exposure must lie between -100 and 100 stops, not {value}")
    return value


def size_of(text: str) -> tuple[int, int]:
    """Parse `640x480`."""
    try:
        width, height = (int(part) for part in text.lower().split("x"))
    except ValueError:
        raise ValueError(f"--size must be like 640x480, not {text!r}") from None
    return width, height


def background_of(text: str) -> Any:
    """Parse `none`, `sky` or `r,g,b` for `Scene.background`; None for `auto`, which becomes a backdrop later."""
    named = {"none": None, "sky": "environment", AUTO: None}
    return named[text] if text in named else numbers(text, "--background")


def light_of(text: str) -> Callable[[Any], Any]:
    """Parse `sun:dx,dy,dz` (direction of travel), `point:x,y,z`, `sky:r,g,b` or `sky:FILE`.

    A sun and a point may end in `:strength`, `,camera`, or both in this order; with `,camera` the
    light moves with the camera.

    Returns a function that makes the light, given the scan's middle. A point light without a strength is as bright
    there as a sun.
    """
    import pointray as pr

    kind, _, rest = text.partition(":")
    if kind == "sky":
        sky = _sky_of(rest)
        return lambda middle: sky
    rest, suffix, _ = rest.partition(",camera")
    camera = bool(suffix)
    vector, _, strength = rest.partition(":")
    if kind not in LIGHTS:
        known = "sun:1,1,-2, point:0,-3,4:20, sky:1,1,1 or sky:FILE, or studio or headlight"
        raise ValueError(f"--light must be like {known}, not {text!r}")
    if camera and not text.endswith(",camera"):
        raise ValueError(f"--light: ,camera comes at the end, not as in {text!r}")
    at = numbers(vector, "--light")
    try:
        power = float(strength) if strength else None
    except ValueError:
        raise ValueError(f"--light: {strength!r} is no strength") from None
    if kind == "sun":
        sun = pr.SunLight(at, SUN if power is None else power, camera=camera)
        sun.record()  # raises what is wrong
        return lambda middle: sun
    pr.PointLight(at, power or 1.0).record()
    if camera and power is None:
        raise ValueError(f"--light: a point light that goes with the camera needs a strength, not {text!r}")
    return lambda middle: pr.PointLight(at, SUN * math.dist(at, middle) ** 2 if power is None else power, camera)


def _sky_of(text: str) -> Any:
    """An environment light of one radiance, or of a picture."""
    import pointray as pr

    if text.lower().endswith((".hdr", ".exr")):
        return pr.EnvironmentLight(image=Path(text))
    return pr.EnvironmentLight(numbers(text, "--light sky"))


def color_of(text: str) -> Any:
    """Parse `NAME`, `NAME:colormap` or `NAME:colormap:low,high` into an `Attribute`."""
    import pointray as pr

    name, _, rest = text.partition(":")
    colormap, _, limits = rest.partition(":")
    if not name:
        raise ValueError(f"--color-by must be like z, z:terrain or z:terrain:0,250, not {text!r}")
    try:
        low_high = tuple(float(x) for x in limits.split(",")) if limits else None
    except ValueError:
        raise ValueError(f"--color-by: {limits!r} is no range like 0,250") from None
    return pr.Attribute(name, colormap or "viridis", low_high)  # type: ignore[arg-type]  # Attribute checks the length


def settings_of(integrator: Integrator, filter: Filter, *, threads: int | None, **others: Any) -> Any:
    """Settings of a picture; raises ValueError if one is wrong, or if the denoiser is needed and not installed."""
    from ..image.denoise import check_denoise
    from ..rendering.settings import Settings

    settings = Settings(integrator.value, filter=filter.value, threads=use_threads(threads), **others)
    if settings.denoised:
        check_denoise()
    return settings


def given(context: typer.Context) -> dict[str, Any]:
    """The options that the user has typed, even with values equal to the defaults."""
    values = {}
    for name, value in context.params.items():
        source = context.get_parameter_source(name)
        if source is not None and source.name == "COMMANDLINE":
            values[name] = value
    return values


def use_threads(threads: int | None) -> int:
    """Set the number of threads for all stages; returns it."""
    from ..engine.jit import thread_count

    count = thread_count(threads)
    os.environ["POINTRAY_THREADS"] = str(count)
    return count


def bytes_of(text: str) -> int:
    """Parse `4GiB`, `500MB` or `2000000`: a number of bytes."""
    match = re.fullmatch(r"\s*([0-9]+(?:\.[0-9]+)?)\s*(?:([kmgt])(i?)b?)?\s*", text, re.IGNORECASE)
    if match is None:
        raise ValueError(f"--memory must be a size like 4GiB or 500MB, not {text!r}")
    number, unit, binary = match.groups()
    return int(float(number) * (1024 if binary else 1000) ** (" kmgt".index(unit.lower()) if unit else 0))
