"""Colour maps by matplotlib's names: a dozen are included, the others need matplotlib.

The tables in `colormaps.npz` are matplotlib's, see `tests/helpers/matplotlib_maps.py`: viridis, magma, inferno, plasma
and twilight are CC0; cividis (Nuñez, Anderton and Renslow 2018), turbo (Mikhailov 2019), coolwarm (Moreland 2009),
terrain and gray follow its licence, tab10 and tab20 are Tableau's. RdBu includes color specifications and designs
developed by Cynthia Brewer (https://colorbrewer.org).
"""

from __future__ import annotations

from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.arrays import Doubles
from ..base.choices import COLORMAPS

TABLES = Path(__file__).with_name("colormaps.npz")
REVERSED = "_r"
MOST_CLASSES = 64  # maps with fewer colours are maps of classes


@cache
def colormap(name: str) -> NDArray[np.uint8]:
    """Return a colour map, (n, 3) uint8 sRGB from the lowest to the highest value; ValueError if the name is unknown.

    The suffix "_r" reverses a map, as in matplotlib.
    """
    plain = name.removesuffix(REVERSED)
    if plain not in COLORMAPS:
        return _of_matplotlib(name)
    with np.load(TABLES) as tables:
        colors: NDArray[np.uint8] = tables[plain]
    return colors if name == plain else colors[::-1]


def shows_classes(name: str) -> bool:
    """Return whether a colour map is one for classes, such as "tab10": it has fewer than 64 colours."""
    return len(colormap(name)) < MOST_CLASSES


def _of_matplotlib(name: str) -> NDArray[np.uint8]:
    try:
        known: Any = import_module("matplotlib").colormaps
        more = "or any other map of matplotlib"
    except ImportError:
        known, more = {}, "or with matplotlib (pip install 'pointray[plot]') any of its maps"
    if name not in known:
        raise ValueError(f"unknown colormap {name!r}: expected {', '.join(COLORMAPS)}, {more}; add _r to reverse")
    colors: Doubles = known[name](np.arange(known[name].N))
    return np.rint(255 * colors[:, :3]).astype(np.uint8)
