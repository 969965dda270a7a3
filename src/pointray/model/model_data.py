"""Arrays and settings of a model that is built: what files store and rays read."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..base.arrays import Doubles, Flags, Floats
from ..cloud.denoising.smooth import check_sigma
from ..cloud.points import Points
from ..engine.kernels.tree import LONGEST, SCATTER, Tree
from ..surface.splats.scattered.levels import spacing_of
from ..surface.splats.scattered.spheres import Drawing, check_drawing
from ..surface.tree.scattered import scattered_rows
from ..surface.tree.settings import TreeSettings, settings_of
from ..surface.tree.stored import find_surface_bounds, longest_leaf
from .model_file import Level


class ModelData(NamedTuple):
    """Arrays and settings of a model that is built: what rays, images and files read.

    settings : the implicit surface, the samples along a ray and the voxel size
    smooth : standard deviation of the noise that was removed from the positions, or "auto"
    drawing : how points that lie on no surface are drawn, such as spheres
    points, radii : the n points as given; (n,) float32 support radii, 0 for points without a splat
    bounds : (2, 3) float64, of the points, world
    tree : over the splats; without splats for a model in parts, whose parts have a tree each
    """

    settings: TreeSettings
    smooth: str | float
    drawing: Drawing
    points: Points
    radii: Floats
    bounds: Doubles
    tree: Tree

    @classmethod
    def from_stored(cls, stored: Level) -> ModelData:
        """Return the data of a model or level of detail that was read from a file.

        Raises
        ------
        ValueError, TypeError
            If a stored setting is invalid.
        """
        settings = dict(stored.settings)
        smooth = check_sigma(settings.pop("smooth", 0.0), "smooth")
        drawing = check_drawing(settings.pop("scatter", "surface"), settings.pop("scatter_size", 1.0))
        return cls(settings_of(settings), smooth, drawing, *stored[1:])

    def to_stored(self) -> Level:
        """Return the data in the form that `write_model` stores: settings as a dict of JSON types, and the arrays."""
        settings = {**self.settings._asdict(), "smooth": self.smooth, **self.drawing.facts}
        return Level(settings, *self[3:])

    @property
    def nbytes(self) -> int:
        """Size of all arrays in bytes."""
        points = self.points
        arrays = [points.positions, points.normals, points.colors, *points.attributes.values(), self.radii, *self.tree]
        return sum(array.nbytes for array in arrays if array is not None)

    @property
    def empty_bounds(self) -> Doubles:
        """Bounds of a model that no ray can hit, (2, 3), relative to the origin: its points' lower corner, twice."""
        return np.repeat(self.bounds[:1] - self.points.origin, 2, axis=0)

    @property
    def surface_bounds(self) -> Doubles:
        """Bounds of all that rays can hit, (2, 3) float64, relative to the origin."""
        found = find_surface_bounds(self.tree)
        return self.empty_bounds if found is None else found

    @property
    def scattered(self) -> Flags:
        """Mask of the points drawn as spheres or as single discs, (n,) bool."""
        mask = np.zeros(len(self.points), np.bool_)
        mask[scattered_rows(self.tree)] = True
        return mask

    @property
    def spacing(self) -> float:
        """Median radius of the points on the surface, in the points' unit, which stands for their spacing.

        If no point is drawn as a sphere or disc, rows without a splat count with radius 0; otherwise they are left out.
        If all points are drawn as spheres or discs, it is the spacing that corresponds to the median of their radii.
        """
        if not self.tree.head[SCATTER]:
            return float(np.median(self.radii))
        scattered = self.scattered
        surface = self.radii[~scattered & (self.radii > 0)]
        return float(np.median(surface)) if len(surface) else spacing_of(self.radii[scattered], self.drawing)

    @property
    def step(self) -> float:
        """Longest step between a ray's samples in any voxel, in the points' unit."""
        return float(self.tree.head[LONGEST])

    @property
    def longest(self) -> int:
        """Number of blocks in the longest leaf; kernels allocate memory by it."""
        return longest_leaf(self.tree)
