"""Files of Gaussian splats for other viewers: the splats of a model, with or without baked light."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..baking.baked import Baked, bake
from ..base.arguments import Vector, check_callback, check_path, wrong, wrong_type
from ..base.atomic_write import check_writable, replacing, unsupported_extension
from ..base.progress import StageProgress, in_stage
from ..base.warning_log import warn
from ..cloud.conversion import PointsLike, check_points
from ..cloud.points import Points
from ..image.exposure import auto_tone, white_under
from ..image.tone import linear_to_srgb, srgb_to_linear, tone
from ..io.exchange.convert import is_path
from ..io.formats._source import Writer
from ..io.formats.splats import _spz_write, gaussians, splat
from ..io.formats.splats._flat import counted, has_scales, lost_of_model, valid_rows
from ..io.opening import named
from ..model.model import Model
from ..model.scan_inputs import is_saved
from ..model.splat_points import splat_points
from ..rendering.picture import render
from ..rendering.settings import Settings
from ..scene.scene import Scene
from ..shade.environment import EnvironmentLight
from ..shade.lights import Light
from . import STUDIO
from .default_scene import model_of, own_material
from .first_view import Scan, ViewChoice
from .framing import Lens
from .studio import CLAY, studio

WRITERS: dict[str, Writer] = {".ply": gaussians.write, ".spz": _spz_write.write, ".splat": splat.write}
METERED = Lens(size=(320, 240))  # of the picture that decides the exposure


class WrittenSplats(NamedTuple):
    """What a file of Gaussian splats contains.

    splats : their number
    lost : what the file cannot store, in words
    """

    splats: int
    lost: list[str]


class LitColors(NamedTuple):
    """Colours of points that contain baked light.

    colors : (n, 3) uint8, sRGB
    exposure, curve : in stops, and the name of the tone curve
    """

    colors: NDArray[np.uint8]
    exposure: float
    curve: str


def write_splats(
    path: str | os.PathLike[str],
    subject: Model | PointsLike,
    *,
    light: str | Sequence[Light | EnvironmentLight] | None = None,
    progress: StageProgress | None = None,
) -> None:
    """Write a file of Gaussian splats that shows a model in other viewers as pointray does.

    Each point becomes a flat Gaussian in the plane of its disc, scaled so that the surface is closed. Points that lie
    on no surface become spheres. Axes are not changed; many viewers take y as up.

    Parameters
    ----------
    path : str or path
        The extension selects the layout: .ply (that of INRIA's training, without harmonics above degree 0), .spz or
        .splat. An existing file is replaced once the new one is complete.
    subject : Model, the path of a saved one, or what `as_points` accepts
        A `Model` is built of points, unless they have the attribute `scale`: splats that were read from a file keep
        their positions, scales, rotations, opacities and colours.
    light : "studio" or sequence of lights, optional
        Light that is baked into the colours: "studio" as in `studio`, fixed for the automatic view, or lights as in
        `Scene.lights`. The exposure is that of a picture of the automatic view. None: the points' own colours.
    progress : callable, optional
        Called as `progress(stage, share)` with the name of the stage and its completed share, 0 to 1.

    Raises
    ------
    TypeError
        If an argument has the wrong type.
    OSError
        If the file cannot be written.
    ValueError
        If the extension is unsupported, the model cannot be built, coordinates are too large for the format, or light
        is to be baked into a model in parts.

    Warns
    -----
    UserWarning
        Names what the format cannot store. Positions are relative to `Points.origin` if that is not 0.

    Examples
    --------
    >>> model = pr.Model(pr.procedural("sphere", 1000))
    >>> pr.write_splats("sphere.spz", model)
    >>> splats = pr.read("sphere.spz")
    >>> len(splats), splats.attributes["scale"].shape
    (1000, (1000, 3))
    """
    file, lights = check_path(path), check_lights(light)
    check_callback(progress)
    check_splats_path(file)
    for lost in write_subject(file, _subject_of(subject), lights, progress).lost:
        warn(f"{file}: {lost}", stacklevel=2)


def _subject_of(subject: Any) -> Points | Model:
    if isinstance(subject, Model):
        return subject
    if is_path(subject) and is_saved(Path(subject)):
        return Model.load(subject)
    return check_points(subject, "subject")


def check_splats_path(file: Path) -> None:
    """Raise ValueError if the extension of a file stands for no layout of splats, OSError if it cannot be written."""
    if file.suffix.lower() not in WRITERS:
        raise unsupported_extension(file, WRITERS)
    check_writable(file)


def check_lights(light: Any) -> Any:
    """Check the parameter `light` of `write_splats`; return "studio", a list of lights, or None."""
    if light is None or (isinstance(light, str) and light == STUDIO):
        return light
    wanted = '"studio", a sequence of lights, or None'
    if isinstance(light, str):
        raise wrong("light", wanted, light)
    if not isinstance(light, Sequence) or not all(isinstance(one, Light | EnvironmentLight) for one in light):
        raise wrong_type("light", wanted, light)
    if not light:
        raise ValueError("light must contain at least one light")
    if any(getattr(one, "camera", False) for one in light):
        raise ValueError("light that moves with the camera cannot be baked")
    return list(light)


def write_subject(file: Path, subject: Points | Model, lights: Any, progress: StageProgress | None) -> WrittenSplats:
    """Write points or a model as Gaussian splats, with baked light; return what the file contains.

    lights : as `check_lights` returns them
    """
    if isinstance(subject, Points) and lights is None and has_scales(subject):
        return write_points(file, subject, progress)
    model = model_of(subject, "subject", progress)
    colors = None
    if lights is not None:
        model.check_whole()
        scan, scene = Scan(model, ViewChoice()), Scene()
        number = scene.add(model, material=own_material(model.points))
        scene.lights = studio(scan.up, float(round(scan.natural_outlook.azimuth))) if lights == STUDIO else lights
        colors = lit_colors(scene, bake(scene, progress=progress), number, scan.up).colors
    return write_model(file, model, colors, progress)


def write_model(
    file: Path, model: Model, colors: NDArray[np.uint8] | None, progress: StageProgress | None
) -> WrittenSplats:
    """Write a model as Gaussian splats; return what the file contains.

    colors : (n, 3) sRGB of all points of the model; None: their own
    """
    points = splat_points(model, colors, in_stage(progress, "splats"))
    count, lost = write_points(file, points, progress)
    missing = len(model.points) - len(points)
    left_out = [f"leaves out {counted(missing, 'point')} without a splat"] if missing else []
    return WrittenSplats(count, [*left_out, *lost_of_model(model.points), *lost])


def write_points(file: Path, points: Points, progress: StageProgress | None) -> WrittenSplats:
    """Write points that are splats already; return what the file contains."""
    with replacing(file) as stream, named(str(file)):
        lost = WRITERS[file.suffix.lower()](stream, points, in_stage(progress, "writing"))
    return WrittenSplats(int(valid_rows(points).sum()), lost)


def lit_colors(scene: Scene, baked: Baked, number: int, up: Vector) -> LitColors:
    """Return the colours of a model's points in baked light, with the exposure of a picture of the automatic view.

    Points of unknown irradiance keep their colours.

    scene : shows the light afterwards; baked : its light; number : of the model's instance; up : direction of the view
    """
    model = scene.shapes[number]
    assert isinstance(model, Model)
    scene.baked = baked
    image = render(scene, Scan(model, ViewChoice(up)).camera(METERED), Settings("baked"))
    exposure, curve = auto_tone(image, white_under(scene.lights, "baked"))
    irradiance = baked.irradiance(number)
    own = np.broadcast_to(np.array(CLAY, np.float32), irradiance.shape)
    if model.points.colors is not None:
        own = srgb_to_linear(model.points.colors)
    shown, known = np.array(own), np.isfinite(irradiance).all(axis=1)
    shown[known] = tone(own[known] * irradiance[known] / np.float32(np.pi), exposure, curve)
    return LitColors(np.rint(255 * linear_to_srgb(shown)).astype(np.uint8), exposure, curve)
