"""Stages that compute the surface of a part: positions, normals and supports, equal to those of a whole model.

Each function computes one stage for one part, from columns of earlier stages, including those of other parts. Values
that are common to all parts come from a sample, see `cloud.statistics`, or from all parts, such as the noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ...base.arrays import Doubles, Flags, Floats
from ...base.disk_columns import Columns
from ...cloud.denoising.noise import NoiseRanges, measure_ranges, points_per_range
from ...cloud.denoising.smooth import Fitting, Noise, noise_by, smooth_known
from ...cloud.georeference import Georeference
from ...cloud.kd_ordering import KdOrdering
from ...cloud.neighbors import distinct, take
from ...cloud.normals.estimate import estimate_normals, normalize_normals, seen_from
from ...cloud.normals.jets import measure_noise
from ...cloud.normals.layers import Layers
from ...cloud.normals.orientation import NEAR
from ...cloud.normals.sheets import is_thick
from ...cloud.normals.stations import eyes_of, faced, is_known
from ...cloud.outliers.layers import Part, merge_for_model
from ...cloud.outliers.search import block_size
from ...cloud.points import Points
from ...cloud.sampled_statistics import of_distinct_positions
from ...cloud.statistics import CloudStatistics
from ...surface.splats.support import Support, find_support
from ...surface.tree.settings import TreeSettings
from .local import Local
from .sorted_sets import distinct_numbers

# Columns: of the given cloud, and of the results of each stage.
POSITIONS, GIVEN = "points.positions", "points.normals"
MERGED, UNITS, TURNED, KNOWN = "merged", "units", "turned", "known"
LAYERS = "layers"  # of blocks, see `second_layers.py`
PLACED, NORMALS, FACED, NOISE = "placed", "normals", "faced", "noise"
PLANES = "planes.moved", "planes.normals"
THICK, PARTED = "thick", "parted"  # whether a point may be near two sheets; normals after orienting these


@dataclass(frozen=True)
class Cloud:
    """A cloud on disk, in kd order.

    columns : the columns on disk; total : number of points
    origin : (3,) float64, world position of the coordinates' origin
    georeference : with the positions of the scanner stations, if known
    viewpoint_columns : for each attribute that says from which station a point was scanned, the name of its column on
        disk
    is_seen : whether any point has a known viewpoint (scanner position)
    ignored : numbers of the stations whose positions are not used, as the points contradict them
    """

    columns: Columns
    total: int
    origin: Doubles
    georeference: Georeference
    viewpoint_columns: dict[str, str]
    is_seen: bool
    ignored: tuple[int, ...] = ()

    @property
    def has_units(self) -> bool:
        """Whether the normals from the files have been replaced by normals of unit length with recomputed signs.

        If so they are not normalised again, which would round them again.
        """
        return self.columns.get(TURNED) is not None

    @property
    def normals(self) -> str:
        """Name of the column with the normals of the surface, as the last finished stage has left them."""
        return self.latest(PARTED, self.latest(FACED, NORMALS))

    def points(self, local: Local) -> Points:
        """Return the points of a part and its margin, at their current positions and with their current normals.

        Current are those after moving second layers (duplicates of a surface) and recomputing signs, if that is done.
        """
        columns = self.columns
        positions = local.read(columns[self.latest(MERGED, POSITIONS)])
        normals = local.read(columns[self.latest(TURNED, GIVEN)]) if GIVEN in columns else None
        attributes = {name: local.read(columns[column]) for name, column in self.viewpoint_columns.items()}
        return Points.about(self.origin, positions, normals, None, attributes, self.georeference)

    def latest(self, found: str, given: str) -> str:
        """Return the name of a column: `found` if the stage that writes it is done for all parts, else `given`."""
        return given if self.columns.get(found) is None else found


class Surface(NamedTuple):
    """The surface at n points: where its splats lie and how they face.

    positions, normals : (n, 3) float32, unit normals
    noise : (n,) float32, standard deviation of the noise that was removed; None: nothing was removed
    planes : positions moved onto planes fitted to their 64 nearest points, and normals of these planes, (n, 3)
        float32 each; signs of normals are found from both; None: no planes were fitted
    known : (n,) bool, whether the viewpoint (scanner position) is known; None: none is known
    repaired : number of missing normals, and number of normals that did not have unit length
    thick : (n,) bool, which points may be near two sheets; None: not computed
    """

    positions: Floats
    normals: Floats
    noise: Floats | None
    planes: tuple[Floats, Floats] | None = None
    known: Flags | None = None
    repaired: tuple[int, int] = (0, 0)
    thick: Flags | None = None


def ordering_of(positions: Floats) -> KdOrdering:
    """Return the kd ordering of finite positions that are in kd order already, equal ones merged."""
    rows, ids = distinct(positions)
    return KdOrdering(positions if len(rows) == len(positions) else take(positions, rows), ids, rows)


def merge(cloud: Cloud, local: Local, statistics: CloudStatistics) -> Floats:
    """Return the positions of a part and its margin, (n, 3), with second layers moved onto one surface.

    Second layers are copies of a surface, such as those of misaligned scans. They are moved in the ranges of the kd
    order that show them, if these are known.

    local : rows of the part and its margin; statistics : of the whole cloud
    """
    points = cloud.points(local)
    ordering = ordering_of(points.positions)
    blocks = None
    if cloud.columns.get(LAYERS) is not None:
        here = distinct_numbers(local.rows // block_size(cloud.total))
        blocks = here[cloud.columns[LAYERS][here] != 0]
    part = Part(
        cloud.total, local.rows[ordering.rows], of_distinct_positions(statistics, ordering.ids), blocks, cloud.ignored
    )
    return merge_for_model(points, ordering=ordering, part=part).positions


def examine(cloud: Cloud, local: Local) -> NoiseRanges:
    """Return the noise measured in ranges of a part's points along the kd order.

    The field `places` of the result says where ranges lie, as rows of the whole cloud.

    local : rows of the part and its margin; only ranges in the part itself are returned
    """
    points = cloud.points(local)
    ordering = ordering_of(points.positions)
    known = None if points.normals is None else take(_units_of(cloud, local, points).normals, ordering.rows)
    found = measure_ranges(ordering.positions, known, points_per_range(cloud.total))
    rows = ordering.rows[found.places]
    own = np.isin(rows, local.own)
    return NoiseRanges(local.rows[rows[own]], found.middles[own], found.noise[own], found.spacing[own])


def place(cloud: Cloud, local: Local, sigma: str | float, ranges: NoiseRanges | None) -> Surface:
    """Return the surface at the points of a part and its margin, if the points have normals.

    Noise is removed from the positions, and normals are scaled to unit length.

    local : rows of the part and its margin; sigma : standard deviation of the noise, or "auto"
    ranges : noise measured along the kd order of the whole cloud; None: `sigma` is the noise
    """
    points = cloud.points(local)
    repaired = _units_of(cloud, local, points)
    ordering = ordering_of(points.positions)
    noise = _noise_along(local, ordering, ranges)
    placed = smooth_known(points.with_normals(repaired.normals), sigma, ordering=ordering, known_noise=noise)
    assert placed.points.normals is not None
    return Surface(placed.points.positions, placed.points.normals, placed.noise, repaired=repaired.repaired)


def survey_fits(cloud: Cloud, local: Local, statistics: CloudStatistics) -> None:
    """Measure the noise of a cloud without normals, which decides how many neighbours its normals are fitted to.

    local : rows of a sample; statistics : of the cloud, where the results are stored
    """
    ordering = ordering_of(cloud.points(local).positions)
    measure_noise(ordering.positions, of_distinct_positions(statistics, ordering.ids))


def fit(
    cloud: Cloud, local: Local, sigma: str | float, ranges: NoiseRanges | None, statistics: CloudStatistics
) -> Surface:
    """Return the surface at the points of a part and its margin, if the points have no normals.

    Noise is removed from the positions, and normals are fitted. Their signs are known only for points with a known
    viewpoint (scanner position).

    local : rows of the part and its margin; sigma : standard deviation of the noise, or "auto"
    ranges : noise measured along the kd order of the whole cloud; None: `sigma` is the noise
    statistics : of the whole cloud
    """
    points = cloud.points(local)
    ordering, (eye, known) = ordering_of(points.positions), _eyes_of(cloud, points)
    ordered, eyes = ordering.positions, None if eye is None else take(eye, ordering.rows)
    layers = None if cloud.is_seen else Layers(ordered)
    fitting = Fitting(sigma, _noise_along(local, ordering, ranges), statistics)
    found = fitting.fit(ordered, NEAR, eyes, None, layers)
    normals, noise = ordering.spread(found.normals, points), None
    if found.noise is not None:
        noise = ordering.spread(found.noise, points)
    positions = points.positions if found.positions is ordered else ordering.spread(found.positions, points)
    planes = None
    if layers is not None and layers.noisy:
        planes = ordering.spread(layers.moved, points), ordering.spread(layers.planes, points)
    thick = None if layers is None else ordering.spread(is_thick(found.residuals), points)
    return Surface(positions, normals, noise, planes, known, thick=thick)


def units(cloud: Cloud, local: Local) -> Surface:
    """Return points with unit normals, turned towards known viewpoints; positions are unchanged."""
    points = cloud.points(local)
    repaired, (eye, known) = _units_of(cloud, local, points), _eyes_of(cloud, points)
    if eye is not None:
        repaired.normals[~faced(points.positions, repaired.normals, eye)] *= -1
    return repaired._replace(known=known)


def _eyes_of(cloud: Cloud, points: Points) -> tuple[Floats | None, Flags | None]:
    """Return the viewpoint (scanner position) of each of n points, and a mask of the points whose viewpoint is known.

    Viewpoints are (n, 3), relative to the points' origin, NaN where unknown. None is returned twice if no point of the
    cloud has a viewpoint, and None with a mask of False if only the n points have none.
    """
    if not cloud.is_seen:
        return None, None
    eyes = eyes_of(points, cloud.ignored)
    if eyes is None:
        return None, np.zeros(len(points), np.bool_)
    eye = np.require(seen_from(points, eyes, np.arange(len(points), dtype=np.int32)), requirements="W")  # for `take`
    return eye, is_known(eye) & (eye != points.positions).any(axis=1)


def _noise_along(local: Local, ordering: KdOrdering, ranges: NoiseRanges | None) -> Noise | None:
    return None if ranges is None else noise_by(ranges, local.rows[ordering.rows])


def _units_of(cloud: Cloud, local: Local, points: Points) -> Surface:
    """Return the points with unit normals, estimated if none is valid.

    Repaired normals are counted for own points only.

    local : rows of a part, whose own points are counted, and its margin; points : the same
    """
    if cloud.has_units:
        return Surface(points.positions, np.asarray(points.normals), None)
    found = normalize_normals(points, local.own)
    if found is None:
        return Surface(points.positions, np.asarray(estimate_normals(points).normals), None)
    return Surface(points.positions, found.unit, None, repaired=(found.lost, found.odd))


def support(
    cloud: Cloud, local: Local, given: Floats | None, settings: TreeSettings, statistics: CloudStatistics
) -> Support:
    """Return the support radii of a part's points and its margin, with their open borders and close sheets.

    local : rows of the n points of the part and its margin
    given : (n,) float32, support radii to use; None: radii are chosen from the spacing
    settings : decide whether borders and sheets are searched; statistics : of the whole cloud
    """
    positions, normals = (local.read(cloud.columns[name]) for name in (PLACED, cloud.normals))
    automatic = settings.overhang < np.inf
    return find_support(
        positions,
        normals,
        given,
        1.0,
        borders=automatic,
        sheets=automatic and settings.surface != "paper",
        statistics=statistics,
        noise=local.read(cloud.columns[NOISE]),
    )
