"""Attribute: what a surface is coloured by where it is neither one colour nor the points' own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arguments import check_numbers, check_text, wrong
from .colormaps import colormap, shows_classes

COORDINATES = ("x", "y", "z")


@dataclass(frozen=True)
class Attribute:
    """A colour for materials: an attribute of the points, through a colour map.

    Between points the value is blended, with the surface's own weights, and then looked up, so that the map is
    followed. A map of classes (under 64 colours: tab10) shows the class of the splat of most weight instead: between
    classes 2 and 6 there is no 4.

    Parameters
    ----------
    name : str
        An attribute of the points; one with several columns shows its length, "name[0]" its first column. "x", "y",
        "z": the coordinate in the world, whatever attributes there are.
    colormap : str
        "viridis", "magma", "inferno", "plasma", "cividis", "turbo", "gray", "coolwarm", "RdBu", "terrain",
        "twilight", "tab10" or "tab20", each also reversed ("viridis_r"); where matplotlib is installed, any of its.
    range : (2,) float, optional
        Which values have the map's first and last colour; those beyond are shown as these. None: the 2nd and the 98th
        percentile of the finite values, over all models of a scene that share this colour the least and the greatest.
        Of a map of classes the first and the last class; None: class k shows colour k, after the last again the first.

    Notes
    -----
    Values that are NaN do not count in the blend; where they have most of the weight, a neutral grey (sRGB 128) shows.
    A range that is found is that of the points: of a coordinate it moves with the instance.
    """

    name: str
    colormap: str = "viridis"
    range: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        for what in ("name", "colormap"):
            object.__setattr__(self, what, check_text(getattr(self, what), what))
        colormap(self.colormap)
        if self.name in COORDINATES and shows_classes(self.colormap):
            raise ValueError(f"{self.colormap} is a map of classes, and {self.name} is none")
        if self.range is not None:
            object.__setattr__(self, "range", _checked_range(self.range))


def _checked_range(pair: tuple[float, float]) -> tuple[float, float]:
    limits = check_numbers(pair, "range", "two numbers")
    if limits.shape != (2,):
        raise wrong("range", "two numbers", pair)
    low, high = map(float, limits)
    if not (np.isfinite([low, high]).all() and low < high):
        raise ValueError(f"range must be two finite numbers, the lower first, not {pair!r}; viridis_r is reversed")
    return low, high
