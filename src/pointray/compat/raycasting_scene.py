"""`RaycastingScene`: the interface of Open3D's class of that name, for points."""

from __future__ import annotations

from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from ..base.arguments import check_number, check_whole
from ..base.arrays import Doubles, Flags, Floats, Indices
from ..scene.casting import intersect_snapshot, occluded_snapshot
from ..scene.crossings import Crossings, find_crossings
from ..scene.nearest_surface import ClosestPoints, NearestSurface
from ..scene.rays import Rays
from ..scene.world import Snapshot
from ..surface.trace.cast import Pace
from .geometries import Geometries
from .occupancy import check_samples, is_inside
from .pinhole import create_rays, create_rays_of_view
from .tensors import as_rows

MOST_THREADS = 1 << 16


class RaycastingScene(Geometries):
    """Scene for ray casting and closest point queries, with the interface of `open3d.t.geometry.RaycastingScene`.

    Points are added with `add_points`. Arguments are arrays of NumPy, or tensors of Open3D, PyTorch and others; results
    are arrays of NumPy with the names, shapes and dtypes of Open3D's, so that `.numpy()` is not needed.

    `primitive_ids` are rows of the points: that of the splat with the greatest weight. `primitive_uvs` are 0, and
    `primitive_normals` are the normals of the surface. Geometry and primitive IDs of misses are `INVALID_ID`.

    Parameters
    ----------
    nthreads : int
        Accepted for compatibility: models are built on all cores.
    device : optional
        Accepted for compatibility: a device other than the CPU is a ValueError.

    Examples
    --------
    >>> from pointray.compat import RaycastingScene
    >>> scene = RaycastingScene()
    >>> scene.add_points(pr.procedural("sphere", 1000))
    0
    >>> scene.cast_rays([[0, -5, 0, 0, 1, 0], [0, -5, 3, 0, 1, 0]])["t_hit"].round(2).tolist()
    [4.0, inf]
    """

    _nearest: tuple[Snapshot, NearestSurface] | None = None  # of the scene as it was at the last query

    def cast_rays(self, rays: Any, nthreads: int = 0) -> dict[str, NDArray[Any]]:
        """Return the first hit of each ray.

        Parameters
        ----------
        rays : (..., 6) array_like
            Origin and direction. Directions need not be normalized: t is in lengths of the direction.
        nthreads : int
            Number of threads; 0: all cores.

        Returns
        -------
        dict
            t_hit : (...) float32, inf for a miss
            geometry_ids, primitive_ids : (...) uint32, `INVALID_ID` for a miss
            primitive_uvs : (..., 2) float32
            primitive_normals : (..., 3) float32, not flipped towards the ray, 0 for a miss

        Raises
        ------
        TypeError, ValueError
            If an argument has the wrong type, shape or value.
        """
        shape, checked = _check_rays(rays)
        hits = intersect_snapshot(self._scene.snapshot(), shape, checked, pace=Pace(_threads(nthreads)))
        found = hits.instance.reshape(-1), hits.point.reshape(-1), hits.position.reshape(-1, 3)
        return {"t_hit": hits.t, **self._primitives(shape, *found, hits.normal.reshape(-1, 3))}

    def test_occlusions(self, rays: Any, tnear: float = 0.0, tfar: float = np.inf, nthreads: int = 0) -> Flags:
        """Return whether each ray hits anything between tnear and tfar.

        Parameters
        ----------
        rays : (..., 6) array_like
            Origin and direction.
        tnear, tfar : float
            Range of hits that count, in lengths of the direction. Hits behind the origin never count, and none does if
            one of the limits is NaN.
        nthreads : int
            Number of threads; 0: all cores.

        Returns
        -------
        (...) bool

        Raises
        ------
        TypeError, ValueError
            If an argument has the wrong type, shape or value.
        """
        near, far = _limit(tnear, "tnear"), _limit(tfar, "tfar")
        shape, (origins, directions, limits) = _check_rays(rays)
        limits[:] = np.maximum(near, 0.0), far
        pace = Pace(_threads(nthreads))
        return occluded_snapshot(self._scene.snapshot(), shape, (origins, directions, limits), pace)

    def count_intersections(self, rays: Any, nthreads: int = 0) -> Indices:
        """Return the number of intersections of each ray with the surfaces.

        Parameters
        ----------
        rays : (..., 6) array_like
            Origin and direction.
        nthreads : int
            Number of threads; 0: all cores.

        Returns
        -------
        (...) int32

        Raises
        ------
        TypeError, ValueError
            If an argument has the wrong type, shape or value.
        """
        shape, found = self._crossings(rays, nthreads)
        return np.bincount(found.ray, minlength=int(np.prod(shape))).astype(np.int32).reshape(shape)

    def list_intersections(self, rays: Any, nthreads: int = 0) -> dict[str, NDArray[Any]]:
        """Return all intersections of rays with the surfaces, sorted by ray and from front to back.

        Parameters
        ----------
        rays : (..., 6) array_like
            Origin and direction; n rays.
        nthreads : int
            Number of threads; 0: all cores.

        Returns
        -------
        dict
            ray_splits : (n + 1,) uint32, where the intersections of each ray begin, and their number
            ray_ids : (m,) uint32
            t_hit : (m,) float32, in lengths of the direction
            geometry_ids, primitive_ids : (m,) uint32
            primitive_uvs : (m, 2) float32

        Raises
        ------
        TypeError, ValueError
            If an argument has the wrong type, shape or value.
        """
        shape, found = self._crossings(rays, nthreads)
        counts = np.bincount(found.ray, minlength=int(np.prod(shape)))
        about = self._primitives((len(found.t),), found.instance, found.point, found.position, found.normal)
        del about["primitive_normals"]
        return {
            "ray_splits": np.concatenate([[0], np.cumsum(counts)]).astype(np.uint32),
            "ray_ids": found.ray.astype(np.uint32),
            "t_hit": _narrow(found.t),
            **about,
        }

    def compute_closest_points(self, query_points: Any, nthreads: int = 0) -> dict[str, NDArray[Any]]:
        """Return the closest points on the surfaces.

        Parameters
        ----------
        query_points : (..., 3) array_like
        nthreads : int
            Number of threads; 0: all cores.

        Returns
        -------
        dict
            points : (..., 3) float32, NaN for queries that are not finite
            geometry_ids, primitive_ids : (...) uint32, `INVALID_ID` for these
            primitive_uvs : (..., 2) float32, 0 for these
            primitive_normals : (..., 3) float32, NaN for these

        Raises
        ------
        TypeError, ValueError
            If an argument has the wrong type or shape, or the scene is empty.
        """
        shape, _, found = self._closest(query_points, nthreads)
        about = self._primitives(shape, found.instance, found.point, found.position, found.normal)
        return {"points": found.position.astype(np.float32).reshape(*shape, 3), **about}

    def compute_distance(self, query_points: Any, nthreads: int = 0) -> Floats:
        """Return the distance to the surfaces, (...) float32.

        Parameters
        ----------
        query_points : (..., 3) array_like
        nthreads : int
            Number of threads; 0: all cores.

        Returns
        -------
        (...) float32
            NaN for queries that are not finite.

        Raises
        ------
        TypeError, ValueError
            If an argument has the wrong type or shape, or the scene is empty.
        """
        shape, _, found = self._closest(query_points, nthreads)
        return _narrow(np.abs(found.distance)).reshape(shape)

    def compute_signed_distance(self, query_points: Any, nthreads: int = 0, nsamples: int = 1) -> Floats:
        """Return the signed distance to the surfaces, negative inside closed surfaces.

        Parameters
        ----------
        query_points : (..., 3) array_like
        nthreads : int
            Number of threads; 0: all cores.
        nsamples : int
            Number of rays that decide what is inside, odd, see `compute_occupancy`.

        Returns
        -------
        (...) float32
            NaN for queries that are not finite.

        Raises
        ------
        TypeError, ValueError
            If an argument has the wrong type, shape or value, or the scene is empty.
        """
        shape, x, found = self._closest(query_points, nthreads)
        inside = self._is_inside(x, nthreads, nsamples)
        return (_narrow(np.abs(found.distance)) * np.where(inside, -1, 1).astype(np.float32)).reshape(shape)

    def compute_occupancy(self, query_points: Any, nthreads: int = 0, nsamples: int = 1) -> Floats:
        """Return 1 for positions inside closed surfaces and 0 for others.

        A position is inside if a ray from it crosses surfaces an odd number of times. Rays in other directions decide
        where that contradicts the side from which the first surface is hit, as at the holes of a scan.

        Parameters
        ----------
        query_points : (..., 3) array_like
        nthreads : int
            Number of threads; 0: all cores.
        nsamples : int
            Number of rays for each position, odd, at most 99,999; the majority decides. At least three are cast.

        Returns
        -------
        (...) float32

        Raises
        ------
        TypeError, ValueError
            If an argument has the wrong type, shape or value.
        """
        x = as_rows(query_points, "query_points", 3)
        inside = self._is_inside(x.reshape(-1, 3), nthreads, nsamples)
        return inside.astype(np.float32).reshape(x.shape[:-1])

    @overload
    @staticmethod
    def create_rays_pinhole(intrinsic_matrix: Any, extrinsic_matrix: Any, width_px: int, height_px: int) -> Floats: ...

    @overload
    @staticmethod
    def create_rays_pinhole(
        fov_deg: float, center: Any, eye: Any, up: Any, width_px: int, height_px: int
    ) -> Floats: ...

    @staticmethod
    def create_rays_pinhole(*args: Any, **given: Any) -> Floats:
        """Return the rays of a pinhole camera through the centres of its pixels.

        Call it with `intrinsic_matrix`, `extrinsic_matrix`, `width_px` and `height_px`, or with `fov_deg`, `center`,
        `eye`, `up`, `width_px` and `height_px`.

        Parameters
        ----------
        intrinsic_matrix : (3, 3) array_like
            Upper triangular, in pixels.
        extrinsic_matrix : (4, 4) array_like
            From world to camera space: x to the right, y down, z forward.
        fov_deg : float
            Horizontal field of view, degrees.
        center, eye, up : (3,) array_like
            The point in the centre of the image, the camera's position, and its up direction.
        width_px, height_px : int
            Size of the image in pixels.

        Returns
        -------
        (height_px, width_px, 6) float32
            Origin and direction. Directions have the length 1 along the view, so that t is the depth. As in Open3D,
            the first row of the second form is the lowest one: the camera's y axis is `up`.

        Raises
        ------
        TypeError, ValueError
            If an argument is missing, or has the wrong type, shape or value.
        """
        from_view = "fov_deg" in given or (args and np.ndim(args[0]) == 0)
        return (create_rays_of_view if from_view else create_rays)(*args, **given)

    def _crossings(self, rays: Any, nthreads: int) -> tuple[tuple[int, ...], Crossings]:
        shape, checked = _check_rays(rays)
        return shape, find_crossings(self._scene.snapshot(), shape, checked, threads=_threads(nthreads))

    def _closest(self, queries: Any, nthreads: int) -> tuple[tuple[int, ...], Doubles, ClosestPoints]:
        """Return the leading shape of queries, the queries as (n, 3), and their closest points."""
        x, threads = as_rows(queries, "query_points", 3), _threads(nthreads)
        flat, now = x.reshape(-1, 3), self._scene.snapshot()
        known = self._nearest
        if known is None or known[0] is not now:
            known = self._nearest = now, NearestSurface(now)
        return x.shape[:-1], flat, known[1].find(flat, threads)

    def _is_inside(self, x: Doubles, nthreads: int, nsamples: int) -> Flags:
        """Return which positions, (n, 3), are inside of closed surfaces."""
        return is_inside(self._scene.snapshot(), x, check_samples(nsamples), _threads(nthreads))


def _narrow(values: Doubles) -> Floats:
    """Return distances as float32, which are finite if the values are."""
    most = np.finfo(np.float32).max
    return np.where(np.isfinite(values), np.minimum(values, most), values).astype(np.float32)


def _threads(nthreads: Any) -> int | None:
    """Return a number of threads; None for all cores, or as many as there are."""
    return min(check_whole(nthreads, "nthreads", 0), MOST_THREADS) or None


def _limit(value: Any, name: str) -> float:
    """Return a limit of rays, which may be infinite or NaN."""
    is_nan = isinstance(value, float | np.floating) and bool(np.isnan(value))
    return np.nan if is_nan else check_number(value, name, "a number", lambda x: True)


def _check_rays(rays: Any) -> tuple[tuple[int, ...], Rays]:
    """Return the leading shape of rays, (..., 6), and their origins, directions, (n, 3), and limits, (n, 2)."""
    array = as_rows(rays, "rays", 6)
    flat = array.reshape(-1, 6)
    limits = np.tile([0.0, np.inf], (len(flat), 1))
    return array.shape[:-1], (np.ascontiguousarray(flat[:, :3]), np.ascontiguousarray(flat[:, 3:]), limits)
