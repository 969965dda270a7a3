"""Field and signed distance of the solids: closed formulas, or clay modelled by `sculpture`."""

from __future__ import annotations

from math import cos, floor, sin, sqrt

from ..engine.jit import Array, inline, kernel, next_tile, routine
from ..engine.kernels.vec import Vec3
from .clay import Solid, work_clay
from .smooth import blend

SPHERE, TORUS, LATTICE, CLAY = 0, 1, 2, 3

TORUS_MAJOR, TORUS_MINOR = 1.0, 0.4
LATTICE_PITCH, LATTICE_END, LATTICE_RADIUS, LATTICE_BLEND = 0.5, 0.75, 0.035, 0.04
LATTICE_KNOB = 0.06  # radius of the balls where struts meet

SETTLED = 1e-10  # |field| of points on the surface
SINGLE, NEARLY = 1e-8, 1e-6  # bounds of |field| below float32 resolution, and sufficient for meshes
SEARCH_DIRECTIONS = 400  # number of directions
CLOSE = 0.004  # distance below which the surface, with radii of curvature of at least 0.005, has one nearest point
STENCIL = 3e-6  # step of central differences: truncation and rounding errors are both below 1e-7
SHORT = 1e-8  # step of one-sided differences: errors of 5e-8 where the field is linear, 1e-6 at the highest curvature


@inline
def _strut(along: float, across: float, other: float) -> float:
    """Return the squared distance to the nearest of the lattice's centre lines that are parallel to one axis.

    along : coordinate along the lines; across, other : the two others
    """
    beyond = max(abs(along) - LATTICE_END, 0.0)
    across -= _nearest_line(across)
    other -= _nearest_line(other)
    return beyond * beyond + across * across + other * other


@inline
def _nearest_line(x: float) -> float:
    line = (floor(x / LATTICE_PITCH) + 0.5) * LATTICE_PITCH
    return min(max(line, -LATTICE_END), LATTICE_END)


@inline
def _lattice(x: float, y: float, z: float) -> float:
    """Return a field that is zero on the surface of the lattice, negative inside.

    It is a cube of 4 x 4 x 4 balls joined by round struts, with filleted joints.
    """
    a = sqrt(_strut(x, y, z)) - LATTICE_RADIUS
    b = sqrt(_strut(y, z, x)) - LATTICE_RADIUS
    c = sqrt(_strut(z, x, y)) - LATTICE_RADIUS
    u, v, w = x - _nearest_line(x), y - _nearest_line(y), z - _nearest_line(z)
    knob = sqrt(u * u + v * v + w * w) - LATTICE_KNOB
    struts = blend(blend(a, b, LATTICE_BLEND), c, LATTICE_BLEND)
    return blend(struts, knob, LATTICE_BLEND)


@routine
def field(solid: Solid, x: float, y: float, z: float) -> float:
    """Return the field of a solid: a smooth function that is zero on its surface, negative inside.

    Its slope is near 1 at the surface.
    """
    if solid.kind == SPHERE:
        return sqrt(x * x + y * y + z * z) - 1.0
    if solid.kind == TORUS:
        ring = sqrt(x * x + y * y) - TORUS_MAJOR
        return sqrt(ring * ring + z * z) - TORUS_MINOR
    if solid.kind == LATTICE:
        return _lattice(x, y, z)
    return work_clay(solid, x, y, z)


@routine
def slope(solid: Solid, x: float, y: float, z: float, e: float) -> Vec3:
    """Return the gradient of a solid's field by central differences. e : distance of the samples on either side"""
    s = 0.5 / e
    gx = (field(solid, x + e, y, z) - field(solid, x - e, y, z)) * s
    gy = (field(solid, x, y + e, z) - field(solid, x, y - e, z)) * s
    gz = (field(solid, x, y, z + e) - field(solid, x, y, z - e)) * s
    return gx, gy, gz


@inline
def slope_from(solid: Solid, x: float, y: float, z: float, f: float, e: float) -> Vec3:
    """Return the gradient of a solid's field by one-sided differences.

    f : the field here; e : distance of the samples
    """
    gx = (field(solid, x + e, y, z) - f) / e
    gy = (field(solid, x, y + e, z) - f) / e
    gz = (field(solid, x, y, z + e) - f) / e
    return gx, gy, gz


@inline
def _bracket(solid: Solid, x: float, y: float, z: float, f: float) -> Vec3:
    """Find a surface point near one where Newton's method stalls: search along 26 directions, farther each time.

    f : the field at the point, not 0. Returns the point itself if no surface is found within about 0.1.
    """
    distance = max(abs(f), 1e-5)
    while distance < 0.1:
        for number in range(27):
            u, v, w = number // 9 - 1, number // 3 % 3 - 1, number % 3 - 1
            if (field(solid, x + distance * u, y + distance * v, z + distance * w) < 0.0) == (f < 0.0):
                continue
            low, high = 0.0, distance
            while high - low > 1e-12:
                middle = 0.5 * (low + high)
                if (field(solid, x + middle * u, y + middle * v, z + middle * w) < 0.0) == (f < 0.0):
                    low = middle
                else:
                    high = middle
            return x + high * u, y + high * v, z + high * w
        distance *= 1.4
    return x, y, z


@routine
def settle(solid: Solid, x: float, y: float, z: float, steps: int, enough: float) -> tuple[float, float, float, float]:
    """Move a point near the surface of a solid onto it; return its new x, y, z and the field there.

    Newton's method uses each one-sided gradient for two steps, which saves evaluations. If `steps` is over 2 and the
    field stays above 10 times `enough`, the surface is found by bisection.

    steps : largest number of gradients
    enough : absolute value of the field at which the method stops
    """
    f = field(solid, x, y, z)
    for _ in range(steps):
        if abs(f) < enough:
            return x, y, z, f
        gx, gy, gz = slope_from(solid, x, y, z, f, 1e-6)
        square = max(gx * gx + gy * gy + gz * gz, 0.04)
        for _ in range(2):
            step = min(max(f / square, -0.05), 0.05)
            x, y, z = x - step * gx, y - step * gy, z - step * gz
            f = field(solid, x, y, z)
            if abs(f) < enough:
                return x, y, z, f
    if steps > 2 and abs(f) > 10.0 * enough:
        x, y, z = _bracket(solid, x, y, z, f)
        f = field(solid, x, y, z)
    return x, y, z, f


@routine
def _slide(
    solid: Solid, x: float, y: float, z: float, p: float, q: float, r: float
) -> tuple[float, float, float, float]:
    """Slide the surface point (p, q, r) along the surface of a solid to where it is locally nearest to (x, y, z).

    There (x, y, z) - (p, q, r) is normal to the surface. Each step follows the tangential part of this difference and
    moves back onto the surface; it converges with distance / radius of curvature.

    Returns the coordinates of the nearest point and its distance.
    """
    best = sqrt((x - p) ** 2 + (y - q) ** 2 + (z - r) ** 2)
    share = 1.0
    for _ in range(24):
        gx, gy, gz = slope(solid, p, q, r, STENCIL)
        along = ((x - p) * gx + (y - q) * gy + (z - r) * gz) / max(gx * gx + gy * gy + gz * gz, 1e-2)
        tx, ty, tz = x - p - along * gx, y - q - along * gy, z - r - along * gz
        if tx * tx + ty * ty + tz * tz < 1e-5 * best * best:
            break
        u, v, w, _ = settle(solid, p + share * tx, q + share * ty, r + share * tz, 4, SETTLED)
        found = sqrt((x - u) ** 2 + (y - v) ** 2 + (z - w) ** 2)
        if found < best:
            p, q, r, best = u, v, w, found
        else:
            share *= 0.5
    return p, q, r, best


@inline
def _spiral_direction(number: int, a: float, b: float, c: float) -> Vec3:
    """Return one of 400 unit vectors on a spiral (Fibonacci) about the unit axis (a, b, c), denser near it.

    number : of the direction, from 0
    """
    share = (number + 0.5) / SEARCH_DIRECTIONS
    along = 1.0 - 2.0 * share * share
    across = sqrt(1.0 - along * along)
    s, t = across * cos(2.399963229728653 * number), across * sin(2.399963229728653 * number)
    # a basis about the axis (Duff et al. 2017, "Building an Orthonormal Basis, Revisited")
    sign = 1.0 if c >= 0.0 else -1.0
    d = -1.0 / (sign + c)
    e = a * b * d
    u = along * a + s * (1.0 + sign * a * a * d) + t * e
    v = along * b + s * sign * e + t * (sign + b * b * d)
    return u, v, along * c - s * sign * a - t * b


@routine
def _nearer(
    solid: Solid, x: float, y: float, z: float, f: float, p: float, q: float, r: float, best: float
) -> tuple[float, float, float, float]:
    """Search a surface point nearer to (x, y, z) than the surface point (p, q, r); return it and its distance.

    f : the field at (x, y, z); best : distance of (p, q, r)

    If none is found the distance is -1.
    """
    distance = 0.992 * best
    for number in range(SEARCH_DIRECTIONS):
        u, v, w = _spiral_direction(number, (p - x) / best, (q - y) / best, (r - z) / best)
        if (field(solid, x + distance * u, y + distance * v, z + distance * w) < 0.0) != (f < 0.0):
            low, high = 0.0, distance
            while high - low > 1e-9:
                middle = 0.5 * (low + high)
                if (field(solid, x + middle * u, y + middle * v, z + middle * w) < 0.0) == (f < 0.0):
                    low = middle
                else:
                    high = middle
            return x + low * u, y + low * v, z + low * w, low
    return x, y, z, -1.0


@routine
def distance(solid: Solid, x: float, y: float, z: float) -> float:
    """Return the signed Euclidean distance from a point to the surface of a solid, negative inside.

    For blended solids (lattice and clay) it is f / norm(grad f), with f the solid's field, if that is below 1e-6.
    Farther away, the projection of the point onto the surface slides to the nearest point; beyond 0.004 (`CLOSE`),
    where a relief has many such points, the ball up to it is searched for a nearer one.
    """
    f = field(solid, x, y, z)
    if solid.kind == SPHERE or solid.kind == TORUS or f == 0.0:
        return f
    gx, gy, gz = slope(solid, x, y, z, STENCIL)
    estimate = f / sqrt(max(gx * gx + gy * gy + gz * gz, 1e-2))
    if abs(estimate) < 1e-6:
        return estimate
    p, q, r, _ = settle(solid, x, y, z, 12, SETTLED)
    p, q, r, best = _slide(solid, x, y, z, p, q, r)
    for _ in range(12):
        if best < CLOSE:
            break
        p, q, r, found = _nearer(solid, x, y, z, f, p, q, r, best)
        if found < 0.0:
            break
        p, q, r, best = _slide(solid, x, y, z, p, q, r)
    return best if f > 0.0 else -best


@kernel
def distances(work: Array, solid: Solid, x: Array, out: Array, tile: int) -> None:
    """Set out[i] to the signed distance from x[i] to the surface of a solid, negative inside.

    x : (n, 3); out : (n,), written; tile : points that a thread takes at a time
    """
    t = next_tile(work)
    while t >= 0:
        for i in range(t * tile, min((t + 1) * tile, out.size)):
            out[i] = distance(solid, x[i, 0], x[i, 1], x[i, 2])
        t = next_tile(work)
