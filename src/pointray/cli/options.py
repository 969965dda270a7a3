"""Arguments of several commands, and parsers of option values, which raise ValueError if a value is invalid."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import typer

from ..base.choices import AUTO, EXPOSED, LIGHTS

SUN = 3.0  # irradiance of a sun without a strength
FILL = 0.3  # see `auto_view.studio.fill`

SCANS = (
    "Scan: .ply, .las, .laz, .e57, .pcd, .xyz and more (manual: File formats). Several files are read as one point "
    "cloud; a folder stands for the scans in it. URLs work too: https://, s3://, gs:// (manual: Remote files)."
)
SUBJECT = f"{SCANS} Or a single saved model (.pointray) or scene file (.toml)."
POINTS = f"{SCANS} Or a single saved model (.pointray), for its points."

Vector = tuple[float, float, float]


def location(text: str) -> Any:
    """Parse an input of a command: a Path, or a `RemoteFile` for a URL; ValueError if the URL is invalid."""
    from ..io.remote.remote_file import location_of

    return location_of(text)


def numbers(text: str, name: str) -> Vector:
    """Parse `x,y,z` into three finite floats; raise ValueError if it is invalid. name : the option, for messages"""
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        raise ValueError(f"{name} must be three numbers like 0,-5,1.5, not {text!r}") from None
    if not all(map(math.isfinite, (x, y, z))):
        raise ValueError(f"{name} must be finite, not {text!r}")
    return x, y, z


def linear_rgb(text: str, name: str) -> Vector:
    """Parse `r,g,b`, linear and each from 0 to 1; raise ValueError if it is invalid. name : the option, for messages"""
    color = numbers(text, name)
    if not all(0 <= part <= 1 for part in color):
        raise ValueError(f"{name} must be linear r,g,b from 0 to 1, not {text}")
    return color


def up_axis(text: str, name: str = "--up") -> Vector | None:
    """Parse the value of --up into a vector: `z`, `-y`, ..., or `x,y,z`; return None for `auto`."""
    if text == AUTO:
        return None
    from ..auto_view.first_view import up_of

    try:
        return up_of(numbers(text, name) if "," in text else text)
    except ValueError as error:
        raise ValueError(f"--{str(error).removeprefix('--')}") from None


def positive(value: float, name: str) -> float:
    """Return the value of an option, a positive finite number. name : the option, for the error if it is invalid"""
    from ..base.arguments import check_positive

    return check_positive(value, name)


def smooth_of(text: str, name: str = "--smooth") -> str | float:
    """Parse the value of --smooth: "auto", or the standard deviation of the noise, 0 or more."""
    if text == AUTO:
        return text
    from ..cloud.denoising.smooth import check_sigma

    try:
        return check_sigma(float(text), name)
    except ValueError:
        raise ValueError(f"{name} must be auto or a finite number from 0, not {text!r}") from None


def exposure_of(text: str, integrator: str = "phong") -> float | str:
    """Parse the value of --exposure: a number of stops, or "auto", returned as "auto".

    For integrators whose images show no light, such as depth, "auto" becomes 0.0.
    """
    if text == AUTO:
        return AUTO if integrator in EXPOSED else 0.0
    try:
        value = float(text)
    except ValueError:
        raise ValueError(f"--exposure must be a number of stops or auto, not {text!r}") from None
    if not -100 <= value <= 100:
        raise ValueError(f"--exposure must lie between -100 and 100 stops, not {value}")
    return value


def size_of(text: str, name: str = "--size") -> tuple[int, int]:
    """Parse `640x480` into (width, height) in pixels; ValueError if it is invalid. name : the option, for messages"""
    try:
        width, height = (int(part) for part in text.lower().split("x"))
    except ValueError:
        raise ValueError(f"{name} must be like 640x480, not {text!r}") from None
    return width, height


def background_of(text: str) -> Any:
    """Parse the value of --background for `Scene.background`.

    `none` and `auto` become None, `sky` becomes "environment", and `r,g,b` a tuple. With `auto` images get a gradient
    behind the scan when they are written; the scene has no background.
    """
    named = {"none": None, "sky": "environment", AUTO: None}
    return named[text] if text in named else numbers(text, "--background")


def light_of(text: str) -> Callable[[Any], Any]:
    """Parse a value of --light: `sun:dx,dy,dz` (direction of travel), `point:x,y,z`, `sky:r,g,b` or `sky:FILE`.

    Suns and points may end in `:strength`, `,camera`, or both in this order; with `,camera` the light moves with the
    camera.

    Return a function that takes the middle of the scan, (3,), and returns the light: a point light without a strength
    is there as bright as a sun.
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
        known = "sun:1,1,-2, point:0,-3,4:20, sky:1,1,1, sky:FILE, studio or headlight"
        raise ValueError(f"--light must be like {known}, not {text!r}")
    if camera and not text.endswith(",camera"):
        raise ValueError(f"--light: expected ,camera at the end, got {text!r}")
    at = numbers(vector, "--light")
    try:
        power = float(strength) if strength else None
    except ValueError:
        raise ValueError(f"--light: invalid strength {strength!r}, expected a number") from None
    if kind == "sun":
        sun = pr.SunLight(at, SUN if power is None else power, camera=camera)
        sun.record()  # checks the values
        return lambda middle: sun
    pr.PointLight(at, power or 1.0).record()
    if camera and power is None:
        raise ValueError(f"--light: a point light that moves with the camera needs a strength, got {text!r}")
    return lambda middle: pr.PointLight(at, SUN * math.dist(at, middle) ** 2 if power is None else power, camera)


def _sky_of(text: str) -> Any:
    """Return an environment light for the rest of `sky:r,g,b` (constant radiance) or `sky:FILE` (environment map)."""
    import pointray as pr

    if text.lower().endswith((".hdr", ".exr")):
        return pr.EnvironmentLight(image=Path(text))
    return pr.EnvironmentLight(numbers(text, "--light sky"))


def color_of(text: str) -> Any:
    """Parse the value of --color-by, `NAME`, `NAME:colormap` or `NAME:colormap:low,high`, into an `Attribute`.

    NAME : attribute of the points or coordinate whose values are shown; low, high : values at the ends of the colormap
    """
    import pointray as pr

    name, _, rest = text.partition(":")
    colormap, _, limits = rest.partition(":")
    if not name:
        raise ValueError(f"--color-by must be like z, z:terrain or z:terrain:0,250, not {text!r}")
    try:
        low_high = tuple(float(x) for x in limits.split(",")) if limits else None
    except ValueError:
        raise ValueError(f"--color-by: invalid range {limits!r}, expected two numbers like 0,250") from None
    return pr.Attribute(name, colormap or "viridis", low_high)  # type: ignore[arg-type]  # Attribute checks the length


def settings_of(threads: int | None = None, **others: Any) -> Any:
    """Return `Settings` of images, and use the same number of threads for all other work of this process.

    Raise ValueError if a value is invalid, or if a denoiser is needed but not installed.

    threads : value of --threads; None: POINTRAY_THREADS, or all cores; others : fields of `Settings`
    """
    from ..image.denoise import check_denoise
    from ..rendering.settings import Settings

    settings = Settings(threads=use_threads(threads), **others)
    if settings.denoised:
        check_denoise()
    return settings


def given(context: typer.Context) -> dict[str, Any]:
    """Return the options that the user typed, by parameter name, even those typed with their default values."""
    values = {}
    for name, value in context.params.items():
        source = context.get_parameter_source(name)
        if source is not None and source.name == "COMMANDLINE":
            values[name] = value
    return values


def use_threads(threads: int | None) -> int:
    """Set the number of threads for all work of this process, by the variable POINTRAY_THREADS, and return it.

    threads : None means that this variable stays as it is, or all cores if it is not set
    """
    from ..engine.jit import thread_count

    count = thread_count(threads)
    os.environ["POINTRAY_THREADS"] = str(count)
    return count


def bytes_of(text: str) -> int:
    """Parse `4GiB`, `500MB` or `2000000` as a number of bytes."""
    match = re.fullmatch(r"\s*([0-9]+(?:\.[0-9]+)?)\s*(?:([kmgt])(i?)b?)?\s*", text, re.IGNORECASE)
    if match is None:
        raise ValueError(f"--memory must be a size like 4GiB or 500MB, not {text!r}")
    number, unit, binary = match.groups()
    return int(float(number) * (1024 if binary else 1000) ** (" kmgt".index(unit.lower()) if unit else 0))
