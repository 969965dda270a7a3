"""pointray bake: the light of a scan or a scene file, as attributes of its points or in a file of its own."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..auto_view import HEADLIGHT
from ..auto_view.first_view import ViewChoice
from ..base.choices import AUTO
from ..cloud.points import Points
from ..image.exposure import auto_tone, white_under
from ..image.tone import linear_to_srgb, srgb_to_linear, tone
from .baked_light import LightSource
from .cluster import wait_for_kernels
from .options import up_axis
from .scan_files import ScanFiles, check_result
from .scan_scene import APPEARANCE, SURFACE, ScanScene
from .scene_file import DescribedScene
from .waiting import Progress, in_background, writing

BAKING = ("noise", "links", "patches", "albedo_scale", "seed", "threads")  # options that are BakeSettings
LIGHT = ".bake"
OCCLUSION, IRRADIANCE = "ao", ("irradiance_r", "irradiance_g", "irradiance_b")  # attributes of the points
WHITE = (1.0, 1.0, 1.0)


class BakeOutput(NamedTuple):
    """What is written.

    Attributes
    ----------
    path : Path
    colors : bool
        Whether the points get colours that hold the light.
    """

    path: Path
    colors: bool = False

    @property
    def is_light(self) -> bool:
        """Whether it is a file of light, not of points."""
        return self.path.suffix.lower() == LIGHT


def check_output(output: BakeOutput) -> None:
    """Raise an error, before any work is done, if the result cannot be written."""
    from ..io.known_formats import written

    if output.colors and output.is_light:
        raise ValueError(f"{output.path}: holds light only; --colors is for {', '.join(written())}")
    check_result(output.path, LIGHT)


def scan_to_bake(scan: ScanFiles, options: dict[str, Any]) -> tuple[ScanScene, LightSource]:
    """The scene of a scan, and how its light is baked, from all options; a wrong one raises ValueError at once."""
    from ..baking.settings import BakeSettings

    plain = {name: getattr(value, "value", value) for name, value in options.items()}
    for text in plain["light"] or []:
        if text.endswith(",camera") or text == HEADLIGHT:
            raise ValueError(f"--light {text}: light that goes with the camera is not baked")
    if plain["colors"] and plain["color_by"] is not None:
        raise ValueError("--colors is for the points' own colours, or --color, not for --color-by")
    source = LightSource(BakeSettings(**{name: plain[name] for name in BAKING}))
    surface = {name: plain[name] for name in SURFACE}
    appearance = {name: plain.get(name) for name in APPEARANCE} | {"background": AUTO}  # which is no option here
    appearance["neutral"] = not BakeOutput(plain["output"]).is_light  # a file of light is for pictures, which have clay
    choice = ViewChoice(up_axis(plain["up"]), azimuth=0.0)  # what is said then names no options of views
    scan_scene = ScanScene(scan, surface, appearance, choice, normals=plain["normals"], baked=source)
    scan.check()
    return scan_scene, source


def bake_scan(scan_scene: ScanScene, source: LightSource, output: BakeOutput, client: Any = None) -> str:
    """Bake a scan's light and write it; returns lines for the user. client : whose workers do; None: this process"""
    with Progress(bakes=True) as progress:
        scene, model, scan = scan_scene.build(progress)
        wait_for_kernels(client)
        baked = in_background(lambda: source.make(scene, progress.show, client))
        if output.is_light:
            told = _write_light(output, baked, len(model.points), progress)
        else:
            number = next(iter(scene.shapes))
            white, points = white_under(scene.lights, "baked"), scan_scene.read or model.points
            told = _write_points(output, baked, number, points, (scan_scene.one_color, white))
    return f"{told}\n{scan.found}" if scan.found else told


def bake_scene(described: DescribedScene, settings: dict[str, Any], output: BakeOutput, client: Any = None) -> str:
    """Bake the light of a scene file and write it; returns a line for the user.

    settings : of `BakeSettings`, those that options give
    client : whose workers do; None: this process
    """
    plan, count = described.plan, described.plan.model_instances
    if not output.is_light and count != 1:
        one = f"{output.path}: holds the points of one instance of a model"
        raise ValueError(f"{one}, the scene has {count:,}: {LIGHT} holds the light of all")
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
        in_background(lambda: baked.save(output.path, lambda share: progress.show("writing", share)))
    ending = f"; {baked.coarser}" if baked.coarser else ""
    return f"{output.path}: the light of {count:,} points, {baked.nbytes / 2**20:.3g} MiB{ending}"


def _write_points(output: BakeOutput, baked: Any, number: int, points: Points, look: tuple[Any, float | None]) -> str:
    """Write the points with the light of an instance. look : color and white, see `lit_colors`"""
    import pointray as pr

    irradiance = baked.irradiance(number)
    attributes = {**points.attributes, OCCLUSION: baked.ambient_occlusion(number)}
    attributes |= dict(zip(IRRADIANCE, irradiance.T, strict=True))
    colors, ending = points.colors, ""
    if output.colors:
        colors, exposure, curve = lit_colors(points, irradiance, *look)
        soft = ", highlights softened" if curve == "soft" else ""
        ending = f", colours in that light, exposure {exposure:g}{soft}"
    lit = points.changed(colors=colors, attributes=attributes)
    with writing(output.path):
        pr.write(output.path, lit)
    return f"{output.path}: {len(points):,} points with {OCCLUSION} and irradiance{ending}"


def lit_colors(
    points: Points, irradiance: NDArray[np.float32], color: Any = None, white: float | None = None
) -> tuple[NDArray[np.uint8], float, str]:
    """The colours of matt points in some light, as a picture would show them, sRGB; exposure, in stops, and curve.

    Points without light keep the colours that they have.

    Parameters
    ----------
    irradiance : (n, 3) float32
        NaN where it is unknown.
    color : (3,) float, linear, optional
        Of all points; None: their own, or white if they have none.
    white : float, optional
        See `auto_exposure`.
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
