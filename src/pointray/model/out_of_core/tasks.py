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
    """Options for finding the surface of a part: how its noise is known, and whether its normals must be fitted.

    sigma : standard deviation of the noise, or "auto"
    ranges : noise measured along the kd order of the whole cloud; None: given by sigma
    statistics : of the whole cloud, for fits to points without normals; None: points have normals
    """

    sigma: str | float
    ranges: NoiseRanges | None
    statistics: CloudStatistics | None


class Supporting(NamedTuple):
    """Options for finding the support radii of points.

    radii : name of the column on disk with given radii; None: chosen from the spacing
    settings : of the implicit surface, which decide whether borders and sheets are searched
    """

    radii: str | None
    settings: TreeSettings

    def find(self, cloud: Cloud, local: Local, statistics: CloudStatistics) -> Support:
        """Return the support radii of a part's points and its margin, with their open borders and close sheets."""
        given = None if self.radii is None else np.asarray(local.read(cloud.columns[self.radii]), np.float32)
        return support(cloud, local, given, self.settings, statistics)


def move_layers(work: Work, cloud: Cloud, statistics: CloudStatistics, part: int) -> None:
    """Move second layers of a part, such as those of misaligned scans, onto one surface.

    The new positions of the part's points are written to the column `MERGED`.

    statistics : of the whole cloud
    """
    local = work.local(part)
    local.write(work.columns[MERGED], merge(cloud, local, statistics))


def measure_noise(work: Work, cloud: Cloud, part: int) -> Facts:
    """Return the noise measured in ranges of a part's points along the kd order.

    Returns
    -------
    dict
        Lists by field of `NoiseRanges`: places (rows in the cloud), middles (positions), noise and spacing.
    """
    found = examine(cloud, work.local(part))
    return {name: values.tolist() for name, values in found._asdict().items()}


def find_surface(work: Work, cloud: Cloud, measure: Measure, part: int) -> Facts:
    """Find the surface at a part's points; write denoised positions, normals and noise to columns on disk.

    measure : how noise is known, and whether normals are fitted

    Returns
    -------
    dict
        is_noisy : whether noise was removed
        has_planes : whether planes were fitted to noisy points, for signs of normals
        mended : numbers of missing normals and of normals of another length
        thick : number of points that may be near two sheets
        low, high : corners of the bounding box
        These three are missing unless normals were fitted without viewpoints (scanner positions).
    """
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
    """Find the support radii, open borders and close sheets of a part's points; write them to columns on disk.

    supporting : given radii, if any, and settings of the surface; statistics : of the whole cloud

    Returns
    -------
    dict
        borders, sheets : whether borders were searched; whether a point has an opposite sheet close by
        lone : number of isolated points
        tight : whether many radii are too small to cover the surface
    """
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
