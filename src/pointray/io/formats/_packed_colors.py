"""Colours packed in a number, as PCL keeps them: fields of PCD files, properties of PLY files."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..colors import GREY

NAMES = ("rgb", "rgba")
NO_COLOR = 0x7FC00000  # bits of the NaN that PCL and Open3D write; of other NaNs the bits are colours of alpha 255


def find_packed(dtypes: Iterable[tuple[str, np.dtype[Any]]]) -> str:
    """The name of the column of packed colours, in capitals or not: 4 bytes a point; empty if there is none."""
    known = {name.lower(): name for name, dtype in dtypes if dtype.itemsize == 4}
    return next((known[name] for name in NAMES if name in known), "")


class PackedColors:
    """Unpacks the colours of a file. Points without a colour become grey.

    Attributes
    ----------
    missing : int
        Points without a colour.
    """

    def __init__(self) -> None:
        self.missing = 0

    @property
    def note(self) -> str:
        """The note about points without a colour; empty without such points."""
        return f"{self.missing:,} points have no colour (NaN): they are grey" if self.missing else ""

    def unpack(self, packed: NDArray[Any]) -> NDArray[np.uint8]:
        """(m, 3) uint8 of packed colours: bits 0xAARRGGBB, as a whole number or as the bits of a float32.

        Some programs write the whole number as a float: as bits these would be colours with alphas of 63 to 79.

        packed : (m,) whole numbers, float32, or float64 if they were read from a text
        """
        none = np.zeros(len(packed), np.bool_)
        if packed.dtype.kind == "f":
            numbers = (packed >= 1) & (packed < 2**32)
            with np.errstate(over="ignore"):
                bits = packed.astype(np.float32).view(np.uint32)
            none = bits == NO_COLOR if packed.dtype.itemsize == 4 else np.isnan(packed)
            bits[numbers] = packed[numbers].astype(np.uint32)
        else:
            bits = packed.astype(np.uint32)
        colors = np.stack([(bits >> shift) & 255 for shift in (16, 8, 0)], axis=1).astype(np.uint8)
        colors[none] = GREY
        self.missing += int(none.sum())
        return colors
