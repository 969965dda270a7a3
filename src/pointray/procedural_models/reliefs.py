"""Fine reliefs: periodic patterns of height about -1 to 1 that displace the statue's clay."""

from __future__ import annotations

from math import atan2, cos, exp, floor, pi, sin, sqrt

from ..engine.jit import inline, routine
from .smooth import blend, step

HAIR, FOLDS, MEANDER, FLUTES, SPIRAL = 10, 11, 12, 13, 14


@inline
def _hair(u: float, v: float, w: float, count: float) -> float:
    """Return the height of a relief of wavy locks of several strands, combed from the forehead to the pole +v.

    It is a Hellenistic melon coiffure.

    u, v, w : position in the axes and scale of the relief; count : number of locks around the head
    """
    around = atan2(u, w)
    along = atan2(sqrt(u * u + w * w), v)
    # ripples shrink towards the pole and have the same sign on both sides of the parting
    wave = 0.045 * sin(15.0 * along + 1.3 * cos(3.0 * around)) + 0.006 * sin(31.0 * along + 2.0)
    angle = around * count + wave * count * u / sqrt(u * u + 0.003)
    lock = cos(angle)
    strands = cos(3.0 * angle + 1.0 * sin(9.0 * along)) + 0.4 * cos(5.0 * angle + 1.0)
    calm = u * u + w * w
    calm = calm / (calm + 0.012)  # all strands meet at the poles
    return calm * calm * (0.75 * lock + 0.14 * strands)


@inline
def _folds(u: float, v: float, w: float) -> float:
    """Return the height of a relief of cloth hanging in folds between two shoulders, deeper the lower they hang.

    u, v, w : position in the axes and scale of the relief, w upward
    """
    spread = 0.30 + 0.70 * exp(-(u * u) / 0.11)
    lean = 0.06 * sin(3.1 * u + 0.6) + 0.035 * sin(7.0 * u - 5.0 * v)
    depth = (lean - w) / spread
    phase = 48.0 * depth + 1.6 * sin(5.0 * u + 9.0 * depth) + 1.1 * sin(2.3 * v + 1.0)
    ridge = (exp(1.1 * sin(phase)) - 1.33) * 0.55
    fine = 0.20 * sin(2.7 * phase + 2.0 * sin(11.0 * u))
    strength = 0.75 + 0.25 * sin(4.0 * u + 13.0 * depth)
    return (ridge * strength + fine) * (0.25 + 0.75 * spread)


@inline
def _segment(u: float, w: float, ax: float, az: float, bx: float, bz: float) -> float:
    """Return the distance in the plane (u, w) to an axis-parallel segment, given by its low and high corner.

    ax, az : low corner; bx, bz : high corner
    """
    du = max(max(ax - u, u - bx), 0.0)
    dw = max(max(az - w, w - bz), 0.0)
    return sqrt(du * du + dw * dw)


@inline
def _meander(u: float, v: float, w: float, count: float) -> float:
    """Return the height, 0 to 1, of a relief of a Greek key around the axis w, between w = -1 and 1; lines are raised.

    u, v, w : position in the axes and scale of the relief; count : number of repeats around the axis
    """
    turn = atan2(v, u) * count / (2.0 * pi)
    s = (turn - floor(turn)) * 8.0
    t = (w + 1.0) * 3.0
    d = 9.0
    for shift in range(-1, 2):  # the key's own cell and its neighbours
        x = s + 8.0 * shift
        d = blend(d, _segment(x, t, 0.0, 0.5, 0.0, 5.5), 0.5)
        d = blend(d, _segment(x, t, 0.0, 5.5, 6.0, 5.5), 0.5)
        d = blend(d, _segment(x, t, 6.0, 2.2, 6.0, 5.5), 0.5)
        d = blend(d, _segment(x, t, 3.0, 2.2, 6.0, 2.2), 0.5)
        d = blend(d, _segment(x, t, 3.0, 2.2, 3.0, 3.6), 0.5)
        d = blend(d, _segment(x, t, 0.0, 0.5, 8.0, 0.5), 0.5)
    return step((0.82 - d) / 0.7)  # 0 half way between two lines


@inline
def _flutes(u: float, v: float, w: float, count: float) -> float:
    """Return the height of a relief of ribs around the axis w that lean along it: gadroons, beads, flutes.

    u, v, w : position in the axes and scale of the relief; count : number of ribs
    """
    wave = cos(count * atan2(v, u) + 2.2 * w)
    return 0.8 * wave - 0.2 * wave * wave


@inline
def _spiral(u: float, v: float, w: float, count: float) -> float:
    """Return the height of a relief of strands of hair wound into a knot about the axis v.

    u, v, w : position in the axes and scale of the relief; count : number of locks around the axis
    """
    radius = sqrt(u * u + w * w + 0.0004)
    angle = atan2(u, w) * count + 24.0 * radius
    strands = cos(3.0 * angle + 1.0) + 0.5 * cos(5.0 * angle)
    calm = u * u + w * w
    calm = calm / (calm + 0.0012)
    return calm * calm * (0.8 * cos(angle) + 0.13 * strands)


@routine
def relief(kind: int, u: float, v: float, w: float, count: float) -> float:
    """Return the height of a relief, a pattern that displaces a surface, at a point; about -1 to 1.

    kind : HAIR, FOLDS, MEANDER, FLUTES or SPIRAL
    u, v, w : position in the axes and scale of the relief; count : number of repeats of the pattern, unused by FOLDS
    """
    if kind == HAIR:
        return _hair(u, v, w, count)
    if kind == FOLDS:
        return _folds(u, v, w)
    if kind == MEANDER:
        return _meander(u, v, w, count)
    if kind == FLUTES:
        return _flutes(u, v, w, count)
    return _spiral(u, v, w, count)
