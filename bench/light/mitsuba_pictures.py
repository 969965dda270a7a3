"""Write two pictures and their difference in false colours side by side to a file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

FULL = 0.2  # share of the mean of the compared pixels: the difference that has the full colour
LARGER = 3  # magnification of each side
BAR = 24  # pixels: the height of the scale


def write_difference(
    path: Path, theirs: NDArray[np.float64], ours: NDArray[np.float64], compared: NDArray[np.bool_]
) -> None:
    """Write pointray's picture, Mitsuba's, and where that is brighter (red) or darker (blue). Grey is not compared."""
    mean = float(ours[compared].mean())
    share = (theirs - ours).mean(axis=2) / (FULL * mean)
    colors = _colors(share)
    colors[~compared] = 0.35
    shown = [np.clip(picture / (2.5 * mean), 0, 1) ** (1 / 2.2) for picture in (ours, theirs)]
    row = np.concatenate([*shown, colors], axis=1)
    width = row.shape[1]
    scale = np.broadcast_to(_colors(np.linspace(-1, 1, width)), (BAR // LARGER, width, 3))
    pixels = (255 * np.concatenate([row, scale])).astype(np.uint8)
    image = Image.fromarray(pixels).resize(
        (LARGER * pixels.shape[1], LARGER * pixels.shape[0]), Image.Resampling.NEAREST
    )
    words, y = ImageDraw.Draw(image), image.height - BAR + 6
    words.text((6, y), f"Mitsuba - pointray: -{FULL:.0%} of the mean", "white")
    words.text((image.width // 2 - 4, y), "0", "black")
    words.text((image.width - 40, y), f"+{FULL:.0%}", "white")
    path.parent.mkdir(parents=True, exist_ok=True)
    image.save(path)


def _colors(share: NDArray[np.float64]) -> NDArray[np.float64]:
    """Blue at -1, white at 0, red at 1."""
    pale = 1.0 - np.minimum(np.abs(share), 1.0)
    return np.stack([np.where(share > 0, 1.0, pale), pale, np.where(share < 0, 1.0, pale)], axis=-1)
