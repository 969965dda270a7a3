"""The splats of a model as points, for files of Gaussian splats."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..base.progress import Progress, report_progress
from ..cloud.points import Points
from ..io.formats.splats._flat import ALPHA, BALL, RADIUS, WIDTH
from ..surface.tree.stored import stored_splats
from .model import Model


def splat_points(model: Model, colors: NDArray[np.uint8] | None = None, progress: Progress | None = None) -> Points:
    """Return the points of a model that have a splat, as writers of Gaussian splats expect them.

    Positions are denoised. Points drawn as spheres have the normal 0. The attributes are `radius` and, if the
    points have it, `opacity`.

    Parameters
    ----------
    model : Model
        In memory or in parts, whose files are opened one after the other.
    colors : (n, 3) uint8, optional
        sRGB of all points of the model. Default: their own.
    progress : callable, optional
        Called with the completed fraction.
    """
    points, scattered = model.points, model.scattered
    positions, normals = points.positions.copy(), np.zeros_like(points.positions)
    there, parts = np.zeros(len(points), np.bool_), model.parts or (model,)
    for number, part in enumerate(parts):
        if part.has_surface:
            splats = stored_splats(part.tree)
            positions[splats.rows], normals[splats.rows], there[splats.rows] = splats.positions, splats.normals, True
        report_progress(progress, (number + 1) / len(parts))
    radii = model.radii.copy()
    if model.drawing.scatter == "discs":
        radii[scattered] *= np.float32(BALL / WIDTH)  # single discs are as large as spheres
    else:
        normals[scattered] = 0
    shades = points.colors if colors is None else colors
    attributes = {RADIUS: radii} | {name: points.attributes[name] for name in (ALPHA,) if name in points.attributes}
    cloud = Points.about(points.origin, positions, normals, shades, attributes, points.georeference)
    return cloud if there.all() else cloud.select(np.flatnonzero(there))
