"""From a file and the options of `render` and `animate` to a scene."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from ..saved import SAVED
from ..splats.radii import radii_in
from .options import background_of, color_of, light_of, positive
from .waiting import Progress, in_background

PLAIN = {"surface": None, "samples": 4, "radius_scale": 1.0}  # of a surface: what the options say by default
HEIGHT = "height"  # of --color-by: the coordinate along --up


def check_scan(file: Path) -> None:
    """Raise what keeps a scan or a saved model from being opened."""
    from ..points.files import check_readable, check_regular

    (check_regular if file.suffix.lower() == SAVED else check_readable)(file)


class Stage:
    """The scan under its lights. Raises what is wrong with an option at once, before the file is read.

    Parameters
    ----------
    surface : dict
        surface, samples and radius_scale, as `Model` takes them.
    place : dict
        The texts of the options light, background and perhaps color, whether there is a ground, and up, a vector.
    """

    def __init__(self, file: Path, surface: dict[str, Any], place: dict[str, Any]) -> None:
        import pointray as pr

        positive(surface["radius_scale"], "--radius-scale")
        self._place = place
        self.file, self._surface, self._ground, self._up = file, surface, place["ground"], place["up"]
        self._lights = [light_of(text) for text in place["light"] or []]
        self._color = color_of(place["color"]) if place.get("color") is not None else None
        self._scene = pr.Scene()
        self._scene.background = background_of(place["background"])

    @property
    def settings(self) -> dict[str, Any]:
        """What the scene depends on, as JSON takes it."""
        facts = self.file.stat()
        scan = {"scan": str(self.file.resolve()), "scan_bytes": facts.st_size, "scan_written": facts.st_mtime_ns}
        return {**scan, **self._surface, **self._place}

    @property
    def is_plain(self) -> bool:
        """Whether the surface is the default one, and not one that the user wants to see."""
        return self._surface == PLAIN

    @property
    def legend(self) -> Any:
        """What the scan is coloured by, with the range that is shown, by the name that was asked for."""
        assert self._color is not None
        return replace(self._scene.shown_attributes[0], name=self._color.name)

    def build(self, progress: Progress) -> tuple[Any, Any]:
        """The scene, and the model in it."""
        model = self._load(progress)
        self._scene.add(model, material=self._material(model.points))
        if self._ground:
            self._scene.add(ground_under(model.bounds, self._up))
        for make in self._lights:
            self._scene.add_light(make(model.bounds.mean(axis=0)))
        return self._scene, model

    def _load(self, progress: Progress) -> Any:
        """The model of the file: a scan's, or a saved one."""
        import pointray as pr

        file = self.file
        progress.show("reading", 0.0)
        if file.suffix.lower() == SAVED:
            if not self.is_plain:
                raise ValueError(f"{file}: --surface, --samples and --radius-scale are part of a saved model")
            return in_background(lambda: pr.Model.load(file))
        points = in_background(lambda: pr.read(file))
        self._material(points)  # raises what is wrong
        radii = radii_in(points)
        try:
            return in_background(lambda: pr.Model(points, radii, **self._surface, progress=progress.show))
        except ValueError as error:
            raise ValueError(f"{file}: {error}") from error

    def _material(self, points: Any) -> Any:
        """What the scan is made of: None for its own colours."""
        from ..paints import check_attribute
        from ..shade.materials import Diffuse

        color = self._color
        if color is None:
            return None
        if color.name == HEIGHT and HEIGHT not in points.attributes:
            color = replace(color, name=_axis_of(self._up))
        check_attribute(points, color)
        return Diffuse(color)


def _axis_of(up: tuple[float, float, float]) -> str:
    """The coordinate that rises upwards."""
    if sorted(up)[:2] != [0, 0]:
        raise ValueError(f"--color-by {HEIGHT} is for --up along x, y or z, not {up}: name the coordinate")
    return "xyz"[up.index(max(up))]


def ground_under(bounds: Any, up: tuple[float, float, float]) -> Any:
    """A plane under a box."""
    from ..instances import Plane

    return Plane([low if u >= 0 else high for u, low, high in zip(up, *bounds, strict=True)], up)
