"""Radiance -> pixels -> files.

tone, exposure : tone curves and automatic exposure; screen : conversion to 8 bits by a table, for the viewer
write : images and layers to files; exr, mp4 : two formats; frames : numbered images of a film
denoise : denoising; legend : legends of attributes

Begin with write, then tone. `image.tone` is the function; the file's other names: `from pointray.image.tone import`.
"""

from ..base.choices import CURVES
from .legend import draw_legend
from .tone import filmic, linear_to_srgb, srgb_to_linear, tone
from .write import write_image, write_layers

__all__ = ["CURVES", "draw_legend", "filmic", "linear_to_srgb", "srgb_to_linear", "tone", "write_image", "write_layers"]
