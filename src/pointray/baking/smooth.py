"""Noise reduction: the light of a patch is averaged with that of neighbours with similar surroundings.

The expected difference between two patches follows Ward, Rubinstein and Clear (1988): it grows with their distance over
the harmonic mean distance of the surfaces they see, and with the angle between their normals. Neighbours across an edge
or behind a thin wall lie off the plane and are excluded.
"""

from __future__ import annotations

import math

from ..engine.jit import Array, borrow, f32, inline, kernel, next_tile

ALLOWED = f32(0.35)  # expected difference at which a neighbour's weight reaches 0
OFF_PLANE = f32(0.25)  # distance from the plane, relative to the neighbours' distance, at which the weight reaches 0
# Near a contact all neighbours would differ too much. The expected difference due to distance is therefore limited so
# that the farthest neighbour has this value, and the nearest ones keep some weight.
CLOSEST = 0.4
CHUNK = 1024


@inline
def _weight(positions: Array, normals: Array, i: int, j: int, bounds: tuple[float, float]) -> float:
    """Return the weight of patch j, a neighbour, in the average of light over patch i and its neighbours.

    It falls with the distance of the patches, the angle between their normals, and the offset from their planes.

    positions, normals : of all patches, flat
    bounds : (mean inverse distance of the surfaces that patch i sees, distance from patch i to its farthest neighbour)
    """
    square = off = cosine = 0.0
    for c in range(3):
        d = positions[3 * j + c] - positions[3 * i + c]
        square += d * d
        off += d * (normals[3 * i + c] + normals[3 * j + c])
        cosine += normals[3 * i + c] * normals[3 * j + c]
    if cosine <= 0.0:
        return f32(0.0)
    change = math.sqrt(square) * bounds[0] + math.sqrt(max(1.0 - cosine, 0.0))
    apart = abs(off) * 0.5 / (bounds[1] * OFF_PLANE)
    return f32(max(1.0 - change / ALLOWED, 0.0) * max(1.0 - apart, 0.0))


@kernel
def smooth(
    work: Array,
    places: tuple[Array, Array, Array, Array],
    near: Array,
    span: tuple[int, int, int, int],
    values: Array,
    out: Array,
    count_of: Array,
) -> None:
    """Reduce noise: average the values of each patch on one side of an instance with those of its neighbours.

    places : (positions, normals, nearness, trust) of all patches, flat; nearness is the mean inverse distance of the
        surfaces that a patch sees, trust 1, or 0 for a patch without valid values, which is left out of averages
    near : for each patch of the side its neighbours, as indices within the side, padded with -1, flat int32
    span : (first patch of the side, number of its patches, neighbours per patch, values per patch)
    values : values of all patches, flat
    out : the averages for this side, written; shaped like `values`
    count_of : (patches,) float32, written for this side, the effective number of patches in each average
    """
    positions, normals, nearness, trust = borrow(places)
    near, values, out, count_of = borrow(near), borrow(values), borrow(out), borrow(count_of)
    first, count, each, size = span
    chunk = next_tile(work)
    while chunk >= 0:
        for k in range(chunk * CHUNK, min((chunk + 1) * CHUNK, count)):
            i, total = first + k, trust[first + k]
            squares = total * total
            for c in range(size):
                out[i * size + c] = total * values[i * size + c]
            width = 0.0
            for m in range(each):
                if near[k * each + m] >= 0:
                    j = first + near[k * each + m]
                    square = 0.0
                    for c in range(3):
                        square += (positions[3 * j + c] - positions[3 * i + c]) ** 2
                    width = max(width, square)
            reach = max(math.sqrt(width), 1e-300)
            bounds = min(nearness[i] * 1.0, CLOSEST / reach), reach
            for m in range(each):
                if near[k * each + m] < 0:
                    continue
                j = first + near[k * each + m]
                w = trust[j] * _weight(positions, normals, i, j, bounds)
                if w > f32(0.0):
                    total += w
                    squares += w * w
                    for c in range(size):
                        out[i * size + c] += w * values[j * size + c]
            count_of[i] = total * total / squares if total > f32(0.0) else f32(0.0)
            for c in range(size):
                out[i * size + c] = out[i * size + c] / total if total > f32(0.0) else values[i * size + c]
        chunk = next_tile(work)
