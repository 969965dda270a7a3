"""The interface of models: what scenes, images and files read of one."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.arrays import Doubles, Flags, Floats
from ..cloud.points import Points
from ..engine.kernels.tree import Tree
from ..surface.splats.scattered.spheres import Drawing
from ..surface.tree.settings import TreeSettings
from ..surface.tree.stored import stored_splats
from .model_data import ModelData
from .model_file import Place
from .residency import Source


class TraceableModel:
    """Base class of models: what scenes, images and files read of one.

    Attributes
    ----------
    levels : tuple of TraceableModel
        Levels of detail, from fine to coarse, without the model itself.
    parts : tuple of TraceableModel
        Parts of a model in a folder. Empty for other models.
    source : Source or None
        The file of a part or level of detail that is on disk, and the cache through which it is opened.
    """

    levels: tuple[TraceableModel, ...] = ()
    parts: tuple[TraceableModel, ...] = ()
    source: Source | None = None
    _data: ModelData
    _saved: tuple[Place, tuple[TraceableModel, ...]] | None = None  # the file that holds it, and its levels then

    @property
    def data(self) -> ModelData:
        """Arrays and settings of the model."""
        return self._data

    @property
    def points(self) -> Points:
        """The points, as given."""
        return self.data.points

    @property
    def radii(self) -> Floats:
        """Support radius of each point, (n,) float32, in the unit of the positions; 0 for points that are left out."""
        return self.data.radii

    @property
    def tree(self) -> Tree:
        """The tree that rays traverse."""
        return self.data.tree

    @property
    def settings(self) -> TreeSettings:
        """The implicit surface, the samples along a ray, how far hits may lie from splats, and the voxel size."""
        return self.data.settings

    @property
    def surface(self) -> str:
        """The implicit surface: "paper" (blended planes), "imls" (mean distance), "apss" (fitted spheres) or "disc"."""
        return self.data.settings.surface

    @property
    def smooth(self) -> str | float:
        """Standard deviation of the noise that was removed from the positions, in their unit, or "auto": measured."""
        return self.data.smooth

    @property
    def drawing(self) -> Drawing:
        """How points that lie on no surface are drawn, such as "spheres" or "surface", and a factor for their radii."""
        return self.data.drawing

    @property
    def place(self) -> Place | None:
        """The file or folder that holds this model as it is now, None if there is none.

        Other processes open the model by it.
        """
        if self._saved is None or not self._saved[0].is_there:
            return None
        place, levels = self._saved
        return replace(place, leveled=bool(self.levels)) if self.levels is levels or not self.levels else None

    def check_whole(self) -> None:
        """Raise a ValueError if the model is in parts, for callers that need all arrays in memory.

        This class does nothing.
        """

    def align_tree(self) -> None:
        """Copy arrays of the tree whose memory is not aligned, such as those of a message: kernels cannot read them."""
        if not all(array.flags.aligned for array in self.tree):
            tree = Tree(*(np.require(array, requirements=["A", "C", "W"]) for array in self.tree))
            self._data = self.data._replace(tree=tree)

    @property
    def bounds(self) -> Doubles:
        """Least and greatest world coordinates of the points, (2, 3) float64."""
        return self.data.bounds.copy()

    @property
    def splats(self) -> tuple[Points, NDArray[np.int64]]:
        """The points as rays meet them: with the denoised positions and unit normals of their splats. New arrays.

        Returns
        -------
        points : Points
            The m points that have a splat.
        rows : (m,) int64
            The row of each in `points` of the model, ascending.
        """
        self.check_whole()
        rows, positions, normals, _ = stored_splats(self.tree)
        return self.points.select(rows).changed(positions=positions, normals=normals), rows

    @property
    def scattered(self) -> Flags:
        """Mask of the points drawn as spheres or as single discs, (n,) bool. A new array."""
        return self.data.scattered

    @property
    def has_levels(self) -> bool:
        """Whether the model, or a part of it, has levels of detail."""
        return bool(self.levels)

    @property
    def has_surface(self) -> bool:
        """Whether rays can hit the model."""
        return bool(self.tree.blocks.size)

    @cached_property
    def surface_bounds(self) -> Doubles:
        """Bounds of all that rays can hit, (2, 3) float64, relative to the origin: larger than those of the points."""
        return self.data.surface_bounds

    @cached_property
    def step(self) -> float:
        """Longest step of a ray's samples, in the points' unit: hits may lie this far outside `surface_bounds`."""
        return self.data.step

    @cached_property
    def spacing(self) -> float:
        """Median of `radii`, in the points' unit, without those of points drawn as spheres or discs.

        It stands for the spacing of the points. Radii chosen by the model are about 1.15 times the spacing of an even
        cloud, which is the square root of its area per point. Given radii and `radius_scale` change it. Rows that are
        left out count with radius 0 if no point is drawn as a sphere or disc.
        """
        return self.data.spacing

    @cached_property
    def longest(self) -> int:
        """Number of blocks in the longest leaf; kernels allocate memory by it."""
        return self.data.longest

    @property
    def nbytes(self) -> int:
        """Size in bytes of all arrays: points, radii, tree and levels of detail.

        Includes the files of a model in parts, whether they are open or not.
        """
        return self.data.nbytes + sum(level.nbytes for level in self.levels)

    @property
    def resident_bytes(self) -> int:
        """Bytes in use: of a model in parts, those of the parts and levels of detail that are open; else `nbytes`."""
        return self.nbytes

    def __getstate__(self) -> dict[str, Any]:
        """Return the state for pickles and copies: a copy, as another thread may compute a property meanwhile."""
        return self.__dict__.copy()

    def __repr__(self) -> str:
        parts = f" in {len(self.parts)} parts" if self.parts else ""
        return f"<Model: {len(self.points):,} points{parts}, surface {self.surface}, {self.nbytes / 2**20:.0f} MiB>"
