"""The material and colour of a scan, from the options --material, --color and --color-by."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from .options import color_of, numbers

HEIGHT = "height"  # a value of --color-by: the coordinate along --up


class ScanMaterial:
    """The material and colour of a scan. A wrong option raises ValueError at once.

    Parameters
    ----------
    material : {"own", "clay", "phong", "metal", "glass"}
    color : str or None
        Linear r,g,b.
    color_by : str or None
        What the colour shows, as for `color_of`.
    neutral : bool
        Whether points without a colour are grey instead of clay, unless that is their material.
    """

    def __init__(
        self, material: str, color: str | None = None, color_by: str | None = None, neutral: bool = False
    ) -> None:
        if color is not None and color_by is not None:
            raise ValueError("--color and --color-by exclude each other")
        if material == "glass" and (color is not None or color_by is not None):
            raise ValueError("--material glass has no colour")
        self._kind, self._neutral = material, neutral
        self.attribute = None if color_by is None else color_of(color_by)
        self._color = None if color is None else numbers(color, "--color")
        if self._color is not None and not all(0 <= part <= 1 for part in self._color):
            raise ValueError(f"--color must be linear r,g,b from 0 to 1, not {color}")

    @property
    def one_color(self) -> tuple[float, float, float] | None:
        """The linear colour that it gives to all points; None: they may have their own."""
        from ..auto_view.studio import CLAY

        clay = self._kind == "clay" and self._color is None and self.attribute is None
        return CLAY if clay else self._color

    def build(self, points: Any, up: Any) -> Any:
        """The material for points, clay or grey if nothing gives them a colour.

        up : (3,) tuple; None if it is not known yet, in which case it will be an axis
        """
        from ..auto_view.studio import CLAY, NEUTRAL
        from ..scene.paints import check_attribute
        from ..shade.materials.diffuse import Diffuse
        from ..shade.materials.phong import Phong
        from ..shade.materials.principled import Principled
        from ..shade.materials.specular import Dielectric

        color: Any = self._color
        if self.attribute is not None:
            color = self.attribute
            if color.name == HEIGHT and HEIGHT not in points.attributes:
                color = replace(color, name=_axis_of(up or (0.0, 0.0, 1.0)))
            check_attribute(points, color)
        elif color is None and (points.colors is None or self._kind == "clay"):
            color = NEUTRAL if self._neutral and self._kind != "clay" else CLAY
        made: dict[str, Any] = {
            "own": lambda: Diffuse(color),
            "clay": lambda: Diffuse(color),
            "phong": lambda: Phong(color),
            "metal": lambda: Principled(color, 0.35, 1.0),
            "glass": Dielectric,
        }
        return made[self._kind]()


def _axis_of(up: tuple[float, float, float]) -> str:
    """The name of the coordinate that increases upwards."""
    axes = sorted(map(abs, up))
    if axes[:2] != [0, 0] or max(up) <= 0:
        raise ValueError(f"--color-by {HEIGHT} is for --up along x, y or z, not {up}: name the coordinate")
    return "xyz"[up.index(max(up))]
