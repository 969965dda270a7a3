"""What a part's surface is: positions and normals where they are met by rays, and supports, as in a whole model.

Each function does one stage for one part, from columns of earlier stages, which other parts have written too. Numbers
that hold for all parts come from a sample, see `cloud.statistics`, or from all parts, as the noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.disk_columns import Columns
from ...cloud.denoising.noise import NoiseRanges, measure_ranges, points_per_range
from ...cloud.denoising.smooth import Fitting, Noise, noise_by, smooth_known
from ...cloud.georeference import Survey
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

Floats = NDArray[np.float32]

# Columns: of the cloud as it was given, and of what is found, stage by stage.
POSITIONS, GIVEN = "points.positions", "points.normals"
MERGED, UNITS, TURNED, KNOWN = "merged", "units", "turned", "known"
LAYERS = "layers"  # of blocks, see `second_layers.py`
PLACED, NORMALS, FACED, NOISE = "placed", "normals", "faced", "noise"
PLANES = "planes.moved", "planes.normals"
THICK, PARTED = "thick", "parted"  # whether a point may be of two sheets; normals where these were looked for


@dataclass(frozen=True)
class Cloud:
    """A cloud on disk, in kd order.

    columns : Columns
    total : int, how many points it has
    origin : (3,) float64
    survey : Survey
    seers : dict of str to str, the columns of the attributes that tell who saw each point
    is_seen : whether they tell it of any
    ignored : the numbers of stations that are not believed, see `eyes_of`
    """

    columns: Columns
    total: int
    origin: NDArray[np.float64]
    survey: Survey
    seers: dict[str, str]
    is_seen: bool
    ignored: tuple[int, ...] = ()

    @property
    def has_units(self) -> bool:
        """Whether the normals that points have by now are unit ones: those of another length would be rounded again."""
        return self.columns.get(TURNED) is not None

    @property
    def normals(self) -> str:
        """The column with the normals of the surface that are there by now."""
        return self.latest(PARTED, self.latest(FACED, NORMALS))

    def points(self, local: Local) -> Points:
        """Some of the points, where they are by now, with the normals that they have by now."""
        columns = self.columns
        positions = local.read(columns[self.latest(MERGED, POSITIONS)])
        normals = local.read(columns[self.latest(TURNED, GIVEN)]) if GIVEN in columns else None
        attributes = {name: local.read(columns[column]) for name, column in self.seers.items()}
        return Points.about(self.origin, positions, normals, None, attributes, self.survey)

    def latest(self, found: str, given: str) -> str:
        """The column that a stage has found, if it is done for all parts, or what was given."""
        return given if self.columns.get(found) is None else found


class Surface(NamedTuple):
    """Some points where rays meet them.

    positions, normals : (n, 3) float32, unit normals
    noise : (n,) float32, what was smoothed away; None if nothing was
    planes : (n, 3) float32 each, positions on planes around noisy points and the planes' normals, which tell signs
    known : (n,) bool, whose scanner is known; None: nobody's
    mended : how many normals were lost, and of another length
    thick : (n,) bool, which points may be of two sheets; None: not asked
    """

    positions: Floats
    normals: Floats
    noise: Floats | None
    planes: tuple[Floats, Floats] | None = None
    known: NDArray[np.bool_] | None = None
    mended: tuple[int, int] = (0, 0)
    thick: NDArray[np.bool_] | None = None


def path_of(positions: Floats) -> KdOrdering:
    """The path through points that are in kd order and finite, see `compute_kd_ordering`."""
    rows, ids = distinct(positions)
    return KdOrdering(positions if len(rows) == len(positions) else take(positions, rows), ids, rows)


def merge(cloud: Cloud, local: Local, statistics: CloudStatistics) -> Floats:
    """Positions with those of second layers moved onto one surface, in the blocks that show them if these are known."""
    points = cloud.points(local)
    ordering = path_of(points.positions)
    blocks = None
    if cloud.columns.get(LAYERS) is not None:
        here = distinct_numbers(local.rows // block_size(cloud.total))
        blocks = here[cloud.columns[LAYERS][here] != 0]
    part = Part(
        cloud.total, local.rows[ordering.rows], of_distinct_positions(statistics, ordering.ids), blocks, cloud.ignored
    )
    return merge_for_model(points, ordering=ordering, part=part).positions


def examine(cloud: Cloud, local: Local) -> NoiseRanges:
    """What the stretches of a part show of its noise; places are those of the whole cloud."""
    points = cloud.points(local)
    ordering = path_of(points.positions)
    known = None if points.normals is None else take(_units_of(cloud, local, points).normals, ordering.rows)
    found = measure_ranges(ordering.positions, known, points_per_range(cloud.total))
    rows = ordering.rows[found.places]
    own = np.isin(rows, local.own)
    return NoiseRanges(local.rows[rows[own]], found.middles[own], found.noise[own], found.spacing[own])


def place(cloud: Cloud, local: Local, sigma: str | float, ranges: NoiseRanges | None) -> Surface:
    """Points with normals of their own, moved where they are noisy. stretches : of all parts; None: sigma tells"""
    points = cloud.points(local)
    mended = _units_of(cloud, local, points)
    ordering = path_of(points.positions)
    noise = _noise_along(local, ordering, ranges)
    placed = smooth_known(points.with_normals(mended.normals), sigma, ordering=ordering, known_noise=noise)
    assert placed.points.normals is not None
    return Surface(placed.points.positions, placed.points.normals, placed.noise, mended=mended.mended)


def survey_fits(cloud: Cloud, local: Local, statistics: CloudStatistics) -> None:
    """Find what fits to points without normals ask of the whole cloud."""
    ordering = path_of(cloud.points(local).positions)
    measure_noise(ordering.positions, of_distinct_positions(statistics, ordering.ids))


def fit(
    cloud: Cloud, local: Local, sigma: str | float, ranges: NoiseRanges | None, statistics: CloudStatistics
) -> Surface:
    """Points without normals, moved where they are noisy; signs are those that scanners tell, or not known."""
    points = cloud.points(local)
    ordering, (eye, known) = path_of(points.positions), _eyes_of(cloud, points)
    path, eyes = ordering.positions, None if eye is None else take(eye, ordering.rows)
    layers = None if cloud.is_seen else Layers(path)
    fitting = Fitting(sigma, _noise_along(local, ordering, ranges), statistics)
    found = fitting.fit(path, NEAR, eyes, None, layers)
    normals, noise = ordering.spread(found.normals, points), None
    if found.noise is not None:
        noise = ordering.spread(found.noise, points)
    positions = points.positions if found.positions is path else ordering.spread(found.positions, points)
    planes = None
    if layers is not None and layers.noisy:
        planes = ordering.spread(layers.moved, points), ordering.spread(layers.planes, points)
    thick = None if layers is None else ordering.spread(is_thick(found.residuals), points)
    return Surface(positions, normals, noise, planes, known, thick=thick)


def units(cloud: Cloud, local: Local) -> Surface:
    """Points with unit normals, which face those who saw them, where that is known."""
    points = cloud.points(local)
    mended, (eye, known) = _units_of(cloud, local, points), _eyes_of(cloud, points)
    if eye is not None:
        mended.normals[~faced(points.positions, mended.normals, eye)] *= -1
    return mended._replace(known=known)


def _eyes_of(cloud: Cloud, points: Points) -> tuple[Floats | None, NDArray[np.bool_] | None]:
    """Who saw each point, about the origin, (n, 3), NaN where that is not known; and where it is known."""
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
    """The points with unit normals; where none is good they are estimated. Own points alone count as mended."""
    if cloud.has_units:
        return Surface(points.positions, np.asarray(points.normals), None)
    found = normalize_normals(points, local.own)
    if found is None:
        return Surface(points.positions, np.asarray(estimate_normals(points).normals), None)
    return Surface(points.positions, found.unit, None, mended=(found.lost, found.odd))


def support(
    cloud: Cloud, local: Local, given: Floats | None, settings: TreeSettings, statistics: CloudStatistics
) -> Support:
    """The support of points on their surface. given : (n,), their radii; None: chosen"""
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
