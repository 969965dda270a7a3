"""Model: points with a support each, and the tree over them. Users trace models."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .arguments import check_callback, check_choice, check_number, check_path, check_positive, check_whole
from .choices import SURFACES
from .data import FARTHEST, Points
from .kernels.tree import BLOCK, NODE, WIDTH, Tree
from .memory import check_memory
from .model_file import Part, read_model, write_model
from .points.smoothing.smooth import check_sigma, smooth_model
from .points.strays import merge_for_model
from .progress import Progress, part_of
from .splats.levels import LEAST_GAIN, LEAST_POINTS, SUPPORT, THIN, coarsen
from .splats.radii import check_radii
from .splats.support import CROWD, find_support
from .tree.build import Splats, TreeSettings, build_tree

SURFACE = "apss"  # the default: the one of the three without bias (measured in bench/)
TRIM = 0.6  # trim="auto": largest |x - P(x)| of a hit, in local radii (docs/decisions/surface.md)
LOOSE_TRIM = 0.95  # the same, where the radii are too small to cover the surface, which then lies in gaps
LEVEL_SAMPLES = 2  # N of levels of detail: error and flicker of 4, in 0.86 (1,000 statues) to 0.92 (24) of the time
COARSER = 2.0  # ratio of a level's cell size to that of the level before; for the first level to the model's spacing
OVERHANG = 0.2  # trim="auto": how far a hit may lie out of an open border, in local radii (docs/decisions/radii.md)
SMALLEST, LARGEST = 1e-12, 1e12  # limits of a radius
LARGEST_SAMPLES, LARGEST_REFINE = 64, 16
MERGED = 0.15  # share of the time for normals until second layers are merged
PEAK = 300  # bytes a point beyond the points, while radii are found: 274 to 330 of 500,000, 262 of 2 million
SMALL = 1 << 16  # points from which memory is asked for: fewer take less than kernels do
WAYS_OUT = "use fewer points: --max-points, --every, or what `pointray prepare --tolerance` leaves on a larger machine"


class Model:
    """A point cloud made ready for rays: every point gets a support, and a tree is built over the supports.

    Parameters
    ----------
    points : Points or (n, 3) array_like
        Rows without a finite position are left out (with a warning); missing normals are estimated, existing ones are
        used, whether or not they are the surface's (`check_normals`).
    radii : (n,) array_like, optional
        Support radius of each point, in the unit of the positions. None: chosen (paper, part II).
    surface : {"paper", "imls", "apss", "disc"}, optional
        The implicit surface, see `pointray.intersect.surface`; "disc" is the flat splats of the paper's figure 1a.
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
        Factor for all radii.
    smooth : "auto" or float
        Standard deviation of the points' noise, in their unit: splats lie on the surface that noisy points and their
        neighbours show (`pr.smooth`), and those of sparse second layers on the surface beside them (docs/strays.md).
        "auto": measured, place by place; 0: where the points are. With given radii "auto" is 0, and no layer is moved.
        Rows, attributes and `points` stay as given.
    progress : callable, optional
        Called with the stage's name and the share done.

    Raises
    ------
    ValueError
        If a shape, dtype or value is wrong, all points coincide and no radius is given, or more memory is needed than
        is available.
    """

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
        progress: Callable[[str, float], None] | None = None,
    ) -> None:
        check_callback(progress)
        self.points = points if isinstance(points, Points) else _points_of(points)
        surface = SURFACE if surface is None else surface
        self.settings = _check_settings(surface, samples, refine, trim)
        self.surface = self.settings.surface
        scale = check_positive(radius_scale, "radius_scale")
        given = None if radii is None else check_radii(radii, len(self.points))
        smooth = check_sigma(smooth, "smooth")
        self.smooth: str | float = smooth if given is None or smooth != "auto" else 0.0
        say = progress or (lambda stage, share: None)
        self.levels: tuple[Model, ...] = ()
        _check_memory(len(self.points))
        self._build(given, scale, None, say)

    def _build(
        self,
        given: NDArray[np.float32] | None,
        scale: float,
        within: tuple[float, NDArray[np.float32]] | None,
        say: Callable[[str, float], None],
        made: Model | None = None,
    ) -> None:
        """Find the supports, see `find_support`, and build the tree.

        made : a model of the same points whose splats lie where they shall
        """
        used = np.flatnonzero(self.points.finite).astype(np.int32)
        lost = len(self.points) - len(used)
        if lost:
            warnings.warn(
                f"{lost:,} of {len(self.points):,} points have no finite position below {FARTHEST:g}: left out",
                stacklevel=3,
            )
        cloud = self.points.select(used) if lost else self.points
        say("normals", 0.0)
        if within is None:  # averaged normals are not mended: neighbours on a thin body may face opposite sides
            cloud = made._moved(used) if made else self._smoothed(cloud, given is None, partial(say, "normals"))
        normals = np.asarray(cloud.normals)
        say("radii", 0.0)
        automatic = self.settings.overhang < np.inf
        support = find_support(
            cloud.positions,
            normals,
            None if given is None else given[used],
            scale,
            borders=automatic,
            sheets=automatic and (self.surface != "paper" or within is not None),
            within=within,
            progress=partial(say, "radii"),
        )
        if within is not None and support.sheets is not None and support.sheets.mean() < THIN:
            support = support._replace(sheets=None)
        if support.tight:
            self.settings = self.settings._replace(trim=LOOSE_TRIM)
        self.radii: NDArray[np.float32] = np.zeros(len(self.points), np.float32)
        self.radii[used] = support.radii
        _check_size(support.radii)
        if support.note and within is None:
            warnings.warn(support.note, stacklevel=3)
        splats = _not_crowded(
            Splats(cloud.positions, normals, support.radii, used, cloud.colors, support.borders, support.sheets),
            support.crowded,
        )
        self.tree: Tree = build_tree(splats, self.settings, progress=lambda share: say("tree", share))
        self._bounds = self.points.bounds

    def _smoothed(self, points: Points, merge: bool, progress: Progress) -> Points:
        """Points with unit normals, repaired or estimated where needed, on the surface where they are noisy.

        merge : whether second layers may be moved onto the surface, unless nothing is to be smoothed
        """
        merge = merge and self.smooth != 0
        if merge:
            points = merge_for_model(points, part_of(progress, 0.0, MERGED))
        smoothed, message = smooth_model(points, self.smooth, part_of(progress, MERGED, 1.0) if merge else progress)
        if message:
            warnings.warn(message, stacklevel=4)
        return smoothed

    def remade(
        self,
        smooth: str | float,
        *,
        surface: str,
        samples: int = 4,
        refine: int = 1,
        radius_scale: float = 1.0,
        progress: Callable[[str, float], None] | None = None,
    ) -> Model:
        """A model of the same points with other settings, see the class. Radii, normals and noise are not sought again,
        unless other noise is to be smoothed away.
        """
        check_callback(progress)
        scale, surface = check_positive(radius_scale, "radius_scale"), check_choice(surface, "surface", SURFACES)
        options: dict[str, Any] = {"surface": surface, "samples": samples, "refine": refine}
        if check_sigma(smooth, "smooth") != self.smooth:
            return Model(self.points, smooth=smooth, radius_scale=scale, progress=progress, **options)
        model = Model.__new__(Model)
        model.settings = _check_settings(**options, trim="auto")
        model.points, model.surface, model.smooth, model.levels = self.points, surface, self.smooth, ()
        model._build(self.radii, scale, None, progress or (lambda stage, share: None), self)
        return model

    def _moved(self, used: NDArray[np.int32]) -> Points:
        """Some of the points, where they are met by rays: those that no splat stands for have the normal 0."""
        splats, rows = self.splats
        assert splats.normals is not None
        positions, normals = self.points.positions.copy(), np.zeros_like(self.points.positions)
        positions[rows], normals[rows] = splats.positions, splats.normals
        return self.points.changed(positions=positions, normals=normals).select(used)

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
        write_model(path, [model._part() for model in (self, *self.levels)], progress or (lambda share: None))

    def _part(self) -> Part:
        return Part(
            {**self.settings._asdict(), "smooth": self.smooth}, self.points, self.radii, self._bounds, self.tree
        )

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Model:
        """A model that `save` has written, mapped into memory: it is ready at once, whatever its size.

        The file must not change while the model is used.

        Raises
        ------
        OSError
            If the file cannot be opened.
        ValueError
            If it is no saved model, has another version, or is damaged.
        """
        check_path(path)
        parts = read_model(path)
        try:
            model, *levels = (cls._restore(part) for part in parts)
        except (ValueError, TypeError) as error:
            raise ValueError(f"{path}: the model is damaged: {error}") from error
        model.levels = tuple(levels)
        return model

    @classmethod
    def _restore(cls, part: Part) -> Model:
        model = cls.__new__(cls)
        settings = dict(part.settings)
        model.smooth = check_sigma(settings.pop("smooth", 0.0), "smooth")
        model.settings = _settings_of(settings)
        model.points, model.radii, model._bounds, model.tree = part.points, part.radii, part.bounds, part.tree
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
        say = progress or (lambda stage, share: None)
        cloud, rows = self.splats
        radii, levels = self.radii[rows], []
        spacing = float(np.median(radii))
        while True:
            spacing *= COARSER
            coarse, limits = coarsen(cloud, radii, spacing)
            if len(coarse) < LEAST_POINTS or len(coarse) * LEAST_GAIN > len(cloud):
                break
            say("levels", 1.0 - len(coarse) / len(self.points))
            levels.append(Model._level(coarse, (SUPPORT * spacing, limits)))
            cloud, radii = coarse, levels[-1].radii
        self.levels = tuple(levels)

    @classmethod
    def _level(cls, points: Points, within: tuple[float, NDArray[np.float32]]) -> Model:
        """A level of detail. Its supports have limits: isolated points stay about as small as they were."""
        model = cls.__new__(cls)
        model.points, model.surface, model.levels, model.smooth = points, "paper", (), 0.0
        model.settings = _check_settings(model.surface, LEVEL_SAMPLES, 1, "auto")
        model._build(None, 1.0, within, lambda stage, share: None)
        return model

    def __getstate__(self) -> dict[str, Any]:
        """State for pickles and copies; it is a copy, as another thread may compute `reach` for the first time."""
        return self.__dict__.copy()

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
        order = self.tree.order.reshape(-1)
        at = np.flatnonzero(order >= 0)
        at = at[np.argsort(order[at])]
        rows = order[at].astype(np.int64)
        table = self.tree.blocks.reshape(-1, BLOCK // 4, 4).transpose(0, 2, 1).reshape(-1, BLOCK // 4)[at]
        return self.points.select(rows).changed(positions=table[:, :3], normals=table[:, 3:6]), rows

    @cached_property
    def reach(self) -> NDArray[np.float64]:
        """Bounds of all that rays can hit, (2, 3) float64 about the origin: the surface extends beyond the points."""
        root = self.tree.boxes[:NODE].reshape(2, 3, WIDTH)
        return np.stack([root[0].min(axis=1), root[1].max(axis=1)]).astype(np.float64)

    @cached_property
    def spacing(self) -> float:
        """The median of `radii`, in the points' unit; rows that are left out count with radius 0.

        It stands for the spacing of the points. Radii that the model chose are about 1.15 times the spacing of an even
        cloud, the root of its area per point. Given radii and `radius_scale` make it larger or smaller.
        """
        return float(np.median(self.radii))

    @cached_property
    def longest(self) -> int:
        """The number of blocks in the longest leaf."""
        return 16 * int(self.tree.spans[1::2].max())

    @property
    def nbytes(self) -> int:
        """Bytes of every array held: the points, their radii, the tree, and the levels."""
        points = self.points
        arrays = [points.positions, points.normals, points.colors, *points.attributes.values(), self.radii, *self.tree]
        return sum(array.nbytes for array in arrays if array is not None) + sum(level.nbytes for level in self.levels)

    def __repr__(self) -> str:
        return f"<Model: {len(self.points):,} points, surface {self.surface}, {self.nbytes / 2**20:.0f} MiB>"


def _points_of(positions: ArrayLike) -> Points:
    try:
        return Points(positions)
    except ValueError as error:
        raise ValueError(f"points: {error}") from None


def _check_memory(count: int) -> None:
    """ValueError if the memory that so many points take while a model is made of them is not available."""
    if count < SMALL:
        return
    try:
        check_memory(PEAK * count, f"to make a model of {count:,} points")
    except ValueError as error:
        raise ValueError(f"{error}; {WAYS_OUT}") from None


def _not_crowded(splats: Splats, crowded: NDArray[np.bool_]) -> Splats:
    """The splats without the crowded ones, with a warning if there are any."""
    lost = int(crowded.sum())
    if not lost:
        return splats
    warnings.warn(f"{lost:,} points lie where {CROWD} others do: left out", stacklevel=4)
    arrays: list[Any] = [None if array is None else np.ascontiguousarray(array[~crowded]) for array in splats]
    return Splats(*arrays)


def _check_size(radii: NDArray[np.float32]) -> None:
    """Check that the squares of radii and their inverses stay within float32."""
    if radii.min() < SMALLEST or radii.max() > LARGEST:
        raise ValueError(
            f"radii reach from {radii.min():.3g} to {radii.max():.3g} with radius_scale: "
            f"they must be from {SMALLEST:g} to {LARGEST:g}"
        )


def _check_settings(surface: str, samples: int, refine: int, trim: str | float | None) -> TreeSettings:
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


def _settings_of(values: dict[str, Any]) -> TreeSettings:
    """Settings from the form in which a file keeps them."""
    settings = TreeSettings(**values)
    if settings.surface not in SURFACES or not all(isinstance(value, int | float) for value in settings[1:]):
        raise ValueError("its settings are unknown")
    return settings
