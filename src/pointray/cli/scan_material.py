"""The material and colour of a scan, from the options --material, --color and --color-by."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from .options import Vector, color_of

HEIGHT = "height"  # value of --color-by: the coordinate along --up


class ScanMaterial:
    """The material and colour of a scan, from options. Raises ValueError if options are invalid.

    Parameters
    ----------
    material : {"own", "clay", "phong", "metal", "glass"}
        Value of --material; "own" is diffuse in the points' colours.
    color : (3,) tuple or None
        Value of --color: linear RGB of all points.
    color_by : str or None
        Value of --color-by: an attribute, optionally with colormap and range, as in "z:terrain:0,250".
    neutral : bool
        Whether points without colours are neutral grey; otherwise, and for the material "clay", they have the colour of
        clay.

    Attributes
    ----------
    attribute : Attribute or None
        Attribute that colours the points.
    """

    def __init__(
        self, material: str, color: Vector | None = None, color_by: str | None = None, neutral: bool = False
    ) -> None:
        if color is not None and color_by is not None:
            raise ValueError("--color and --color-by exclude each other")
        if material == "glass" and (color is not None or color_by is not None):
            raise ValueError("--material glass cannot be coloured")
        self._kind, self._neutral = material, neutral
        self.attribute = None if color_by is None else color_of(color_by)
        self._color = color

    @property
    def one_color(self) -> Vector | None:
        """Linear RGB of all points if options give them one colour; None if they may differ."""
        from ..auto_view.studio import CLAY

        clay = self._kind == "clay" and self._color is None and self.attribute is None
        return CLAY if clay else self._color

    def build(self, points: Any, up: Any) -> Any:
        """Return the material for points; those without any colour get the colour of clay or neutral grey.

        up : (3,) up direction, along which points are coloured by height; None: not yet known, z is assumed
        """
        from ..auto_view.studio import CLAY, NEUTRAL
        from ..base.spelling import did_you_mean
        from ..scene.paints import check_attribute
        from ..shade.attributes import COORDINATES
        from ..shade.materials.diffuse import Diffuse
        from ..shade.materials.phong import Phong
        from ..shade.materials.principled import Principled
        from ..shade.materials.specular import Dielectric

        color: Any = self._color
        if self.attribute is not None:
            color = self.attribute
            if color.name == HEIGHT and HEIGHT not in points.attributes:
                color = replace(color, name=_axis_of(up or (0.0, 0.0, 1.0)))
            try:
                check_attribute(points, color)
            except ValueError as error:
                names = (*points.attributes, *COORDINATES, HEIGHT)
                raise ValueError(f"{error}{did_you_mean(color.name, names)}") from None
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


def _axis_of(up: Vector) -> str:
    """Return the coordinate that is the height, "x", "y" or "z"; raise ValueError if none increases along `up`."""
    axes = sorted(map(abs, up))
    if axes[:2] != [0, 0] or max(up) <= 0:
        raise ValueError(f"--color-by {HEIGHT} requires --up along x, y or z, got {up}: use --color-by x, y or z")
    return "xyz"[up.index(max(up))]
