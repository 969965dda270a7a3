"""From a file and the options of `render` and `animate` to a scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ..arguments import check_positive
from ..choices import AUTO
from ..model_file import SAVED
from ..points.trust import trusted
from ..splats.radii import radii_in
from ..staging.first_view import ViewChoice
from .options import FILL, background_of, color_of, light_of, numbers, settings_of
from .views import View
from .waiting import Progress, in_background

PLAIN = {"surface": None, "samples": 4, "radius_scale": 1.0}  # of a surface: what the options say by default
HEIGHT = "height"  # of --color-by: the coordinate along --up


def check_scan(file: Path) -> None:
    """Raise what keeps a scan or a saved model from being opened."""
    from ..points.files import check_readable, check_regular

    (check_regular if file.suffix.lower() == SAVED else check_readable)(file)


def check_saved(file: Path, is_plain: bool) -> None:
    """Raise if a saved model is asked for another surface or other normals than it has."""
    if file.suffix.lower() == SAVED and not is_plain:
        raise ValueError(f"{file}: --surface, --samples, --radius-scale and --normals are part of a saved model")


SHAPE = ("samples", "radius_scale")
LENS = ("fov", "projection", "aperture", "focus")
FRAMING = ("eye", "target", "view", "azimuth", "elevation", "zoom")
EFFORT = ("spp", "max_depth", "time_limit", "noise", "denoise", "seed", "threads", "levels")
PLACE = ("light", "fill", "background", "ground", "material", "color", "color_by")


def staged(file: Path, options: dict[str, Any], layers: bool = False) -> tuple[View, Any, ScanScene]:
    """How a scan is seen, rendered and lit, by all options of `render` or `animate`. Raises what is wrong at once.

    layers : whether the result is numbers for other programs, not a picture to look at
    """
    from ..staging.studio import with_contact

    check_scan(file)
    plain = {name: getattr(value, "value", value) for name, value in options.items()}
    lens, framing, effort, shape, place = (
        {k: plain[k] for k in names} for names in (LENS, FRAMING, EFFORT, SHAPE, PLACE)
    )
    seen = View(plain["size"], plain["up"], lens, **framing)
    settings = with_contact(settings_of(options["integrator"], options["filter"], **effort))
    surface = {"surface": plain["surface"], **shape}
    return seen, settings, ScanScene(file, surface, place, seen.choice, layers, plain["normals"])


class ScanScene:
    """The scan under its lights. Raises what is wrong with an option at once, before the file is read.

    Parameters
    ----------
    surface : dict
        surface, samples and radius_scale, as `Model` takes them.
    place : dict
        The texts of the options light, background, material and perhaps color and color_by; fill, a number or None;
        whether there is a ground.
    choice : ViewChoice
        How the scan is seen.
    layers : bool
        Whether a background is part of the light, as in layers; in a picture it stands behind.
    normals : str
        Whose: "auto", "file" or "fit".
    """

    def __init__(
        self,
        file: Path,
        surface: dict[str, Any],
        place: dict[str, Any],
        choice: ViewChoice,
        layers: bool = False,
        normals: str = AUTO,
    ) -> None:
        import pointray as pr

        check_positive(surface["radius_scale"], "--radius-scale")
        self.file, self._surface, self._place, self._choice = file, surface, place, choice
        self._normals = normals
        check_saved(file, surface == PLAIN and normals == AUTO)
        self._lights = [light_of(text) for text in place["light"] or []]
        self._fill = fill_of(place["fill"], place["light"])
        self._coat = Coat(place["material"], place.get("color"), place.get("color_by"))
        self._scene = pr.Scene()
        self._background = background_of(place["background"])
        self._scene.background = self._background  # raises what is wrong
        # A colour stands behind the picture, where it is not exposed with the light.
        if not layers and not isinstance(self._background, str):
            self._scene.background = None

    @property
    def settings(self) -> dict[str, Any]:
        """What the scene depends on, as JSON takes it."""
        facts = self.file.stat()
        scan = {"scan": str(self.file.resolve()), "scan_bytes": facts.st_size, "scan_written": facts.st_mtime_ns}
        return {**scan, **self._surface, "normals": self._normals, **self._place, **asdict(self._choice)}

    @property
    def is_plain(self) -> bool:
        """Whether the surface is the default one, and not one that the user wants to see."""
        return self._surface == PLAIN

    @property
    def backdrop(self) -> Any:
        """What stands behind the picture, as `write_image` takes it."""
        from ..image.tone import GRADIENT, linear_to_srgb

        if self._place["background"] == AUTO:
            return GRADIENT
        if not isinstance(self._background, tuple):
            return None
        color = tuple(linear_to_srgb(np.array(self._background)).tolist())
        return color, color

    @property
    def legend(self) -> Any:
        """What the scan is coloured by, with the range that is shown, by the name that was asked for."""
        assert self._coat.attribute is not None
        return replace(self._scene.shown_attributes[0], name=self._coat.attribute.name)

    def build(self, progress: Progress) -> tuple[Any, Any, Any]:
        """The scene, the model in it, and what was found out about it: a `Scan`."""
        from ..staging.first_view import Scan

        model = self._load(progress)
        scan = in_background(lambda: Scan(model, self._choice))
        self._scene.add(model, material=self._coat.material(model.points, scan.up))
        if self._place["ground"]:
            self._scene.add(ground_under(model.bounds, scan.up))
        self._scene.lights = lights_for(self._lights, self._fill, model.bounds.mean(axis=0), scan.up)
        return self._scene, model, scan

    def _load(self, progress: Progress) -> Any:
        """The model of the file: a scan's, or a saved one."""
        import pointray as pr

        from ..rendering.warmup import NORMALS, expect

        file = self.file
        progress.show("reading", 0.0)
        if file.suffix.lower() == SAVED:
            return in_background(lambda: pr.Model.load(file))
        points = in_background(lambda: pr.read(file, partial(progress.show, "reading")))
        if points.normals is None or self._normals == "fit":
            expect(NORMALS)
        self._coat.material(points, self._choice.up)  # raises what is wrong
        radii = radii_in(points)
        progress.show("normals", 0.0)
        try:
            trusty = in_background(lambda: trusted(points, self._normals, progress=partial(progress.show, "normals")))
            return in_background(lambda: pr.Model(trusty, radii, **self._surface, progress=progress.show))
        except ValueError as error:
            raise ValueError(f"{file}: {error}") from error


class Coat:
    """What the scan is made of, and in which colour. Raises what is wrong with the options at once.

    Parameters
    ----------
    material : str
        "own", "clay", "phong", "metal" or "glass".
    color : str or None
        Linear r,g,b.
    color_by : str or None
        What the colour tells.
    """

    def __init__(self, material: str, color: str | None = None, color_by: str | None = None) -> None:
        if color is not None and color_by is not None:
            raise ValueError("--color and --color-by exclude each other")
        if material == "glass" and (color is not None or color_by is not None):
            raise ValueError("--material glass has no colour")
        self._kind = material
        self.attribute = None if color_by is None else color_of(color_by)
        self._color = None if color is None else numbers(color, "--color")
        if self._color is not None and not all(0 <= part <= 1 for part in self._color):
            raise ValueError(f"--color must be linear r,g,b from 0 to 1, not {color}")

    def material(self, points: Any, up: Any) -> Any:
        """The material for points; what they have no colour for is grey. up : None: it will be along an axis"""
        from ..scene.paints import check_attribute
        from ..shade.materials import Dielectric, Diffuse, Phong, Principled
        from ..staging.studio import ALBEDO, CLAY

        color: Any = self._color
        if self.attribute is not None:
            color = self.attribute
            if color.name == HEIGHT and HEIGHT not in points.attributes:
                color = replace(color, name=_axis_of(up or (0.0, 0.0, 1.0)))
            check_attribute(points, color)
        elif color is None and (points.colors is None or self._kind == "clay"):
            color = CLAY if self._kind == "clay" else (ALBEDO, ALBEDO, ALBEDO)
        made: dict[str, Any] = {
            "own": lambda: Diffuse(color),
            "clay": lambda: Diffuse(color),
            "phong": lambda: Phong(color),
            "metal": lambda: Principled(color, 0.35, 1.0),
            "glass": Dielectric,
        }
        return made[self._kind]()


def fill_of(fill: float | None, lights: list[str] | None) -> float:
    """How much light comes from the sky beside lights that are given: none where one of them is a sky."""
    if fill is not None and not 0 <= fill <= 1e6:
        raise ValueError(f"--fill must be a number from 0 on, not {fill}")
    if fill is not None and not lights:
        raise ValueError("--fill is for --light sun or point, which is not given")
    if any(text.startswith("sky") for text in lights or []):
        if fill:
            raise ValueError("--fill is for --light sun or point: there is a sky already")
        return 0.0
    return FILL if fill is None else fill


def lights_for(lights: Sequence[Any], fill: float, middle: Any, up: Any) -> list[Any]:
    """The lights of the options, see `light_of`, around a scan's middle; where there are none, a studio."""
    from ..staging import studio

    if not lights:
        return studio.studio(up)
    return [*(make(middle) for make in lights), *([studio.fill(fill, up)] if fill > 0 else [])]


def _axis_of(up: tuple[float, float, float]) -> str:
    """The coordinate that rises upwards."""
    axes = sorted(map(abs, up))
    if axes[:2] != [0, 0] or max(up) <= 0:
        raise ValueError(f"--color-by {HEIGHT} is for --up along x, y or z, not {up}: name the coordinate")
    return "xyz"[up.index(max(up))]


def ground_under(bounds: Any, up: tuple[float, float, float]) -> Any:
    """A plane under a box."""
    from ..scene.instances import Plane

    return Plane([low if u >= 0 else high for u, low, high in zip(up, *bounds, strict=True)], up)
