"""The options that several commands share, and what their texts mean; ValueError says what is wrong with one."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

SUN = 3.0  # irradiance of a light without a strength

Surface = StrEnum("Surface", ["paper", "imls", "apss", "disc"])
Integrator = StrEnum("Integrator", ["phong", "ao", "path", "normal", "depth", "color", "cost"])
Projection = StrEnum("Projection", ["perspective", "orthographic", "panorama"])
Filter = StrEnum("Filter", ["box", "tent", "gaussian", "blackman-harris"])

SubjectArgument = Annotated[
    Path, typer.Argument(help="A scan: .ply, a model that prepare has saved: .pointray, or a scene: .toml.")
]
EyeOption = Annotated[str | None, typer.Option(help="Where the camera is, x,y,z; default: it frames the scan.")]
TargetOption = Annotated[str | None, typer.Option(help="What it looks at, x,y,z; default: the scan's middle.")]
UpOption = Annotated[str, typer.Option(help="Which way is up, x,y,z.")]
FovOption = Annotated[float, typer.Option(help="Vertical field of view, degrees.")]
SizeOption = Annotated[str, typer.Option(help="Width and height in pixels, like 640x480.")]
IntegratorOption = Annotated[Integrator, typer.Option(help="What is shown.")]
SppOption = Annotated[int, typer.Option(help="Samples a pixel; 1 with a limit of time or noise: as many as it takes.")]
ProjectionOption = Annotated[
    Projection, typer.Option(help="Orthographic: as high at the target; panorama: 360 x 180 degrees.")
]
ApertureOption = Annotated[float, typer.Option(help="Diameter of the lens, in the scan's units; 0: all is sharp.")]
FocusOption = Annotated[float | None, typer.Option(help="How far away it is sharp; default: the target.")]
MaxDepthOption = Annotated[int, typer.Option(help="Scatterings along a path; of phong, mirrors and panes.")]
TimeLimitOption = Annotated[float | None, typer.Option(help="Seconds after which no more samples are begun.")]
NoiseOption = Annotated[float | None, typer.Option(help="Stop at this standard error, as a share of the mean: 0.02.")]
DenoiseOption = Annotated[bool, typer.Option("--denoise/--no-denoise", help="Take out the noise of path and ao.")]
FilterOption = Annotated[Filter, typer.Option(help="How a pixel is made of its samples.")]
SeedOption = Annotated[int, typer.Option(help="Of all that is left to chance.")]
ThreadsOption = Annotated[int | None, typer.Option(help="Threads; default: POINTRAY_THREADS, else all processors.")]
LevelsOption = Annotated[
    bool, typer.Option("--levels/--no-levels", help="From afar, take levels of detail in the place of all points.")
]
SurfaceOption = Annotated[Surface | None, typer.Option(help="Which surface; default: apss.")]
SamplesOption = Annotated[int, typer.Option(min=2, max=64, help="Samples along a ray in a support's diameter.")]
RadiusScaleOption = Annotated[float, typer.Option(help="All radii times this.")]
BackgroundOption = Annotated[str, typer.Option(help="Linear r,g,b, none: transparent, or sky: the light all around.")]
LightOption = Annotated[
    list[str] | None,
    typer.Option(
        help="sun:dx,dy,dz (the way it travels) or point:x,y,z, then :strength; sky:r,g,b or sky:FILE (.hdr, .exr: "
        "all around); repeatable. Default: a headlight."
    ),
]
ExposureOption = Annotated[float, typer.Option(help="Stops.")]
GroundOption = Annotated[bool, typer.Option("--ground/--no-ground", help="A grey plane under the scan.")]
ColorByOption = Annotated[
    str | None,
    typer.Option(
        help="height, x, y, z or an attribute of the scan (info lists them), then :colormap and :low,high; default: "
        "the points' own colours."
    ),
]
LegendOption = Annotated[bool, typer.Option("--legend/--no-legend", help="Draw what the colors of --color-by mean.")]

SKY = "0.85,0.87,0.9"  # the background where none is given


def numbers(text: str, name: str) -> tuple[float, float, float]:
    """`x,y,z`."""
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        raise ValueError(f"{name} must be three numbers like 0,-5,1.5, not {text!r}") from None
    if not all(map(math.isfinite, (x, y, z))):
        raise ValueError(f"{name} must be finite, not {text!r}")
    return x, y, z


def positive(value: float, name: str) -> float:
    """A finite number greater than 0."""
    if not 0 < value < math.inf:
        raise ValueError(f"{name} must be a positive number, not {value}")
    return value


def exposure_of(value: float) -> float:
    """Stops that float32 can hold."""
    if not -100 <= value <= 100:
        raise ValueError(f"--exposure must lie between -100 and 100 stops, not {value}")
    return value


def size_of(text: str) -> tuple[int, int]:
    """`640x480`."""
    try:
        width, height = (int(part) for part in text.lower().split("x"))
    except ValueError:
        raise ValueError(f"--size must be like 640x480, not {text!r}") from None
    return width, height


def background_of(text: str) -> Any:
    """`none`, `sky` or `r,g,b`, as `Scene.background` takes it."""
    named = {"none": None, "sky": "environment"}
    return named[text] if text in named else numbers(text, "--background")


def light_of(text: str) -> Callable[[Any], Any]:
    """`sun:dx,dy,dz` (direction of travel) or `point:x,y,z`, either with a strength behind another colon.

    Or the light from all around: `sky:r,g,b`, `sky:FILE`.

    Returns what makes the light, given the scan's middle: a point light without a strength is there as bright as a sun.
    """
    import pointray as pr

    kind, _, rest = text.partition(":")
    if kind == "sky":
        around = _sky_of(rest)
        return lambda middle: around
    place, _, strength = rest.partition(":")
    if kind not in ("sun", "point"):
        raise ValueError(f"--light must be like sun:1,1,-2, point:0,-3,4:20, sky:1,1,1 or sky:FILE, not {text!r}")
    at = numbers(place, "--light")
    try:
        power = float(strength) if strength else None
    except ValueError:
        raise ValueError(f"--light: {strength!r} is no strength") from None
    if kind == "sun":
        sun = pr.SunLight(at, SUN if power is None else power)
        sun.record()  # raises what is wrong
        return lambda middle: sun
    pr.PointLight(at, power or 1.0).record()
    return lambda middle: pr.PointLight(at, SUN * math.dist(at, middle) ** 2 if power is None else power)


def _sky_of(text: str) -> Any:
    """Light from all around: a radiance, or a picture."""
    import pointray as pr

    if text.lower().endswith((".hdr", ".exr")):
        return pr.EnvironmentLight(image=Path(text))
    return pr.EnvironmentLight(numbers(text, "--light sky"))


def color_of(text: str) -> Any:
    """`NAME`, `NAME:colormap` or `NAME:colormap:low,high` as an `Attribute`."""
    import pointray as pr

    name, _, rest = text.partition(":")
    colormap, _, limits = rest.partition(":")
    if not name:
        raise ValueError(f"--color-by must be like z, z:terrain or z:terrain:0,250, not {text!r}")
    try:
        low_high = tuple(float(x) for x in limits.split(",")) if limits else None
    except ValueError:
        raise ValueError(f"--color-by: {limits!r} is no range like 0,250") from None
    return pr.Attribute(name, colormap or "viridis", low_high)  # type: ignore[arg-type]  # it checks the length


class View:
    """Where the camera is: where the options say, else where the whole scan is seen. Raises what is wrong at once."""

    def __init__(
        self,
        size: str,
        fov: float = 40.0,
        up: str = "0,0,1",
        eye: str | None = None,
        target: str | None = None,
        projection: str = "perspective",
        aperture: float = 0.0,
        focus: float | None = None,
    ) -> None:
        self.up = numbers(up, "--up")
        if not any(self.up):
            raise ValueError("--up must not be zero")
        self.size = size_of(size)
        self.eye = None if eye is None else numbers(eye, "--eye")
        self.target = None if target is None else numbers(target, "--target")
        if focus is not None and not aperture:
            raise ValueError("--focus is for --aperture, which is not given")
        self.lens: dict[str, Any] = {"fov": fov, "projection": projection, "aperture": aperture, "focus": focus}
        near = self.eye or (0.0, 0.0, 0.0)
        self.camera([near, [x + 1 + abs(x) for x in near]])  # some box that the eye is not in the middle of

    @property
    def settings(self) -> dict[str, Any]:
        """What a turntable's frames depend on, as JSON takes it; the size apart."""
        return {"eye": self.eye, "target": self.target, "up": self.up, **self.lens}

    @property
    def framed(self) -> bool:
        """Whether the options leave it to the scan where the camera is."""
        return self.eye is None and self.target is None

    def camera(self, bounds: Any) -> Any:
        """The camera for a box."""
        from ..camera import Camera

        fov, projection = self.lens["fov"], self.lens["projection"]
        framed = Camera.frame(bounds, fov=fov, size=self.size, up=self.up, projection=projection)
        if self.framed:
            return replace(framed, **self.lens)
        target = self.target or [(low + high) / 2 for low, high in zip(*bounds, strict=True)]
        # Without an eye: as far away, and on the same side, as to frame the box.
        eye = self.eye or [e + a - t for e, a, t in zip(framed.eye, target, framed.target, strict=True)]
        return Camera.look_at(eye, target, self.up, size=self.size, **self.lens)

    def turning(self, bounds: Any) -> Any:
        """The camera for a box that turns; where the options say nothing, it stays in the picture all the way.

        Not for a panorama, which is all around the camera: `Way` has refused its turntable, keys do without this one.
        """
        from ..film import frame_turning

        if self.framed and self.lens["projection"] != "panorama":
            framed = frame_turning(bounds, self.lens["fov"], self.size, self.up, self.lens["projection"])
            return replace(framed, aperture=self.lens["aperture"], focus=self.lens["focus"])
        return self.camera(bounds)


def settings_of(integrator: Integrator, filter: Filter, *, threads: int | None, **others: Any) -> Any:
    """How a picture is made; raises what is wrong, also where what takes out noise is not installed."""
    from ..image.denoise import check_denoise
    from ..settings import Settings

    settings = Settings(integrator.value, filter=filter.value, threads=use_threads(threads), **others)
    if settings.denoised:
        check_denoise()
    return settings


def given(context: typer.Context) -> dict[str, Any]:
    """The options that the user has typed: those that are not at their defaults by themselves."""
    values = {}
    for name, value in context.params.items():
        source = context.get_parameter_source(name)
        if source is not None and source.name == "COMMANDLINE":
            values[name] = value
    return values


def use_threads(threads: int | None) -> int:
    """The number of threads, for all stages."""
    from ..jit import thread_count

    count = thread_count(threads)
    os.environ["POINTRAY_THREADS"] = str(count)
    return count
