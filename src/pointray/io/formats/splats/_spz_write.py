"""Writer of SPZ, version 2: gzip, coordinates of 24 bits, quaternions of three bytes.

More programs read version 2 than its successors. Its quaternions are precise here, because w is never small: splats
that were read are described by other axes where it is (`with_large_w`).
"""

from __future__ import annotations

import gzip
import math
import struct
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....base.arrays import Floats
from ....base.progress import Progress, part_of
from ....cloud.points import Points
from ._common import HARMONIC
from ._flat import FlatSplats, counted
from ._own_shapes import with_large_w

MAGIC = b"NGSP"
HEADER = struct.Struct("<4sIIBBBBI12x")  # versions before 4 end before the last field
OLD = 16  # bytes of the header before version 4
FINEST = 24  # maximum bits of a fraction
SHADE = 0.15  # factor of the stored coefficient of degree 0
VERSION, LEVEL = 2, 6  # LEVEL : of gzip
LARGEST = 2**23 - 1  # of a coordinate in units of its last bit
LOWEST, STEPS = -10.0, 16  # logarithm of the smallest scale, and steps per unit of logarithm
ROUND = 0.5  # least ratio of the shortest axis to the longest in a splat whose normal is not visible
MANY = 10_000_000  # splats that Niantic's library accepts

Bytes = NDArray[np.uint8]


def write(file: Any, points: Points, progress: Progress | None = None) -> list[str]:
    """Write points to a stream as flat Gaussian splats; return what the format cannot store, in words.

    Raise ValueError if coordinates are too large. The size of the cloud decides the precision of the coordinates.
    """
    splats = FlatSplats(points, part_of(progress, 0.0, 0.4))
    bits, clipped, rounded = _fraction_bits(splats.positions), 0, 0

    def scales(part: slice) -> Bytes:
        nonlocal clipped, rounded
        shapes = with_large_w(*splats.shapes(part))[0]
        stored = _byte((np.log(shapes) - LOWEST) * STEPS)
        resized = _out_of_range(shapes.max(axis=1))
        clipped += int(resized.sum())
        rounded += int((_becomes_round(shapes, stored) & ~resized).sum())
        return stored

    columns: list[Callable[[slice], Bytes]] = [
        lambda part: _fixed(splats.positions[part], bits),
        lambda part: _byte(255 * splats.opacity(part)),
        lambda part: _byte((splats.colors(part) / 255 - 0.5) * (255 * SHADE / HARMONIC) + 127.5),
        scales,
        lambda part: _byte(with_large_w(*splats.shapes(part))[1][:, 1:] * 127.5 + 127.5),
    ]
    with gzip.GzipFile("", "wb", LEVEL, file, mtime=0) as packed:
        packed.write(HEADER.pack(MAGIC, VERSION, splats.count, 0, bits, 0, 0, 0)[:OLD])
        for k, column in enumerate(columns):
            for part in splats.parts(part_of(progress, 0.4 + 0.12 * k, 0.52 + 0.12 * k)):
                packed.write(np.ascontiguousarray(column(part)).data)
    lost = list(splats.lost)
    if clipped:
        lost.append(f"changes the size of {counted(clipped, 'splat')}: SPZ stores widths from 4.5e-5 to 380")
    if rounded:
        lost.append(
            f"makes {counted(rounded, 'small splat')} round: SPZ stores no axis below 4.5e-5; use smaller units"
        )
    if splats.count > MANY:
        lost.append(f"has more than {MANY:,} splats, which some programs refuse")
    return lost


def _fraction_bits(positions: Floats) -> int:
    """Return the largest number of fractional bits with which coordinates fit into 24 bits; ValueError if none do."""
    most = float(max(positions.max(), -positions.min()))
    if most > LARGEST:
        raise ValueError(f"an SPZ file cannot store coordinates above {LARGEST:,}, got {most:g}; use larger units")
    return FINEST if most == 0 else min(math.floor(math.log2(LARGEST / most)), FINEST)


def _fixed(positions: Floats, bits: int) -> Bytes:
    """Convert coordinates, (m, 3), to signed integers of 24 bits, (m, 9) uint8. bits : number of fractional bits"""
    whole = np.clip(np.rint(positions.astype(np.float64) * 2.0**bits), -LARGEST, LARGEST).astype("<i4")
    return whole.view(np.uint8).reshape(-1, 3, 4)[:, :, :3].reshape(-1, 9)


def _out_of_range(scales: Floats) -> NDArray[np.bool_]:
    """Return whether the stored value of a scale differs by more than the rounding."""
    steps = (np.log(scales) - LOWEST) * STEPS
    return (steps < -0.5) | (steps > 255.5)


def _becomes_round(scales: Floats, stored: Bytes) -> NDArray[np.bool_]:
    """Return whether splats lose their flat or elongated shape, because short axes are stored as the smallest one.

    scales, stored : (m, 3), standard deviations and their bytes
    """
    ratio = scales.min(axis=1) / scales.max(axis=1)
    range_stored = np.ptp(stored, axis=1) / STEPS  # logarithm of the ratio
    return (ratio < ROUND) & (range_stored < -np.log(ROUND)) & (stored.min(axis=1) == 0)


def _byte(values: NDArray[Any]) -> Bytes:
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)
