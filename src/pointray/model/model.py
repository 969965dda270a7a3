"""Models: points with a support each, and the tree over them. Users trace models.

Model : of points, in memory
PrebuiltModel : of arrays that exist already: a saved model, a level of detail
ModelInParts : of a folder; its parts are PartOnDisk, their levels of detail LevelOnDisk
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.arguments import check_callback, check_choice, check_path, check_positive, check_whole
from ..base.choices import AUTO, SURFACES
from ..base.deprecation import warn_renamed
from ..base.progress import StageProgress, in_stage
from ..base.registered import registered
from ..cloud.conversion import PointsLike, check_points
from ..cloud.denoising.smooth import check_sigma
from ..cloud.points import spread_rows
from ..cloud.preparation import check_model_memory, finite_rows
from ..engine.kernels.tree import SCATTER, Tree
from ..surface.splats.radii import check_radii
from ..surface.splats.scattered.levels import spacing_of
from ..surface.splats.scattered.spheres import check_drawing, check_mask
from ..surface.tree.settings import check_settings
from .building import BuildOptions, build_model, ignore_progress, rebuild_model
from .levels_of_detail import COARSER, make_levels
from .model_data import ModelData
from .model_file import place_of, read_model, write_model
from .model_folder import INDEX, PartFile, read_folder
from .residency import Key, ResidencyCache, Source
from .traceable import TraceableModel

SURFACE = "apss"  # the default: the only one of the three without bias (bench/surface/accuracy.py)
SAMPLE = 1 << 20  # the median radius of a model in parts is that of at most so many points


class Model(TraceableModel):
    """A point cloud prepared for ray tracing: each point gets a support, and a tree is built over the supports.

    Parameters
    ----------
    points : Points, or what `as_points` accepts
        Rows without a finite position are left out, with a warning. Missing normals are estimated; existing ones are
        used as they are, even if they deviate from the surface (`check_normals`).
    radii : (n,) array_like, optional
        Support radius of each point, in the unit of the positions. Default: chosen from the spacing of neighbouring
        points (part II of the paper).
    surface : {"paper", "imls", "apss", "disc"}, optional
        The implicit surface f = 0: planes blended from weighted mean positions and normals ("paper"), the weighted mean
        distance from the splats' planes ("imls"), a fitted sphere ("apss"), or flat discs without blending ("disc",
        figure 1a of the paper). Default: "apss".
    samples : int
        Samples of f along a ray over the diameter of a support, the paper's N: steps are at most radius * 2 / N.
    refine : int
        Number of secant steps that refine a hit after f has changed its sign between two samples. The paper has 0.
    trim : "auto", float or None
        A hit x counts only within this distance of P(x), the weighted mean of the splats' positions around it, in local
        radii. This removes phantom surface far from all points. "auto": 0.6 (0.95 where the radii are too small to
        cover the surface), and at most 0.2 radii beyond the splats of an open border, so that the surface does not
        extend past it. None: no limit, as in the paper.
    radius_scale : float
        Factor for all radii of the surface.
    smooth : "auto" or float
        Standard deviation of the positions' noise, in their unit. Splats lie on the surface estimated from noisy points
        and their neighbours (`pr.smooth`). Those of sparse second layers, such as of misaligned scans, lie on the
        surface beside them (https://pointray.readthedocs.io/page/strays.html). "auto": measured, locally; 0: positions
        are used as they are. With given radii "auto" is 0, and no layer is moved. Rows, attributes and `points` stay as
        given.
    scatter : {"auto", "spheres", "discs", "surface", "none"}
        How points that lie on no surface (leaves, wires, strays) are drawn: as spheres, as single flat discs
        perpendicular to their normals, as splats of the surface like all other points, or not at all. With given radii,
        spheres and discs have these. "auto": "spheres", but "surface" with given radii.
    scatter_size : float
        Factor for the radii of the points drawn as spheres or discs, which are 0.35 of the local spacing.
    progress : callable, optional
        Called as `progress(stage, share)` with the name of the stage and its completed share, 0 to 1.

    Attributes
    ----------
    parts : tuple of Model
        The parts of a model that `load` takes from a folder, each with the points of the whole and levels of detail of
        its own. A scene shows them as one model. Files are opened when they are needed. Empty for other models.

    Raises
    ------
    TypeError
        If an argument has the wrong type.
    ValueError
        If a shape, dtype or value is invalid, all points coincide and no radius is given, or more memory is needed than
        is available.

    References
    ----------
    Wald, Seidel: Interactive ray tracing of point-based models (2005).
    Kolluri: Provably good moving least squares (2005), for "imls".
    Guennebaud, Gross: Algebraic point set surfaces (2007), for "apss".

    Examples
    --------
    >>> model = pr.Model(pr.procedural("sphere", 1000), surface="imls")
    >>> model.radii.shape, model.surface
    ((1000,), 'imls')
    """

    levels: tuple[Model, ...] = ()
    parts: tuple[Model, ...] = ()

    def __init__(
        self,
        points: PointsLike,
        radii: ArrayLike | None = None,
        *,
        surface: str | None = None,
        samples: int = 4,
        refine: int = 1,
        trim: str | float | None = "auto",
        radius_scale: float = 1.0,
        smooth: str | float = "auto",
        scatter: str = AUTO,
        scatter_size: float = 1.0,
        progress: StageProgress | None = None,
        _scattered: ArrayLike | None = None,
    ) -> None:
        check_callback(progress)
        cloud = check_points(points)
        settings = check_settings(SURFACE if surface is None else surface, samples, refine, trim)
        scale = check_positive(radius_scale, "radius_scale")
        given = None if radii is None else check_radii(radii, len(cloud))
        smooth = check_sigma(smooth, "smooth")
        smooth = smooth if given is None or smooth != "auto" else 0.0
        drawing = check_drawing(scatter, scatter_size, given is not None)
        mask = check_mask(_scattered, len(cloud))
        check_model_memory(len(cloud))
        options = BuildOptions(settings, scale, smooth, drawing)
        self._data = build_model(cloud, finite_rows(cloud), given, mask, options, progress or ignore_progress)

    def rebuild(
        self,
        smooth: str | float,
        *,
        surface: str,
        samples: int = 4,
        refine: int = 1,
        radius_scale: float = 1.0,
        scatter: str | None = None,
        scatter_size: float | None = None,
        progress: StageProgress | None = None,
    ) -> Model:
        """Return a model of the same points with other settings.

        Radii, normals, noise and the set of points drawn apart from the surface (as spheres or discs) are reused,
        unless `smooth`, `scatter` or `scatter_size` change.

        Parameters
        ----------
        smooth : "auto" or float
            Standard deviation of the positions' noise, in their unit; 0: positions are used as they are.
        surface : {"paper", "imls", "apss", "disc"}
            The implicit surface, see `Model`.
        samples : int
            Samples of f along a ray over the diameter of a support.
        refine : int
            Number of secant steps that refine a hit.
        radius_scale : float
            Factor for all radii of the surface.
        scatter, scatter_size : optional
            How points that lie on no surface are drawn, and a factor for their radii, see `Model`. Default: as in this
            model.
        progress : callable, optional
            Called as `progress(stage, share)` with the name of the stage and its completed share, 0 to 1.

        Returns
        -------
        Model

        Raises
        ------
        TypeError
            If an argument has the wrong type.
        ValueError
            If a value is invalid, or for a model in parts.

        Examples
        --------
        >>> model = pr.Model(pr.procedural("sphere", 1000))
        >>> model.rebuild(0.0, surface="disc").surface
        'disc'
        """
        check_callback(progress)
        self.check_whole()
        scale, surface = check_positive(radius_scale, "radius_scale"), check_choice(surface, "surface", SURFACES)
        drawing = check_drawing(
            self.drawing.scatter if scatter is None else scatter,
            self.drawing.size if scatter_size is None else scatter_size,
        )
        smooth, report = check_sigma(smooth, "smooth"), progress or ignore_progress
        options = BuildOptions(check_settings(surface, samples, refine, "auto"), scale, smooth, drawing)
        if smooth == self.smooth and drawing == self.drawing:
            return PrebuiltModel(rebuild_model(self.data, options, report))
        check_model_memory(len(self.points))
        mask = self.scattered if self.tree.head[SCATTER] else None
        return PrebuiltModel(build_model(self.points, finite_rows(self.points), None, mask, options, report))

    def remade(self, *args: Any, **options: Any) -> Model:
        """Deprecated alias of `rebuild`: warn, and return a model of the same points with other settings."""
        warn_renamed("Model.remade", "Model.rebuild")
        return self.rebuild(*args, **options)

    def save(self, path: str | os.PathLike[str], progress: StageProgress | None = None) -> None:
        """Write the model, its tree and its levels of detail to a file for `Model.load`.

        Parameters
        ----------
        path : str or path
            Usually ends in .pointray. An existing file is replaced when the new one is complete.
        progress : callable, optional
            Called as `progress(stage, share)` with the name of the stage and its completed share, 0 to 1.

        Raises
        ------
        TypeError
            If an argument has the wrong type.
        OSError
            If the file cannot be written.
        ValueError
            For a model in parts.

        Examples
        --------
        >>> pr.Model(pr.procedural("sphere", 1000)).save("sphere.pointray")
        >>> pr.Model.load("sphere.pointray").surface
        'apss'
        """
        check_path(path)
        check_callback(progress)
        self.check_whole()
        stored = [model.data.to_stored() for model in (self, *self.levels)]
        write_model(path, stored, in_stage(progress, "writing") or (lambda share: None))
        self._saved = place_of(path), self.levels

    @classmethod
    def load(cls, path: str | os.PathLike[str], memory: int | None = None) -> Model:
        """Open a model written by `Model.save`, or a folder written by `pointray prepare IN -o city.pointray/`.

        Files are memory-mapped: the model is ready at once, whatever its size. They must not change while the model is
        in use. Parts and their levels of detail are opened and checked when they are first needed.

        Parameters
        ----------
        path : str or path
            A file, or a folder of parts.
        memory : int, optional
            Bytes of parts and levels of detail that stay open, for a model in parts. The least recently used ones are
            closed. What one call needs at once is opened nevertheless. Default: half of the available memory.

        Returns
        -------
        Model

        Raises
        ------
        TypeError
            If an argument has the wrong type.
        OSError
            If the file cannot be opened.
        ValueError
            If it is not a saved model, has another version, or is damaged.

        Examples
        --------
        >>> pr.Model(pr.procedural("sphere", 1000)).save("sphere.pointray")
        >>> model = pr.Model.load("sphere.pointray")
        >>> len(model.points)
        1000
        """
        budget = None if memory is None else check_whole(memory, "memory", 1, or_none=True)
        check_path(path)
        if os.path.isdir(path):
            return ModelInParts(path, budget)
        stored = read_model(path)
        try:
            model, *levels = (PrebuiltModel(ModelData.from_stored(level)) for level in stored)
        except (ValueError, TypeError) as error:
            raise ValueError(f"{path}: the model is damaged: {error}") from error
        model.levels = tuple(levels)
        model._saved = place_of(path), model.levels
        return model

    def make_levels(self, progress: StageProgress | None = None) -> None:
        """Make coarser versions of the model, its `levels`, for views in which points are finer than pixels.

        `levels` is a tuple of models from fine to coarse. Each has half as many points along a line as the one before.
        Images then show each instance in the level that fits its distance: less flicker in motion, higher frame rates.
        Levels have the surface "paper" with 2 samples over a support's diameter, as their points are about as far apart
        as pixels. The last level of a surface, of less than 700 points, is drawn as spheres. Memory grows by a third.
        `Settings(levels=False)` ignores levels.

        Parameters
        ----------
        progress : callable, optional
            Called as `progress(stage, share)` with the name of the stage and its completed share, 0 to 1.

        Raises
        ------
        TypeError
            If an argument has the wrong type.
        ValueError
            For a model in parts.

        Examples
        --------
        >>> model = pr.Model(pr.procedural("sphere", 5000))
        >>> model.make_levels()
        >>> len(model.levels) > 0
        True
        """
        check_callback(progress)
        self.check_whole()
        self.levels = tuple(PrebuiltModel(level) for level in make_levels(self.data, progress or ignore_progress))

    def to_mesh(self, resolution: int | None = None, progress: StageProgress | None = None) -> Any:
        """Return the surface as a closed triangle mesh, by marching cubes on a grid.

        The vertices lie on the surface that rays hit, on the edges of the grid. Neighbouring triangles share vertices,
        all triangles face outwards, and every edge has two (`is_watertight`). Details smaller than a cell, such as
        sharp edges and thin parts, are lost, and so are separate pieces smaller than three cells. Memory grows with the
        square of the resolution.

        Holes are closed where the surface encloses a place along at least two of the three axes, such as under a statue
        that was not scanned from below. A warning says so if more than 2% of the mesh's vertices close holes; if more
        than 40% do, the surface counts as open. Points drawn as spheres or discs are left out.

        Parameters
        ----------
        resolution : int, optional
            Number of cells along the longest side, 2 to 4096. Default: cells as wide as the median radius of the
            supports, about the spacing of the points, but at most 400.
        progress : callable, optional
            Called as `progress(stage, share)` with the name of the stage and its completed share, 0 to 1.

        Returns
        -------
        trimesh.Trimesh
            World coordinates, with the points' colours at the vertices if they have any. `mesh.export("statue.ply")`
            writes a file.

        Raises
        ------
        TypeError
            If an argument has the wrong type.
        ValueError
            If the surface is open and encloses nothing, like that of a terrain, if its normals point inward (flip them
            with `points.with_normals(-points.normals)`), if the resolution is out of its range, or for a model in
            parts.
        ImportError
            If trimesh or scikit-image is not installed: `pip install 'pointray[mesh]'`.

        Examples
        --------
        >>> mesh = pr.Model(pr.procedural("sphere", 1000)).to_mesh(20)
        >>> mesh.is_watertight, mesh.euler_number
        (True, 2)
        >>> path = mesh.export("sphere.ply")
        """
        return registered("meshing").mesh_model(self, resolution, progress)


class PrebuiltModel(Model):
    """A model of arrays that exist already, such as those of a saved model, a level of detail or a rebuilt model.

    Parameters
    ----------
    data : ModelData
        Arrays and settings of the model.
    levels : sequence of Model
        Its levels of detail, from fine to coarse.
    """

    def __init__(self, data: ModelData, levels: Sequence[Model] = ()) -> None:
        self._data, self.levels = data, tuple(levels)


class _OnDisk(Model):
    """A part of a model in a folder, or a level of detail of a part. Its file is opened whenever it is needed.

    source : the file, and the cache of open files through which it is opened
    """

    source: Source

    @cached_property
    def step(self) -> float:
        """Upper limit of the steps between a ray's samples, in the points' unit.

        It is the longest step in any part of the model, times 2 for each level of detail of this part: a level's steps
        are about twice as long as those of the next finer one.
        """
        return self.source.cache.step * COARSER ** len(self.levels)

    @cached_property
    def spacing(self) -> float:
        """Median radius of the splats in the file, in the points' unit, as the folder's index file states it."""
        return self.source.file.spacing

    @cached_property
    def longest(self) -> int:
        """Number of blocks in the longest leaf, as the folder's index file states it; kernels allocate memory by it."""
        return self.source.file.longest

    @property
    def nbytes(self) -> int:
        """Size in bytes of the file and of those of its levels of detail, whether they are open or not."""
        return self.source.file.nbytes + sum(level.nbytes for level in self.levels)

    def __reduce__(self) -> tuple[Any, ...]:
        return PrebuiltModel, (self.source.open(), self.levels)


class LevelOnDisk(_OnDisk):
    """A level of detail of one part of a model in a folder: a coarser version of the part, with points of its own."""

    def __init__(self, source: Source) -> None:
        self.source, self.levels = source, ()

    @property
    def data(self) -> ModelData:
        """Arrays and settings of the level, read from its file, which is opened if it is not open."""
        return self.source.open()


class PartOnDisk(_OnDisk):
    """A part of a model in a folder. Its tree is read from its file; its points are those of the whole model.

    Parameters
    ----------
    data : ModelData
        Arrays and settings of the whole model, with the bounds of the part.
    source : Source
        The file of the part, and the cache through which it is opened.
    levels : sequence of Model
        Levels of detail of the part, from fine to coarse.
    """

    def __init__(self, data: ModelData, source: Source, levels: Sequence[Model]) -> None:
        self._data, self.source, self.levels = data, source, tuple(levels)

    @property
    def tree(self) -> Tree:
        """The tree over the splats of the part and those of other parts that reach into it, read from its file."""
        return self.source.open().tree

    @property
    def has_surface(self) -> bool:
        """Whether rays can hit the part, according to the folder's index file."""
        return self._stored_bounds is not None

    @cached_property
    def surface_bounds(self) -> NDArray[np.float64]:
        """Bounds of all that rays can hit of the part, (2, 3) float64, relative to the origin, from the index file."""
        return self.data.empty_bounds if self._stored_bounds is None else np.array(self._stored_bounds)

    @property
    def _stored_bounds(self) -> list[list[float]] | None:
        """Bounds of all that rays can hit of the part, (2, 3), relative to the origin, from the folder's index file.

        None if rays cannot hit it.
        """
        file = self.source.file
        assert isinstance(file, PartFile)
        return file.reach


class ModelInParts(Model):
    """A model in a folder, in parts whose files are opened when they are needed; `Model.load` returns it for a folder.

    Parameters
    ----------
    path : str or path
        The folder.
    memory : int, optional
        Bytes of files that stay open. Default: half of the available memory.

    Raises
    ------
    OSError
        If a file cannot be opened.
    ValueError
        If the folder has no valid index, or is damaged.
    """

    def __init__(self, path: str | os.PathLike[str], memory: int | None = None) -> None:
        index, whole = read_folder(path)
        try:
            self._data = ModelData.from_stored(whole)
        except (ValueError, TypeError) as error:
            raise ValueError(f"{path}: the model is damaged: {error}") from error
        cache = ResidencyCache(Path(path).absolute(), index, whole, memory)
        parts = []
        for number, file in enumerate(index.parts):
            levels = [LevelOnDisk(Source(cache, Key(number, k + 1))) for k in range(len(file.levels))]
            data = self._data._replace(bounds=np.array(file.bounds))
            parts.append(PartOnDisk(data, Source(cache, Key(number, 0)), levels))
        self.parts, self.levels = tuple(parts), ()
        self._cache: ResidencyCache | None = cache  # None for copies, which hold the parts themselves
        self._scattered_points = index.scattered  # the last rows
        self._saved = place_of(path, INDEX), self.levels

    def __getstate__(self) -> dict[str, Any]:
        """Return the state for pickles and copies, without the cache of files; parts are pickled with their arrays."""
        return {**super().__getstate__(), "_cache": None}

    def check_whole(self) -> None:
        """Raise a ValueError: the caller needs a model in memory, and this one is in parts."""
        raise ValueError("this needs a model in memory, not one in parts: build it from the scan")

    @property
    def scattered(self) -> NDArray[np.bool_]:
        """Mask of the points drawn as spheres or as single discs, (n,) bool: the last rows. A new array."""
        mask = np.zeros(len(self.points), np.bool_)
        mask[len(mask) - self._scattered_points :] = True
        return mask

    @property
    def has_levels(self) -> bool:
        """Whether any part has levels of detail."""
        return any(part.levels for part in self.parts)

    @property
    def has_surface(self) -> bool:
        """Whether rays can hit any part."""
        return any(part.has_surface for part in self.parts)

    @cached_property
    def surface_bounds(self) -> NDArray[np.float64]:
        """Bounds of all that rays can hit of any part, (2, 3) float64, relative to the origin."""
        boxes = [part.surface_bounds for part in self.parts if part.has_surface]
        each = np.array(boxes or [self.data.bounds - self.points.origin])
        return np.stack([each[:, 0].min(axis=0), each[:, 1].max(axis=0)])

    @cached_property
    def spacing(self) -> float:
        """Median radius of the points on the surface, in the points' unit, from at most 2^20 evenly spread points.

        Reading all radii would take seconds. If all points are drawn as spheres or discs, it is the spacing that
        corresponds to the median of their radii.
        """
        count = len(self.radii) - self._scattered_points
        radii = self.radii[spread_rows(count or len(self.radii), SAMPLE)]
        return float(np.median(radii)) if count else spacing_of(radii, self.drawing)

    @cached_property
    def longest(self) -> int:
        """Number of blocks in the longest leaf of any part; kernels allocate memory by it."""
        return max(part.longest for part in self.parts)

    @property
    def nbytes(self) -> int:
        """Size in bytes of the points and of the files of all parts and levels of detail, also of those not open."""
        if self._cache is not None:
            return self.data.nbytes + sum(part.nbytes for part in self.parts)
        held = sum(array.nbytes for part in self.parts for array in part.tree)  # copies share the points
        return self.data.nbytes + held + sum(level.nbytes for part in self.parts for level in part.levels)

    @property
    def resident_bytes(self) -> int:
        """Size in bytes of the files of parts and levels of detail that are open.

        Of a copy of the model, which has no files, it is the size of all arrays.
        """
        return self.nbytes if self._cache is None else self._cache.nbytes
