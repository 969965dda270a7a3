"""The geometries of a `RaycastingScene`: points and sampled meshes, and the IDs of what rays hit."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.arguments import check_whole, wrong
from ..base.arrays import Doubles, Indices, Rows
from ..model.model import Model
from ..scene.scene import Scene
from .mesh_samples import Triangles, mesh_arrays, sample_triangles

INVALID_ID = 0xFFFFFFFF
UInts = NDArray[np.uint32]


class Geometries:
    """Base class of `RaycastingScene`: adds geometries, and describes hits on them."""

    INVALID_ID = INVALID_ID

    def __init__(self, nthreads: int = 0, device: Any = None) -> None:
        check_whole(nthreads, "nthreads", 0)
        if device is not None and "cpu" not in str(device).lower():
            raise wrong("device", "a CPU: other devices are not supported", str(device))
        self._scene = Scene()
        self._triangles: dict[int, Triangles] = {}

    def add_points(self, points: Any, radii: ArrayLike | None = None, **options: Any) -> int:
        """Add points to the scene, and return the ID of the geometry.

        Parameters
        ----------
        points : Points, array_like or Model
            What `pr.Model` takes, or a model.
        radii : (n,) array_like, optional
            Support radius of each point.
        **options
            Other parameters of `pr.Model`, such as `surface` and `scatter`.

        Returns
        -------
        int
            0 for the first geometry, 1 for the second one, ...

        Raises
        ------
        TypeError, ValueError
            As `pr.Model`; ValueError if options are given with a model.
        """
        if isinstance(points, Model):
            if radii is not None or options:
                raise ValueError("radii and options apply to points, not to a Model, which has its own")
            return self._scene.add(points)
        return self._scene.add(Model(points, radii, **options))

    def add_triangles(
        self, vertex_positions: Any = None, triangle_indices: Any = None, *, mesh: Any = None, samples: int = 200_000
    ) -> int:
        """Sample points on a triangle mesh, add them to the scene, and return the ID of the geometry.

        Rays hit the surface of the sampled points: it is that of the mesh, except that its edges are rounded within
        about the spacing of the samples, and its open borders end within that distance. A warning states the spacing.
        `primitive_ids` are indices of triangles, that of the sample with the greatest weight, and `primitive_uvs` the
        barycentric coordinates in that triangle.

        Parameters
        ----------
        vertex_positions : (v, 3) array_like, or a mesh
            A mesh of Open3D or trimesh as the only argument is that of the parameter `mesh`.
        triangle_indices : (m, 3) array_like of int
        mesh : optional
            Mesh of Open3D (tensors or legacy) or trimesh.
        samples : int
            Number of points.

        Returns
        -------
        int

        Raises
        ------
        TypeError
            If the mesh has an unknown type.
        ValueError
            If a shape or an index is invalid, or the mesh has no triangles or no area.
        """
        count = check_whole(samples, "samples", 100)
        vertices, faces = mesh_arrays(vertex_positions, triangle_indices, mesh)
        points, triangles = sample_triangles(vertices, faces, count)
        model = Model(points, smooth=0.0, scatter="surface")
        spacing = model.spacing / 1.15
        warnings.warn(
            f"the mesh is represented by {count:,} points sampled every {spacing:.3g} units: edges are rounded within "
            "about that distance; `samples` changes it",
            stacklevel=2,
        )
        number = self._scene.add(model)  # after the warning, which may be an error
        self._triangles[number] = triangles
        return number

    def _primitives(
        self, shape: tuple[int, ...], instance: Indices, point: Rows, position: Doubles, normal: NDArray[Any]
    ) -> dict[str, NDArray[Any]]:
        """Return the IDs, coordinates and normals of hits, in arrays of a leading shape. instance : -1 for a miss"""
        ids, uvs, normals = point.copy(), np.zeros((len(point), 2), np.float32), normal.astype(np.float32)
        for number, triangles in self._triangles.items():
            here = np.flatnonzero(instance == number)
            ids[here] = triangles.of_point[point[here]]
            uvs[here] = triangles.coordinates(ids[here], position[here])
            normals[here] = triangles.normals[ids[here]]
        return {
            "geometry_ids": _as_ids(instance).reshape(shape),
            "primitive_ids": _as_ids(ids).reshape(shape),
            "primitive_uvs": uvs.reshape(*shape, 2),
            "primitive_normals": normals.reshape(*shape, 3),
        }


def _as_ids(numbers: NDArray[Any]) -> UInts:
    """Return numbers as uint32, INVALID_ID for -1."""
    return np.where(numbers < 0, INVALID_ID, numbers).astype(np.uint32)
