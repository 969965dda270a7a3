"""Radiance -> pixels -> files.

tone, exposure : from light to 8 bits, and how bright; screen : the same by a table, for the viewer
write : pictures and layers as files; exr, mp4 : two formats; frames : a film's numbered pictures
denoise : noise removed; legend : what colours stand for

Begin with write, then tone. `image.tone` is the function; the file's other names: `from pointray.image.tone import`.
"""

from ..base.choices import CURVES
from .legend import draw_legend
from .tone import filmic, linear_to_srgb, srgb_to_linear, tone
from .write import write_image, write_layers

__all__ = ["CURVES", "draw_legend", "filmic", "linear_to_srgb", "srgb_to_linear", "tone", "write_image", "write_layers"]
