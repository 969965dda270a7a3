"""`draw_legend`: the colour scale of an attribute, drawn onto an image."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from ..base.arguments import check_flag, check_kind
from ..base.arrays import Doubles
from ..shade.attributes import Attribute, category_colors, category_name
from ..shade.colormaps import colormap, shows_classes
from .tone import srgb_to_linear

PANEL, INK = (255, 255, 255, 205), (25, 25, 25, 255)  # background and text colours
LETTERS, SMALLEST = 40, 10.0  # image height in letters, and minimum letter height in pixels
BAR = 0.45  # height of the bar, relative to the image
MOST_TICKS = 9
LEAST_ROW = 8.0  # minimum height of a category, pixels; the rest is summarized as "and n more"
NO_FIELD = ()  # colour of an entry without a swatch


def draw_legend(image: NDArray[Any], attribute: Attribute, beside: bool = False) -> NDArray[Any]:
    """Draw the legend of an attribute at the right edge of a copy of an image.

    The legend is a colour bar with ticks at round numbers or, for categories and maps of classes, a swatch for each.

    Parameters
    ----------
    image : (h, w, 3) or (h, w, 4) float32 or uint8
        float32: linear and premultiplied, as returned by `render`; uint8: sRGB.
    attribute : Attribute
        With a range or categories, see `Scene.shown_attributes`; its name is the title.
    beside : bool
        Append a white strip for the legend at the right, which widens the image, instead of covering it.

    Returns
    -------
    (h, w, 3) or (h, w, 4) float32 or uint8
        Image of the same dtype and channels. Exposure and curve of `write_image` also change a legend drawn on a linear
        image; a legend drawn by `write_image(path, image, legend=attribute)` is not changed.

    Raises
    ------
    TypeError
        If an argument has the wrong type.
    ValueError
        If the attribute has neither range nor categories, or the array is not an image.

    Examples
    --------
    >>> image = np.ones((240, 320, 3), np.float32)
    >>> wide = pr.draw_legend(image, pr.Attribute("z", range=(0, 10)), beside=True)
    >>> wide.shape[0], wide.shape[1] > 320
    (240, True)
    """
    check_legend(attribute, "attribute")
    beside = check_flag(beside, "beside")
    try:
        array = np.asarray(image)
    except (TypeError, ValueError):
        raise ValueError("image must be a regular array of numbers") from None
    if array.ndim != 3 or array.shape[2] not in (3, 4) or array.dtype not in (np.uint8, np.float32) or not array.size:
        raise ValueError(
            f"image must have the shape (h, w, 3) or (h, w, 4) and be uint8 or float32, not {array.shape} {array.dtype}"
        )
    if beside:
        array = _widened(array, attribute)
    layer = _layer(array.shape[1], array.shape[0], attribute)
    left, top, right, bottom = layer.getbbox() or (0, 0, 0, 0)
    over, part = layer.crop((left, top, right, bottom)), np.s_[top:bottom, left:right]
    out = array.copy()
    if array.dtype == np.uint8:
        mode = "RGBA" if array.shape[2] == 4 else "RGB"
        drawn = Image.alpha_composite(Image.fromarray(array[part]).convert("RGBA"), over)
        out[part] = np.asarray(drawn.convert(mode))
        return out
    pixels = np.asarray(over)
    alpha = (pixels[..., 3:] / 255).astype(np.float32)
    light = np.concatenate([srgb_to_linear(pixels[..., :3]) * alpha, alpha], axis=2)
    out[part] = light[..., : array.shape[2]] + array[part] * (1 - alpha)
    return out


def _widened(array: NDArray[Any], attribute: Attribute) -> NDArray[Any]:
    """Append a white strip, in which the attribute's legend fits, at the right of an image, (h, w, 3 or 4)."""
    height, width = array.shape[:2]
    left, _, right, _ = _layer(width, height, attribute).getbbox() or (0, 0, 0, 0)
    strip = right - left + round(max(height / LETTERS, SMALLEST))
    out = np.full((height, width + strip, array.shape[2]), 255 if array.dtype == np.uint8 else 1, array.dtype)
    out[:, :width] = array
    return out


def check_legend(attribute: Any, name: str) -> None:
    """Raise ValueError if an attribute has neither a range nor categories, which a legend shows, or is no Attribute.

    name : of the parameter, for messages
    """
    checked = check_kind(attribute, name, Attribute, "an Attribute")
    if checked.range is None and not checked.values:
        raise ValueError(f"{name}: a legend needs an attribute with a range, such as those of Scene.shown_attributes")


def ticks(low: float, high: float, most: int = MOST_TICKS) -> Doubles:
    """Return at most `most` round numbers from low to high for the ticks of a colour bar.

    They are multiples of 1, 2 or 5 times a power of ten.
    """
    power = 10.0 ** math.floor(math.log10((high - low) / most))
    for step in (1, 2, 5, 10, 20):
        first, last = math.ceil(low / (step * power) - 1e-9), math.floor(high / (step * power) + 1e-9)
        if last - first < most:
            break
    return np.asarray(np.arange(first, last + 1) * step * power, np.float64)


def labels(values: Doubles) -> list[str]:
    """Format round numbers for the ticks of a colour bar, all with the same number of decimals, as many as needed."""
    largest = np.abs(values).max() if len(values) else 0.0
    if largest >= 1e7 or 0 < largest < 1e-3:
        return [f"{x:.6g}" for x in values]
    for decimals in range(9):
        texts = [f"{x + 0.0:.{decimals}f}" for x in values]
        if np.allclose([float(t) for t in texts], values, rtol=0, atol=1e-9 * largest):
            break
    return texts


@dataclass(frozen=True)
class _Entry:
    """Line of a legend: a tick of the colour bar, or a category.

    text : the label; y : distance from the top of the bar or swatches, pixels
    color : RGB, 0 to 255, of a category's swatch; None for a tick; NO_FIELD, an empty tuple, for a line of text alone
    """

    text: str
    y: float
    color: tuple[int, ...] | None = None


def _entries(attribute: Attribute, size: float, height: float) -> tuple[list[_Entry], float]:
    """Return (lines of an attribute's legend, height of its colour bar or of all swatches in pixels).

    size : height of letters; height : of the image, both in pixels
    """
    if attribute.values:
        kinds, colors = attribute.values[::-1], category_colors(attribute)[::-1]
        step = max(min(1.5 * size, 0.8 * height / len(kinds)), LEAST_ROW)
        fitting = max(int(0.8 * height / step), 2)
        names = [category_name(attribute, value) for value in kinds]
        rows = [_Entry(name, (row + 0.5) * step, tuple(colors[row])) for row, name in enumerate(names)]
        if len(rows) > fitting:
            rows = rows[: fitting - 1]
            rows.append(_Entry(f"and {len(names) - len(rows)} more", (len(rows) + 0.5) * step, NO_FIELD))
        return rows, step * len(rows)
    assert attribute.range is not None
    low, high = attribute.range
    table = colormap(attribute.colormap)
    if shows_classes(attribute.colormap):
        first, last = round(low), round(high)
        classes = range(min(last, first + len(table) - 1), first - 1, -1)
        step = min(1.5 * size, 0.8 * height / len(classes))
        fields = [_Entry(str(k), (row + 0.5) * step, tuple(table[k - first])) for row, k in enumerate(classes)]
        return fields, step * len(classes)
    length = BAR * height
    values = ticks(low, high, max(2, min(MOST_TICKS, int(length / (1.8 * size)))))
    heights = (high - values) / (high - low) * length
    return [_Entry(text, y) for text, y in zip(labels(values), heights, strict=True)], length


def _layer(width: int, height: int, attribute: Attribute) -> Image.Image:
    """Draw the legend of an attribute at the right of a transparent image of this size, in pixels."""
    size = max(height / LETTERS, SMALLEST)
    entries, length = _entries(attribute, size, height)
    fields = bool(attribute.values) or shows_classes(attribute.colormap)
    rows = length / len(entries) if fields else 1.5 * size
    font, title = _font(min(size, 0.85 * rows)), _fitting(attribute.name, size, 0.8 * width)
    over = Image.new("RGBA", (width, height))
    draw = ImageDraw.Draw(over)
    broad = max([draw.textlength(e.text, font) for e in entries], default=0.0)
    bar, gap = round(size), size / 2
    inner = max(bar + gap + broad, draw.textlength(attribute.name, title))
    right, top = width - size, (height - length) / 2 + size
    left = right - inner
    box = (left - gap, top - 2.1 * size, right + gap, top + length + 0.8 * size)
    draw.rounded_rectangle(box, gap, PANEL)
    draw.text((left, top - 0.8 * size), attribute.name, INK, title, anchor="ls")
    corner = round(left), round(top)
    if not fields:
        strip = Image.fromarray(np.ascontiguousarray(colormap(attribute.colormap)[::-1, None]))
        over.paste(strip.resize((bar, round(length)), Image.Resampling.BILINEAR), corner)
        draw.rectangle((corner[0], corner[1], corner[0] + bar, corner[1] + round(length)), outline=INK)
    for entry in entries:
        y = top + entry.y
        if entry.color:
            half = 0.4 * rows
            draw.rectangle((corner[0], y - half, corner[0] + bar, y + half), (*map(int, entry.color), 255), INK)
        elif entry.color is None:
            draw.line((corner[0] + bar, y, corner[0] + bar + gap / 2, y), INK)
        draw.text((corner[0] + bar + gap, y), entry.text, INK, font, anchor="lm")
    return over


def _font(size: float) -> Any:
    return ImageFont.load_default(max(size, 1.0))


def _fitting(text: str, size: float, width: float) -> Any:
    """Return a font of letter height `size`, or smaller if a text would else be wider than `width` pixels."""
    return _font(size * min(1.0, width / max(_font(size).getlength(text), 1.0)))
