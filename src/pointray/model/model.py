"""Model: points with a support each, and the tree over them. Users trace models."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.arguments import check_callback, check_choice, check_path, check_positive, check_whole
from ..base.choices import AUTO, SURFACES
from ..cloud.denoising.smooth import Placed, check_sigma
from ..cloud.points import Points, spread_rows
from ..cloud.preparation import check_model_memory, finite_rows, placed_for_model
from ..engine.kernels.tree import LONGEST, SCATTER, Tree, no_tree
from ..surface.splats.build import Sizes, SplatBuild, check_size, make_splats
from ..surface.splats.levels import LEAST_GAIN, LEAST_POINTS, SUPPORT, coarsen
from ..surface.splats.radii import check_radii
from ..surface.splats.scattered.classification import find_scattered_placed, has_few_places
from ..surface.splats.scattered.levels import ScatteredPoints, coarsen_scattered, joined, spacing_of
from ..surface.splats.scattered.spheres import Drawing, check_drawing, check_mask, make_scattered
from ..surface.tree.build import Splats, build_tree
from ..surface.tree.scattered import scattered_of, scattered_rows, with_scattered
from ..surface.tree.settings import LOOSE_TRIM, check_settings, settings_of
from ..surface.tree.stored import find_surface_bounds, longest_leaf, stored_splats
from .model_file import Level, Place, place_of, read_model, write_model
from .model_folder import INDEX, read_folder
from .residency import Key, OnDisk, ResidencyCache, Source

SURFACE = "apss"  # the default: the one of the three without bias (measured in bench/)
LEVEL_SAMPLES = 2  # N of levels of detail: error and flicker of 4, in 0.86 (1,000 statues) to 0.92 (24) of the time
SAMPLE = 1 << 20  # of more radii of a model in parts the median is that of so many
COARSER = 2.0  # ratio of a level's cell size to that of the level before; for the first level to the model's spacing


class Model(OnDisk):
    """A point cloud made ready for rays: every point gets a support, and a tree is built over the supports.

    Parameters
    ----------
    points : Points or (n, 3) array_like
        Rows without a finite position are left out (with a warning); missing normals are estimated, existing ones are
        used, whether or not they are the surface's (`check_normals`).
    radii : (n,) array_like, optional
        Support radius of each point, in the unit of the positions. None: chosen (paper, part II).
    surface : {"paper", "imls", "apss", "disc"}, optional
        The implicit surface, see `surface/intersect/surface.py`; "disc" is the flat splats of the paper's figure 1a.
        None: "apss".
    samples : int
        Samples along a ray over a support's diameter, the paper's N: steps are radius * 2 / N or less.
    refine : int
        Secant steps after the bracket; 0 is the paper.
    trim : "auto", float or None
        A hit counts only where |x - P(x)| is at most this many local radii: it removes phantom surface. "auto": 0.6
        (0.95 where the radii are too small to cover the surface), and no farther than 0.2 out of the splats on an
        open border, so that no skirt grows. None: the paper.
    radius_scale : float
        Factor for all radii of the surface.
    smooth : "auto" or float
        Standard deviation of the points' noise, in their unit: splats lie on the surface that noisy points and their
        neighbours show (`pr.smooth`), and those of sparse second layers on the surface beside them (docs/strays.md).
        "auto": measured, place by place; 0: where the points are. With given radii "auto" is 0, and no layer is moved.
        Rows, attributes and `points` stay as given.
    scatter : {"auto", "spheres", "discs", "surface", "none"}
        How points are drawn that lie on no surface, such as those of leaves, wires and strays: as spheres, as single
        flat discs that face along their normals, as all others, or not at all. With given radii spheres and discs
        have these. "auto": spheres, but as all others with given radii.
    scatter_size : float
        Factor for the radii of scattered points, which are 0.35 of the local spacing.
    progress : callable, optional
        Called with the stage's name and the share done.

    Attributes
    ----------
    parts : tuple of Model
        Of a model in parts, which `load` takes from a folder: the parts, each with the points of the whole, and levels
        of detail of its own. A scene shows them as one model. What lies on disk is opened when it is asked for. Empty
        for others.

    Raises
    ------
    ValueError
        If a shape, dtype or value is wrong, all points coincide and no radius is given, or more memory is needed than
        is available.
    """

    parts: tuple[Model, ...] = ()
    _saved: tuple[Place, tuple[Model, ...]] | None = None  # the file that holds it, with which levels of detail
    drawing = Drawing()  # how scattered points are drawn
    _scattered_points = 0  # of a model in parts: how many of its points, the last ones, are scattered
    _residence: ResidencyCache[Model] | None = None  # of a model in parts: what is open of it

    def __init__(
        self,
        points: Points | ArrayLike,
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
        progress: Callable[[str, float], None] | None = None,
        _scattered: ArrayLike | None = None,
    ) -> None:
        check_callback(progress)
        self.points = points if isinstance(points, Points) else _points_of(points)
        surface = SURFACE if surface is None else surface
        self.settings = check_settings(surface, samples, refine, trim)
        self.surface = self.settings.surface
        scale = check_positive(radius_scale, "radius_scale")
        given = None if radii is None else check_radii(radii, len(self.points))
        smooth = check_sigma(smooth, "smooth")
        self.smooth: str | float = smooth if given is None or smooth != "auto" else 0.0
        say = progress or (lambda stage, share: None)
        self.levels: tuple[Model, ...] = ()
        check_model_memory(len(self.points))
        used = finite_rows(self.points)
        say("normals", 0.0)
        cloud = self.points if len(used) == len(self.points) else self.points.select(used)
        self.drawing = check_drawing(scatter, scatter_size, given is not None)
        mask = check_mask(_scattered, len(self.points))
        sizes, scattered, made = Sizes(None if given is None else given[used], scale), None, None
        found: NDArray[np.bool_] | None = None
        placed: list[Placed] = []  # the surface, if there is one
        if self.drawing.is_apart and (mask is not None or has_few_places(cloud.positions)):
            found = np.ones(len(used), np.bool_) if mask is None else mask[used]
        if found is None or not found.all():
            placed = [placed_for_model(cloud, self.smooth, given is None, partial(say, "normals"))]
        if found is None and self.drawing.is_apart:
            found = find_scattered_placed(cloud, placed[0], partial(say, "scattered points"))
        if found is not None and found.any():
            if self.drawing.scatter != "none":
                scattered = make_scattered(cloud, found, used, self.drawing, sizes.given)
            elif found.all():
                raise ValueError("scatter: none of the points is left, as all of them are scattered: choose spheres")
            placed = [] if found.all() else [placed[0].select(~found)]
            used, sizes = used[~found], sizes.select(~found)._replace(others=cloud.positions[found])
        if placed:  # `make_splats` alone holds the placed points, and frees them
            made = make_splats(placed.pop(), used, sizes, self.settings, partial(say, "radii"))
        self._build(made, say, scattered)

    def _build(
        self, made: SplatBuild | None, say: Callable[[str, float], None], scattered: Splats | None = None
    ) -> None:
        """Build the tree over splats of the model's points, and over scattered ones."""
        if made is not None and made.tight:
            self.settings = self.settings._replace(trim=LOOSE_TRIM)
        self._bounds = self.points.bounds
        self.radii: NDArray[np.float32] = np.zeros(len(self.points), np.float32)
        self.tree: Tree = no_tree(np.zeros(6, np.float32))
        if made is not None:
            self.radii[made.rows] = made.radii
            self.tree = build_tree(made.splats, self.settings, progress=partial(say, "tree"), in_order=True)
        if scattered is not None:
            check_size(scattered.radii, "scatter_size")
            self.radii[scattered.rows] = scattered.radii
            self.tree = with_scattered(self.tree, scattered, self.drawing.kind)

    def remade(
        self,
        smooth: str | float,
        *,
        surface: str,
        samples: int = 4,
        refine: int = 1,
        radius_scale: float = 1.0,
        scatter: str | None = None,
        scatter_size: float | None = None,
        progress: Callable[[str, float], None] | None = None,
    ) -> Model:
        """A model of the same points with other settings, see the class; scatter, scatter_size: None: as they are.

        Radii, normals and noise are not sought again, unless other noise is to be smoothed away, or scattered points
        are to be drawn otherwise; nor are scattered points, if this model has any.
        """
        check_callback(progress)
        self.check_whole()
        scale, surface = check_positive(radius_scale, "radius_scale"), check_choice(surface, "surface", SURFACES)
        options: dict[str, Any] = {"surface": surface, "samples": samples, "refine": refine}
        drawing = check_drawing(
            self.drawing.scatter if scatter is None else scatter,
            self.drawing.size if scatter_size is None else scatter_size,
        )
        if check_sigma(smooth, "smooth") != self.smooth or drawing != self.drawing:
            options |= {"scatter": drawing.scatter, "scatter_size": drawing.size}
            mask = self.scattered if self.tree.head[SCATTER] else None
            return Model(self.points, smooth=smooth, radius_scale=scale, progress=progress, _scattered=mask, **options)
        model = Model.__new__(Model)
        model.settings = check_settings(**options, trim="auto")
        model.points, model.surface, model.smooth, model.levels = self.points, surface, self.smooth, ()
        model.drawing = self.drawing
        used = np.flatnonzero(self.points.finite & (self.radii > 0) & ~self.scattered).astype(np.int32)
        sizes = Sizes(self.radii[used], scale)
        say = progress or (lambda stage, share: None)
        made = None
        if len(used):
            made = make_splats(self._placed(used), used, sizes, model.settings, partial(say, "radii"))
        model._build(made, say, scattered_of(self.tree, self.radii))
        return model

    def _placed(self, used: NDArray[np.int32]) -> Placed:
        """Some of the points, where they are met by rays: those that no splat stands for have the normal 0."""
        splats = stored_splats(self.tree)
        positions, normals = self.points.positions.copy(), np.zeros_like(self.points.positions)
        noise = np.zeros(len(positions), np.float32)
        positions[splats.rows], normals[splats.rows] = splats.positions, splats.normals
        noise[splats.rows] = 0.0 if splats.noise is None else splats.noise
        return Placed(self.points.changed(positions=positions, normals=normals).select(used), noise[used])

    def save(self, path: str | os.PathLike[str], progress: Callable[[float], None] | None = None) -> None:
        """Write the model, its tree and its levels of detail to a file that `load` maps.

        Parameters
        ----------
        path : str or path
            Usually ends in .pointray; the file is replaced when all is written.
        progress : callable, optional
            Called with the share done.

        Raises
        ------
        OSError
            If the file cannot be written.
        """
        check_path(path)
        check_callback(progress)
        self.check_whole()
        write_model(path, [model._kept() for model in (self, *self.levels)], progress or (lambda share: None))
        self._saved = place_of(path), self.levels

    def _kept(self) -> Level:
        settings = {**self.settings._asdict(), "smooth": self.smooth, **self.drawing.facts}
        return Level(settings, self.points, self.radii, self._bounds, self.tree)

    @classmethod
    def load(cls, path: str | os.PathLike[str], memory: int | None = None) -> Model:
        """A model that `save` has written, or a folder with one in parts (`pointray prepare IN -o city.pointray/`).

        It is mapped into memory: ready at once, whatever its size. The files must not change while the model is used.
        Parts, and their levels of detail, are opened and checked when they are first needed.

        Parameters
        ----------
        memory : int, optional
            Of a model in parts: how many bytes of parts and levels of detail stay open. The least recently used ones
            go. What a call needs at once is opened nevertheless. None: half of the memory that is available now.

        Raises
        ------
        OSError
            If the file cannot be opened.
        ValueError
            If it is no saved model, has another version, or is damaged.
        """
        budget = None if memory is None else check_whole(memory, "memory", 1, or_none=True)
        check_path(path)
        if os.path.isdir(path):
            return cls._in_parts(path, budget)
        kept = read_model(path)
        try:
            model, *levels = (cls._restore(level) for level in kept)
        except (ValueError, TypeError) as error:
            raise ValueError(f"{path}: the model is damaged: {error}") from error
        model.levels = tuple(levels)
        model._saved = place_of(path), model.levels
        return model

    @property
    def place(self) -> Place | None:
        """The file that holds this model as it is now, if there is one."""
        if self._saved is None or not self._saved[0].is_there:
            return None
        place, levels = self._saved
        return replace(place, leveled=bool(self.levels)) if self.levels is levels or not self.levels else None

    @classmethod
    def _in_parts(cls, path: str | os.PathLike[str], budget: int | None) -> Model:
        """A model in parts, from a folder."""
        index, whole = read_folder(path)
        try:
            model = cls._restore(whole)
        except (ValueError, TypeError) as error:
            raise ValueError(f"{path}: the model is damaged: {error}") from error
        residence = ResidencyCache(Path(path).absolute(), index, whole, cls._restore, budget)
        parts = []
        for number, file in enumerate(index.parts):
            part = cls._restore(whole._replace(bounds=np.array(file.bounds)))
            del part.tree
            part._source = Source(residence, Key(number, 0))
            sources = [Source(residence, Key(number, level + 1)) for level in range(len(file.levels))]
            part.levels = tuple(cls._on_disk(source) for source in sources)
            parts.append(part)
        model.parts, model._residence = tuple(parts), residence
        model._scattered_points, model._saved = index.scattered, (place_of(path, INDEX), model.levels)
        return model

    @classmethod
    def _on_disk(cls, source: Source) -> Model:
        """A level of detail of a part."""
        level = cls.__new__(cls)
        level._source, level.levels = source, ()
        return level

    @property
    def resident_bytes(self) -> int:
        """Of a model in parts: bytes of the parts and levels of detail that are open; of others: all of `nbytes`."""
        return self.nbytes if self._residence is None else self._residence.nbytes

    @classmethod
    def _restore(cls, level: Level) -> Model:
        model = cls.__new__(cls)
        settings = dict(level.settings)
        model.smooth = check_sigma(settings.pop("smooth", 0.0), "smooth")
        model.drawing = check_drawing(settings.pop("scatter", "surface"), settings.pop("scatter_size", 1.0))
        model.settings = settings_of(settings)
        model.points, model.radii, model._bounds, model.tree = level.points, level.radii, level.bounds, level.tree
        model.surface, model.levels = model.settings.surface, ()
        return model

    def make_levels(self, progress: Callable[[str, float], None] | None = None) -> None:
        """Make coarser versions for where points are finer than pixels: each has half as many points along a line.

        Pictures then show each instance in the level that fits its distance: less flicker in films, more frames a
        second. The levels have the surface "paper", with N = 2: their points are about as far apart as pixels. Memory
        grows by a third. `Settings(levels=False)` ignores them.

        Attributes
        ----------
        levels : tuple of Model
            From fine to coarse, without the model itself.
        """
        check_callback(progress)
        self.check_whole()
        say = progress or (lambda stage, share: None)
        rows, positions, normals, noise = stored_splats(self.tree, by_row=False)
        points = self.points
        colors = None if points.colors is None else points.colors[rows]
        attributes = {name: values[rows] for name, values in points.attributes.items()}
        cloud = Points.about(points.origin, positions, normals, colors, attributes, points.survey)
        radii, levels, some = self.radii[rows], [], self.scattered[rows]
        fine: Points | None = cloud
        loose: ScatteredPoints | None = None
        if some.any():
            loose = ScatteredPoints(cloud.select(some), radii[some])
            fine = None if some.all() else cloud.select(~some)
            radii, noise = radii[~some], None if noise is None else noise[~some]
        spacing, count, limits = self.spacing if fine is None else float(np.median(radii)), len(rows), radii
        while True:
            spacing *= COARSER
            if fine is not None:
                fine, limits, noise = coarsen(fine, radii, spacing, noise)
            loose = None if loose is None else coarsen_scattered(loose, spacing)
            before, count = count, (0 if fine is None else len(fine)) + (0 if loose is None else len(loose.points))
            if count < LEAST_POINTS or count * LEAST_GAIN > before:
                break
            say("levels", 1.0 - count / len(self.points))
            drawing = self.drawing if loose is None else loose.drawing(self.drawing.scatter, spacing)
            placed = None if fine is None else Placed(fine, noise)
            levels.append(Model._level(placed, (SUPPORT * spacing, limits), loose, drawing))
            radii = levels[-1].radii[: len(limits)]
        self.levels = tuple(levels)

    @classmethod
    def _level(
        cls,
        placed: Placed | None,
        within: tuple[float, NDArray[np.float32]],
        loose: ScatteredPoints | None = None,
        drawing: Drawing = Drawing(),  # noqa: B008  # never changes
    ) -> Model:
        """A level of detail. Its supports have limits: isolated points stay about as small as they were."""
        model, fine = cls.__new__(cls), None if placed is None else placed.points
        model.points = joined(fine, None if loose is None else loose.points)
        model.surface, model.levels, model.smooth, model.drawing = "paper", (), 0.0, drawing
        model.settings = check_settings(model.surface, LEVEL_SAMPLES, 1, "auto")
        made, count = None, 0
        if placed is not None:
            count = len(placed.points)
            made = make_splats(placed, np.arange(count, dtype=np.int32), Sizes(within=within), model.settings)
        # Normals are not mended: neighbours may face opposite sides.
        model._build(made, lambda stage, share: None, None if loose is None else loose.splats(count))
        return model

    def check_whole(self) -> None:
        """ValueError for a model in parts."""
        if self.parts:
            raise ValueError("this needs a model as a whole, not one in parts: prepare the scan anew")

    def __getstate__(self) -> dict[str, Any]:
        """State for pickles and copies, with all that lies on disk.

        It is a copy, as another thread may compute `reach` for the first time.
        """
        state = self._state()
        state.pop("_residence", None)
        return state

    @property
    def bounds(self) -> NDArray[np.float64]:
        """Least and greatest world coordinates of the points, (2, 3) float64."""
        return self._bounds.copy()

    @property
    def splats(self) -> tuple[Points, NDArray[np.int64]]:
        """The points as rays meet them: moved where they are noisy, with unit normals. New arrays.

        Returns
        -------
        points : Points
        rows : (m,) int64
            The row of each in `points`, ascending.
        """
        self.check_whole()
        rows, positions, normals, _ = stored_splats(self.tree)
        return self.points.select(rows).changed(positions=positions, normals=normals), rows

    @property
    def scattered(self) -> NDArray[np.bool_]:
        """Which points are drawn as spheres or as single discs, (n,) bool; a new array."""
        mask = np.zeros(len(self.points), np.bool_)
        if self.parts:
            mask[len(mask) - self._scattered_points :] = True
        else:
            mask[scattered_rows(self.tree)] = True
        return mask

    @property
    def has_levels(self) -> bool:
        """Whether it, or a part of it, has levels of detail."""
        return bool(self.levels) or any(part.levels for part in self.parts)

    @property
    def has_surface(self) -> bool:
        """Whether rays can hit it."""
        if self.source is None:
            return bool(self.tree.blocks.size) or any(part.has_surface for part in self.parts)
        return self.told_reach is not None

    @cached_property
    def reach(self) -> NDArray[np.float64]:
        """Bounds of all that rays can hit, (2, 3) float64 about the origin: the surface extends beyond the points."""
        if self.parts:
            each = np.array(
                [part.reach for part in self.parts if part.has_surface] or [self._bounds - self.points.origin]
            )
            return np.stack([each[:, 0].min(axis=0), each[:, 1].max(axis=0)])
        if self.told_reach is not None:
            return np.array(self.told_reach)
        reach = find_surface_bounds(self.tree)
        if reach is None:  # no surface: a box without size
            return np.repeat(self._bounds[:1] - self.points.origin, 2, axis=0)
        return reach

    @cached_property
    def step(self) -> float:
        """The longest step of a ray's samples, in the points' unit: hits may lie this far outside of `reach`.

        Of a part on disk also that of its levels of detail, about: each has steps twice as long.
        """
        if self.source is None:
            return float(self.tree.head[LONGEST])
        return self.source.residence.step * COARSER ** len(self.levels)

    @cached_property
    def spacing(self) -> float:
        """The median of `radii`, in the points' unit; rows that are left out count with radius 0.

        It stands for the spacing of the points. Radii that the model chose are about 1.15 times the spacing of an even
        cloud, the root of its area per point. Given radii and `radius_scale` make it larger or smaller.
        """
        if self.source is not None:
            return self.source.file.spacing
        radii = self.radii
        if self.parts:  # reading all of them would take seconds
            count = len(radii) - self._scattered_points
            radii = radii[spread_rows(count or len(radii), SAMPLE)]
            if not count:
                return spacing_of(radii, self.drawing)
        elif self.tree.head[SCATTER]:
            scattered = self.scattered
            surface = radii[~scattered & (radii > 0)]
            return float(np.median(surface)) if len(surface) else spacing_of(radii[scattered], self.drawing)
        return float(np.median(radii))

    @cached_property
    def longest(self) -> int:
        """The number of blocks in the longest leaf."""
        if self.source is not None:
            return self.source.file.longest
        return max([longest_leaf(self.tree), *(part.longest for part in self.parts)])

    @property
    def nbytes(self) -> int:
        """Bytes of every array: the points, their radii, the tree, and the levels.

        Of a model in parts also of what is not open, as large as the files are.
        """
        if self.source is not None:
            return self.source.file.nbytes + sum(level.nbytes for level in self.levels)
        points = self.points
        arrays = [points.positions, points.normals, points.colors, *points.attributes.values(), self.radii, *self.tree]
        held = sum(array.nbytes for array in arrays if array is not None)
        if self._residence is None and self.parts:  # copies, which share the points
            held += sum(array.nbytes for part in self.parts for array in part.tree)
            return held + sum(level.nbytes for part in self.parts for level in part.levels)
        return held + sum(model.nbytes for model in (*self.levels, *self.parts))

    def __repr__(self) -> str:
        parts = f" in {len(self.parts)} parts" if self.parts else ""
        return f"<Model: {len(self.points):,} points{parts}, surface {self.surface}, {self.nbytes / 2**20:.0f} MiB>"


def _points_of(positions: ArrayLike) -> Points:
    try:
        return Points(positions)
    except ValueError as error:
        raise ValueError(f"points: {error}") from None
