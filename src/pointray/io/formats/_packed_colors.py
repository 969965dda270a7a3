"""Colours packed in one number, as in PCL: fields of PCD files, properties of PLY files."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..colors import GREY

NAMES = ("rgb", "rgba")
NO_COLOR = 0x7FC00000  # bits of the NaN that PCL and Open3D write; other NaNs are colours with alpha 255


def find_packed(dtypes: Iterable[tuple[str, np.dtype[Any]]]) -> str:
    """Return the name of the column with colours packed in one number: "rgb" or "rgba", ignoring case, of 4 bytes.

    Return "" if there is none.

    dtypes : name and dtype of each column
    """
    known = {name.lower(): name for name, dtype in dtypes if dtype.itemsize == 4}
    return next((known[name] for name in NAMES if name in known), "")


class PackedColors:
    """Decoder of the colours of a file that are packed in one number, as in PCL. Points without a colour become grey.

    Attributes
    ----------
    missing : int
        Number of points without a colour.
    """

    def __init__(self) -> None:
        self.missing = 0

    @property
    def note(self) -> str:
        """Message about points without a colour, or empty."""
        return f"{self.missing:,} points without a colour (NaN) are set to grey" if self.missing else ""

    def unpack(self, packed: NDArray[Any]) -> NDArray[np.uint8]:
        """Unpack colours with bits 0xAARRGGBB, given as integers or as the bits of a float32, into (m, 3) uint8.

        Some programs store the integer's value as a float instead. Floats from 1 to 2^32 are taken for such values: as
        bits they would have an alpha of 63 to 79.

        packed : (m,) integers, float32, or float64 if they were read from text
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
