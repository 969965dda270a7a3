"""LAS and LAZ files with random values in all dimensions."""

from __future__ import annotations

from pathlib import Path

import laspy
import numpy as np


def write_random(path: Path, version: str, format: int, n: int = 500) -> laspy.LasData:
    """A file of laspy's with random values in all dimensions."""
    random = np.random.default_rng(format)
    header = laspy.LasHeader(version=version, point_format=format)
    header.scales, header.offsets = np.array([0.001, 0.01, 0.5]), np.array([4e5, 5.4e6, -3])
    if path.suffix == ".laz":  # each byte more costs lazrs 10 ms
        header.add_extra_dim(laspy.ExtraBytesParams("e i2", "i2"))
    else:
        header.add_extra_dims(
            [laspy.ExtraBytesParams(f"e {t}", t) for t in ("u1", "i2", "u4", "i8", "f4", "f8", "3f4")]
        )
        header.add_extra_dim(laspy.ExtraBytesParams("scaled", "i4", offsets=[7.0], scales=[0.1]))
        header.add_extra_dim(laspy.ExtraBytesParams("scaled 2", "2u2", offsets=[7.0, 1.0], scales=[0.1, 0.2]))
    las = laspy.LasData(header, laspy.ScaleAwarePointRecord.zeros(n, header=header))
    raw = las.points.array
    for name in raw.dtype.names:
        kind, shape = raw[name].dtype, raw[name].shape
        whole = kind.kind != "f"
        raw[name] = (
            random.integers(0, 2 ** min(8 * kind.itemsize - 1, 20), shape) if whole else random.normal(size=shape)
        )
    las.write(path, do_compress=path.suffix == ".laz")
    return laspy.read(path)
