"""The statue: a bust of Iphigenia on a turned plinth, about 2 high, standing on z = 0 and facing -y."""

from __future__ import annotations

from typing import Any

import numpy as np

from .bust import sculpt_bust, sculpt_plinth
from .cells import clay_solid
from .clay import Solid
from .head import sculpt_head
from .strokes import Clay

HEAD: dict[str, Any] = {"place": (0.0, -0.005, 1.315), "turn": (-3.0, 4.0, -14.0), "scale": 0.62}
BOUNDS = np.array([[-0.70, -0.48, -0.03], [0.70, 0.52, 2.08]])
CELL = 0.014


def statue() -> Solid:
    """Return the procedural model "statue", a bust on a plinth, as a solid that kernels take.

    It is made of strokes, shapes that add or remove clay, with a list of those near each place.
    """
    clay = Clay()
    sculpt_bust(clay)  # first, because its foot is cut off, which would also cut the plinth
    sculpt_plinth(clay)
    with clay.part(**HEAD):
        sculpt_head(clay)
    return clay_solid(clay.table(), BOUNDS[0], BOUNDS[1], CELL)
