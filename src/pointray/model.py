"""Model: points with a support each, and the tree over them. Users trace models."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .arguments import check_callback, check_choice, check_path, check_positive
from .choices import SURFACES
from .data import FARTHEST, Points
from .kernels.tree import NODE, WIDTH, Tree
from .memory import check_memory, give_back
from .model_file import Part, read_model, write_model
from .points.smoothing.smooth import Placed, check_sigma, place
from .points.strays import merge_for_model
from .progress import Progress, part_of
from .splats.levels import LEAST_GAIN, LEAST_POINTS, SUPPORT, coarsen
from .splats.make import Sizes, make_splats
from .splats.radii import check_radii
from .tree.build import build_tree
from .tree.settings import LOOSE_TRIM, check_settings, settings_of
from .tree.stored import stored_splats

SURFACE = "apss"  # the default: the one of the three without bias (measured in bench/)
LEVEL_SAMPLES = 2  # N of levels of detail: error and flicker of 4, in 0.86 (1,000 statues) to 0.92 (24) of the time
COARSER = 2.0  # ratio of a level's cell size to that of the level before; for the first level to the model's spacing
# Bytes a point beyond the points, while radii are found: 290 to 330 of 500,000, 262 of 2 million; noisy ones 450.
PEAK = 300
MERGED = 0.15  # share of the time for normals until second layers are merged
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
        self.settings = check_settings(surface, samples, refine, trim)
        self.surface = self.settings.surface
        scale = check_positive(radius_scale, "radius_scale")
        given = None if radii is None else check_radii(radii, len(self.points))
        smooth = check_sigma(smooth, "smooth")
        self.smooth: str | float = smooth if given is None or smooth != "auto" else 0.0
        say = progress or (lambda stage, share: None)
        self.levels: tuple[Model, ...] = ()
        _check_memory(len(self.points))
        used = _finite_rows(self.points)
        say("normals", 0.0)
        cloud = self.points if len(used) == len(self.points) else self.points.select(used)
        placed = _placed(cloud, self.smooth, given is None, partial(say, "normals"))
        self._build(placed, used, Sizes(None if given is None else given[used], scale), say)

    def _build(
        self,
        placed: Placed,
        used: NDArray[np.int32],
        sizes: Sizes,
        say: Callable[[str, float], None] = lambda stage, share: None,
    ) -> None:
        """Make splats of some rows' points, and the tree over them."""
        if len(used) > SMALL:
            give_back()
        say("radii", 0.0)
        made = make_splats(placed.points, placed.noise, used, sizes, self.settings, partial(say, "radii"))
        if made.tight:
            self.settings = self.settings._replace(trim=LOOSE_TRIM)
        self.radii: NDArray[np.float32] = np.zeros(len(self.points), np.float32)
        self.radii[used] = made.radii
        self.tree: Tree = build_tree(made.splats, self.settings, progress=partial(say, "tree"))
        self._bounds = self.points.bounds

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
        model.settings = check_settings(**options, trim="auto")
        model.points, model.surface, model.smooth, model.levels = self.points, surface, self.smooth, ()
        used = np.flatnonzero(self.points.finite).astype(np.int32)
        sizes = Sizes(self.radii[used], scale)
        model._build(self._placed(used), used, sizes, progress or (lambda stage, share: None))
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
        model.settings = settings_of(settings)
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
        radii, noise, levels = self.radii[rows], stored_splats(self.tree).noise, []
        spacing = float(np.median(radii))
        while True:
            spacing *= COARSER
            coarse, limits, noise = coarsen(cloud, radii, spacing, noise)
            if len(coarse) < LEAST_POINTS or len(coarse) * LEAST_GAIN > len(cloud):
                break
            say("levels", 1.0 - len(coarse) / len(self.points))
            levels.append(Model._level(Placed(coarse, noise), (SUPPORT * spacing, limits)))
            cloud, radii = coarse, levels[-1].radii
        self.levels = tuple(levels)

    @classmethod
    def _level(cls, placed: Placed, within: tuple[float, NDArray[np.float32]]) -> Model:
        """A level of detail. Its supports have limits: isolated points stay about as small as they were."""
        model = cls.__new__(cls)
        model.points, model.surface, model.levels, model.smooth = placed.points, "paper", (), 0.0
        model.settings = check_settings(model.surface, LEVEL_SAMPLES, 1, "auto")
        used = np.arange(len(placed.points), dtype=np.int32)
        model._build(placed, used, Sizes(within=within))  # normals are not mended: neighbours may face opposite sides
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
        rows, positions, normals, _ = stored_splats(self.tree)
        return self.points.select(rows).changed(positions=positions, normals=normals), rows

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


def _finite_rows(points: Points) -> NDArray[np.int32]:
    """The rows that are finite; a warning tells how many are not."""
    used = np.flatnonzero(points.finite).astype(np.int32)
    lost = len(points) - len(used)
    if lost:
        text = f"{lost:,} of {len(points):,} points have no finite position below {FARTHEST:g}: left out"
        warnings.warn(text, stacklevel=3)
    return used


def _placed(points: Points, sigma: str | float, merge: bool, progress: Progress) -> Placed:
    """Points with unit normals, repaired or estimated where needed, on the surface where they are noisy.

    merge : whether second layers may be moved onto the surface, unless nothing is to be smoothed
    """
    merge = merge and sigma != 0.0
    if merge:
        points = merge_for_model(points, part_of(progress, 0.0, MERGED))
    placed, message = place(points, sigma, part_of(progress, MERGED if merge else 0.0, 1.0))
    if message:
        warnings.warn(message, stacklevel=3)
    return placed


def _check_memory(count: int) -> None:
    """ValueError if the memory that so many points take while a model is made of them is not available."""
    if count < SMALL:
        return
    try:
        check_memory(PEAK * count, f"to make a model of {count:,} points")
    except ValueError as error:
        raise ValueError(f"{error}; {WAYS_OUT}") from None
