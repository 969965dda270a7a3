"""Radiance -> pixels: tone and files."""

from ..choices import CURVES
from .legend import draw_legend
from .tone import filmic, linear_to_srgb, srgb_to_linear, tone
from .write import write_image, write_layers

__all__ = ["CURVES", "draw_legend", "filmic", "linear_to_srgb", "srgb_to_linear", "tone", "write_image", "write_layers"]
