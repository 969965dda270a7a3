"""Solids of planes: the two or three candidates, with signs, whose solid is closest to a point's neighbours.

Some of the neighbours are used for scoring; the heights of one above all candidates are one vector.
"""

from __future__ import annotations

from ...engine.jit import Array, f32, inline, routine
from ...engine.simd import (
    F16,
    INF,
    ZERO,
    Mask,
    bits,
    broadcast16,
    broadcast_from,
    count_trailing_zeros,
    lane,
    load16,
    mask16,
    reduce_min,
    select,
    store,
    vabs,
    vmax,
    vmin,
)
from ..normals.fit_batch import LANES, zeros
from .candidates import CANDIDATES, SAMPLES, Neighbors, height

BLUNT = 0.9  # cosine between planes above which they count as one
BELOW = f32(-1e15)  # offset of a plane below all others


@routine
def score(k: int, memory: Neighbors) -> int:
    """Write the heights of about 31 of `k` neighbours above the nine candidate planes; return the number of these.

    Heights are signed distances. `choose_two` and `choose_third` select the planes of an edge or corner by them.

    memory : holds the neighbours and the planes; receives 16 heights for each neighbour
    """
    found, width, samples = memory.found, len(memory.weights), 0
    n = load16(found, 0), load16(found, LANES), load16(found, 2 * LANES)
    offset = load16(found, 3 * LANES)
    for j in range(0, k, max(k // SAMPLES, 1)):
        x, y = broadcast_from(memory.places, j), broadcast_from(memory.places, width + j)
        z = broadcast_from(memory.places, 2 * width + j)
        store(memory.heights, LANES * samples, n[0] * x + n[1] * y + n[2] * z + offset)
        samples += 1
    return samples


@inline
def _unlike(planes: Array, a: int, memory: Neighbors) -> Mask:
    """Return which of the nine candidate planes are at an angle to plane `a` of `planes` and can form an edge with it.

    planes : (4 * 16,) x, y, z of the normals, and the offsets, one plane a lane
    """
    found, normal = memory.found, (planes[a], planes[LANES + a], planes[2 * LANES + a])
    cosine = load16(found, 0) * normal[0] + load16(found, LANES) * normal[1] + load16(found, 2 * LANES) * normal[2]
    return vabs(cosine) <= f32(BLUNT)


@inline
def _take(memory: Neighbors, at: int, a: int, sign: float) -> None:
    """Choose candidate plane `a` as plane `at` of the edge or corner; `sign` -1 turns it to face the other side."""
    for c in range(4):
        memory.chosen[LANES * c + at] = f32(sign) * memory.found[LANES * c + a]


@routine
def choose_two(samples: int, cut: float, memory: Neighbors) -> float:
    """Choose the two candidate planes, and their sides, whose edge is closest to the neighbours of a point.

    Returns the sum of the squared distances.

    samples : number of neighbours whose heights above the candidates `score` has written
    cut : squared distances beyond this count as this, so that neighbours far off both planes do not decide
    """
    least, one, two, sign_one, sign_two = INF, 0, 0, 1.0, 1.0
    for a in range(1, CANDIDATES):
        allowed = _unlike(memory.found, a, memory) & mask16((1 << a) - 1)
        if bits(allowed) == 0:
            continue
        convex, concave, up, down = _squares(samples, a, cut, memory)
        best = vmin(vmin(convex, concave), vmin(up, down))
        best = select(allowed, best, broadcast16(INF))
        lowest = reduce_min(best)
        if lowest < least:
            least, one, two = lowest, a, count_trailing_zeros(bits(best <= lowest))
            sign_one = 1.0 if min(lane(convex, two), lane(up, two)) <= lowest else -1.0
            sign_two = 1.0 if min(lane(convex, two), lane(down, two)) <= lowest else -1.0
    _take(memory, 0, one, sign_one)
    _take(memory, 1, two, sign_two)
    for c in range(3):
        memory.chosen[LANES * c + 2] = ZERO
    memory.chosen[3 * LANES + 2] = BELOW
    return least


@inline
def _squares(samples: int, a: int, cut: float, memory: Neighbors) -> tuple[F16, F16, F16, F16]:
    """Sum up squared distances of neighbours from the edges of candidate `a` with each other candidate (one a lane).

    With heights p above `a` and q above the other, the edges are where max(p, q), min(p, q), max(p, -q) and max(-p, q)
    are zero; the four sums are returned in this order.

    samples : number of neighbours, whose heights `score` has written
    cut : squared distances beyond this count as this
    """
    most = broadcast16(f32(cut))
    convex = concave = up = down = zeros()
    for j in range(samples):
        p, q = broadcast_from(memory.heights, LANES * j + a), load16(memory.heights, LANES * j)
        high, low, right, left = vmax(p, q), vmin(p, q), vmax(p, ZERO - q), vmax(ZERO - p, q)
        convex, concave = convex + vmin(high * high, most), concave + vmin(low * low, most)
        up, down = up + vmin(right * right, most), down + vmin(left * left, most)
    return convex, concave, up, down


@routine
def _replace(k: int, at: int, cut: float, memory: Neighbors) -> float:
    """Replace one of the three chosen planes by the candidate whose corner with the others is nearest to the points.

    Returns the sum of the squared distances; infinity if every candidate is nearly parallel to one of the other two.

    k : number of neighbours
    at : the plane to replace, 0 to 2
    cut : squared distances beyond this count as this
    """
    chosen, one, two, samples = memory.chosen, (at + 1) % 3, (at + 2) % 3, 0
    allowed = _unlike(chosen, one, memory) & _unlike(chosen, two, memory) & mask16((1 << CANDIDATES) - 1)
    if bits(allowed) == 0:
        return INF
    width, most, up = len(memory.weights), broadcast16(f32(cut)), zeros()
    down = up
    for j in range(0, k, max(k // SAMPLES, 1)):
        x, y = broadcast_from(memory.places, j), broadcast_from(memory.places, width + j)
        place = x, y, broadcast_from(memory.places, 2 * width + j)
        p, q = (vmax(height(chosen, one, place), height(chosen, two, place)), load16(memory.heights, LANES * samples))
        above, below = vmax(p, q), vmax(p, ZERO - q)
        up, down, samples = up + vmin(above * above, most), down + vmin(below * below, most), samples + 1
    best = select(allowed, vmin(up, down), broadcast16(INF))
    least = reduce_min(best)
    a = count_trailing_zeros(bits(best <= least))
    _take(memory, at, a, 1.0 if lane(up, a) < lane(down, a) else -1.0)
    return least


@inline
def choose_third(k: int, cut: float, memory: Neighbors) -> float:
    """Add a third candidate plane to the two chosen ones, then try to improve these; return the sum of squares.

    The sum is that of the neighbours' squared distances from the corner.

    k : number of neighbours
    cut : squared distances beyond this count as this
    """
    least = _replace(k, 2, cut, memory)
    if least < INF:
        least = min(least, _replace(k, 0, cut, memory))
        least = min(least, _replace(k, 1, cut, memory))
    return least
