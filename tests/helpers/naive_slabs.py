"""A slow search for zeros of f outside the slab of a leaf."""

import numpy as np

from pointray.engine.jit import f32, kernel, next_tile
from pointray.surface.tree.columns import LANES, PARTS, Members, slab_along

from .naive import bisect, field

TRIM, STEPS, LINES = 0.75, 120, 24

PAD = 1e-4  # of a radius, against rounding: the slab of a single splat has no thickness


@kernel
def outside(work, clouds, normals, lines, settings, out):
    """Per cloud: zeros found on lines through it, and their greatest height in the slab (1 at its border)."""
    kind, trim, limits = settings
    found, most = out
    i = next_tile(work)
    while i >= 0:
        splats, m = clouds[i], normals[i]
        count = len(splats)
        chosen = np.arange(count)
        members = Members(np.empty(PARTS * 2 * LANES, np.float32), 2 * LANES, count)
        for k in range(count):
            for row in range(PARTS):
                members.rows[row * members.room + k] = splats[k, row]
        low, high = slab_along(members, (f32(m[0]), f32(m[1]), f32(m[2])), limits)
        found[i], most[i] = 0, 0.0
        for line in range(len(lines[i])):
            o, d = lines[i, line, 0], lines[i, line, 1]
            before = np.nan
            for k in range(STEPS):
                t = 2.0 * k / STEPS
                f = field(splats, chosen, count, o + t * d, kind)[0]
                if (f < 0.0 and before >= 0.0) or (f >= 0.0 and before < 0.0):
                    x = o + bisect(splats, chosen, count, (o, d), (t - 2.0 / STEPS, t), kind) * d
                    value, away, radius, _, _ = field(splats, chosen, count, x, kind)
                    if abs(value) < 1e-6 and away <= trim * radius:
                        found[i] += 1
                        share = (2.0 * (m * x).sum() - low - high) / (high - low + PAD)
                        most[i] = max(most[i], abs(share))
                before = f
        i = next_tile(work)
    return 0
