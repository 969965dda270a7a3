"""pointray bake: writes the light of a scan or a scene file to its points or to a separate file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..auto_view import HEADLIGHT
from ..auto_view.first_view import ViewChoice
from ..base.arrays import Floats
from ..cloud.points import Points
from ..image.exposure import auto_tone, white_under
from ..image.tone import linear_to_srgb, srgb_to_linear, tone
from ..model.scan_inputs import check_result
from .baked_light import LightSource
from .cluster import wait_for_kernels
from .picture_options import PictureOptions
from .scan_files import ScanFiles
from .scan_scene import ScanScene
from .scene_file import DescribedScene
from .waiting import Progress, in_background, writing

BAKING = ("noise", "links", "patches", "albedo_scale", "seed", "threads")  # options that `BakeSettings` has
LIGHT = ".bake"
OCCLUSION, IRRADIANCE = "ao", ("irradiance_r", "irradiance_g", "irradiance_b")  # attributes of the points
WHITE = (1.0, 1.0, 1.0)


class BakeOutput(NamedTuple):
    """The result of the command `bake`: a file of light, or points with their light as attributes.

    Attributes
    ----------
    path : Path
        The extension .bake stands for a file of light.
    colors : bool
        Whether the points get colours that contain the light.
    """

    path: Path
    colors: bool = False

    @property
    def is_light(self) -> bool:
        """Whether the file holds light for the option --bake, instead of points."""
        return self.path.suffix.lower() == LIGHT


def check_output(output: BakeOutput) -> None:
    """Raise an error, before any work is done, if the result of `bake` cannot be written to its path."""
    from ..io.known_formats import written

    if output.colors and output.is_light:
        raise ValueError(f"{output.path}: contains light only; --colors requires {', '.join(written())}")
    check_result(output.path, LIGHT)


def check_bakeable(lights: list[str] | None) -> None:
    """Raise ValueError if a value of --light is a light that moves with the camera."""
    for text in lights or []:
        if text.endswith(",camera") or text == HEADLIGHT:
            raise ValueError(f"--light {text}: light that moves with the camera cannot be baked")


def scan_to_bake(
    scan: ScanFiles, options: PictureOptions, baking: dict[str, Any], output: BakeOutput
) -> tuple[ScanScene, LightSource]:
    """Return the scene of a scan, not yet built, and the source of its light; raise ValueError if an option is invalid.

    baking : keyword arguments of `BakeSettings`
    """
    from ..baking.settings import BakeSettings

    check_bakeable(options.light)
    if output.colors and options.color_by is not None:
        raise ValueError("--colors cannot be combined with --color-by, only with the points' own colours or --color")
    source = LightSource(BakeSettings(**baking))
    choice = ViewChoice(options.up, azimuth=0.0)  # the printed choices are without a view then
    neutral = not output.is_light  # a file of light is for images, in which scans are clay
    scan_scene = ScanScene(scan, options, choice, baked=source, neutral=neutral)
    scan.check()
    return scan_scene, source


def bake_scan(scan_scene: ScanScene, source: LightSource, output: BakeOutput, client: Any = None) -> str:
    """Bake the light of a scan and write it; return the lines that the command prints.

    scan_scene, source : as returned by `scan_to_bake`; client : Dask client whose workers bake; None: this process
    """
    with Progress(bakes=True) as progress:
        scene, model, scan = scan_scene.build(progress)
        wait_for_kernels(client)
        baked = in_background(lambda: source.make(scene, progress.show, client))
        if output.is_light:
            report = _write_light(output, baked, len(model.points), progress)
        else:
            number = next(iter(scene.shapes))
            white, points = white_under(scene.lights, "baked"), scan_scene.read or model.points
            report = _write_points(output, baked, number, points, (scan_scene.one_color, white))
    return f"{report}\n{scan.found}" if scan.found else report


def bake_scene(described: DescribedScene, settings: dict[str, Any], output: BakeOutput, client: Any = None) -> str:
    """Bake the light of a scene file and write it; return the line that the command prints.

    settings : fields of `BakeSettings` to replace, by options that the user typed
    client : Dask client whose workers bake; None: this process
    """
    plan, count = described.plan, described.plan.model_instances
    if not output.is_light and count != 1:
        one = f"{output.path}: can store one instance of a model, the scene has {count:,}"
        raise ValueError(f"{one}; use {LIGHT}, which stores the light of all")
    source = LightSource(replace(plan.bake.settings, **settings))
    with Progress(bakes=True) as progress:
        scene = in_background(lambda: plan.build(progress.show, lit=False)).scene
        wait_for_kernels(client)
        baked = in_background(lambda: source.make(scene, progress.show, client))
        if output.is_light:
            return _write_light(output, baked, sum(len(model.points) for model in scene.models), progress)
        number = next(number for number, shape in scene.shapes.items() if shape is scene.models[0])
        white = white_under(scene.lights, "baked")
        return _write_points(output, baked, number, scene.models[0].points, (None, white))


def _write_light(output: BakeOutput, baked: Any, count: int, progress: Progress) -> str:
    progress.show("writing", 0.0)
    with writing(output.path):
        in_background(lambda: baked.save(output.path, progress.show))
    ending = f"; {baked.coarser}" if baked.coarser else ""
    return f"{output.path}: light of {count:,} points, {baked.nbytes / 2**20:.3g} MiB{ending}"


def _write_points(output: BakeOutput, baked: Any, number: int, points: Points, look: tuple[Any, float | None]) -> str:
    """Write points with ambient occlusion and irradiance as attributes; return the line that the command prints.

    number : the instance whose light is written
    look : linear colour of all points (None: their own) and radiance of a white surface that faces the lights (None:
    unknown), used if the written colours contain the light
    """
    import pointray as pr

    irradiance = baked.irradiance(number)
    attributes = {**points.attributes, OCCLUSION: baked.ambient_occlusion(number)}
    attributes |= dict(zip(IRRADIANCE, irradiance.T, strict=True))
    colors, ending = points.colors, ""
    if output.colors:
        colors, exposure, curve = lit_colors(points, irradiance, *look)
        soft = ", highlights softened" if curve == "soft" else ""
        ending = f", lit colours, exposure {exposure:g}{soft}"
    lit = points.changed(colors=colors, attributes=attributes)
    with writing(output.path):
        pr.write(output.path, lit)
    return f"{output.path}: {len(points):,} points with {OCCLUSION} and irradiance{ending}"


def lit_colors(
    points: Points, irradiance: Floats, color: Any = None, white: float | None = None
) -> tuple[NDArray[np.uint8], float, str]:
    """Return the colours of diffuse points in their baked light, as an image with automatic exposure would show them.

    Points of unknown irradiance keep their colours.

    Parameters
    ----------
    irradiance : (n, 3) float32
        NaN where unknown.
    color : (3,) float, linear, optional
        Colour of all points; None: their own, or white if they have none.
    white : float, optional
        Radiance of a white surface that faces the lights, which keeps dark points dark. None: unknown.

    Returns
    -------
    colors : (n, 3) uint8
        sRGB.
    exposure : float
        In stops.
    curve : str
        Name of the tone curve.
    """
    constant = WHITE if color is None else color
    own = np.broadcast_to(np.array(constant, np.float32), irradiance.shape)
    if color is None and points.colors is not None:
        own = srgb_to_linear(points.colors)
    known = np.isfinite(irradiance).all(axis=1)
    light = own[known] * irradiance[known] / np.float32(np.pi)
    exposure, curve = auto_tone(light[None], white)
    shown = np.array(own)
    shown[known] = tone(light, exposure, curve)
    return np.rint(255 * linear_to_srgb(shown)).astype(np.uint8), exposure, curve
