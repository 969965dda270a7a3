"""Settings of a tree: validation of those from callers and from files."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ...base.arguments import check_choice, check_number, check_whole
from ...base.choices import SURFACES

TRIM = 0.6  # trim="auto": largest |x - P(x)| of a hit, in local radii (docs/decisions/surface.md)
LOOSE_TRIM = 0.95  # the same if many radii are too small to cover the surface, so that it extends into gaps
OVERHANG = 0.2  # trim="auto": largest distance of a hit beyond an open border, in local radii (docs/decisions/radii.md)
LARGEST_SAMPLES, LARGEST_REFINE = 64, 16
LEAF_WIDTH = 8.0  # upper limit of a voxel's longest edge, in mean support radii


class TreeSettings(NamedTuple):
    """Settings of a tree: kind of surface, samples along rays, how far hits may be from splats, width of voxels.

    surface : 'paper', 'imls', 'apss' or 'disc'
    samples : samples per support diameter, the paper's N
    refine : secant steps that refine a hit between two samples
    trim : largest distance of a hit from the mean centre of its splats, in their mean radii; inf for any
    overhang : largest distance of a hit beyond an open border, in mean radii; inf for any
    leaf_width : maximum of a voxel's longest edge, in mean radii; down to half of it where the costs favour it
    cut : False for infinite slabs and boxes as large as their voxels; for tests
    """

    surface: str
    samples: int = 4
    refine: int = 1
    trim: float = float("inf")
    overhang: float = float("inf")
    leaf_width: float = LEAF_WIDTH
    cut: bool = True


def check_settings(surface: str, samples: int, refine: int, trim: str | float | None) -> TreeSettings:
    """Check the parameters of `Model` with these names, and return them as `TreeSettings`.

    surface : kind of surface; samples : per support diameter; refine : secant steps
    trim : largest distance of a hit from its splats, in radii; None for any; "auto" also bounds how far hits may lie
        beyond open borders
    """
    surface = check_choice(surface, "surface", SURFACES)
    samples = check_whole(samples, "samples", 2, LARGEST_SAMPLES)
    refine = check_whole(refine, "refine", 0, LARGEST_REFINE)
    if isinstance(trim, str) and trim == "auto":
        limit, overhang = (np.inf, np.inf) if surface == "disc" else (TRIM, OVERHANG)
    elif trim is None:
        limit = overhang = np.inf
    else:
        wanted = "'auto', None or a positive number of radii"
        limit, overhang = check_number(trim, "trim", wanted, lambda x: x > 0), np.inf
    return TreeSettings(surface, samples, refine, limit, overhang)


def settings_of(values: dict[str, Any]) -> TreeSettings:
    """Return settings from the values stored in a model's file, by name; raise ValueError if they are invalid."""
    settings = TreeSettings(**values)
    if settings.surface not in SURFACES or not all(isinstance(value, int | float) for value in settings[1:]):
        raise ValueError("invalid settings")
    return settings
