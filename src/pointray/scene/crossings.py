"""All crossings of rays with the surfaces of a scene, not only the first ones."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..base.arrays import Doubles, Flags, Floats, Indices, Rows
from ..base.progress import Progress, report_progress
from ..engine.kernels.records import INSTANCE, KIND, MODEL, SHAPE_ROW, TO_MODEL
from ..engine.kernels.tree import REFINE
from ..surface.intersect.march import START, START_UNREFINED
from ..surface.trace.cast import Pace
from .casting import intersect_snapshot
from .rays import Hits, Rays
from .separate_instances import separate_instances
from .world import Snapshot

BATCH = 1 << 20  # rays traced at a time, which limits the memory
PASSES = 10_000  # bound of the crossings of one ray, against endless loops
BEYOND = 1.2  # distance from a crossing at which the search continues, relative to the limit of the start rule
FARTHEST_START = 0.5  # the same along grazing rays, in radii
# Two crossings of one surface in a row, from the same side, are one if their distance along the ray is below the first
# limit, and their distance along the mean of their normals is within the start rule and the second limit. In radii.
REPEATED, REPEATED_DEPTH = 1.5, 0.04


class Crossings(NamedTuple):
    """Crossings of n rays with the surfaces of a scene, sorted by ray and from front to back.

    Attributes
    ----------
    ray : (m,) int64
        Index of the ray.
    t : (m,) float64
        Distance in lengths of the ray's direction.
    position : (m, 3) float64
    normal : (m, 3) float32
        Unit normal, on the side of the points' normals.
    point : (m,) int64
        Row of the splat of greatest weight, -1 for planes.
    instance : (m,) int32
        Number that `Scene.add` returned.
    entering : (m,) bool
        Whether the ray comes from the side to which the normal points.
    """

    ray: Rows
    t: Doubles
    position: Doubles
    normal: Floats
    point: Rows
    instance: Indices
    entering: Flags

    def select(self, rows: Rows | Flags) -> Crossings:
        """Return some of the crossings. rows : indices, or a mask"""
        return Crossings._make(column[rows] for column in self)


def world_scales(scene: Snapshot) -> Doubles:
    """Return the greatest scale of each instance's transform, from model to world space, (n,); 1 for planes."""
    records = scene.world.instances.reshape(-1, INSTANCE)
    scales = np.ones(len(records))
    rows = np.flatnonzero(records[:, KIND] == MODEL)
    to_model = records[rows, TO_MODEL : TO_MODEL + 12].reshape(-1, 3, 4)[:, :, :3]
    scales[rows] = 1 / np.linalg.svd(to_model, compute_uv=False).min(axis=1)
    return scales


def local_radii(scene: Snapshot, numbers: Indices, points: Rows) -> tuple[Doubles, Doubles]:
    """Return the support radii around hits in world units, (m,), and the distances at which the start rule ends.

    Both are 0 on planes.

    numbers, points : (m,), `Hits.instance` and `Hits.point`
    """
    records = scene.world.instances.reshape(-1, INSTANCE)
    radii, starts = np.zeros((2, len(points)))
    scales = world_scales(scene)
    for number in np.unique(numbers[points >= 0]):
        row = int(np.searchsorted(scene.numbers[:-1], number))
        model = scene.models[int(records[row, SHAPE_ROW])]
        here = (numbers == number) & (points >= 0)
        radii[here] = model.radii[points[here]] * scales[row]
        starts[here] = radii[here] * float(START if model.tree.head[REFINE] > 0 else START_UNREFINED)
    return radii, starts


def find_crossings(
    scene: Snapshot, shape: tuple[int, ...], rays: Rays, progress: Progress | None = None, threads: int | None = None
) -> Crossings:
    """Return all crossings of rays with the surfaces of a scene.

    The closest hits are searched for again and again, from just behind the last ones. Models whose bounds overlap are
    searched one after the other, so that they may be as near to each other as they like, even equal.

    Two crossings in a row of one model, from the same side, are one if they are nearer to each other than 5% of a
    support radius (9% without refinement), measured along their normals: rays at small angles find a surface again
    within the limit of the start rule. Layers of one model that face the same way are one surface anyway if they are
    nearer than about 0.8 radii; up to 1.6 radii the surface has a third layer between them, where its side changes.

    Parameters
    ----------
    scene : Snapshot
    shape : tuple of int
        Leading shape of the rays, an image if it has two axes; nearby rays are traced together.
    rays : tuple
        Origins and directions, (n, 3), and limits t_min, t_max, (n, 2), as returned by `check_rays`.
    progress : callable, optional
        Called with the completed share.
    threads : int, optional
        Number of threads; None for all cores.
    """
    pace, scenes = Pace(threads), separate_instances(scene)
    n = len(rays[0])
    if n <= BATCH:
        return _crossings_of_all(scenes, shape, rays, pace)
    found = []
    for start in range(0, n, BATCH):
        some = slice(start, min(start + BATCH, n))
        one = _crossings_of_all(scenes, (some.stop - start,), (rays[0][some], rays[1][some], rays[2][some]), pace)
        found.append(one._replace(ray=one.ray + start))
        report_progress(progress, some.stop / n)
    return _joined(found)


def _crossings_of_all(scenes: list[Snapshot], shape: tuple[int, ...], rays: Rays, pace: Pace) -> Crossings:
    """Return the crossings of rays with several scenes, sorted. pace : number of threads"""
    found = [_crossings(scene, shape, rays, pace) for scene in scenes]
    return found[0] if len(found) == 1 else _sorted(_joined(found))


def _crossings(scene: Snapshot, shape: tuple[int, ...], rays: Rays, pace: Pace) -> Crossings:
    """Return the crossings of rays that are traced at once. pace : number of threads"""
    origins, directions, limits = rays
    lengths = _lengths(directions)
    active, limits = np.arange(len(origins)), limits.copy()
    last = _Last(len(origins))
    found = [_no_crossings()]
    for _ in range(PASSES):
        hits = intersect_snapshot(scene, shape, (origins[active], directions[active], limits[active]), pace=pace)
        hit = np.flatnonzero(hits.instance.reshape(-1) >= 0)
        active = active[hit]
        if not len(active):
            break
        one = _crossings_at(hits, hit, active, rays)
        radii, starts = local_radii(scene, one.instance, one.point)
        new = last.update(one, lengths[active], radii, starts)
        cosine = np.abs(np.einsum("ij,ij->i", one.normal, directions[active])) / lengths[active]
        step = np.minimum(BEYOND * starts / np.maximum(cosine, 1e-6), FARTHEST_START * radii)
        step = np.maximum(step * last.factors[active] / lengths[active], 1e-12 * np.abs(one.t) + 1e-300)
        limits[active, 0] = one.t + step
        found.append(one.select(new))
        active = active[limits[active, 0] < limits[active, 1]]
        shape = (len(active),)
    every = _sorted(_joined(found))
    return _sorted(_joined([every, _missed_exits(scene, every, rays, pace)]))


def _missed_exits(scene: Snapshot, every: Crossings, rays: Rays, pace: Pace) -> Crossings:
    """Return the crossings at which rays leave a surface that they have only grazed, which the search misses.

    A ray that is less than the limit of the start rule below a surface, where the search continues, counts as outside.
    Rays in the opposite direction, from the next crossing on, find its exit.

    every : crossings, sorted; pace : number of threads
    """
    same_ray = every.ray[1:] == every.ray[:-1]
    alone = np.flatnonzero(every.entering & ~np.append(same_ray & ~every.entering[1:], False) & (every.point >= 0))
    if not len(alone):
        return _no_crossings()
    one, directions, last = every.select(alone), rays[1][every.ray[alone]], rays[2][every.ray[alone], 1]
    size = float(np.linalg.norm(np.diff(scene.bounds, axis=0)))
    end = np.minimum(one.t + 2 * size / _lengths(directions), last)
    followed = np.append(same_ray, False)[alone]
    end[followed] = every.t[alone[followed] + 1]
    back = one.t[:, None] * directions - end[:, None] * directions
    start = one.position - back
    hits = intersect_snapshot(scene, (len(alone),), (start, back, np.tile([0.0, 1.0], (len(alone), 1))), pace=pace)
    out = _crossings_at(hits, np.arange(len(alone)), one.ray, rays)
    return out.select((hits.instance == one.instance) & ~out.entering & (out.t > one.t) & (out.t < end))


def _lengths(directions: Doubles) -> Doubles:
    """Return the lengths of directions, (n, 3), whose squares may not be finite; those that miss have any length."""
    most = np.abs(directions).max(axis=1, initial=0)
    most = np.where((most > 0) & (most < np.inf), most, 1.0)
    return np.asarray(most * np.linalg.norm(directions / most[:, None], axis=1))


def _joined(found: list[Crossings]) -> Crossings:
    return Crossings(*(np.concatenate(columns) for columns in zip(*found, strict=True)))


def _sorted(every: Crossings) -> Crossings:
    """Return crossings sorted by ray and t."""
    return every.select(np.lexsort((every.t, every.ray)))


class _Last:
    """The last crossing of each of n rays, to recognize a surface that is found twice.

    A ray that crosses a surface at a small angle may start on it again, if its start is still within the limit of the
    start rule. Another sheet of the surface is distinguished by its distance along the normals.

    Attributes
    ----------
    factors : (n,) float64
        Factor for the distance at which the search continues; it doubles with every crossing that is found twice.
    """

    def __init__(self, n: int) -> None:
        self.factors = np.ones(n)
        self._t, self._instance, self._entering = np.full(n, -np.inf), np.full(n, -1, np.int32), np.zeros(n, np.bool_)
        self._position, self._normal = np.zeros((n, 3)), np.zeros((n, 3), np.float32)

    def update(self, one: Crossings, lengths: Doubles, radii: Doubles, starts: Doubles) -> Flags:
        """Return which crossings, at most one of each ray, are new, and keep all of them.

        lengths : (m,), lengths of the rays' directions; radii, starts : (m,), see `local_radii`
        """
        ray = one.ray
        same = (self._instance[ray] == one.instance) & (one.entering == self._entering[ray])
        same &= (one.t - self._t[ray]) * lengths < REPEATED * self.factors[ray] * radii
        # On an arc, the mean of two normals is perpendicular to the chord.
        step, mean = one.position - self._position[ray], 0.5 * (one.normal + self._normal[ray])
        same &= np.abs(np.einsum("ij,ij->i", step, mean)) < starts + REPEATED_DEPTH * radii
        self.factors[ray] = np.where(same, 2 * self.factors[ray], 1.0)
        self._t[ray], self._instance[ray], self._entering[ray] = one.t, one.instance, one.entering
        self._position[ray], self._normal[ray] = one.position, one.normal
        return ~same


def _crossings_at(hits: Hits, hit: Rows, active: Rows, rays: Rays) -> Crossings:
    """Return hits as crossings, with t in float64, computed from their positions.

    hit : (m,), rows of the hits; active : (m,), indices of their rays
    """
    position, normal = hits.position.reshape(-1, 3)[hit], hits.normal.reshape(-1, 3)[hit]
    origins, directions = rays[0][active], rays[1][active]
    most = np.abs(directions).max(axis=1, keepdims=True)  # the square of a very long or short direction is not finite
    unit = directions / most
    t = np.einsum("ij,ij->i", position - origins, unit) / np.einsum("ij,ij->i", unit, unit) / most[:, 0]
    entering = np.einsum("ij,ij->i", normal, unit) < 0
    return Crossings(active, t, position, normal, hits.point.reshape(-1)[hit], hits.instance.reshape(-1)[hit], entering)


def _no_crossings() -> Crossings:
    rows, flags = np.zeros(0, np.int64), np.zeros(0, np.bool_)
    return Crossings(
        rows, np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3), np.float32), rows, np.zeros(0, np.int32), flags
    )
