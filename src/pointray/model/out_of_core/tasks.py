"""Tasks for one part: columns of earlier stages -> new columns, and a few facts.

These are module-level functions with small arguments, so that they can be sent to workers; columns are reopened.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...cloud.denoising.noise import NoiseRanges
from ...cloud.statistics import CloudStatistics
from ...surface.splats.build import check_size
from ...surface.splats.support import Support
from ...surface.tree.settings import TreeSettings
from .local import Local
from .stages import KNOWN, MERGED, NOISE, NORMALS, PLACED, PLANES, THICK, Cloud, examine, fit, merge, place, support
from .work import Facts, Work

RADII, BORDERS, SHEETS = "radii", "borders", "sheets"  # columns


class Measure(NamedTuple):
    """Options for finding the surface of a part.

    sigma : standard deviation of the noise, or "auto"
    ranges : noise of all parts; None: given by sigma
    statistics : of the whole cloud, for fits to points without normals; None: points have normals
    """

    sigma: str | float
    ranges: NoiseRanges | None
    statistics: CloudStatistics | None


class Supporting(NamedTuple):
    """Options for finding supports. radii : the column of given radii, or None"""

    radii: str | None
    settings: TreeSettings

    def find(self, cloud: Cloud, local: Local, statistics: CloudStatistics) -> Support:
        """Return the supports of some points."""
        given = None if self.radii is None else np.asarray(local.read(cloud.columns[self.radii]), np.float32)
        return support(cloud, local, given, self.settings, statistics)


def move_layers(work: Work, cloud: Cloud, statistics: CloudStatistics, part: int) -> None:
    """Move second layers onto one surface."""
    local = work.local(part)
    local.write(work.columns[MERGED], merge(cloud, local, statistics))


def measure_noise(work: Work, cloud: Cloud, part: int) -> Facts:
    """Measure the noise of the ranges of a part, see `NoiseRanges`."""
    found = examine(cloud, work.local(part))
    return {name: values.tolist() for name, values in found._asdict().items()}


def find_surface(work: Work, cloud: Cloud, measure: Measure, part: int) -> Facts:
    """Write the surface positions, normals and noise of a part."""
    local = work.local(part)
    sigma, ranges, statistics = measure
    found = place(cloud, local, sigma, ranges) if statistics is None else fit(cloud, local, sigma, ranges, statistics)
    named = {PLACED: found.positions, NORMALS: found.normals, NOISE: found.noise, KNOWN: found.known}
    planes = dict(zip(PLANES, found.planes or (), strict=False))
    local.write_all(work.columns, {**named, **planes, THICK: found.thick})
    facts: Facts = {"is_noisy": found.noise is not None, "has_planes": found.planes is not None}
    if found.thick is not None:
        own = found.positions[local.own]
        facts |= {"thick": int(found.thick[local.own].sum()), "low": own.min(axis=0).tolist()}
        facts |= {"high": own.max(axis=0).tolist()}
    return {**facts, "mended": list(found.repaired)}


def find_supports(work: Work, cloud: Cloud, supporting: Supporting, statistics: CloudStatistics, part: int) -> Facts:
    """Write the supports of a part."""
    local = work.local(part)
    found = supporting.find(cloud, local, statistics)
    check_size(found.radii)
    local.write_all(work.columns, {RADII: found.radii, BORDERS: found.borders, SHEETS: found.sheets})
    return {
        "borders": found.borders is not None,
        "sheets": found.sheets is not None and bool(found.sheets[local.own].any()),
        "lone": int(found.isolated[local.own].sum()),
        "tight": found.tight,
    }
