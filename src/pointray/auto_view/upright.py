"""Up direction of a scan from a weighted sum of evidence: file format, depth camera, shape and common practice.

Each source scores the six axes, see `evidence`. The axis with the largest weighted sum is up. The source with the
largest margin over the second axis is reported as the reason.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..base.arrays import Doubles, Flags
from .camera_frame import find_camera_frame
from .evidence import AXES, Scores, Shape, faces, foliage, ground, stands, stationed, trunk, turning, walls
from .sample import Sample

FLAT = 0.2  # height over width below which a scan is flat: terrain, a city, a floor
FAR_OUT = 0.2  # share of the size: points farther outside the central 98% are outliers
EDGE = 0.01  # share of the points at either end of an axis beyond those 98%, also for flatness
MAX_POINTS = 8_000  # points used
# Priors of the axes: z is up for scanners and CAD programs, y for graphics and many meshes.
HABIT = {"z": 0.2, "y": 0.08, "-y": -0.05, "x": -0.15, "-x": -0.15, "-z": -0.2}
# The same for Gaussian splats, whose cameras follow the computer vision convention, y down.
SPLAT_HABIT = {"-y": 0.4, "y": 0.2, "z": 0.0, "x": -0.2, "-x": -0.2, "-z": -0.3}
# Up axis of each format and its weight, by standard or by convention.
FORMATS = {
    "LAS": ("z", 2.0),
    "E57": ("z", 0.5),
    "PTX": ("z", 1.0),
    "PTS": ("z", 1.0),
    "KITTI": ("z", 1.0),
    "glTF": ("y", 2.0),
    "SPZ": ("y", 0.5),
    "COLMAP": ("-y", 0.4),
    "depth image": ("-y", 3.0),
}
# Weights of the other sources, whose scores lie between -1 and 1. Those of shape were fitted to 500 clouds.
WEIGHTS = {
    "frame": 3.0,
    "map": 3.0,
    "flat": 0.3,
    "stance": 0.4,
    "feet": 0.7,
    "base": 1.1,
    "trunk": 1.5,
    "ground": 0.3,
    "things": 1.1,
    "walls": 1.0,
    "normals": 0.3,
    "foliage": 0.4,
    "turning": 1.3,
    "stations": 0.5,
}
REASONS = {
    "habit": "as in most files",
    "splats": "as in most files of splats",
    "frame": "a frame of a depth camera",
    "map": "large coordinates, as on a map",
    "flat": "the scan is flat",
    "stance": "stable base",
    "feet": "stands on feet",
    "base": "flat base",
    "trunk": "stands on a trunk or post",
    "ground": "level ground below",
    "things": "objects stand on the ground",
    "walls": "vertical walls",
    "normals": "most normals point up",
    "foliage": "foliage above",
    "turning": "spread around the scanner or the origin",
    "stations": "stations at one height",
}
HABITS = "habit", "splats"
SUPPORTS = "base", "feet", "trunk"  # evidence that an object stands
STANDING = 0.3  # smallest weighted score of one of these for a standing object; the Nefertiti bust on its neck has 0.49
LEAST = 0.05  # smallest margin of a source that is reported as the reason


class Up(NamedTuple):
    """Detected up direction of a scan.

    Attributes
    ----------
    axis : str
        "x", "-x", "y", "-y", "z" or "-z".
    why : str
        The decisive evidence, in a few words, for messages.
    stands : bool
        Whether the shape has a flat base, feet or a trunk at its lower end.
    """

    axis: str
    why: str
    stands: bool = False

    @property
    def direction(self) -> tuple[float, float, float]:
        """Up direction as a unit vector, (x, y, z)."""
        return axis_direction(self.axis)


def axis_direction(axis: str) -> tuple[float, float, float]:
    """Return the unit vector of "x", "-x", "y", "-y", "z" or "-z"."""
    sign = -1.0 if axis.startswith("-") else 1.0
    x, y, z = (sign if axis[-1] == name else 0.0 for name in "xyz")
    return x, y, z


def find_up(sample: Sample) -> Up:
    """Find the up direction of a scan: the axis with the largest sum of evidence.

    The reason given is the evidence by which it most exceeds the second axis.
    """
    scores = weighted_evidence(sample)
    total = np.sum(list(scores.values()), axis=0)
    best, next_best = np.argsort(-total, kind="stable")[:2]
    margins = {name: found[best] - found[next_best] for name, found in scores.items()}
    source = max(margins, key=lambda name: margins[name] if name not in HABITS else LEAST)
    axis, stands = AXES[best], _stands(scores, int(best))
    if source == "format":
        down = axis.startswith("-")
        return Up(axis, f"{sample.format} files are {axis.lstrip('-')} {'down' if down else 'up'}", stands)
    return Up(axis, REASONS[source], stands)


def stands_along(sample: Sample, up: ArrayLike) -> bool:
    """Return whether an object stands on a flat base, feet or a trunk if `up` is up; False if `up` is not an axis."""
    found = [k for k, axis in enumerate(AXES) if np.allclose(axis_direction(axis), up)]
    return bool(found) and _stands(weighted_evidence(sample), found[0])


def _stands(scores: dict[str, Scores], axis: int) -> bool:
    return max(float(scores[name][axis]) if name in scores else 0.0 for name in SUPPORTS) >= STANDING


def weighted_evidence(sample: Sample) -> dict[str, Scores]:
    """Return weighted scores of x, -x, y, -y, z and -z as the up direction, (6,) each, by name of the evidence.

    Evidence is the file format, a depth camera, large coordinates, the shape, and common practice.
    """
    frame = find_camera_frame(sample.positions + sample.origin)
    sample = _thinned(sample)
    habit = SPLAT_HABIT if sample.splats else HABIT
    scores = {"splats" if sample.splats else "habit": np.array([habit[axis] for axis in AXES])}
    if sample.format in FORMATS:
        axis, weight = FORMATS[sample.format]
        scores["format"] = _only(axis) * weight
    if frame:
        scores["frame"] = WEIGHTS["frame"] * frame.certainty * _only(frame.up)
    if sample.far:
        scores["map"] = WEIGHTS["map"] * _only("z")
    if is_flat(sample.positions):
        scores["flat"] = WEIGHTS["flat"] * _only("z")
    if frame and frame.certainty == 1:  # shape cannot outweigh it
        return scores
    return scores | {name: WEIGHTS[name] * found for name, found in _shape_evidence(sample).items()}


def _shape_evidence(sample: Sample) -> dict[str, Scores]:
    """Return unweighted scores of x, -x, y, -y, z and -z as the up direction, (6,) each, from the points alone.

    The keys are names of the evidence, such as "trunk" and "walls".
    """
    kept = _without_strays(sample.positions)
    normals = np.zeros((0, 3)) if sample.splats else sample.normals[kept]
    eye = sample.stations[0] if len(sample.stations) == 1 else -sample.origin
    shape = Shape.of(sample.positions[kept], normals, eye, sample.stations)
    if len(shape.planes.positions) == 0:
        return {}
    stance, feet, base = stands(shape)
    floors, things = ground(shape)
    return {
        "stance": stance,
        "feet": feet,
        "base": base,
        "trunk": trunk(shape),
        "ground": floors,
        "things": things,
        "walls": walls(shape),
        "normals": faces(shape),
        "foliage": foliage(shape),
        "turning": turning(shape),
        "stations": stationed(shape),
    }


def _thinned(sample: Sample) -> Sample:
    step = max(len(sample.positions) // MAX_POINTS, 1)
    return sample._replace(positions=sample.positions[::step], normals=sample.normals[::step])


def _without_strays(positions: Doubles) -> Flags:
    """Return whether each point is no outlier, (n,): within or not far outside the central 98% along each axis.

    positions : (n, 3)
    """
    low, high = np.quantile(positions, [EDGE, 1.0 - EDGE], axis=0)
    margin = FAR_OUT * (high - low).max()
    return np.asarray(((positions >= low - margin) & (positions <= high + margin)).all(axis=1))


def _only(axis: str) -> Scores:
    return np.array([float(name == axis) for name in AXES])


def is_flat(positions: Doubles) -> bool:
    """Return whether points, (n, 3), are at most a fifth as high (along the last axis) as wide, without outliers."""
    across, deep, high = np.ptp(np.quantile(positions, [EDGE, 1.0 - EDGE], axis=0), axis=0)
    return bool(high <= FLAT * max(across, deep))
