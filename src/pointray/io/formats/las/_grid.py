"""Integer coordinates to be written to LAS files."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....base.arrays import Flags
from ....cloud.geographic import in_file
from ....cloud.georeference import RESIDUAL, numbers_of
from ....cloud.points import Points
from .._losses import Losses
from .._source import CHUNK

DEGREE = 1e-6  # step in degrees per step in metres: fine enough that nothing is lost by rounding

Rows = slice | NDArray[np.integer[Any]]


class Grid:
    """Scale and offset of the integer coordinates to be written: those of the original file, or as fine as float32.

    Attributes
    ----------
    scale, offset : (3,) tuple of float
        coordinate = offset + scale * integer.
    """

    def __init__(self, points: Points, losses: Losses) -> None:
        self._residual: NDArray[Any] | None = None
        self._shift = np.zeros(3, np.int64)
        self._georeference = points.georeference
        if not self._fits(points):
            if points.georeference.scale is not None:
                losses.append(
                    f"rounds its coordinates: too large for 32 bits at steps of {min(points.georeference.scale):g}"
                )
            self._residual, self._shift = None, np.zeros(3, np.int64)
            size = max(float(np.abs(points.bounds - points.origin).max()), 1e-30)
            step = float(f"1e{int(np.floor(np.log10(size * 2.0**-24)))}")  # float32 is not finer there
            across = step if points.georeference.projection is None else step * DEGREE
            offset = in_file(points.georeference, points.origin[None])[0].tolist()
            self._georeference = replace(points.georeference, scale=(across, across, step), offset=tuple(offset))
        self.scale = self._georeference.scale
        self.offset = tuple((np.array(self._georeference.offset) + self._shift * np.array(self.scale)).tolist())

    def _fits(self, points: Points) -> bool:
        """Whether 32-bit integers with the file's original scale hold all coordinates.

        If necessary, the offset is moved by whole steps.
        """
        if self._georeference.scale is None:
            return False
        residual = points.attributes.get(RESIDUAL)
        if residual is not None and residual.shape == (len(points), 3) and residual.dtype.kind == "i":
            self._residual = residual
        with np.errstate(over="ignore"):
            bounds = in_file(self._georeference, points.bounds)
            farthest = np.abs((bounds - np.array(self._georeference.offset)) / np.array(self._georeference.scale)).max()
        if farthest < 2.0**31 - 2**12:  # float32 may be off by 128 steps there
            return True
        if not farthest < 2.0**52:
            return False
        finite = points.finite
        parts = [slice(start, start + CHUNK) for start in range(0, len(points), CHUNK)]
        limits = [_limits(self._whole(points, part)[finite[part]]) for part in parts if finite[part].any()]
        low, high = np.min([low for low, _ in limits], axis=0), np.max([high for _, high in limits], axis=0)
        if low.min() < -(2**31) or high.max() >= 2**31:
            self._shift = (low + high + 1) // 2
        return bool((high - low < 2**32).all())

    def _whole(self, points: Points, part: Rows) -> NDArray[np.int64]:
        numbers = numbers_of(self._georeference, in_file(self._georeference, points.positions[part] + points.origin))
        if self._residual is not None:
            numbers += self._residual[part]
        return numbers

    def numbers_of(self, points: Points, part: Rows, finite: Flags) -> NDArray[np.int64]:
        """Return the integer coordinates of some rows, (m, 3); 0 where a row is not finite.

        finite : (n,), whether each of all rows has a finite position
        """
        with np.errstate(invalid="ignore"):
            numbers = self._whole(points, part) - self._shift
        numbers[~finite[part]] = 0
        if numbers.min() < -(2**31) or numbers.max() >= 2**31:
            raise ValueError("cannot be written: its coordinates do not fit into 32-bit integers")
        return numbers


def _limits(numbers: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    return numbers.min(axis=0), numbers.max(axis=0)
