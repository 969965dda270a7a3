"""`Attribute`: a surface colour taken from values of the points through a colour map."""

from __future__ import annotations

from colorsys import hsv_to_rgb
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.arguments import check_numbers, check_text, wrong
from .colormaps import colormap, shows_classes

COORDINATES = ("x", "y", "z")
DEFAULT_COLORMAP = "viridis"
FIRST_MANY = 11  # number of categories from which tab20 replaces tab10
HUE = 0.618034  # hue step between categories of the same tone: the golden ratio, so that hues do not repeat
TONES = (0.55, 0.95), (0.9, 0.75), (0.4, 0.7), (0.75, 0.5)  # (saturation, value), used in turn
# Classes of LAS files (ASPRS LAS 1.4, table 17), in the colours of QGIS.
ASPRS = {
    0: ("never classified", 0xBABABA),
    1: ("unassigned", 0xAAAAAA),
    2: ("ground", 0xAA5500),
    3: ("low vegetation", 0x00AAAA),
    4: ("medium vegetation", 0x55FF55),
    5: ("high vegetation", 0x00AA00),
    6: ("building", 0xFF5555),
    7: ("low noise", 0xAA0000),
    8: ("model key point", 0x555555),
    9: ("water", 0x55FFFF),
    10: ("rail", 0xAA00AA),
    11: ("road surface", 0x202020),
    12: ("overlap", 0x777777),
    13: ("wire guard", 0xFFFF55),
    14: ("wire conductor", 0xFFFF00),
    15: ("transmission tower", 0x5555FF),
    16: ("wire connector", 0xC8C800),
    17: ("bridge deck", 0xFF9900),
    18: ("high noise", 0xFF0000),
}


@dataclass(frozen=True)
class Attribute:
    """Colour of a material, taken from an attribute of the points through a colour map.

    Values are blended between points with the weights of the surface, then looked up in the map. Maps of classes (fewer
    than 64 colours, such as tab10) and categories are not blended: a hit shows the value of the splat with the greatest
    weight.

    Parameters
    ----------
    name : str
        Attribute of the points. A vector attribute shows its length, "name[0]" its first column. "x", "y" and "z" are
        always the world coordinates.
    colormap : str
        "viridis", "magma", "inferno", "plasma", "cividis", "turbo", "gray", "coolwarm", "RdBu", "terrain",
        "twilight", "tab10" or "tab20", each also reversed ("viridis_r"); with matplotlib installed, any of its maps.
        Categories take evenly spaced colours of the map. With the default "viridis" they take distinct colours (tab10,
        tab20), and those of "classification" the standard colours of LAS files.
    range : (2,) float, optional
        Values of the map's first and last colour; values outside are clamped. None: 2nd and 98th percentile of the
        finite values; the union of these ranges over the models of a scene.
        For a map of classes: first and last class; None: class k shows colour k, and the colours repeat.
    categories : sequence of int, or False, optional
        Values that are categories and never blended; other values show a neutral grey. None: detected if no range is
        given and all values are bools, shown as no and yes, or whole numbers, at most 32 different ones (256 of
        "classification", "point_source_id" and "scan"). False: no categories, values are blended.

    Raises
    ------
    TypeError
        If an argument has the wrong type.
    ValueError
        If the colour map is unknown, the range is invalid, or categories are combined with a coordinate, a range or a
        map of classes.

    Notes
    -----
    NaN values are left out of the blend; where they have most of the weight, a neutral grey (sRGB 128) is shown.
    A detected range is that of the points: the range of a coordinate moves with the instance.

    Examples
    --------
    >>> scene = pr.Scene()
    >>> height = pr.Attribute("z", "terrain", range=(-1, 1))
    >>> scene.add(pr.Model(pr.procedural("sphere", 1000)), material=pr.Diffuse(height))
    0
    """

    name: str
    colormap: str = DEFAULT_COLORMAP
    range: tuple[float, float] | None = None
    categories: ArrayLike | bool | None = None

    def __post_init__(self) -> None:
        for what in ("name", "colormap"):
            object.__setattr__(self, what, check_text(getattr(self, what), what))
        colormap(self.colormap)
        if self.name in COORDINATES and shows_classes(self.colormap):
            raise ValueError(f"{self.colormap} is a map of classes; the coordinate {self.name} has no classes")
        if self.range is not None:
            object.__setattr__(self, "range", _checked_range(self.range))
        if self.categories is not None and self.categories is not False:
            object.__setattr__(self, "categories", _checked_categories(self.categories))
            if self.name in COORDINATES or self.range is not None or shows_classes(self.colormap):
                raise ValueError("categories cannot be combined with a coordinate, a range or a map of classes")

    @property
    def values(self) -> tuple[int, ...]:
        """Categories given on construction, in increasing order; empty if none were given."""
        return self.categories if isinstance(self.categories, tuple) else ()

    @property
    def may_have_categories(self) -> bool:
        """Whether categories are detected from the values, as no categories, range or map of classes were given."""
        plain = self.range is None and self.name not in COORDINATES and not shows_classes(self.colormap)
        return self.categories is None and plain


def category_colors(attribute: Attribute) -> NDArray[np.uint8]:
    """Return the colours of an attribute's categories, (n, 3) uint8 sRGB, in the order of `attribute.values`."""
    values = attribute.values
    if attribute.colormap != DEFAULT_COLORMAP:
        table = colormap(attribute.colormap)
        sampled: NDArray[np.uint8] = table[np.linspace(0, len(table) - 1, len(values)).round().astype(int)]
        return sampled
    classes = is_classification(attribute.name)
    own = [value for value in values if not (classes and value in ASPRS)]
    free = iter(_distinct_colors(len(own)))
    codes = [ASPRS[value][1] if classes and value in ASPRS else None for value in values]
    rows = [next(free) if code is None else (code >> 16, (code >> 8) & 255, code & 255) for code in codes]
    return np.array(rows, np.uint8).reshape(-1, 3)


def _distinct_colors(count: int) -> list[tuple[int, ...]]:
    """Return `count` distinct colours (r, g, b), 0 to 255: those of tab10 or tab20 if enough, else generated ones."""
    table = colormap("tab10" if count < FIRST_MANY else "tab20")
    if count <= len(table):
        return [tuple(color) for color in table[:count].tolist()]
    turns = (divmod(k, len(TONES)) for k in range(count))
    colors = (hsv_to_rgb((k * HUE + tone / len(TONES)) % 1, *TONES[tone]) for k, tone in turns)
    return [tuple(round(255 * part) for part in color) for color in colors]


def category_name(attribute: Attribute, value: int) -> str:
    """Return the label of a category, such as "2 ground" or "yes", for legends and for points clicked in the viewer."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    known = is_classification(attribute.name) and value in ASPRS
    return f"{value} {ASPRS[value][0]}" if known else str(value)


def is_classification(name: str) -> bool:
    """Return whether an attribute is named "classification", as LAS classes are, perhaps with the prefix "scalar_"."""
    return name.lower().removeprefix("scalar_") == "classification"


def _checked_categories(values: Any) -> tuple[int, ...]:
    if isinstance(values, tuple) and values and all(isinstance(value, bool) for value in values):
        return tuple(sorted(set(values)))
    numbers = check_numbers(values, "categories", "whole numbers, or False")
    if values is True or numbers.ndim != 1 or not len(numbers) or not (numbers == np.rint(numbers)).all():
        raise wrong("categories", "whole numbers, or False", values)
    return tuple(sorted({int(value) for value in numbers}))


def _checked_range(pair: tuple[float, float]) -> tuple[float, float]:
    limits = check_numbers(pair, "range", "two numbers")
    if limits.shape != (2,):
        raise wrong("range", "two numbers", pair)
    low, high = map(float, limits)
    if not (np.isfinite([low, high]).all() and low < high):
        raise ValueError(
            f"range must be two finite numbers, the lower first, not {pair!r}; to reverse a map, use viridis_r"
        )
    return low, high
